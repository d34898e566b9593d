"""Files for other people's tools."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from . import _octobayes
from ._api import Nerf, _asked, _field, _image_options, _opened, _remarks, _threshold, _training_cameras, _warn
from ._arguments import flag, real, whole, wrong
from ._arguments import path as as_path
from ._cameras import NUMBERS
from ._defaults import DEFAULT
from ._progress import Progress, reporting
from ._splats import Splats
from ._uncertainty import Uncertainty

# What is written of the field alone, and of surfaces.
FIELD = {".npy": "official", ".npz": "leaves", ".htg": "hyper tree"}
SURFACES = {".ply": "points", ".csv": "report"}


def export(
    u: Uncertainty | str,
    path: str | os.PathLike[str],
    nerf: Nerf | None = None,
    cameras: Any = None,
    *,
    mesh: bool = False,
    ellipsoids: bool = False,
    threshold: float | str | None = None,
    pixels: int = DEFAULT.pixels,
    cells: int = DEFAULT.cells,
    density: float | None = None,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = DEFAULT.occupancy,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> None:
    """Writes a field for other tools; the extension says what.

    Of the field alone: ``.npz``, its leaves (centre, edge, level, log10 U, rays, what was seen, 3x3 covariance);
    ``.htg``, the octree for VTK and ParaView; ``.npy``, the official code's grid.
    With ``nerf`` and its training ``cameras`` (both as in :func:`uncertainty`): ``.ply``, points on the surfaces that
    the cameras see, with colour, normal, log10 U, sigma and rays, and with ``ellipsoids`` the axes of the covariance;
    ``.ply`` with ``mesh``, the surface as triangles; ``.csv``, per camera and region the share of surfaces that was
    never seen, and quantiles of sigma. With Gaussian splats as ``nerf``: ``.ply``, the splats with columns
    uncertainty, log10_uncertainty, seen and, with ``cameras``, weight, views and front_share (:func:`splat_columns`).

    threshold: first remove density, or splats, where log10 U exceeds this (or, as '99%', what it exceeds on the most
    certain 99 percent of visible surfaces). pixels: how many to look at, over all cameras. cells: of the mesh, along
    the longest edge. density: on the mesh's surface, 1 / scene unit; by default what absorbs half of the light along a
    cell's edge.
    Raises ValueError if the field does not keep what the file needs, OSError if it cannot be written, and whatever a
    callable raises.
    """
    u, path = _field("u", u), as_path("path", path)
    extension = os.path.splitext(path)[1]
    if extension not in FIELD | SURFACES:
        expected = f"a name that ends in {', '.join(FIELD | SURFACES)} (Uncertainty.save writes .oct)"
        raise wrong("path", expected, path)
    is_points = not flag("mesh", mesh) and extension == ".ply"
    if mesh and extension != ".ply":
        raise wrong("mesh", "a mesh only in a .ply", path)
    if ellipsoids and not is_points:
        raise wrong("ellipsoids", "ellipsoids only with points in a .ply", path)
    if extension in FIELD:
        if threshold is not None:
            raise wrong("threshold", "surfaces to clean, in a .ply or .csv", path)
        _octobayes.export_field(u._field, path, FIELD[extension])
        return
    if nerf is None:
        raise wrong("nerf", "a model beside the field, for surfaces", "none")
    nerf = _opened(nerf, cameras, u)
    if isinstance(nerf, Splats):
        if not is_points or ellipsoids:
            found = "ellipsoids" if ellipsoids else "mesh" if mesh else path
            raise wrong("export of splats", "a .ply of the splats themselves: the rest is of volumes' surfaces", found)
        if os.path.exists(path) and os.path.samefile(path, nerf.name):
            raise wrong("path", "a file other than the model", path)
        options = {
            **_image_options(nerf, background, march_step, pixel_offset, occupancy, u),
            "threshold": None if threshold is None else _threshold(threshold, u),
            "pixels": whole("pixels", pixels, 1),
        }
        rows = None
        if cameras is not None:
            rows = np.ascontiguousarray(_training_cameras(nerf, cameras, views, resolution, fov).rows)
        with reporting(progress) as report:
            _octobayes.export_splats(nerf._model, u._field, path, rows, options, report)
        return
    if mesh:
        numbers, names = np.empty((0, NUMBERS)), []
    else:
        seen_by = _training_cameras(nerf, cameras, views, resolution, fov)
        numbers, names = seen_by.rows, seen_by.names
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy, u),
        "kind": "mesh" if mesh else SURFACES[extension],
        "ellipsoids": flag("ellipsoids", ellipsoids),
        "threshold": None if threshold is None else _threshold(threshold, u),
        "pixels": whole("pixels", pixels, 1),
        "cells": whole("cells", cells, 8, 640),
        "density": None if density is None else real("density", density, above=0),
    }
    asked = _asked(nerf, box, march_step, batch, u)
    with reporting(progress) as report:
        _octobayes.export_surfaces(asked, u._field, path, np.ascontiguousarray(numbers), names, options, report)
    _warn(_remarks(asked))
