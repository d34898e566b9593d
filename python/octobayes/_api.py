"""The functions of the package."""

from __future__ import annotations

import json
import logging
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from inspect import signature
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np

from . import _octobayes, _shards
from ._arguments import array, color, flag, floats, names, real, whole, wrong
from ._arguments import box as as_box
from ._arguments import path as as_path
from ._cameras import Cameras, selected
from ._cameras import rows as camera_rows
from ._cameras import size as as_size
from ._defaults import DEFAULT
from ._gate import Gate, remarks
from ._model import Model, Opened
from ._progress import Progress, reporting
from ._splats import Splats
from ._uncertainty import Uncertainty

#: What a run assumed or left out.
LOG = logging.getLogger("octobayes")

Nerf: TypeAlias = "str | os.PathLike[str] | Model | Splats | Callable[..., Any]"


def open_model(
    name: str | os.PathLike[str], coordinates: str | None = None, *, splat_mode: str | None = None
) -> Model | Splats:
    """Opens a model file or a built-in scene.

    name: a ``.safetensors`` hash grid (of ``octobayes train``) or MLP NeRF, a ``.ppng`` Plenoptic PNG, an ``.npz``
    voxel grid, or ``scene:NAME``: a callable ``(x[N, 3], d[N, 3]) -> (density[N], color[N, 3])``. Or a ``.ply``,
    ``.compressed.ply``, ``.spz`` or ``.splat`` of Gaussian splats: :class:`Splats`. coordinates: 'ngp' or 'blender',
    scene units and axes of a ``.ppng``. splat_mode: 'classic', 'mip' or 'mip-splatting', how splats smaller than
    a pixel were drawn in training; by default as their file says.
    Raises OSError or ValueError if it cannot be read.
    """
    name = as_path("name", name)
    if not _octobayes.Splats.is_file(name):
        if splat_mode is not None:
            raise wrong("splat_mode", "None but for splats", splat_mode)
        return Model(name, coordinates)
    if coordinates is not None:
        raise wrong("coordinates", "None but for a .ppng", coordinates)
    splats = Splats(name, splat_mode)
    for note in splats._model.notes:
        LOG.info(note)
    return splats


def load(
    path: str | os.PathLike[str],
    *,
    box: Any = None,
    rays: int | None = None,
    contract: Any = None,
) -> Uncertainty:
    """Reads an ``.oct`` file; or the official code's ``.npy``, with the space it covers and its number of ``rays``.

    That space is a ``box`` (low, high), or contracted as ``contract`` of :func:`uncertainty` says.

    Raises OSError or ValueError if it cannot be read.
    """
    path = as_path("path", path)
    if not path.endswith(".npy"):
        if any(argument is not None for argument in (box, rays, contract)):
            raise wrong("box, rays, contract", "None for an .oct file, which knows its own", path)
        return Uncertainty(_octobayes.load(path, {}))
    domain = _domain_options(box, contract)
    if box is None and contract is None:
        raise wrong("box", "the box of the official grid, which its file does not name", "none")
    if rays is None:
        rays = DEFAULT.official_rays
        text = f"{path} is taken for sums of {rays} rays, the official default (rays=)"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return Uncertainty(_octobayes.load(path, domain, whole("rays", rays, 1)))


def _field(name: str, value: Any) -> Uncertainty:
    if isinstance(value, (str, os.PathLike)):
        return load(value)
    if not isinstance(value, Uncertainty):
        raise wrong(name, "an Uncertainty or the path of an .oct file", value)
    return value


def _opened(nerf: Any, cameras: Any = None, u: Uncertainty | None = None) -> Any:
    """A model, or the callable as it is. Warns if ``u`` is of another model.

    A ``.ppng`` is in the coordinates in which ``u`` was computed; without ``u`` in those of NeRF-synthetic camera files
    beside one of these, and else in its file's own.
    """
    if isinstance(nerf, (str, os.PathLike)):
        path = as_path("nerf", nerf)
        in_blender = isinstance(cameras, (str, os.PathLike)) if u is None else True
        nerf = open_model(path, "blender" if path.endswith(".ppng") and in_blender else None)
        if path.endswith(".ppng") and u is not None and nerf._model.checksum != u.record["model_checksum"]:
            nerf = open_model(path)
        if isinstance(nerf, Splats) and u is not None:
            # A field of splats in a mode that was chosen: they are drawn as they were then.
            wanted = u.record["model_checksum"]
            others = (Splats(path, mode) for mode in (None, "classic", "mip"))
            nerf = next((splats for splats in others if splats._model.checksum == wanted), nerf)
    if not callable(nerf) and not isinstance(nerf, Splats):
        raise wrong("nerf", "a model file, a model of open_model or a callable (x, d) -> (density, color)", nerf)
    if isinstance(nerf, Opened) and u is not None:
        _warn(nerf._model.check(u._field, "u"), stacklevel=4)
    return nerf


def _source(nerf: Any) -> str:
    """A name for a model."""
    if isinstance(nerf, Opened):
        return nerf.name
    name = getattr(nerf, "__qualname__", None) or type(nerf).__qualname__
    return f"the Python callable {name}"


def _asked(nerf: Any, box: Any, march_step: float | None, batch: int, u: Uncertainty | None = None) -> Any:
    """What the Rust part asks: its own model, or the gate of a callable, by default in the box of ``u``."""
    batch = whole("batch", batch, 1)
    if isinstance(nerf, Opened):
        return nerf._model
    if box is None and u is not None:
        box = getattr(nerf, "box", u.box)
    return Gate(nerf, box=box, step=march_step, batch=batch, description=_source(nerf))


def _remarks(asked: Any) -> list[tuple[str, bool]]:
    """What is to be said of a callable's answers once it is no longer asked."""
    return remarks(getattr(asked, "overshoot", 0.0))


def _refuse_for_splats(**given: tuple[Any, Any]) -> None:
    """Refuses arguments that are not their defaults, because splats are not marched."""
    for name, (value, default) in given.items():
        if value != default:
            raise wrong(name, "the default: splats are projected, and rays through them not marched", value)


def _image_options(
    nerf: Any,
    background: Any,
    march_step: float | None,
    pixel_offset: float | None,
    occupancy: int,
    u: Uncertainty | None = None,
) -> dict[str, Any]:
    """Options that say how rays pass through the model: beside ``u`` as they did for it."""
    if isinstance(nerf, Splats):
        _refuse_for_splats(march_step=(march_step, None), occupancy=(occupancy, DEFAULT.occupancy))
    record = {} if u is None else u.record
    if background is None:
        background = getattr(nerf, "background", None)
    if background is None:
        background = record.get("background")
    if pixel_offset is None and isinstance(nerf, Opened):
        pixel_offset = record.get("pixel_offset")
    return {
        # Without one, what lies beside splats decides, or else it is white.
        "background": None if background is None else color("background", background),
        "march_step": None if march_step is None else real("march_step", march_step, above=0),
        "pixel_offset": None if pixel_offset is None else real("pixel_offset", pixel_offset, low=0),
        "occupancy": whole("occupancy", occupancy, 4, 512),
    }


def _domain_options(box: Any, contract: Any) -> dict[str, Any]:
    norm, ball = None, None
    if contract is not None:
        try:
            norm, *numbers = contract
        except (TypeError, ValueError) as error:
            raise wrong("contract", "(norm, x, y, z, radius)", contract) from error
        ball = floats("contract[1:]", numbers, (4,), np.float64).tolist()
    return {"box": None if box is None else as_box("box", box), "contract": norm, "inner": ball}


def _grid_options(given: SimpleNamespace) -> dict[str, Any]:
    """Options that say how information becomes a field."""
    return {
        "for_": given.for_,
        "level": None if given.level is None else whole("level", given.level, 1, 16),
        "refine": names("refine", given.refine),
        "grid": given.grid,
        "covariance": given.covariance,
        "lambda_": None if given.lambda_ is None else real("lambda_", given.lambda_, above=0),
        "tolerance": real("tolerance", given.tolerance, low=0),
        "pooling": given.pooling,
        "keep_sums": None if given.keep_sums is None else flag("keep_sums", given.keep_sums),
        "scale": given.scale,
        "noise": None if given.noise is None else real("noise", given.noise, above=0),
    }


def _part(name: str, part: Any) -> list[int] | None:
    """Number of a part, and of all parts."""
    if part is None:
        return None
    expected = "'I/N' or (I, N) with 0 <= I < N"
    try:
        parts = map(int, part.split("/")) if isinstance(part, str) else part
        index, of = (whole(name, number, 0, 2**64 - 1) for number in parts)
    except (TypeError, ValueError) as error:
        raise wrong(name, expected, part) from error
    if not 0 <= index < of:
        raise wrong(name, expected, part)
    return [index, of]


def _warn(said: Iterable[tuple[str, bool]], stacklevel: int = 3) -> None:
    """Warns the caller of the function that calls this; notes go to the log."""
    for text, is_note in said:
        if is_note:
            LOG.info(text)
        else:
            warnings.warn(text, RuntimeWarning, stacklevel=stacklevel)


def uncertainty(
    nerf: Nerf,
    cameras: Any = None,
    *,
    for_: str | None = None,
    box: Any = None,
    level: int | None = None,
    rays: int | str = DEFAULT.rays,
    target_error: float | None = None,
    seed: int = DEFAULT.seed,
    gradient: str = DEFAULT.gradient,
    covariance: str | None = None,
    keep_sums: bool | None = None,
    contract: Any = None,
    memory: int | None = None,
    scratch: str | os.PathLike[str] | None = None,
    refine: str | Sequence[str] = DEFAULT.refine,
    grid: str = DEFAULT.grid,
    lambda_: float | None = None,
    tolerance: float = DEFAULT.tolerance,
    scale: str | None = None,
    noise: float | None = None,
    pooling: str = DEFAULT.pooling,
    step: float | None = None,
    cutoff: float = DEFAULT.cutoff,
    error_bars: int | None = None,
    audit: bool = False,
    shard: str | tuple[int, int] | None = None,
    executor: Executor | None = None,
    shards: int | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    restart: bool = False,
    dump_samples: str | os.PathLike[str] | None = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = DEFAULT.occupancy,
    views: Any = None,
    resolution: Any = None,
    fov: float | None = None,
    force: bool = False,
    batch: int = DEFAULT.batch,
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
    called from this thread only; nine of ten points come in calls of at least ``batch`` points, and no call has twice
    as many.

    cameras: those that the model was trained on. A file (transforms.json, or a COLMAP model), a list of dictionaries,
    or one dictionary of arrays: ``pose`` (4x4, camera-to-world, OpenGL axes), ``focal`` (pixels; one or two) or ``fov``
    (degrees), ``size`` (width, height), optional ``center``, ``k1`` to ``k4``, ``p1``, ``p2`` and ``mask_path``: an
    image of that size (or ``image_size``) whose black pixels were not trained on. ``None`` takes the model's
    own. ``views`` (how many, or frames by their numbers in the file from 0, or 'all') and ``resolution`` choose frames
    of a file and image sizes. Where images lie beside a file's cameras, a few hundred of their pixels are compared with
    the model first: a RuntimeWarning if it shows them poorly, ValueError if not at all, unless ``force``.

    box: (low, high), corners in scene units; for a callable also where its density is zero outside. contract (norm, x,
    y, z, radius), norm 'l2' or 'linf', covers all of space instead, contracted outside this ball.

    for_: what the field is for: 'ranking' (of pixels by their error of depth), 'depth' (its error bars), 'next-view' or
    'splats'. Sets level, covariance, scale and keep_sums as that needs, unless they are given, and logs what it set.

    Other arguments have the command line's names, meanings and defaults (``octobayes uncertainty --help``): rays
    ('all': every training pixel once); target_error (decades: draw rays until the mean error of log10 U is within it,
    at most ``rays``); gradient ('finite-difference': central; 'forward-difference': four points a sample, not seven;
    'analytic': the model's own derivatives; 'auto': these if it has any); covariance ('diagonal', 'block', 'trace');
    refine ('sensitivity', 'density', 'ray-count', or several); memory in bytes (sums that do not fit go to files
    without names in the folder ``scratch``, by default the system's for such files, which may be memory; with a
    checkpoint they lie beside it); step in edges of the finest lattice; error_bars (number of groups); audit (measure
    what skipped samples and the derivatives cost, for :attr:`Uncertainty.report`); shard (a part of the rays, which
    :func:`merge` joins); checkpoint (a file: the state is saved every minute, and a run with the same arguments goes on
    from there unless ``restart``); scale ('paper', or 'data': a standard deviation in scene units, which needs the
    noise that training left, as ``noise``, 10^(-PSNR/20), recorded in the model, or by images beside the cameras, and
    cameras of the size that the model was trained at). ``lambda_`` is ``--lambda``.

    executor: anything with the ``submit`` of ``concurrent.futures``, which runs the ``shards`` instead of this process:
    a ProcessPoolExecutor, dask.distributed's ``client.get_executor()``. nerf must be a model's file that the workers
    see, too, or a callable that they can unpickle. The shards are merged here as they come; the result is that of one
    run up to the order of additions, and the same to the last bit whichever came first.

    progress: called with (stage, done, total); True for a bar of tqdm, False for none; by default a bar where one is
    seen and tqdm is installed.

    Raises ValueError for arguments that make no sense, OSError for files, FloatingPointError if the field is not finite
    on more than 1 % of the rays, and whatever the callable raises, as it raised it. Ctrl-C stops within a second. Where
    it raises, nothing is written (but the checkpoint, if there is one). Warns (RuntimeWarning) of cameras that see
    little, of a bad finite-difference step and of dropped rays. What was assumed goes to the logger ``octobayes``.
    """
    field, said, _ = _run(SimpleNamespace(**locals()))
    _warn(said)
    return Uncertainty(field)


def forecast(nerf: Nerf, cameras: Any = None, **arguments: Any) -> dict[str, Any]:
    """What :func:`uncertainty` with these arguments will need at most, by the first sixteenth of its rays.

    Returns what ``octobayes uncertainty --dry-run --json`` prints, as a dictionary: 'rays', 'vertices', 'peak_bytes',
    'file_bytes', 'seconds' on as many 'threads', and others. Nothing is written. Warns and raises as
    :func:`uncertainty` does.
    """
    given = signature(uncertainty).bind(nerf, cameras, **arguments)
    given.apply_defaults()
    _, said, needs = _run(SimpleNamespace(**given.arguments), is_dry=True)
    _warn(said)
    return json.loads(needs)


def _run(given: SimpleNamespace, is_dry: bool = False) -> tuple[Any, list[tuple[str, bool]], str]:
    """The field of a run (none if ``is_dry``), what a user should know, and what it will need."""
    nerf, executor, shards = _opened(given.nerf, given.cameras), given.executor, given.shards
    domain = _domain_options(given.box, given.contract)
    if isinstance(nerf, Splats):
        _refuse_for_splats(
            gradient=("" if given.gradient in ("auto", DEFAULT.gradient) else given.gradient, ""),
            step=(given.step, None),
            cutoff=(given.cutoff, DEFAULT.cutoff),
            audit=(given.audit, False),
        )
    if given.contract is not None and isinstance(nerf, Opened) and given.box is not None:
        raise wrong("box", "None with contract", "a box")
    parts = {name: getattr(given, name) for name in ("shard", "error_bars", "dump_samples")}
    if given.target_error is not None and any(part is not None for part in parts.values()):
        raise wrong("target_error", "None with shard, error_bars or dump_samples", given.target_error)
    if given.shard is not None and given.error_bars is not None:
        raise wrong("error_bars", "None with shard, which is one group of rays", given.error_bars)
    if flag("restart", given.restart) and given.checkpoint is None:
        raise wrong("restart", "a checkpoint beside it", "none")
    own_box = getattr(nerf, "box", None)
    if not isinstance(nerf, Opened) and domain["box"] is None and own_box is not None:
        domain["box"] = as_box("nerf.box", own_box)
    cameras = _training_cameras(nerf, given.cameras, given.views, given.resolution, given.fov)
    if executor is None and shards is not None:
        raise wrong("shards", "an executor beside them (one shard alone: shard=)", shards)
    if executor is not None:
        shards = _shards.checked(executor, shards, vars(given), is_dry)
        if given.target_error is not None or given.memory is not None:
            raise wrong("executor", "no target_error, and no limit of memory, which is each shard's own", "one")
    options = {
        **domain,
        **_grid_options(given),
        **_image_options(nerf, given.background, given.march_step, given.pixel_offset, given.occupancy),
        **cameras.options(),
        "memory": None if given.memory is None else whole("memory", given.memory, 1),
        "rays": "all" if isinstance(given.rays, str) and given.rays == "all" else whole("rays", given.rays, 1),
        "target_error": None if given.target_error is None else real("target_error", given.target_error, above=0),
        "seed": whole("seed", given.seed, 0, 2**64 - 1),
        "gradient": given.gradient,
        "step": None if given.step is None else real("step", given.step, above=0),
        "cutoff": real("cutoff", given.cutoff, low=0),
        "error_bars": None if given.error_bars is None else whole("error_bars", given.error_bars, 2, 64),
        "audit": flag("audit", given.audit),
        "force": flag("force", given.force),
        "has_fov": given.fov is not None,
        "shard": _part("shard", given.shard),
        "checkpoint": None if given.checkpoint is None else as_path("checkpoint", given.checkpoint),
        "restart": given.restart,
        "scratch": None if given.scratch is None else as_path("scratch", given.scratch),
        "dump_samples": None if given.dump_samples is None else as_path("dump_samples", given.dump_samples),
        "source": f"{nerf._model.source if isinstance(nerf, Opened) else _source(nerf)} seen by {cameras.source}",
        "dry_run": is_dry,
    }
    if is_dry:
        options |= {"checkpoint": None, "dump_samples": None}
    if executor is not None and shards is not None:
        gate = {"box": domain["box"], "step": given.march_step, "batch": given.batch, "description": _source(nerf)}
        task = _shards.Task(nerf, gate, cameras.rows, options)
        with reporting(given.progress) as report:
            field, said = _shards.run(task, executor, shards, report)
        return field if _octobayes.keeps_sums(options) else field.for_queries(), said, ""
    asked = _asked(nerf, domain["box"], given.march_step, given.batch)
    with reporting(given.progress) as report:
        field, said, needs = _octobayes.uncertainty(asked, cameras.rows, options, report)
    return field, [*said, *_remarks(asked)], needs


def _training_cameras(nerf: Any, cameras: Any, views: Any, resolution: Any, fov: float | None) -> Cameras:
    """The cameras that the model was trained on."""
    model = nerf if isinstance(nerf, Model) else None
    if cameras is None and model is None:
        cameras = getattr(nerf, "cameras", None)
        cameras = cameras() if callable(cameras) else cameras
        if cameras is None:
            raise wrong("cameras", "a camera file or cameras, as this model brings none", "none")
    if cameras is not None and fov is not None:
        raise wrong("fov", "None with cameras, which have their own", fov)
    return camera_rows(cameras, views, resolution, model=model, fov=fov)


def compare(
    a: Uncertainty | str,
    b: Uncertainty | str,
    *,
    points: int = DEFAULT.points,
    seed: int = 0,
    covariance: str | None = None,
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
    found, said = _octobayes.compare(a._field, b._field, points, seed)
    _warn(said)
    return json.loads(found)


def merge(
    fields: Sequence[Uncertainty | str],
    *,
    error_bars: bool = False,
    keep_sums: bool = False,
    scratch: str | os.PathLike[str] | None = None,
) -> Uncertainty:
    """Joins fields of one box, level and record from different rays: shards of a run, or other seeds.

    error_bars: also the error of log10 U, from the fields' differences (of different seeds, at most 64). scratch: the
    folder for sums beyond 256 MB, by default the system's for temporary files, which may be memory. The fields must
    keep their sums (shards do). Raises ValueError if they do not belong together. Warns of missing shards.
    """
    given = [_field(f"fields[{i}]", field)._field for i, field in enumerate(fields)]
    field, texts = _octobayes.merge(
        given,
        flag("error_bars", error_bars),
        flag("keep_sums", keep_sums),
        None if scratch is None else as_path("scratch", scratch),
    )
    _warn(texts)
    return Uncertainty(field)


def accumulate(
    samples: str | os.PathLike[str] | Mapping[str, Any],
    *,
    for_: str | None = None,
    box: Any = None,
    level: int | None = None,
    contract: Any = None,
    refine: str | Sequence[str] = DEFAULT.refine,
    grid: str = DEFAULT.grid,
    covariance: str | None = None,
    lambda_: float | None = None,
    tolerance: float = DEFAULT.tolerance,
    scale: str | None = None,
    noise: float | None = None,
    training_pixels: int | None = None,
    pooling: str = DEFAULT.pooling,
    keep_sums: bool | None = None,
    progress: Progress | bool | None = None,
) -> Uncertainty:
    """Sums ray samples whose Jacobians were computed elsewhere.

    samples: an ``.npz`` file, or a dictionary of arrays: ``positions`` ``[N, 3]`` (scene units), ``jacobian``
    ``[N, 3, 3]`` (∂C_c/∂x_k, rows colour, columns axis), ``ray`` ``[N]`` (never decreasing), ``rays_total`` (all that
    were drawn), optional ``weight`` ``[N]``. scale='data' needs ``noise`` and ``training_pixels``, the number of
    pixels of all training images, unless the file states it. The other arguments are those of :func:`uncertainty`.
    Raises ValueError or OSError.
    """
    options = {
        **_domain_options(box, contract),
        **_grid_options(SimpleNamespace(**locals())),
        "training_pixels": None if training_pixels is None else whole("training_pixels", training_pixels, 1),
    }
    with reporting(progress) as report:
        given = _samples(samples) if isinstance(samples, Mapping) else as_path("samples", samples)
        field, said = _octobayes.accumulate(given, options, report)
    _warn(said)
    return Uncertainty(field)


def _samples(samples: Mapping[str, Any]) -> tuple[Any, ...]:
    missing = [key for key in ("positions", "jacobian", "ray", "rays_total") if key not in samples]
    if missing:
        raise wrong("samples", "keys positions, jacobian, ray and rays_total", f"none of {missing}")
    positions = floats("samples['positions']", samples["positions"], (None, 3))
    n = len(positions)
    jacobian = floats("samples['jacobian']", samples["jacobian"], (n, 3, 3)).reshape(n, 9)
    ray = array("samples['ray']", samples["ray"])
    if ray.shape != (n,) or ray.dtype.kind not in "iu" or (n > 0 and ray.min() < 0):
        raise wrong("samples['ray']", f"an array of whole numbers of shape [{n}], 0 or more", ray)
    weight = samples.get("weight")
    weight = np.zeros(n, np.float32) if weight is None else floats("samples['weight']", weight, (n,))
    total = array("samples['rays_total']", samples["rays_total"])
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
    ray_average: str = DEFAULT.ray_average,
    threshold: float | str | None = None,
    depth_error: bool = False,
    confirm: bool = False,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = DEFAULT.occupancy,
    resolution: Any = None,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> dict[str, np.ndarray]:
    """Renders one view.

    nerf, camera and the arguments not explained here: as in :func:`uncertainty`; of a camera file, ``frame`` is
    rendered. u: the model's uncertainty, or None for none. ray_average: how log10 U becomes a pixel's
    ('weighted-mean', 'u-spread', 'u-spread-per-root-ray'). threshold: remove density where
    log10 U exceeds this (or, as '99%', what it exceeds on the most certain 99 percent of visible surfaces).
    depth_error: the standard deviation of depth, too; u must be one of scale='data'. confirm: where three training
    cameras see a surface at the pixel's depth, for a model that stores its cameras; do not rely on the deviation
    elsewhere. Each call renders them all, with at most 128 pixels a side. box: for a callable, by default u's.

    Returns float32 arrays: 'color' ``[H, W, 3]``, 'depth' ``[H, W]`` (median distance from the camera, scene units; 0
    where nothing is), 'opacity' ``[H, W]``, with u 'log10_uncertainty' ``[H, W]`` (NaN where the opacity is 0.05 or
    less, or what is seen lies outside the box of u, as in the command line's pictures), and with depth_error
    'depth_error' ``[H, W]`` (scene units; NaN where nothing is) and, if u is calibrated, 'depth_interval' ``[H, W]``
    (half width of the interval, scene units). With confirm also 'depth_confirmed' ``[H, W]``, which is bool.
    Raises as :func:`uncertainty` does.
    """
    u = None if u is None else _field("u", u)
    nerf = _opened(nerf, camera, u)
    if isinstance(camera, (str, os.PathLike)):
        numbers = camera_rows(camera, None, resolution, every_frame=True).rows
        numbers = numbers[whole("frame", frame, 0, len(numbers) - 1)][None]
    else:
        listed = [camera] if isinstance(camera, Mapping) else camera
        numbers = camera_rows(listed, None, resolution).rows
    if len(numbers) != 1:
        raise wrong("camera", "one camera", f"{len(numbers)} cameras")
    if threshold is not None:
        threshold = _threshold(threshold, u)
    if depth_error and u is None:
        raise wrong("depth_error", "an uncertainty beside it", "none")
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy, u),
        "ray_average": names("ray_average", ray_average)[:1],
        "threshold": threshold,
        "depth_error": flag("depth_error", depth_error),
        "confirm": flag("confirm", confirm),
    }
    asked = _asked(nerf, box, march_step, batch, u)
    field = None if u is None else u._field
    with reporting(progress) as report:
        view = _octobayes.render(asked, field, np.ascontiguousarray(numbers), options, report)
    _warn(_remarks(asked))
    return view


def splat_columns(
    splats: Splats | str | os.PathLike[str],
    u: Uncertainty | str,
    cameras: Any = None,
    *,
    pixels: int = DEFAULT.pixels,
    background: Any = None,
    pixel_offset: float | None = None,
    views: Any = None,
    resolution: Any = None,
    progress: Progress | bool | None = None,
) -> dict[str, np.ndarray]:
    """What :func:`export` writes beside each splat, as arrays ``[n]``.

    Returns 'uncertainty' (U at the centre; of a u of scale='data' in scene units), 'log10_uncertainty' and, if u knows
    where rays passed, 'seen' (0 never seen, 1 free, 2 constrained, as ``u.seen``); and with the training ``cameras``
    'weight' (sum of the splat's shares of about ``pixels`` pixels that were looked at), 'views' (training views in
    which its share of one of these pixels exceeds 0.05) and 'front_share' (the part of its weight that is nearer than
    where half of a pixel's light is reached, by more than a hundredth of that depth, and in empty pixels once a view
    contradicts the splat: near 1 for floaters).
    """
    u = _field("u", u)
    splats = _opened(splats, cameras, u)
    if not isinstance(splats, Splats):
        raise wrong("splats", "Gaussian splats, or a file of these", splats)
    uncertainty = u.query(splats.means)
    columns = {"uncertainty": uncertainty, "log10_uncertainty": np.log10(uncertainty)}
    if u.ray_coverage is not None:
        known = u.seen(splats.means)
        columns["seen"] = np.select([known == "constrained", known == "free"], [2.0, 1.0], 0.0)
    if cameras is not None:
        rows = _training_cameras(splats, cameras, views, resolution, None).rows
        options = {
            **_image_options(splats, background, None, pixel_offset, DEFAULT.occupancy, u),
            "pixels": whole("pixels", pixels, 1),
        }
        with reporting(progress) as report:
            seen = _octobayes.seen_splats(splats._model, np.ascontiguousarray(rows), options, report)
        columns |= dict(zip(("weight", "views", "front_share"), seen))
    return columns


def _threshold(threshold: float | str, u: Uncertainty | None) -> float:
    if u is None:
        raise wrong("threshold", "an uncertainty to cut by", "none")
    log10, said = u._field.threshold(threshold if isinstance(threshold, str) else real("threshold", threshold))
    _warn(said, stacklevel=4)
    return log10


def evaluate(
    nerf: Nerf,
    u: Uncertainty | str | Mapping[str, Uncertainty | str],
    cameras: str | os.PathLike[str],
    *,
    depth: str | os.PathLike[str] | None = None,
    depth_encoding: tuple[float, float] | None = None,
    depth_pattern: str = DEFAULT.depth_pattern,
    z_depth: bool = False,
    object_masks: str | os.PathLike[str] | None = None,
    images: str | os.PathLike[str] | None = None,
    training_depth: str | os.PathLike[str] | None = None,
    covariance: str | Sequence[str] | None = None,
    ray_average: str | Sequence[str] | None = None,
    ensemble: Sequence[str | os.PathLike[str] | Model | Splats] = (),
    clean_up: bool = False,
    stride: int = DEFAULT.stride,
    views: Any = None,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = DEFAULT.occupancy,
    resolution: Any = None,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> dict[str, Any]:
    """Whether U ranks the depth error of held-out views: AUSE beside measures that need no Hessian.

    u: one field, or several by name. cameras: a camera file with images. depth: folder of depth maps, named by
    ``depth_pattern`` ({} is the frame's name without extension) and looked for below the directories of the frame's
    name, then in the folder itself; without it the maps are those that the camera file names (``depth_file_path``).
    depth = offset + scale * p for ``depth_encoding`` (offset, scale), p from 0 to 1, or scene units in .exr and .npy,
    which have no encoding. ray_average: by default ``u-spread-per-root-ray``. The other arguments are the command
    line's (``octobayes evaluate --help``); views: how many, or frames by their numbers, or 'all'.

    Values that are no measurements (0, the largest value of a PNG, NaN, infinity, 1e10 of Blender, or depths far behind
    the model's box) are left out. A ``RuntimeWarning`` says how many and why, and whether depths are unlikely; a
    ``ValueError`` says so if nearly none is left, or if half of them are off by more than the box is wide.

    object_masks: folder of masks in which the object is not black, 'NAME.png' of each view; ``None`` for those that the
    camera file names. images: folder from which the names of the training images start; deviations of depth then also
    count how well these agree on each surface.
    training_depth: folder of the training views' maps; every measure then says how well it detects what no training
    view saw. ensemble: two or more models that were trained like this one, not callables. clean_up: also remove density
    (or splats) above ten thresholds of log10 U; alone, it needs no depth.

    Returns what ``octobayes evaluate --json`` prints for these arguments, as a dictionary: 'readings' and 'baselines'
    (name; 'ause_pooled', 'ause_from_start' (where both curves are divided by their start), 'rise' (of the curve above
    it), 'ause_mean_over_views', 'risk' and 'least_risk' by error kind; 'rank_correlation' and
    'rank_correlation_mean_over_views'; 'calibration' of standard deviations of depth, which fields of scale='data'
    give, and 'confirmed', the same where three training views see a surface, if the model stores its cameras;
    'never_seen' with training_depth), 'depth_error', 'depth_readings' (pixels of the maps: 'measured', and the others
    by reason), 'kinds' (share, depth error and measures of the object, silhouettes, thin
    parts, ...), 'psnr', 'views', 'pixels', 'clean_up' (a dictionary for each threshold) and others. Raises as
    :func:`uncertainty` does.
    """
    named = u if isinstance(u, Mapping) else {"u": u}
    fields = {str(name): _field(f"u[{name!r}]", field) for name, field in named.items()}
    first = next(iter(fields.values()), None)
    nerf = _opened(nerf, cameras, first)
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy, first),
        **_held_out_options(cameras, depth, depth_encoding, depth_pattern, z_depth, stride, views, resolution),
        "object_masks": None if object_masks is None else as_path("object_masks", object_masks),
        "images": None if images is None else as_path("images", images),
        "training_depth": None if training_depth is None else as_path("training_depth", training_depth),
        "clean_up": flag("clean_up", clean_up),
        "ray_average": None if ray_average is None else names("ray_average", ray_average),
        "covariance": None if covariance is None else names("covariance", covariance),
    }
    report, _ = _judged(nerf, fields, ensemble, options, box, march_step, batch, progress)
    return report


def calibrate(
    nerf: Nerf,
    u: Uncertainty | str,
    cameras: str | os.PathLike[str],
    *,
    depth: str | os.PathLike[str] | None = None,
    depth_encoding: tuple[float, float] | None = None,
    depth_pattern: str = DEFAULT.depth_pattern,
    z_depth: bool = False,
    covariance: str | None = None,
    probability: float = DEFAULT.probability,
    stride: int = DEFAULT.stride,
    views: Any = None,
    box: Any = None,
    background: Any = None,
    march_step: float | None = None,
    pixel_offset: float | None = None,
    occupancy: int = DEFAULT.occupancy,
    resolution: Any = None,
    batch: int = DEFAULT.batch,
    progress: Progress | bool | None = None,
) -> tuple[Uncertainty, dict[str, Any]]:
    """An interval of depth that holds by counting, from held-out views of known depth.

    Errors of depth are divided by their deviations; the quantile of these ratios that holds the share ``probability``
    of further ones (split conformal prediction) goes with the field, and into ``render``'s 'depth_interval'. u must be
    one of ``scale='data'``. covariance: the one by which depths have their deviations, and that the calibrated field
    has; by default the field's own. The other arguments are those of :func:`evaluate`.

    It promises that share of pixels that are drawn like these: this scene, this model, views chosen as these were. It
    promises nothing of other scenes, of views from other sides or of a single pixel.

    Returns the calibrated field, and the dictionary of :func:`evaluate`, whose 'calibrated' has 'conformal' (as
    :attr:`Uncertainty.conformal`), 'predicted_factor' (what it would be without) and 'views_left_out' (least, median
    and largest share that a view's errors have in the interval of all others). Warns and raises as :func:`evaluate`
    does.
    """
    u = _field("u", u)
    nerf = _opened(nerf, cameras, u)
    options = {
        **_image_options(nerf, background, march_step, pixel_offset, occupancy, u),
        **_held_out_options(cameras, depth, depth_encoding, depth_pattern, z_depth, stride, views, resolution),
        "probability": real("probability", probability, above=0),
        "covariance": [u.record["covariance"] if covariance is None else covariance],
    }
    if not options["probability"] < 1:
        raise wrong("probability", "a share between 0 and 1", probability)
    report, field = _judged(nerf, {"u": u}, (), options, box, march_step, batch, progress)
    return Uncertainty(field), report


def _judged(
    nerf: Any,
    fields: Mapping[str, Uncertainty],
    ensemble: Sequence[Any],
    options: dict[str, Any],
    box: Any,
    march_step: float | None,
    batch: int,
    progress: Progress | bool | None,
) -> tuple[dict[str, Any], Any]:
    """The report, and the calibrated field."""
    coordinates = getattr(nerf, "_coordinates", None)
    mode = nerf.mode if isinstance(nerf, Splats) else None

    def member(of: Any) -> Any:
        is_open = isinstance(of, Opened) or callable(of)
        return of if is_open else open_model(of, coordinates, splat_mode=mode)

    members = [member(of) for of in ensemble]
    if len(members) == 1 or not all(isinstance(member, Opened) for member in members):
        raise wrong("ensemble", "two or more models, or files of models", ensemble)
    asked = _asked(nerf, box, march_step, batch, next(iter(fields.values()), None))
    given = [(name, field._field) for name, field in fields.items()]
    options = {**options, "source": _source(nerf)}
    with reporting(progress) as report:
        said, notes, field = _octobayes.evaluate(asked, given, [m._model for m in members], options, report)
    for text, _ in [*notes, *_remarks(asked)]:
        warnings.warn(text, RuntimeWarning, stacklevel=3)
    return json.loads(said), field


def _held_out_options(
    cameras: Any,
    depth: Any,
    depth_encoding: Any,
    depth_pattern: str,
    z_depth: bool,
    stride: int,
    views: Any,
    resolution: Any,
) -> dict[str, Any]:
    """Where held-out views and their depth are."""
    width, height = as_size(resolution)
    if depth_encoding is not None:
        depth_encoding = floats("depth_encoding", depth_encoding, (2,), np.float64).tolist()
    return {
        "cameras": as_path("cameras", cameras),
        "depth": None if depth is None else as_path("depth", depth),
        "depth_encoding": depth_encoding,
        "depth_pattern": depth_pattern,
        "z_depth": flag("z_depth", z_depth),
        "stride": whole("stride", stride, 1),
        "views": selected(views),
        "width": width,
        "height": height,
    }
