"""Which splats would a scene be better without?"""

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
from ._progress import Progress, reporting
from ._splats import Splats

#: Why a splat goes, by number; 0 is that it stays.
REASONS = ("kept", *DEFAULT.clean_reasons)
#: How much goes.
STRENGTHS = tuple(DEFAULT.clean_strengths)


@dataclass(frozen=True)
class Cleaned:
    """What is left of splats, and what the training views show of each: arrays ``[n]``."""

    #: Which splats stay.
    kept: NDArray[np.bool_]
    #: Why each goes, one of 'floating', 'unseen', 'outside', 'transparent', or 'kept'.
    reason: NDArray[np.str_]
    #: 'score' (how far views contradict it, at most 1), 'front_share' (the part of its weight that is in front of
    #: what pixels show), 'weight' (sum of its shares of the pixels that were looked at), 'views' (training views that
    #: show it).
    columns: dict[str, np.ndarray]
    _splats: Splats

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the splats that stay: ``.ply``, ``.compressed.ply``, ``.spz`` or ``.splat``."""
        path = as_path("path", path)
        if os.path.exists(path) and os.path.samefile(path, self._splats.name):
            raise wrong("path", "a file other than the model", path)
        _octobayes.write_kept_splats(self._splats._model, self.kept, path)


def clean(
    splats: Splats | str | os.PathLike[str],
    cameras: Any,
    *,
    strength: str = DEFAULT.clean_strength,
    pixels: int = DEFAULT.clean_pixels,
    pixel_offset: float = 0.5,
    views: Any = None,
    resolution: Any = None,
    progress: Progress | bool | None = None,
) -> Cleaned:
    """Finds floaters, and what no camera saw, as the command ``octobayes clean``.

    Masks are not applied, and images are not compared with the splats: the command does both.

    splats: a file, or :func:`open_model` of one. cameras: those of its training, as in :func:`uncertainty`. strength:
    'careful', 'normal' or 'strong'. pixels: how many are looked at, over all cameras. Raises ValueError if the cameras
    show nothing of the splats.
    """
    if strength not in STRENGTHS:
        raise wrong("strength", ", ".join(STRENGTHS), strength)
    splats = _opened(splats, cameras, None)
    if not isinstance(splats, Splats):
        raise wrong("splats", "Gaussian splats, or a file of these", splats)
    rows = np.ascontiguousarray(_training_cameras(splats, cameras, views, resolution, None).rows)
    offset, pixels = real("pixel_offset", pixel_offset), whole("pixels", pixels, 1)
    with reporting(progress) as report:
        columns = _octobayes.clean_splats(splats._model, rows, offset, pixels, report)
    reason, at = columns.pop("reason"), columns.pop("strength")
    gone = (at > 0) & (at <= 1 + STRENGTHS.index(strength))
    return Cleaned(~gone, np.array(REASONS)[np.where(gone, reason, 0)], columns, splats)
