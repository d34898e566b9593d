"""nerfacto, trained by nerfstudio, against nerfstudio itself; then its uncertainty. Writes nerfacto.md beside itself.

    python experiments/nerfacto.py WORK [--rays 8000] [--step 0.015] [--width 100]

WORK holds what nerfacto_train.py left: a run on lego, which is wanted, and one on fox, if there is one.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import subprocess
import time
from pathlib import Path

import numpy as np
import torch
import yaml
from nerfacto_train import without_lpips

import octobayes as ob

HERE = Path(__file__).parent
#: Cells per axis. After so few steps there is thin fog everywhere, and nothing to leap over.
OCCUPANCY = 32


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(((a - b) ** 2).mean()))


class Run:
    """A trained model, its training views, and how nerfstudio renders them."""

    def __init__(self, work: Path, scene: str, step: float | None = None, reach: float = 4) -> None:
        self.config = next((work / "outputs" / scene).rglob("config.yml"))
        self.field, self.cameras = ob.nerfstudio.load(self.config, step=step, reach=reach)
        self.model = self.field.model
        checkpoints = sorted((self.config.parent / "nerfstudio_models").glob("*.ckpt"))
        self.steps = int(checkpoints[-1].stem.removeprefix("step-"))

    def nerfstudio_cameras(self, k: int, width: int):
        """Camera k with images of another width."""
        from nerfstudio.cameras.cameras import Cameras

        camera = self.cameras[k]
        full, high = camera["size"]
        height = max(1, round(width * high / full))
        (fx, fy), (cx, cy), along, up = camera["focal"], camera["center"], width / full, height / high
        lens = torch.tensor([camera["k1"], camera["k2"], 0, 0, camera["p1"], camera["p2"]], dtype=torch.float32)
        pose = torch.tensor(camera["pose"][None, :3], dtype=torch.float32)
        return Cameras(
            pose, fx * along, fy * up, cx * along, cy * up, width, height, distortion_params=lens[None]
        ), camera | {"focal": (fx * along, fy * up), "center": (cx * along, cy * up), "size": (width, height)}

    def equality(self) -> dict[str, float]:
        """Differences of densities and colours at nerfstudio's own samples, and of the rays of a whole picture."""
        from nerfstudio.field_components.field_heads import FieldHeadNames

        theirs, own = self.nerfstudio_cameras(len(self.cameras) // 3, 60)
        rays = theirs.generate_rays(camera_indices=0, keep_shape=True)
        flat = rays.flatten()
        with torch.no_grad():
            bundle = self.model.collider(flat[:: max(1, len(flat) // 720)])
            samples, _, _ = self.model.proposal_sampler(bundle, density_fns=self.model.density_fns)
            truth = self.model.field(samples)
        x = samples.frustums.get_positions().reshape(-1, 3).numpy()
        # Beyond its cube a contracted field is a backdrop.
        near = np.flatnonzero((abs(x) < self.field.box[1] - 0.1).all(axis=1))[:10_000]
        x, d = x[near], samples.frustums.directions.reshape(-1, 3).numpy()[near]
        density, color = (part.numpy() for part in self.field(x, d))
        density_truth = truth[FieldHeadNames.DENSITY].reshape(-1).numpy()[near]
        color_truth = truth[FieldHeadNames.RGB].reshape(-1, 3).numpy()[near]
        wall = lambda x, d: (np.full(len(x), 1e6, np.float32), 0.5 * (d + 1))
        shown = ob.render(wall, None, own, box=([-8] * 3, [8] * 3), occupancy=4, march_step=0.5, progress=False)
        return {
            "points": len(x),
            "density": float((abs(density - density_truth) / np.maximum(density_truth, 1)).max()),
            "color": float(abs(color - color_truth).max()),
            "directions": float(abs(2 * shown["color"] - 1 - rays.directions.numpy()).max()),
        }

    def own_view(self, k: int, width: int, samples: int | None = None) -> np.ndarray:
        """A view as nerfstudio renders it; with so many evenly spaced samples instead of those proposed, if asked."""
        theirs, _ = self.nerfstudio_cameras(k, width)
        rays = theirs.generate_rays(camera_indices=0, keep_shape=True)
        with torch.no_grad():
            if samples is None:
                return self.model.get_outputs_for_camera_ray_bundle(rays)["rgb"].numpy()
            return self._evenly(rays, samples).reshape(*rays.shape, 3).numpy()

    def _evenly(self, rays, samples: int) -> torch.Tensor:
        from nerfstudio.field_components.field_heads import FieldHeadNames
        from nerfstudio.model_components.ray_samplers import UniformSampler

        sampler, rows = UniformSampler(num_samples=samples).eval(), []
        for part in torch.arange(len(rays.flatten())).split(128):
            placed = sampler(self.model.collider(rays.flatten()[part]))
            found = self.model.field(placed)
            weights = placed.get_weights(found[FieldHeadNames.DENSITY])
            rows.append(self.model.renderer_rgb(rgb=found[FieldHeadNames.RGB], weights=weights))
        return torch.cat(rows)

    def truth(self, k: int, width: int) -> np.ndarray:
        """The training picture, on the model's background."""
        from PIL import Image

        with Image.open(self.cameras[k]["file_path"]) as image:
            rgba = np.asarray(image.convert("RGBA"), dtype=np.float32) / 255
        background = self.field.background
        rgb = rgba[..., :3] * rgba[..., 3:] + background * (1 - rgba[..., 3:])
        factor = rgb.shape[1] // width
        rgb = rgb[: rgb.shape[0] // factor * factor, : width * factor]
        return rgb.reshape(rgb.shape[0] // factor, factor, width, factor, 3).mean(axis=(1, 3))


def views(run: Run, chosen: list[int], width: int) -> list[str]:
    """Rows of the table: a view each."""
    rows = []
    for k in chosen:
        truth, start = run.truth(k, width), time.perf_counter()
        theirs = run.own_view(k, width)
        middle = time.perf_counter()
        _, camera = run.nerfstudio_cameras(k, width)
        own = ob.render(run.field, None, camera, occupancy=OCCUPANCY, progress=False)
        end = time.perf_counter()
        evenly = run.own_view(k, width, 512)
        figures = [psnr(theirs, truth), psnr(own["color"], truth), psnr(evenly, truth)]
        rows.append(
            f"| {k} | {figures[0]:.2f} | {figures[1]:.2f} | **{figures[1] - figures[0]:+.2f}** | {figures[2]:.2f} | "
            f"{psnr(own['color'], theirs):.1f} | {psnr(own['color'], evenly):.1f} | {middle - start:.0f} | "
            f"{end - middle:.0f} |"
        )
        print(rows[-1], flush=True)
    return rows


def contracted(work: Path, chosen: list[int], width: int, step: float) -> list[str]:
    """Rows of the table: a view and a cube each in which rays are followed."""
    rows = []
    for reach in (2, 4):
        run = Run(work, "fox", step, reach)
        for k in chosen:
            truth, theirs, start = run.truth(k, width), run.own_view(k, width), time.perf_counter()
            _, camera = run.nerfstudio_cameras(k, width)
            own = ob.render(run.field, None, camera, occupancy=OCCUPANCY, progress=False)["color"]
            rows.append(
                f"| {k} | {reach} | {psnr(theirs, truth):.2f} | {psnr(own, truth):.2f} | "
                f"**{psnr(own, truth) - psnr(theirs, truth):+.2f}** | {psnr(own, theirs):.1f} | "
                f"{time.perf_counter() - start:.0f} |"
            )
            print(rows[-1], flush=True)
    return rows


def uncertainty(run: Run, work: Path, rays: int, level: int, width: int, k: int) -> dict:
    """The uncertainty, its files, and what the clean-up leaves of a training view."""
    start = time.perf_counter()
    space = {"contract": run.field.contract}
    u = ob.uncertainty(
        run.field,
        run.cameras,
        level=level,
        rays=rays,
        gradient="analytic",
        keep_sums=True,
        occupancy=OCCUPANCY,
        progress=False,
        **space,
    )
    seconds = time.perf_counter() - start
    u.save(work / "field.oct")
    ob.export(u, work / "unc.npy")
    space = space if run.field.contract else {"box": run.field.box}
    again = ob.load(work / "unc.npy", rays=u.record["rays"], **space)
    surface = u.surface[:: max(1, len(u.surface) // 4000)]
    own = u.with_covariance("trace").log10(surface)
    _, camera = run.nerfstudio_cameras(k, width)
    truth = run.truth(k, width)
    cleaned = {}
    for threshold in (None, "99%", "90%"):
        view = ob.render(run.field, u, camera, threshold=threshold, occupancy=OCCUPANCY, progress=False)
        cleaned[threshold] = psnr(view["color"], truth), float(view["opacity"].mean())
    points = np.random.default_rng(0).uniform(*run.field.box, (200_000, 3)).astype(np.float32)
    matter = points[run.field.density(points).numpy() > 5]
    limit = u.surface_quantile(0.99)
    return {
        "seconds": seconds,
        "summary": u.summary,
        "u": u,
        "sizes": [(work / name).stat().st_size for name in ("field.oct", "unc.npy")],
        "official": abs(again.log10(surface) - own).max(),
        "surface": np.percentile(u.log10(surface), [5, 50, 95]),
        "prior": np.log10(u.prior),
        "cleaned": cleaned,
        "limit": limit,
        "matter": len(matter) / len(points),
        "removed": float((u.log10(matter) > limit).mean()),
        "unseen": float((u.seen(matter) == "unseen").mean()),
    }


def options(config: Path) -> str:
    """What of the model's settings is not nerfacto's default, as far as it matters here."""
    model = yaml.load(config.read_text(), Loader=yaml.Loader).pipeline.model
    return (
        f"2^{model.log2_hashmap_size} entries, proposals of {model.num_proposal_samples_per_ray} and "
        f"{model.num_nerf_samples_per_ray} samples, "
        + ("no contraction" if model.disable_scene_contraction else "contraction")
        + f", background {model.background_color}, from {model.near_plane:g} to {model.far_plane:g} along a ray"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("work", type=Path)
    parser.add_argument("--rays", type=int, default=8_000)
    parser.add_argument("--step", type=float, default=0.015)
    parser.add_argument("--level", type=int, default=6)
    parser.add_argument("--width", type=int, default=100)
    parser.add_argument("--views", type=int, nargs="+", default=[0, 50])
    parser.add_argument("--fox-views", type=int, nargs="+", default=[10, 30])
    arguments = parser.parse_args()
    without_lpips()
    # Threads of torch spin while they wait for each other, which costs more than it brings on a busy machine.
    torch.set_num_threads(1)
    runs = {
        scene: Run(arguments.work, scene, arguments.step)
        for scene in ("lego", "fox")
        if (arguments.work / "outputs" / scene).exists()
    }
    lego = runs["lego"]
    equal = {scene: run.equality() for scene, run in runs.items()}
    print(json.dumps(equal), flush=True)
    found = uncertainty(lego, arguments.work, arguments.rays, arguments.level, arguments.width, arguments.views[0])
    print(found, flush=True)
    rows = views(lego, arguments.views, arguments.width)
    far = contracted(arguments.work, arguments.fox_views, 45, 1 / 64) if "fox" in runs else []
    write(arguments, runs, equal, rows, far, found)


def write(
    arguments: argparse.Namespace, runs: dict[str, Run], equal: dict, rows: list[str], far: list[str], found: dict
) -> None:
    config = runs["lego"].model.config
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True, check=False
    )
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("nerfstudio", "torch", "numpy"))
    trained = "\n".join(
        f"| {s} | {run.steps} | {len(run.cameras)} | {options(run.config)} |" for s, run in runs.items()
    )
    equality = "\n".join(
        f"| {scene} | {e['points']:,} | {e['density']:.1e} | {e['color']:.1e} | {e['directions']:.1e} |"
        for scene, e in equal.items()
    )
    low, middle, high = found["surface"]
    sizes = " and ".join(f"{size / 1e6:.1f} MB" for size in found["sizes"])
    cleaned = "\n".join(
        f"| {'none' if name is None else name + f' of surfaces: log10 U = {limit:.2f}'} | {dB:.2f} | {opacity:.3f} |"
        for (name, (dB, opacity)), limit in zip(
            found["cleaned"].items(), [0, *(found["u"].surface_quantile(share) for share in (0.99, 0.9))]
        )
    )
    given = f"--rays {arguments.rays} --step {arguments.step} --level {arguments.level} --width {arguments.width}"
    text = f"""# nerfacto

Written by `python experiments/nerfacto.py WORK {given}`, commit {commit.stdout.strip() or "unknown"}, Python
{platform.python_version()}, {versions}, two processors shared with others. The models were trained by
`nice -n 10 python experiments/nerfacto_train.py WORK lego` (and `fox`), with OMP_NUM_THREADS=1, 512 rays a step, and
stopped when time was up: a few hundred steps, where nerfstudio means 30,000. They are poor, and as good as any to
compare programs on.

| scene | steps | training cameras | model |
|---|---:|---:|---|
{trained}

## The same field

`field(x, d)` of `ob.nerfstudio.load` against nerfstudio's `model.field` at samples of its proposal sampler: the largest
difference of density (relative to it, or to 1 where it is less) and of colour. *Rays*: the largest difference of the
directions of all pixels of a view from nerfstudio's `generate_rays`. The fox's lens is distorted, its photographs are a
quarter as wide as its camera file says, and its poses were centred, scaled and corrected in training.
The target is 1e-5.

| scene | points | density | colour | rays |
|---|---:|---:|---:|---:|
{equality}

## The same pictures

Training views of lego, {arguments.width} pixels wide: PSNR against the training picture, dB. *512 even* is
nerfstudio's own renderer with its field at 512 evenly spaced samples instead of the 48 that its proposal networks
choose, from {config.near_plane:g} to {config.far_plane:g} along the ray. Ours are {arguments.step} apart in the box.
The target is a difference of 0.3 dB.

| view | nerfstudio | `ob.render` | difference | 512 even | ours to nerfstudio | ours to 512 even | s | ours, s |
|---:|---:|---:|---:|---:|---:|---:|---:|---:|
{chr(10).join(rows)}

The fox, 45 pixels wide, 1/64 between samples. Its space is contracted and has no end: what is beyond a cube is painted
on the cube's faces, as nerfstudio's field shows itself along each ray (`reach` is half the cube's edge, in scene units;
cameras are within 1).

| view | reach | nerfstudio | `ob.render` | difference | ours to nerfstudio | ours, s |
|---:|---:|---:|---:|---:|---:|---:|
{chr(10).join(far)}

## Uncertainty

lego, {arguments.rays:,} rays, level {arguments.level}, derivatives by autograd: {found["seconds"]:.0f} s.
{found["summary"]["vertices"]:,} vertices. log10 U on visible surfaces: {low:.2f}, {middle:.2f}, {high:.2f} (5, 50,
95 %); the prior is {found["prior"]:.2f}. `field.oct` and the official code's `unc.npy` take {sizes}; read back,
the latter differs by at most {found["official"]:.0e} in log10 U on surfaces.

Clean-up (`ob.render(threshold=...)`) of training view {arguments.views[0]}:

| threshold | PSNR, dB | mean opacity |
|---|---:|---:|
{cleaned}

Of all space in the box {100 * found["matter"]:.1f} % has a density above 5; of this {100 * found["removed"]:.1f} % is
more uncertain than 99 % of visible surfaces and would go; {100 * found["unseen"]:.1f} % no training ray ever reached.
"""
    (HERE / "nerfacto.md").write_text(text)


if __name__ == "__main__":
    main()
