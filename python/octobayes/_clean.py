"""What would a scene be better without?"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _octobayes
from ._api import _opened, _training_cameras
from ._arguments import path as as_path
from ._arguments import real, whole, wrong
from ._defaults import DEFAULT
from ._model import Model, Opened
from ._progress import Progress, reporting
from ._splats import Splats

#: Why a part goes, by number; 0 is that it stays.
REASONS = ("kept", *DEFAULT.clean_reasons)
#: How much goes.
STRENGTHS = tuple(DEFAULT.clean_strengths)


@dataclass(frozen=True)
class Cleaned:
    """What is left of a model, and what the training views show of its n parts: splats, or cells of a volume."""

    #: ``[n]``: which parts stay.
    kept: NDArray[np.bool_]
    #: ``[n]``: why each goes, one of 'floating', 'unseen', 'outside', 'transparent', or 'kept'.
    reason: NDArray[np.str_]
    #: ``[n, 3]``: centres of the parts, scene units. A cell is a part if a pixel shows it, or if it has
    #: matter that no camera has in its image.
    position: NDArray[np.float32]
    #: ``[n]`` each: 'score' (how far views contradict it, at most 1), 'front_share' (the part of its weight that is in
    #: front of what pixels show), 'weight' (sum of its shares of the pixels that were looked at), 'views' (training
    #: views that show it).
    columns: dict[str, np.ndarray]
    _model: Opened
    _found: Any
    _strength: str

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        points: int = DEFAULT.clean_points,
        progress: Progress | bool | None = None,
    ) -> None:
        """Writes what stays.

        path: of splats ``.ply``, ``.compressed.ply``, ``.spz`` or ``.splat``; of a hash grid of ``octobayes train``
        ``.safetensors``; of any volume ``.npz``, a voxel grid. points: along its longest edge, if the model is none.
        """
        path, points = as_path("path", path), whole("points", points, 2, 1024)
        if os.path.exists(path) and os.path.exists(self._model.name) and os.path.samefile(path, self._model.name):
            raise wrong("path", "a file other than the model", path)
        with reporting(progress) as report:
            self._found.write(path, self._strength, points, report)


def clean(
    nerf: Model | Splats | str | os.PathLike[str],
    cameras: Any = None,
    *,
    strength: str = DEFAULT.clean_strength,
    pixels: int = DEFAULT.clean_pixels,
    pixel_offset: float | None = None,
    points: int = DEFAULT.clean_points,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    progress: Progress | bool | None = None,
) -> Cleaned:
    """Finds floaters, and what no camera saw, as the command ``octobayes clean``.

    Images are not compared with the model, as the command does. Masks that lie beside the cameras are applied.

    nerf: a file, or :func:`open_model` of one. cameras: those of its training, as in :func:`uncertainty`; ``None`` for
    the model's own. strength: 'careful', 'normal' or 'strong'. pixels: how many are looked at, over all cameras.
    pixel_offset: where in a pixel its ray goes; ``None`` for the middle, or what the model was trained with. points: of
    a volume that has no grid of its own; its cells are no smaller. Raises ValueError if the cameras show nothing of
    the model.
    """
    if strength not in STRENGTHS:
        raise wrong("strength", ", ".join(STRENGTHS), strength)
    model = _opened(nerf, cameras, None)
    if not isinstance(model, Opened):
        raise wrong("nerf", "a model file, or open_model of one", model)
    chosen = _training_cameras(model, cameras, views, resolution, fov)
    offset = getattr(model, "pixel_offset", 0.5) if pixel_offset is None else real("pixel_offset", pixel_offset)
    options = {"pixels": whole("pixels", pixels, 1), "points": whole("points", points, 2, 1024), "pixel_offset": offset}
    options |= chosen.options()
    with reporting(progress) as report:
        found = _octobayes.clean(model._model, np.ascontiguousarray(chosen.rows), options, report)
    position, columns = found.columns()
    reason, at = columns.pop("reason"), columns.pop("strength")
    gone = (at > 0) & (at <= 1 + STRENGTHS.index(strength))
    reasons = np.array(REASONS)[np.where(gone, reason, 0)]
    return Cleaned(~gone, reasons, position, columns, model, found, strength)
