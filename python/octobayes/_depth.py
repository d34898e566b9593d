"""Where can depth be trusted, and how far may it be off?"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from . import _octobayes
from ._api import Nerf, _asked, _field, _image_options, _opened, _remarks, _training_cameras, _warn, uncertainty
from ._arguments import array, flag, whole, wrong
from ._defaults import DEFAULT
from ._progress import Progress, reporting
from ._uncertainty import Uncertainty

#: What each number of the arrays 'trust' means.
TRUST = {
    255: "trusted",
    192: "fewer than three cameras see a surface there",
    128: "most cameras that see the place see through it",
    64: "no other camera sees it",
    0: "nothing is shown",
}
#: Longest side of depth maps unless ``stride`` is given, pixels.
SIDE = 640


def depth(
    nerf: Nerf,
    cameras: Any = None,
    u: Uncertainty | str | None = None,
    *,
    photographs: Sequence[int] | None = None,
    stride: int | None = None,
    images: bool = True,
    z_depth: bool = False,
    noise: float | None = None,
    background: Any = None,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    force: bool = False,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> list[dict[str, Any]]:
    """Depth maps of the training views, how far depths may be off, and which can be trusted, as ``octobayes depth``.

    nerf, cameras and the arguments not explained here: as in :func:`uncertainty`. u: its uncertainty, of scale='data'
    (``uncertainty(..., for_='depth')``); ``None`` computes it first, as the command does. photographs: numbers of the
    training cameras to look through; ``None`` for all. stride: every so many pixels along x and y; ``None`` for at most
    640 along the longer side. images: whether the images beside the cameras make deviations more precise, if all are
    there. z_depth: along the optical axis instead of the distance from the camera, deviations likewise.

    Returns a dictionary for each photograph: 'camera' (its number), 'name', and arrays ``[H, W]``: 'depth' and 'sigma'
    (float32, scene units; NaN where more than half of the light passes; 1.645 'sigma' hold 90 % of normal errors) and
    'trust' (uint8, see ``octobayes.TRUST``: 255 can be trusted). Raises as :func:`uncertainty` does.
    """
    settings = {"background": background, "views": views, "resolution": resolution, "fov": fov, "force": force}
    look = _Look(nerf, cameras, u, images, noise, batch, settings)
    chosen = range(len(look.rows)) if photographs is None else photographs
    if not isinstance(chosen, Iterable):
        raise wrong("photographs", "numbers of training cameras", photographs)
    chosen = [whole("photographs", i, 0, len(look.rows) - 1) for i in chosen]
    longest = [int(look.rows[i, 20:22].max()) for i in chosen]
    every = None if stride is None else whole("stride", stride, 1, 1024)
    strides = [-(-side // SIDE) if every is None else every for side in longest]
    own = {"photographs": chosen, "strides": strides, "z_depth": flag("z_depth", z_depth)}
    asked, field, options = look.ready(progress)
    with reporting(progress) as report:
        maps, said = _octobayes.depth(asked, field, look.rows, options | own, report)
    _warn([*said, *_remarks(asked)])
    return maps


def measure(
    nerf: Nerf,
    a: Any,
    b: Any,
    cameras: Any = None,
    u: Uncertainty | str | None = None,
    *,
    images: bool = True,
    noise: float | None = None,
    background: Any = None,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    force: bool = False,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> dict[str, Any]:
    """The distance of two points on surfaces with its standard deviation, as ``octobayes measure``.

    a, b: points ``[3]``, scene units. Each is moved to the surface that a training camera sees there, along the view in
    which its depth has the smallest deviation; ValueError says where the nearest surface is if there is none. The other
    arguments: as in :func:`depth`.

    Returns 'length', 'sigma', 'interval_90' (low, high), 'correlation' (of the two depths) and 'points': for each
    'position', 'view', 'sigma' along that view, and 'trust'.
    """
    points = [_point(name, value) for name, value in (("a", a), ("b", b))]
    settings = {"background": background, "views": views, "resolution": resolution, "fov": fov, "force": force}
    look = _Look(nerf, cameras, u, images, noise, batch, settings)
    asked, field, options = look.ready(progress)
    with reporting(progress) as report:
        text, said = _octobayes.measure(asked, field, look.rows, points, options, report)
    _warn([*said, *_remarks(asked)])
    return json.loads(text)


class _Look:
    """A model and its training cameras, checked before its uncertainty is computed."""

    def __init__(
        self, nerf: Any, cameras: Any, u: Any, images: bool, noise: float | None, batch: int, settings: dict[str, Any]
    ) -> None:
        if u is not None:
            for name, value in (("noise", noise), ("background", settings["background"])):
                if value is not None:
                    raise wrong(name, "None beside u, which was computed with its own", value)
        self._u = None if u is None else _field("u", u)
        self._nerf, self._batch = _opened(nerf, cameras, self._u), whole("batch", batch, 1)
        self._cameras, self._settings = cameras, settings | {"noise": noise, "batch": batch}
        self._images = flag("images", images)
        seen = [settings[name] for name in ("views", "resolution", "fov")]
        self._found = _training_cameras(self._nerf, cameras, *seen)
        self.rows = np.ascontiguousarray(self._found.rows)

    def ready(self, progress: Any) -> tuple[Any, Any, dict[str, Any]]:
        """What is asked, its uncertainty, which is computed if it was not given, and how rays pass through it."""
        u = self._u
        if u is None:
            preset = {"for_": "depth", "rays": DEFAULT.depth_rays, "gradient": "auto"}
            u = uncertainty(self._nerf, self._cameras, **preset, **self._settings, progress=progress)
        options = {
            **_image_options(self._nerf, None, None, None, DEFAULT.occupancy, u),
            **self._found.options(),
            "images": self._images,
        }
        return _asked(self._nerf, None, None, self._batch, u), u._field, options


def _point(name: str, value: Any) -> list[float]:
    found = array(name, value)
    if found.shape != (3,) or found.dtype.kind not in "iuf" or not np.isfinite(found).all():
        raise wrong(name, "three finite numbers, scene units", value)
    return [float(v) for v in found]
