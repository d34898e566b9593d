"""Which photograph should be taken next?"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from . import _octobayes
from ._api import Nerf, _asked, _field, _opened, _refuse_for_splats, _remarks, _training_cameras, _warn
from ._arguments import array, flag, floats, whole, wrong
from ._cameras import Cameras, as_dictionary
from ._cameras import rows as camera_rows
from ._defaults import DEFAULT
from ._progress import Progress, reporting
from ._splats import Splats
from ._uncertainty import Uncertainty

#: Most candidates and views.
MOST = 100_000


def next_view(
    nerf: Nerf,
    u: Uncertainty | str,
    candidates: Any = None,
    *,
    sphere: int | None = None,
    upper: bool = False,
    orbit: int | None = None,
    near: int | None = None,
    object: Any = None,
    up: Any = None,
    take: int = DEFAULT.take,
    gain: str = DEFAULT.gain,
    pixels: int = DEFAULT.view_pixels,
    seed: int = DEFAULT.seed,
    map: bool = False,
    cameras: Any = None,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    box: Any = None,
    occupancy: int = DEFAULT.occupancy,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> dict[str, Any]:
    """Ranks cameras by what their images, not yet taken, would tell.

    The candidate whose pixels would tell most of the displacements that the training images leave free is taken, then
    the best one beside it, and so on. Candidates need no images. nerf: as in :func:`uncertainty`. u: its uncertainty,
    of ``scale='data'`` and ``keep_sums=True``.

    candidates: an array of poses ``[C, 4, 4]`` or ``[C, 3, 4]`` (camera-to-world, OpenGL axes, scene units), which get
    the lens and the size of the first training camera; or cameras as :func:`uncertainty` takes them, of a file all
    frames. Without candidates they are made: ``sphere`` of them around the middle of u's box (``upper``: over the upper
    half), or ``orbit`` on a level circle, as far away as the training cameras are and with their lens; or ``near``:
    where a photographer may stand who took the others. Those that stand in matter are left out. ``up``: what is up for
    them, a direction ``[3]``; by default what is level in the training cameras. ``cameras``, ``views``, ``resolution``
    and ``fov`` give the training cameras as in :func:`uncertainty`; they are read only where they count: for poses, for
    candidates that are made, and for
    'coverage'. ``resolution`` is the candidates' image size, too.

    object: a box ``[2, 3]``, the part of the scene whose displacements count; by default all of it.

    take: how many views. gain: 'logdet' (Σ ½ log det(I + P⁻¹ ΔP) over vertices, nats), 'trace' (its first-order term
    Σ ½ tr(P⁻¹ ΔP)) or 'coverage' (from which sides visible surface was seen). pixels: how many of a candidate's pixels
    are traced; they are scaled to all. seed: of these pixels. map: also what each pixel of the first view would tell by
    itself. box, batch and progress: as in :func:`render`. occupancy: cells per axis of the grid that lets
    rays skip empty space.

    Returns a dictionary: 'steps', a list of dictionaries in the order in which to take the views ('index' of the
    candidate, 'name', 'gain' in nats given all steps before, 'gain_per_pixel', 'surface' and 'unseen', shares of its
    rays, 'seconds'); 'candidates', one dictionary each ('index', 'name', 'gain' before any view was taken,
    'why_nothing'); 'gain', 'pixels', 'seed' and 'complete', as in the command line's file. In arrays: 'gains'
    ``[candidates]`` (nats); 'poses' ``[steps, 4, 4]`` (float64, camera-to-world) and 'cameras', a list of dictionaries
    that :func:`uncertainty` takes, of the views taken; with ``map`` 'map' ``[H, W]`` (float32, nats; at most 256 pixels
    a side).

    Fewer views than asked for are taken if no other adds information; 'why_nothing' says why: 'in-matter',
    'past-the-box' or 'meets-nothing'. Warns of candidates whose axes differ from those of the training cameras. Raises
    ValueError if no candidate adds information, if u keeps no sums or is not in the scale of the data, and as
    :func:`uncertainty` does.
    """
    u = _field("u", u)
    nerf = _opened(nerf, cameras, u)
    if isinstance(nerf, Splats):
        _refuse_for_splats(occupancy=(occupancy, DEFAULT.occupancy))
    made = {"sphere": sphere, "orbit": orbit, "near": near}
    ways = [name for name, value in {"candidates": candidates, **made}.items() if value is not None]
    if len(ways) != 1:
        raise wrong("candidates", "candidates, sphere, orbit or near, one of them", " and ".join(ways) or "none")
    if flag("upper", upper) and sphere is None:
        raise wrong("upper", "sphere beside it", "none")
    if up is not None and candidates is not None:
        raise wrong("up", "sphere, orbit or near beside it", "candidates")
    are_poses = candidates is not None and not _are_cameras(candidates)
    training = None
    if are_poses or candidates is None or gain == "coverage":
        training = _training_cameras(nerf, cameras, views, resolution, fov)
    if are_poses and training is not None:
        given = _posed(candidates, training)
    elif candidates is not None:
        given = camera_rows(candidates, None, resolution, every_frame=True)
    else:
        given = None
    options = {
        **{name: None if count is None else whole(name, count, 1, MOST) for name, count in made.items()},
        "upper": upper,
        "object": None if object is None else floats("object", object, (2, 3), np.float64).ravel().tolist(),
        "up": None if up is None else floats("up", up, (3,), np.float64).tolist(),
        "names": [] if given is None else given.names,
        "file": os.fspath(candidates) if isinstance(candidates, (str, os.PathLike)) else None,
        "take": whole("take", take, 1, MOST),
        "gain": gain,
        "pixels": whole("pixels", pixels, 1, 100_000_000),
        "seed": whole("seed", seed, 0, 2**64 - 1),
        "occupancy": whole("occupancy", occupancy, 4, 512),
        "map": flag("map", map),
    }
    asked = _asked(nerf, box, None, batch, u)
    rows = [None if known is None else np.ascontiguousarray(known.rows) for known in (given, training)]
    with reporting(progress) as report:
        found, all_rows, gains, said = _octobayes.next_view(asked, u._field, *rows, options, report)
    _warn([*said, *_remarks(asked)])
    ranking = json.loads(found)
    taken = all_rows[[step["index"] for step in ranking["steps"]]]
    ranking["gains"] = np.array([candidate["gain"] for candidate in ranking["candidates"]])
    ranking["poses"] = taken[:, :16].reshape(-1, 4, 4)
    ranking["cameras"] = [as_dictionary(row) for row in taken]
    if map:
        ranking["map"] = gains
    return ranking


def _are_cameras(candidates: Any) -> bool:
    """Whether they are a file or dictionaries."""
    listed = candidates if isinstance(candidates, (list, tuple)) else [candidates]
    return any(isinstance(one, (str, os.PathLike, Mapping)) for one in listed)


def _posed(poses: Any, training: Cameras) -> Cameras:
    """Cameras of these poses with the lens of the first training camera."""
    given = array("candidates", poses)
    if given.ndim != 3 or given.shape[1:] not in ((3, 4), (4, 4)) or len(given) == 0:
        raise wrong("candidates", "an array of poses [C, 4, 4] or [C, 3, 4], or cameras", given)
    given = floats("candidates", given, given.shape, np.float64)
    rows = np.repeat(training.rows[:1], len(given), axis=0)
    rows[:, :16] = np.eye(4).ravel()
    rows[:, : given[0].size] = given.reshape(len(given), -1)
    return Cameras(rows, [f"pose {i}" for i in range(len(rows))], [], f"{len(rows)} poses")
