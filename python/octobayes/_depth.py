"""Where can depth be trusted, and how far may it be off?"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
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
    (float32, scene units; one standard deviation, 1.645 of which hold 90 % of the errors if these are normal; NaN where
    more than half of the light passes), and 'trust' (uint8, see ``octobayes.TRUST``: 255 can be trusted). Raises as
    :func:`uncertainty` does.
    """
    settings = (noise, background, views, resolution, fov, force)
    nerf, found, u, options = _look(nerf, cameras, u, images, *settings, progress)
    count = len(found.rows)
    chosen = range(count) if photographs is None else photographs
    chosen = [whole("photographs", i, 0, count - 1) for i in chosen]
    longest = int(found.rows[chosen, 20:22].max()) if chosen else 1
    options |= {
        "photographs": chosen,
        "stride": -(-longest // SIDE) if stride is None else whole("stride", stride, 1, 1024),
        "z_depth": flag("z_depth", z_depth),
    }
    asked = _asked(nerf, None, None, batch, u)
    with reporting(progress) as report:
        maps, said = _octobayes.depth(asked, u._field, np.ascontiguousarray(found.rows), options, report)
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
    settings = (noise, background, views, resolution, fov, force)
    nerf, found, u, options = _look(nerf, cameras, u, images, *settings, progress)
    points = [_point(name, value) for name, value in (("a", a), ("b", b))]
    asked = _asked(nerf, None, None, batch, u)
    rows = np.ascontiguousarray(found.rows)
    with reporting(progress) as report:
        text, said = _octobayes.measure(asked, u._field, rows, points, options, report)
    _warn([*said, *_remarks(asked)])
    return json.loads(text)


def _look(
    nerf: Any,
    cameras: Any,
    u: Any,
    images: bool,
    noise: float | None,
    background: Any,
    views: Any,
    resolution: Any,
    fov: float | None,
    force: bool,
    progress: Any,
) -> tuple[Any, Any, Uncertainty, dict[str, Any]]:
    """The model, its training cameras, its uncertainty, and how both are looked at."""
    if u is not None:
        for name, value in (("noise", noise), ("background", background)):
            if value is not None:
                raise wrong(name, "None beside u, which was computed with its own", value)
    u = None if u is None else _field("u", u)
    nerf = _opened(nerf, cameras, u)
    if u is None:
        u = uncertainty(
            nerf,
            cameras,
            for_="depth",
            rays=DEFAULT.depth_rays,
            gradient="auto",
            noise=noise,
            background=background,
            views=views,
            resolution=resolution,
            fov=fov,
            force=force,
            progress=progress,
        )
    found = _training_cameras(nerf, cameras, views, resolution, fov)
    options = {
        **_image_options(nerf, None, None, None, DEFAULT.occupancy, u),
        **found.options(),
        "images": flag("images", images),
    }
    return nerf, found, u, options


def _point(name: str, value: Any) -> list[float]:
    found = array(name, value)
    if found.shape != (3,) or found.dtype.kind not in "iuf" or not np.isfinite(found).all():
        raise wrong(name, "three finite numbers, scene units", os.fspath(value) if isinstance(value, str) else value)
    return [float(v) for v in found]
