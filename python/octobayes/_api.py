"""The functions of the package."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any, TypeAlias

import numpy as np

from . import _octobayes, _shards
from ._arguments import array, color, degrees, flag, floats, names, real, whole, wrong
from ._arguments import box as as_box
from ._arguments import path as as_path
from ._cameras import Beside, named, resized
from ._cameras import rows as camera_rows
from ._cameras import size as as_size
from ._gate import Gate, remarks
from ._model import Model
from ._progress import Progress, reporting
from ._uncertainty import Uncertainty

#: What the official code draws unless told otherwise.
OFFICIAL_RAYS = 4_096_000

Nerf: TypeAlias = "str | os.PathLike[str] | Model | Callable[..., Any]"


def open_model(name: str | os.PathLike[str], coordinates: str | None = None) -> Model:
    """Opens a model file or a built-in scene as a callable ``(x[N, 3], d[N, 3]) -> (density[N], color[N, 3])``.

    name: a ``.safetensors`` hash grid (of ``octobayes train``) or MLP NeRF, a ``.ppng`` Plenoptic PNG, an ``.npz``
    voxel grid, or ``scene:NAME``. coordinates: 'ngp' or 'blender', scene units and axes of a ``.ppng``.
    Raises OSError or ValueError if it cannot be read.
    """
    return Model(as_path("name", name), coordinates)


def load(
    path: str | os.PathLike[str],
    *,
    box: Any = None,
    rays: int | None = None,
    contract: str | None = None,
    inner: Any = None,
) -> Uncertainty:
    """Reads an ``.oct`` file; or the official code's ``.npy``, with the space it covers and its number of ``rays``.

    That space is a ``box`` (low, high), or contracted as ``contract`` and ``inner`` of :func:`uncertainty` say.

    Raises OSError or ValueError if it cannot be read.
    """
    path = as_path("path", path)
    if not path.endswith(".npy"):
        if any(argument is not None for argument in (box, rays, contract, inner)):
            raise wrong("box, rays, contract, inner", "None for an .oct file, which knows its own", path)
        return Uncertainty(_octobayes.load(path, {}))
    domain = _domain_options(box, contract, inner)
    if box is None and contract is None:
        raise wrong("box", "the box of the official grid, which its file does not name", "none")
    if rays is None:
        rays = OFFICIAL_RAYS
        text = f"{path} is taken for sums of {rays} rays, the official default (rays=)"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return Uncertainty(_octobayes.load(path, domain, whole("rays", rays, 1)))


def _field(name: str, value: Any) -> Uncertainty:
    if isinstance(value, (str, os.PathLike)):
        return load(value)
    if not isinstance(value, Uncertainty):
        raise wrong(name, "an Uncertainty or the path of an .oct file", value)
    return value


def _opened(nerf: Any, coordinates: str | None = None) -> Any:
    """A model, or the callable as it is."""
    if isinstance(nerf, (str, os.PathLike)):
        return open_model(nerf, coordinates)
    if coordinates is not None:
        raise wrong("coordinates", "None for a model that is not a file", coordinates)
    if not callable(nerf):
        raise wrong("nerf", "a model file, a model of open_model or a callable (x, d) -> (density, color)", nerf)
    return nerf


def _source(nerf: Any) -> str:
    """A name for a model."""
    if isinstance(nerf, Model):
        return nerf.name
    name = getattr(nerf, "__qualname__", None) or type(nerf).__qualname__
    return f"the Python callable {name}"


def _asked(nerf: Any, box: Any, march_step: float | None, batch: int, u: Uncertainty | None = None) -> Any:
    """What the Rust part asks: its own model, or the gate of a callable, by default in the box of ``u``."""
    batch = whole("batch", batch, 1)
    if isinstance(nerf, Model):
        return nerf._model
    if box is None and u is not None:
        box = getattr(nerf, "box", u.box)
    return Gate(nerf, box=box, step=march_step, batch=batch, description=_source(nerf))


def _remarks(asked: Any) -> list[str]:
    """What is to be said of a callable's answers once it is no longer asked."""
    return remarks(getattr(asked, "overshoot", 0.0))


def _image_options(
    nerf: Any, background: Any, march_step: float | None, pixel_offset: float | None, occupancy: int
) -> dict[str, Any]:
    """Options that say how rays pass through the model."""
    if background is None:
        background = getattr(nerf, "background", None)
    return {
        "background": color("background", "white" if background is None else background),
        "march_step": None if march_step is None else real("march_step", march_step, above=0),
        "pixel_offset": None if pixel_offset is None else real("pixel_offset", pixel_offset, low=0),
        "occupancy": whole("occupancy", occupancy, 4, 512),
    }


def _domain_options(box: Any, contract: str | None, inner: Any) -> dict[str, Any]:
    if (contract is None) != (inner is None):
        raise wrong("contract, inner", "both or neither", f"contract={contract!r}, inner={inner!r}")
    ball = None if inner is None else floats("inner", inner, (4,), np.float64).tolist()
    return {"box": None if box is None else as_box("box", box), "contract": contract, "inner": ball}


def _grid_options(
    level: int,
    cell_size: float | None,
    domain: Mapping[str, Any],
    memory: int | None,
    refine: Any,
    grid: str,
    covariance: str,
    lambda_: float | None,
    tolerance: float,
    prior: str,
    min_rays: float,
    keep_sums: bool,
    surface_points: int,
) -> dict[str, Any]:
    if cell_size is not None:
        if domain["contract"] is not None or domain["box"] is None:
            raise wrong("cell_size", "a box, whose edge it divides (level= else)", "none")
        if level != 8:
            raise wrong("level", "none beside cell_size, which sets it", level)
        longest = max(high - low for low, high in zip(*domain["box"]))
        level = max(1, int(np.ceil(np.log2(longest / real("cell_size", cell_size, above=0)))))
    return {
        "level": whole("level", level, 1, 16),
        "memory": None if memory is None else whole("memory", memory, 1),
        "refine": names("refine", refine),
        "grid": grid,
        "covariance": covariance,
        "lambda_": None if lambda_ is None else real("lambda_", lambda_, above=0),
        "tolerance": real("tolerance", tolerance, low=0),
        "prior": prior,
        "min_rays": real("min_rays", min_rays, low=0),
        "keep_sums": flag("keep_sums", keep_sums),
        "surface_points": whole("surface_points", surface_points, 0),
    }


def _shard(shard: Any) -> list[int] | None:
    if shard is None:
        return None
    try:
        parts = map(int, shard.split("/")) if isinstance(shard, str) else shard
        index, of = (whole("shard", part, 0, 2**64 - 1) for part in parts)
    except (TypeError, ValueError) as error:
        raise wrong("shard", "'I/N' or (I, N) with 0 <= I < N", shard) from error
    if not 0 <= index < of:
        raise wrong("shard", "'I/N' or (I, N) with 0 <= I < N", shard)
    return [index, of]


def _warn(texts: Iterable[str]) -> None:
    """Warns the caller of the function that calls this."""
    for text in texts:
        warnings.warn(text, RuntimeWarning, stacklevel=3)


def uncertainty(
    nerf: Nerf,
    cameras: Any = None,
    *,
    box: Any = None,
    level: int = 8,
    rays: int | str = 4_096_000,
    seed: int = 0,
    gradient: str = "finite-difference",
    covariance: str = "diagonal",
    keep_sums: bool = False,
    contract: str | None = None,
    inner: Any = None,
    cell_size: float | None = None,
    memory: int | None = None,
    refine: str | Sequence[str] = "sensitivity",
    grid: str = "octree",
    lambda_: float | None = None,
    tolerance: float = 0.01,
    prior: str = "uniform",
    scale: str = "paper",
    noise: float | None = None,
    psnr: float | None = None,
    prior_deviation: float | None = None,
    min_rays: float = 0.0,
    surface_points: int = 16_384,
    max_rays: int = 32_768_000,
    pixels: str = "sobol",
    step: float | None = None,
    cutoff: float = 1e-6,
    error_bars: int | None = None,
    coarser_levels: int = 0,
    images: Any = None,
    shard: str | tuple[int, int] | None = None,
    executor: Executor | None = None,
    shards: int | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: float = 60.0,
    resume: bool = False,
    dump_samples: str | os.PathLike[str] | None = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = 128,
    coordinates: str | None = None,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    force: bool = False,
    batch: int = 1 << 16,
    progress: Progress | bool | None = None,
) -> Uncertainty:
    """Computes the uncertainty of a trained radiance field from its training cameras.

    nerf: a callable, a model file, or a model of :func:`open_model`. A callable is ``f(x: float32[N, 3], d: float32[N,
    3]) -> (density[N], color[N, 3])``: positions in scene units and directions of length 1; density in 1 / scene unit,
    0 or more; colours in [0, 1], in floating point. Other values are refused; colours that exceed the range by 0.05 at
    most are clamped, with one RuntimeWarning, and their derivatives are 0 there. What it returns at a point must not
    depend on the other points. It may have attributes: ``derivatives(x, d) -> (density, color, d_density[N, 3],
    d_color[N, 3, 3])``, the last by channel and axis; ``density(x)``, if that is cheaper; ``step``, the distance
    between samples along a ray (default: the box's diagonal / 1024); ``background``; ``box``; ``pixel_offset``. It is
    called from this thread only, with at least ``batch`` points while there are rays to begin, and fewer than twice as
    many.

    cameras: those that the model was trained on. A file (transforms.json, or a COLMAP model), a list of dictionaries,
    or one dictionary of arrays: ``pose`` (4x4, camera-to-world, OpenGL axes), ``focal`` (pixels; one or two) or ``fov``
    (degrees), ``size`` (width, height), optional ``center``, ``k1``, ``k2``, ``p1``, ``p2`` and ``mask_path``: an image
    of that size (or ``image_size``) whose black pixels were not trained on. ``None`` takes the model's
    own. ``views`` (how many, or frames by their numbers in the file from 0, or 'all') and ``resolution`` choose frames
    of a file and image sizes. Where images lie beside a file's cameras, a few hundred of their pixels are compared with
    the model first: a RuntimeWarning if it shows them poorly, ValueError if not at all, unless ``force``.

    box: (low, high), corners in scene units; for a callable also where its density is zero outside. contract ('l2' or
    'linf') and inner (x, y, z, radius) cover all of space instead.

    Other arguments have the command line's names, meanings and defaults (``octobayes uncertainty --help``): rays (a
    number, or 'auto': until the mean error of log10 U is within ``tolerance``, at most ``max_rays``); gradient
    ('finite-difference': central; 'forward-difference': four points a sample, not seven; 'analytic': the model's own
    derivatives; 'auto': these if it has any); covariance ('diagonal', 'block', 'trace'); refine ('sensitivity',
    'density', 'ray-count', or several); memory in bytes; step in edges of the finest lattice; error_bars (number of
    groups); coarser_levels (how many, for ranking pixels); checkpoint_every in seconds; scale ('paper', or 'data': a
    standard deviation in scene units, which needs the noise that training left, as ``noise``, ``psnr`` or recorded in
    the model, and cameras of the size that the model was trained at). ``lambda_`` is ``--lambda``.

    images: the training images, with which the model is compared, so that deviations of depth count what it does not
    show of them (``scale='data'``): the folder from which the cameras' names start, or a list of files, one per camera.

    executor: anything with the ``submit`` of ``concurrent.futures``, which runs the ``shards`` instead of this process:
    a ProcessPoolExecutor, dask.distributed's ``client.get_executor()``. nerf must be a model's file that the workers
    see, too, or a callable that they can unpickle. The shards are merged here as they come; the result is that of one
    run up to the order of additions, and the same to the last bit whichever came first.

    progress: called with (stage, done, total); True for a bar of tqdm, False for none; by default a bar where one is
    seen and tqdm is installed.

    Raises ValueError for arguments that make no sense, OSError for files, FloatingPointError if the field is not finite
    on more than 1 % of the rays, and whatever the callable raises, as it raised it. Ctrl-C stops within a second. Where
    it raises, nothing is written (but the checkpoint, if there is one). Warns (RuntimeWarning) of cameras that see
    little, of a bad finite-difference step and of dropped rays.
    """
    nerf = _opened(nerf, coordinates)
    domain = _domain_options(box, contract, inner)
    if contract is not None and isinstance(nerf, Model) and box is not None:
        raise wrong("box", "None with contract", "a box")
    auto = rays == "auto"
    if isinstance(rays, str) and not auto:
        raise wrong("rays", "a whole number, 1 or more, or 'auto'", rays)
    if auto and (shard is not None or error_bars is not None or dump_samples is not None):
        raise wrong("rays='auto'", "a run by itself, to its end", "shard, error_bars or dump_samples")
    if shard is not None and error_bars is not None:
        raise wrong("error_bars", "None with shard, which is one group of rays", error_bars)
    if flag("resume", resume) and checkpoint is None:
        raise wrong("resume", "a checkpoint beside it", "none")
    if isinstance(nerf, Model) and cell_size is not None and domain["box"] is None and contract is None:
        domain["box"] = nerf.box.tolist()
    own_box = getattr(nerf, "box", None)
    if not isinstance(nerf, Model) and domain["box"] is None and own_box is not None:
        domain["box"] = as_box("nerf.box", own_box)
    numbers, frames, seen_by, beside = _training_cameras(nerf, cameras, views, resolution, fov)
    if executor is None and shards is not None:
        raise wrong("shards", "an executor beside them (one shard alone: shard=)", shards)
    if executor is not None:
        own = {"shard": shard, "checkpoint": checkpoint, "dump_samples": dump_samples, "error_bars": error_bars}
        shards = _shards.checked(executor, shards, own | {"coarser_levels": coarser_levels or None, "images": images})
        if auto or memory is not None:
            raise wrong("executor", "a number of rays, and no limit of memory, which is each shard's own", "another")
    options = {
        **domain,
        **_grid_options(
            level, cell_size, domain, memory, refine, grid, covariance, lambda_, tolerance, prior, min_rays, keep_sums,
            surface_points,
        ),
        **_image_options(nerf, background, march_step, pixel_offset, occupancy),
        **_scale_options(scale, noise, psnr, prior_deviation, lambda_),
        "rays": whole("max_rays", max_rays, 1) if auto else whole("rays", rays, 1),
        "auto": auto,
        "seed": whole("seed", seed, 0, 2**64 - 1),
        "gradient": gradient,
        "pixels": pixels,
        "step": None if step is None else real("step", step, above=0),
        "cutoff": real("cutoff", cutoff, low=0),
        "error_bars": None if error_bars is None else whole("error_bars", error_bars, 2, 64),
        "coarser_levels": whole("coarser_levels", coarser_levels, 0, 4),
        **_images(images, frames, scale),
        "beside": beside,
        "force": bool(force),
        "shard": _shard(shard),
        "checkpoint": None if checkpoint is None else as_path("checkpoint", checkpoint),
        "checkpoint_every": real("checkpoint_every", checkpoint_every, low=0),
        "resume": bool(resume),
        "dump_samples": None if dump_samples is None else as_path("dump_samples", dump_samples),
        "source": f"{_source(nerf)} seen by {seen_by}",
    }  # fmt: skip
    if executor is not None and shards is not None:
        gate = {"box": domain["box"], "step": march_step, "batch": batch, "description": _source(nerf)}
        task = _shards.Task(nerf, gate, numbers, options)
        with reporting(progress) as report:
            field, texts = _shards.run(task, executor, shards, report)
        _warn(texts)
        return Uncertainty(field if keep_sums else field.for_queries())
    asked = _asked(nerf, domain["box"], march_step, batch)
    with reporting(progress) as report:
        field, texts = _octobayes.uncertainty(asked, numbers, options, report)
    _warn([*texts, *_remarks(asked)])
    return Uncertainty(field)


def _images(images: Any, frames: list[str], scale: str) -> dict[str, Any]:
    """Where the training images are, if they are asked for: a folder and the frames' names, or files."""
    if images is None:
        return {}
    if scale == "paper":
        raise wrong("images", "scale='data' beside it, in which depths have deviations", "scale='paper'")
    if isinstance(images, (str, os.PathLike)):
        return {"images": as_path("images", images), "frames": frames}
    if not isinstance(images, Sequence):
        raise wrong("images", f"a folder, or a list of {len(frames)} files", images)
    files = [as_path(f"images[{i}]", file) for i, file in enumerate(images)]
    if len(files) != len(frames):
        raise wrong("images", f"a file for each of {len(frames)} cameras", f"{len(files)} files")
    return {"frames": files}


def _scale_options(
    scale: str, noise: float | None, psnr: float | None, prior_deviation: float | None, lambda_: float | None
) -> dict[str, Any]:
    """What U is a deviation of."""
    if scale not in ("paper", "data"):
        raise wrong("scale", "'paper' or 'data'", scale)
    given = {"noise": noise, "psnr": psnr, "prior_deviation": prior_deviation}
    for name in (name for name, value in given.items() if value is not None and scale == "paper"):
        raise wrong(name, "scale='data' beside it", "scale='paper'")
    if scale == "data" and lambda_ is not None:
        raise wrong("lambda_", "None with scale='data', where prior_deviation stands for it", lambda_)
    if noise is not None and psnr is not None:
        raise wrong("noise", "None with psnr, which says the same", noise)
    numbers = {name: None if value is None else real(name, value, above=0) for name, value in given.items()}
    return {"of_data": scale == "data", **numbers}


def _training_cameras(
    nerf: Any, cameras: Any, views: Any, resolution: Any, fov: float | None
) -> tuple[Any, list[str], str, list[Beside]]:
    """Numbers of the cameras that the model was trained on, their names, what they are, and a file's images."""
    if cameras is None and isinstance(nerf, Model):
        return *_own_cameras(nerf, resolution, fov), []
    if fov is not None:
        raise wrong("fov", "None with cameras, which have their own", fov)
    if cameras is None:
        cameras = getattr(nerf, "cameras", None)
        cameras = cameras() if callable(cameras) else cameras
    if cameras is None:
        raise wrong("cameras", "a camera file or cameras, as this model brings none", "none")
    return camera_rows(cameras, "training", views, resolution)


def _own_cameras(model: Model, resolution: Any, fov: float | None) -> tuple[Any, list[str], str]:
    """The cameras that come with a model."""
    width, height = as_size(resolution)
    fov = None if fov is None else degrees("fov", fov)
    numbers = model._model.cameras(fov, None if width is None or height is None else (width, height))
    if numbers is None:
        raise wrong("cameras", "a camera file or cameras, as this model brings none", "none")
    if width is not None:
        numbers = resized(numbers, width, height)
    return numbers, named(len(numbers)), f"its own {len(numbers)} cameras"


def compare(
    a: Uncertainty | str, b: Uncertainty | str, *, points: int = 1_000_000, seed: int = 0, covariance: str | None = None
) -> dict[str, Any]:
    """Compares a field with a reference ``b``: |Δ log10 U| at random points of the box and on visible surfaces.

    points: random points, and at most as many on surfaces. covariance: read this one off both. Returns a dictionary:
    'fields' (size and structure), 'in_box' and 'on_surfaces' (points, mean, percentile_95, percentile_99, max, max_at,
    log10_at_max). Raises ValueError if the fields have different boxes.
    """
    a, b = _field("a", a), _field("b", b)
    if covariance is not None:
        a, b = a.with_covariance(covariance), b.with_covariance(covariance)
    points, seed = whole("points", points, 0), whole("seed", seed, 0, 2**64 - 1)
    return json.loads(_octobayes.compare(a._field, b._field, points, seed))


def merge(fields: Sequence[Uncertainty | str], *, error_bars: bool = False, keep_sums: bool = False) -> Uncertainty:
    """Joins fields of one box, level and protocol from different rays: shards of a run, or other seeds.

    error_bars: also the error of log10 U, from the fields' differences (of different seeds). The fields must keep their
    sums (shards do). Raises ValueError if they do not belong together. Warns of missing shards.
    """
    given = [_field(f"fields[{i}]", field)._field for i, field in enumerate(fields)]
    field, texts = _octobayes.merge(given, flag("error_bars", error_bars), flag("keep_sums", keep_sums))
    _warn(texts)
    return Uncertainty(field)


def accumulate(
    samples: str | os.PathLike[str] | Mapping[str, Any],
    *,
    box: Any = None,
    level: int = 8,
    contract: str | None = None,
    inner: Any = None,
    cell_size: float | None = None,
    refine: str | Sequence[str] = "sensitivity",
    grid: str = "octree",
    covariance: str = "diagonal",
    lambda_: float | None = None,
    tolerance: float = 0.01,
    prior: str = "uniform",
    min_rays: float = 0.0,
    keep_sums: bool = False,
    surface_points: int = 16_384,
    progress: Progress | bool | None = None,
) -> Uncertainty:
    """Sums ray samples whose Jacobians were computed elsewhere.

    samples: an ``.npz`` file, or a dictionary of arrays: ``positions`` ``[N, 3]`` (scene units), ``jacobian``
    ``[N, 3, 3]`` (∂C_c/∂x_k, rows colour, columns axis), ``ray`` ``[N]`` (never decreasing), ``rays_total`` (all that
    were drawn), optional ``weight`` ``[N]``. The other arguments are those of :func:`uncertainty`.
    Raises ValueError or OSError.
    """
    domain = _domain_options(box, contract, inner)
    options = {
        **domain,
        **_grid_options(
            level, cell_size, domain, None, refine, grid, covariance, lambda_, tolerance, prior, min_rays, keep_sums,
            surface_points,
        ),
    }  # fmt: skip
    with reporting(progress) as report:
        given = _samples(samples) if isinstance(samples, Mapping) else as_path("samples", samples)
        field, text = _octobayes.accumulate(given, options, report)
    _warn([] if text is None else [text])
    return Uncertainty(field)


def _samples(samples: Mapping[str, Any]) -> tuple[Any, ...]:
    missing = [key for key in ("positions", "jacobian", "ray", "rays_total") if key not in samples]
    if missing:
        raise wrong("samples", "keys positions, jacobian, ray and rays_total", f"none of {missing}")
    positions = floats("samples['positions']", samples["positions"], (None, 3))
    n = len(positions)
    jacobian = floats("samples['jacobian']", samples["jacobian"], (n, 3, 3)).reshape(n, 9)
    ray = array(samples["ray"])
    if ray.shape != (n,) or ray.dtype.kind not in "iu" or (n > 0 and ray.min() < 0):
        raise wrong("samples['ray']", f"an array of whole numbers of shape [{n}], 0 or more", ray)
    weight = samples.get("weight")
    weight = np.zeros(n, np.float32) if weight is None else floats("samples['weight']", weight, (n,))
    total = array(samples["rays_total"])
    if total.size != 1:
        raise wrong("samples['rays_total']", "a whole number, 1 or more", total)
    total = whole("samples['rays_total']", total.item(), 1)
    return positions, jacobian, np.ascontiguousarray(ray, dtype=np.uint64), weight, total


def render(
    nerf: Nerf,
    u: Uncertainty | str | None,
    camera: Any,
    *,
    frame: int = 0,
    ray_average: str = "weighted-mean",
    threshold: float | str | None = None,
    depth_error: bool = False,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = 128,
    coordinates: str | None = None,
    resolution: Any = None,
    batch: int = 1 << 16,
    progress: Progress | bool | None = None,
) -> dict[str, np.ndarray]:
    """Renders one view.

    nerf, camera and the arguments not explained here: as in :func:`uncertainty`; of a camera file, ``frame`` is
    rendered. u: the model's uncertainty, or None for none. ray_average: how log10 U becomes a pixel's
    ('weighted-mean', 'official', 'at-expected', 'spread'). threshold: remove density where log10 U exceeds this (or,
    as '99%', what it exceeds on the most certain 99 percent of visible surfaces). depth_error: the standard deviation
    of depth, too; u must be one of scale='data'. box: for a callable, by default u's.

    Returns float32 arrays: 'color' ``[H, W, 3]``, 'depth' ``[H, W]`` (median distance from the camera, scene units; 0
    where nothing is), 'opacity' ``[H, W]``, with u 'log10_uncertainty' ``[H, W]`` (NaN where the opacity is 0.05 or
    less, or what is seen lies outside the box of u, as in the command line's pictures), and with depth_error
    'depth_error' ``[H, W]`` (scene units; NaN where nothing is) and, if u is calibrated, 'depth_interval' ``[H, W]``
    (half width of the interval, scene units).
    Raises as :func:`uncertainty` does.
    """
    nerf = _opened(nerf, coordinates)
    u = None if u is None else _field("u", u)
    if isinstance(camera, (str, os.PathLike)):
        numbers, *_ = camera_rows(camera, "every frame", None, resolution)
        numbers = numbers[whole("frame", frame, 0, len(numbers) - 1)][None]
    else:
        listed = [camera] if isinstance(camera, Mapping) else camera
        numbers, *_ = camera_rows(listed, resolution=resolution)
    if len(numbers) != 1:
        raise wrong("camera", "one camera", f"{len(numbers)} cameras")
    if threshold is not None:
        threshold = _threshold(threshold, u)
    if depth_error and u is None:
        raise wrong("depth_error", "an uncertainty beside it", "none")
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy),
        "ray_average": names("ray_average", ray_average)[:1],
        "threshold": threshold,
        "depth_error": flag("depth_error", depth_error),
    }
    asked = _asked(nerf, box, march_step, batch, u)
    field = None if u is None else u._field
    with reporting(progress) as report:
        view = _octobayes.render(asked, field, np.ascontiguousarray(numbers), options, report)
    _warn(_remarks(asked))
    return view


def _threshold(threshold: float | str, u: Uncertainty | None) -> float:
    if u is None:
        raise wrong("threshold", "an uncertainty to cut by", "none")
    if not isinstance(threshold, str):
        log10, prior = real("threshold", threshold), float(np.log10(u.prior))
        if log10 >= prior:
            text = f"no density lies above the threshold of {log10:g}: log10 U of the field's prior is {prior:.3f}"
            warnings.warn(text, RuntimeWarning, stacklevel=3)
        text = u._field.threshold_warning(log10)
        _warn([] if text is None else [f"threshold: {text}"])
        return log10
    try:
        share = 0.01 * float(threshold.removesuffix("%"))
    except ValueError as error:
        raise wrong("threshold", "log10 U, or a share of visible surfaces as '99%'", threshold) from error
    if not threshold.endswith("%") or not 0 <= share <= 1:
        raise wrong("threshold", "log10 U, or a share of visible surfaces as '99%'", threshold)
    log10 = u.surface_quantile(share)
    if log10 is None:
        raise wrong("threshold", "a field with points on visible surfaces, for a share", "one without")
    return log10


def evaluate(
    nerf: Nerf,
    u: Uncertainty | str | Mapping[str, Uncertainty | str],
    cameras: str | os.PathLike[str],
    *,
    depth: str | os.PathLike[str] | None = None,
    depth_encoding: tuple[float, float] | None = None,
    depth_pattern: str = "{}_depth_0001.png",
    z_depth: bool = False,
    covariance: str | Sequence[str] | None = None,
    ray_average: str | Sequence[str] | None = None,
    stride: int = 1,
    every: int = 1,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = 128,
    coordinates: str | None = None,
    resolution: tuple[int, int] | None = None,
    batch: int = 1 << 16,
    progress: Progress | bool | None = None,
) -> dict[str, Any]:
    """Whether U ranks the depth error of held-out views: AUSE beside measures that need no Hessian.

    u: one field, or several by name. cameras: a camera file with images. depth: folder of depth maps, named by
    ``depth_pattern`` ({} is the frame's name without extension) and looked for below the directories of the frame's
    name, then in the folder itself; without it the maps are those that the camera file names (``depth_file_path``).
    depth = offset + scale * p for ``depth_encoding`` (offset, scale), p from 0 to 1, or scene units in .exr, which have
    no encoding. ray_average: ``u-spread-per-root-ray`` unless told otherwise. The other arguments are the command
    line's (``octobayes evaluate --help``).

    Values that are no measurements (0, the largest value of a PNG, NaN, infinity, 1e10 of Blender, or depths far behind
    the model's box) are left out. A ``RuntimeWarning`` says how many and why, and whether depths are unlikely; a
    ``ValueError`` says so if nearly none is left, or if half of them are off by more than the box is wide.

    Returns a dictionary: 'readings' and 'baselines' (name, 'ause_pooled' and 'ause_mean_over_views' by error kind, and
    'calibration' of standard deviations of depth, which fields of scale='data' give), 'depth_error', 'depth_readings'
    (pixels of the maps: 'measured', and the others by reason), 'psnr', 'views', 'pixels'. Raises as
    :func:`uncertainty` does.
    """
    nerf = _opened(nerf, coordinates)
    named = u if isinstance(u, Mapping) else {"u": u}
    fields = {str(name): _field(f"u[{name!r}]", field) for name, field in named.items()}
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy),
        **_held_out_options(cameras, depth, depth_encoding, depth_pattern, z_depth, stride, every, resolution),
        "ray_average": None if ray_average is None else names("ray_average", ray_average),
        "covariance": None if covariance is None else names("covariance", covariance),
    }
    asked = _asked(nerf, box, march_step, batch, next(iter(fields.values()), None))
    given = [(name, field._field) for name, field in fields.items()]
    with reporting(progress) as report:
        said, notes = _octobayes.evaluate(asked, given, options, report)
    _warn(notes)
    _warn(_remarks(asked))
    return json.loads(said)


def calibrate(
    nerf: Nerf,
    u: Uncertainty | str,
    cameras: str | os.PathLike[str],
    *,
    depth: str | os.PathLike[str] | None = None,
    depth_encoding: tuple[float, float] | None = None,
    depth_pattern: str = "{}_depth_0001.png",
    z_depth: bool = False,
    covariance: str | None = None,
    probability: float = 0.9,
    stride: int = 2,
    every: int = 1,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = 128,
    coordinates: str | None = None,
    resolution: tuple[int, int] | None = None,
    batch: int = 1 << 16,
    progress: Progress | bool | None = None,
) -> tuple[Uncertainty, dict[str, Any]]:
    """An interval of depth that holds by counting, from held-out views of known depth.

    Errors of depth are divided by their deviations; the quantile of these ratios that holds the share ``probability``
    of further ones (split conformal prediction) goes with the field, and into ``render``'s 'depth_interval'. u must be
    one of ``scale='data'``. covariance: the one by which depths have their deviations, and that the calibrated field
    has; the field's own unless told otherwise. The other arguments are those of :func:`evaluate`.

    It promises that share of pixels that are drawn like these: this scene, this model, views chosen as these were. It
    promises nothing of other scenes, of views from other sides or of a single pixel.

    Returns the calibrated field, and a dictionary: 'conformal' (as :attr:`Uncertainty.conformal`), 'predicted_factor'
    (what it would be without), 'views_left_out' (least, median and largest share that a view's errors have in the
    interval of all others), 'depth_readings' (as of :func:`evaluate`). Warns and raises as :func:`evaluate` does.
    """
    nerf = _opened(nerf, coordinates)
    u = _field("u", u)
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy),
        **_held_out_options(cameras, depth, depth_encoding, depth_pattern, z_depth, stride, every, resolution),
        "probability": real("probability", probability, above=0),
        "covariance": covariance,
    }
    if not options["probability"] < 1:
        raise wrong("probability", "a share between 0 and 1", probability)
    asked = _asked(nerf, box, march_step, batch, u)
    with reporting(progress) as report:
        field, said, notes = _octobayes.calibrate(asked, u._field, options, report)
    _warn(notes)
    _warn(_remarks(asked))
    return Uncertainty(field), json.loads(said)


def _held_out_options(
    cameras: Any,
    depth: Any,
    depth_encoding: Any,
    depth_pattern: str,
    z_depth: bool,
    stride: int,
    every: int,
    resolution: Any,
) -> dict[str, Any]:
    """Where held-out views and their depth are."""
    width, height = as_size(resolution)
    if width is not None and height is None:
        raise wrong("resolution", "(width, height)", resolution)
    if depth_encoding is not None:
        depth_encoding = floats("depth_encoding", depth_encoding, (2,), np.float64).tolist()
    return {
        "cameras": as_path("cameras", cameras),
        "depth": None if depth is None else as_path("depth", depth),
        "depth_encoding": depth_encoding,
        "depth_pattern": depth_pattern,
        "z_depth": flag("z_depth", z_depth),
        "stride": whole("stride", stride, 1),
        "every": whole("every", every, 1),
        "resolution": None if width is None else [width, height],
    }
