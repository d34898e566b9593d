"""Models that nerfstudio trained: their radiance fields, and the cameras that they were trained on.

    field, cameras = ob.nerfstudio.load("outputs/.../config.yml")
    u = ob.uncertainty(field, cameras, contract=field.contract, gradient="analytic")

nerfstudio must be installed. It runs what config.yml and the checkpoint say as it loads them: open only your own.
Tested with nerfacto of nerfstudio 1.1.5.
"""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import path as as_path
from ._arguments import points as as_points
from ._arguments import real, wrong
from ._autodiff import TorchField
from ._cameras import LENS


class NerfstudioField(TorchField):
    """A trained radiance field of nerfstudio, as :func:`load` returns it: ``field(x, d) -> (density, color)``.

    Positions are in scene units, those of nerfstudio's data parser, which orients, centres and scales the poses:
    ``x = scale * (transform[:, :3] @ x_original + transform[:, 3])``. U is in scene units, too; U / ``scale`` is in
    those of the original cameras.
    """

    #: ``[2, 3]``: the part of space in which rays are followed, scene units.
    box: NDArray[np.float64]
    #: Distance between samples along a ray, scene units.
    step: float
    #: ('linf', 0, 0, 0, 1) or ('l2', 0, 0, 0, 1) if the model contracts all of space around the unit cube or ball, else
    #: None; for :func:`octobayes.uncertainty`.
    contract: tuple[str, float, float, float, float] | None
    #: ``[3, 4]``: original to scene axes and origin, before :attr:`scale`.
    transform: NDArray[np.float64]
    #: Scene units per original unit.
    scale: float
    #: Number of rays in a batch of training.
    rays_per_batch: int
    #: The model as nerfstudio has it.
    model: Any

    def to_scene(self, points: ArrayLike) -> NDArray[np.float64]:
        """Scene positions ``[N, 3]`` of points in the units and axes of the original cameras."""
        x, shape = as_points("points", points)
        moved = x.astype(np.float64) @ self.transform[:, :3].T + self.transform[:, 3]
        return (self.scale * moved).reshape(*shape, 3)

    def to_original(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points ``[N, 3]`` in the units and axes of the original cameras, from scene positions."""
        x, shape = as_points("points", points)
        moved = x.astype(np.float64) / self.scale - self.transform[:, 3]
        return np.linalg.solve(self.transform[:, :3], moved.T).T.reshape(*shape, 3)


def _radiance(field: Any, rest: Any = None) -> Any:
    """A field of nerfstudio as a module of positions and directions; beyond it, ``rest`` of :func:`_backdrop`."""
    import torch
    from nerfstudio.cameras.rays import Frustums, RaySamples
    from nerfstudio.field_components.field_heads import FieldHeadNames

    class Radiance(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.field = field

        def density(self, x: torch.Tensor) -> torch.Tensor:
            density = self.field.density_fn(x)[:, 0]
            return density if rest is None else torch.where(rest.is_on(x), rest.density, density)

        def forward(self, x: torch.Tensor, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            density, color = self.trained(x, d)
            if rest is not None and (on := rest.is_on(x)).any():
                density = torch.where(on, rest.density, density)
                color = color.clone()
                color[on] = rest.color(self.trained, x[on], d[on])
            return density, color

        def trained(self, x: torch.Tensor, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            # A sample of no length has its position at its origin. In evaluation no image's appearance is used, so that
            # the camera does not matter.
            none = torch.zeros_like(x[:, :1])
            frustums = Frustums(origins=x, directions=d, starts=none, ends=none, pixel_area=none)
            samples = RaySamples(frustums=frustums, camera_indices=torch.zeros_like(none, dtype=torch.long))
            density, features = self.field.get_density(samples)
            color = self.field.get_outputs(samples, density_embedding=features)[FieldHeadNames.RGB]
            return density[:, 0], color

    return Radiance().eval()


class _Backdrop:
    """What a contracted scene shows beyond a cube, painted on the cube's faces from inside.

    Rays are followed in even steps, which cannot go on for ever. On the faces a field is opaque, with the colour that
    the rest of the ray would bring: samples that are farther apart the farther they are, up to the model's far plane.
    """

    #: Samples of the rest of a ray; nerfacto has 48 for all of it.
    SAMPLES = 64

    def __init__(self, reach: float, far: float, step: float, background: Any) -> None:
        # Two steps of it leave exp(-20) of the light.
        self.edge, self.density = reach - 2 * step, 10 / step
        self._reach, self._far, self._background = reach, far, background

    def is_on(self, x: Any) -> Any:
        return x.abs().amax(dim=-1) > self.edge

    def color(self, trained: Any, x: Any, d: Any) -> Any:
        """Colour of the rest of rays from ``x`` along ``d``."""
        import torch

        # Even in disparity, as seen from the cube's middle.
        last = self._far / (self._reach + self._far)
        s = torch.linspace(0, last, self.SAMPLES + 1, device=x.device)
        edges = self._reach * s / (1 - s)
        t, width = 0.5 * (edges[1:] + edges[:-1]), edges[1:] - edges[:-1]
        at = x[:, None] + t[:, None] * d[:, None]
        along = d[:, None].expand_as(at)
        density, color = trained(at.reshape(-1, 3), along.reshape(-1, 3))
        depth = density.reshape(len(x), -1) * width
        color = color.reshape(*depth.shape, 3)
        before = torch.exp(-(depth.cumsum(-1) - depth))
        weights = before * -torch.expm1(-depth)
        behind = color[:, -1] if self._background is None else self._background.to(x)
        return (weights[..., None] * color).sum(dim=1) + (1 - weights.sum(dim=1, keepdim=True)) * behind


def _contraction(field: Any) -> tuple[str, float, float, float, float] | None:
    """``contract`` of a field of nerfstudio."""
    distortion = getattr(field, "spatial_distortion", None)
    if distortion is None:
        return None
    order = getattr(distortion, "order", "unknown")
    if order not in (None, 2, math.inf):
        raise wrong("spatial_distortion", "a SceneContraction of order None, 2 or infinity", f"order {order!r}")
    return "linf" if order == math.inf else "l2", 0.0, 0.0, 0.0, 1.0


def _background(model: Any) -> Any:
    """The colour behind the scene as nerfstudio evaluates, a tensor; None for that of a ray's last sample."""
    import torch

    color = getattr(getattr(model, "renderer_rgb", None), "background_color", "black")
    if not isinstance(color, str):
        return color.detach().float()
    # 'random' adds none in evaluation.
    return None if color == "last_sample" else torch.full((3,), 1.0 if color == "white" else 0.0)


def _readable() -> Any:
    """A context in which ``torch.load`` reads checkpoints of nerfstudio without executing them.

    Schedulers leave NumPy scalars in them, which PyTorch 2.6 and later refuse unless they are allowed by name.
    """
    import torch

    allowed = getattr(torch.serialization, "safe_globals", None)
    if allowed is None:
        return contextlib.nullcontext()
    scalar = np.float64(0).__reduce__()[0]
    kinds = [np.dtype, type(np.dtype(np.float64)), type(np.dtype(np.float32)), type(np.dtype(np.int64))]
    return allowed([(scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")] + kinds)


def cameras(cameras: Any, corrections: Any = None) -> list[dict[str, Any]]:
    """Cameras of nerfstudio (``nerfstudio.cameras.cameras.Cameras``) as :func:`octobayes.uncertainty` takes them.

    corrections: ``[C, 3, 4]``, what nerfstudio's camera optimiser learnt: rotations and shifts in scene axes.
    Raises ValueError for lenses other than perspective ones.
    """
    from nerfstudio.cameras.cameras import CameraType

    found = []
    for i in range(len(cameras)):
        kind = CameraType(int(cameras.camera_type[i]))
        if kind != CameraType.PERSPECTIVE:
            raise wrong(f"cameras[{i}]", "a perspective camera", kind.name)
        pose = np.eye(4)
        pose[:3] = cameras.camera_to_worlds[i].detach().cpu().numpy()
        if corrections is not None:
            shift = np.asarray(corrections[i].detach().cpu(), dtype=np.float64)
            pose[:3, :3] = shift[:, :3] @ pose[:3, :3]
            pose[:3, 3] += shift[:, 3]
        lens = [0.0] * 6 if cameras.distortion_params is None else cameras.distortion_params[i].tolist()
        number = {key: float(getattr(cameras, key)[i]) for key in ("fx", "fy", "cx", "cy", "width", "height")}
        camera = {
            "pose": pose,
            "focal": (number["fx"], number["fy"]),
            "center": (number["cx"], number["cy"]),
            "size": (int(number["width"]), int(number["height"])),
        }
        found.append(camera | dict(zip(LENS, lens)))
    return found


def load(
    config: str | os.PathLike[str], *, reach: float = 4.0, step: float | None = None, pose_corrections: bool = True
) -> tuple[NerfstudioField, list[dict[str, Any]]]:
    """Opens a run of nerfstudio: the field of its latest checkpoint, and its training cameras.

    config: the run's ``config.yml``. reach: half the edge of the cube around the origin in which rays are followed,
    scene units, for a model that contracts all of space; others have a box. What is beyond is painted on the cube's
    faces, opaque, as seen along each ray; U cannot tell there how far it is. step: distance between samples on a ray,
    scene units; by default 1/128 with a contraction, else the box's diagonal / 1024. pose_corrections: apply what the
    camera optimiser learnt, as training did; False for the poses as evaluation has them.

    Returns the field, of type :class:`NerfstudioField`, and cameras as :func:`octobayes.uncertainty` takes them: of the
    size of the training images, with their lens distortion and the images' names, in scene units. The field is what
    nerfstudio evaluates: appearance embeddings are averaged (or zero, as the model has it), on the model's device.

    The cameras are those of the training split, as nerfstudio's data parser divides the frames: by the lists of names
    in the dataset (``train_filenames``, ...), or as the run's configuration says. Cameras have the masks that the run
    applied, as ``mask_path``.

    Raises ImportError without nerfstudio, FileNotFoundError without config or checkpoint, ValueError for a model
    without a radiance field (splatfacto), for lenses that are not perspective, and what nerfstudio raises.
    """
    path = Path(as_path("config", config))
    reach = real("reach", reach, above=1)
    if not path.exists():
        raise FileNotFoundError(f"config: expected the config.yml of a run of nerfstudio, found no file {path}")
    try:
        from nerfstudio.utils.eval_utils import eval_setup
    except ImportError as error:
        raise ImportError(
            "nerfstudio: expected it to be installed (pip install nerfstudio), found it missing"
        ) from error
    try:
        with _readable():
            settings, pipeline, _, _ = eval_setup(path, test_mode="inference")
    except SystemExit as error:
        raise FileNotFoundError(f"config: expected a run with a checkpoint, found none beside {path}") from error
    model = pipeline.model.eval()
    trained = getattr(model, "field", None) or getattr(model, "field_fine", None)
    if not (hasattr(trained, "get_density") and hasattr(trained, "get_outputs")):
        raise wrong("config", "a model with a radiance field, such as nerfacto", type(model).__name__)
    # For inference the pipeline takes full-size images; the parser itself knows the size of those trained on.
    manager = settings.pipeline.datamanager
    parsed = manager.dataparser.setup().get_dataparser_outputs(split="train")
    masks = _masks(manager, parsed)
    sizes = [(int(w), int(h)) for w, h in zip(parsed.cameras.width, parsed.cameras.height)] if masks else []
    if (factor := getattr(manager, "camera_res_scale_factor", 1.0)) != 1:
        parsed.cameras.rescale_output_resolution(scaling_factor=factor)
    field = _field(model, trained, parsed, reach, step)
    field.rays_per_batch = int(manager.train_num_rays_per_batch)
    optimizer = getattr(model, "camera_optimizer", None) if pose_corrections else None
    is_on = optimizer is not None and optimizer.config.mode != "off"
    found = cameras(parsed.cameras, optimizer.get_correction_matrices() if is_on else None)
    for camera, name in zip(found, parsed.image_filenames):
        camera["file_path"] = os.fspath(name)
    for camera, mask, size in zip(found, masks, sizes):
        # The size of the image on disk: training may have used a smaller copy.
        camera |= {"mask_path": os.fspath(mask), "image_size": size}
    return field, found


def _masks(manager: Any, parsed: Any) -> list[Any]:
    """The masks that the training applied, one for each image, if there are any."""
    masks = list(getattr(parsed, "mask_filenames", None) or ())
    return [] if getattr(getattr(manager, "pixel_sampler", None), "ignore_mask", False) else masks


def _field(model: Any, trained: Any, parsed: Any, reach: float, step: float | None) -> NerfstudioField:
    """The field of a model, with what its data parser did to space."""
    contract = _contraction(trained)
    behind, rest = _background(model), None
    if contract is None:
        box = np.asarray(trained.aabb.detach().cpu(), dtype=np.float64).reshape(2, 3)
        step = float(np.linalg.norm(box[1] - box[0])) / 1024 if step is None else real("step", step, above=0)
    else:
        box = np.array([[-reach] * 3, [reach] * 3])
        step = 1 / 128 if step is None else real("step", step, above=0)
        rest = _Backdrop(reach, getattr(model.config, "far_plane", 1000.0), step, behind)
    # In a box, where nothing was met, the last sample's colour cannot be known.
    background = np.zeros(3) if behind is None else behind.cpu().numpy()
    device = next(trained.parameters()).device
    attributes = {"box": box, "step": step, "background": background, "pixel_offset": None}
    field = NerfstudioField(_radiance(trained, rest), device, None, attributes)
    field.contract, field.model = contract, model
    field.transform = np.asarray(parsed.dataparser_transform, dtype=np.float64)[:3]
    field.scale = float(parsed.dataparser_scale)
    field.__qualname__ = f"{type(model).__name__} of nerfstudio"
    return field
