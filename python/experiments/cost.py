"""What it costs that the field is asked in Python. Writes cost.md beside itself.

    OCTOBAYES_DATA=... python experiments/cost.py [--rays 409600] [--scene lego]

A Plenoptic PNG is run in Rust, and passed through Python as a callable, with the same derivatives, in turns. A torch
MLP of the size of the original NeRF's is run on the CPU, beside the forward passes of the same run alone.
"""

from __future__ import annotations

import argparse
import itertools
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import octobayes as ob

HERE = Path(__file__).parent
#: The field of view of the NeRF-synthetic scenes, degrees.
FOV = 39.6


class Clock:
    """Processor seconds of all threads, and seconds by the wall."""

    def __enter__(self) -> Clock:
        self._start = time.process_time(), time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        self.cpu, self.wall = time.process_time() - self._start[0], time.perf_counter() - self._start[1]


class InPython:
    """A model as any callable would be: called back from Rust, with these of its attributes."""

    def __init__(self, model: ob.Model, *names: str) -> None:
        self._model, self.calls = model, []
        for name in names:
            setattr(self, name, getattr(model, name))
        if "density" in names:
            self.density = lambda x: self._noted(x, model.density, x)
        if "derivatives" in names:
            self.derivatives = lambda x, d: self._noted(x, model.derivatives, x, d)

    def __call__(self, x, d):
        return self._noted(x, self._model, x, d)

    def _noted(self, x, function, *arguments):
        self.calls.append(len(x))
        return function(*arguments)


def through_python(scene: Path, rays: int, turns: int) -> list[str]:
    """Rows of the table: one for each kind of derivatives."""
    model = ob.open_model(scene)
    cameras = model.cameras(fov=FOV, resolution=(400, 400))
    rows = []
    for gradient, names in [
        ("finite-difference", ["step", "density"]),
        ("finite-difference", ["step"]),
        ("analytic", ["step", "density", "derivatives"]),
    ]:
        run = {"rays": rays, "gradient": gradient, "progress": False, "pixel_offset": model.pixel_offset}
        clocks = {"rust": [], "python": []}
        for _ in range(turns):
            with Clock() as clock:
                rust = ob.uncertainty(model, cameras, **run)
            clocks["rust"].append(clock)
            callable_ = InPython(model, *names)
            with Clock() as clock:
                python = ob.uncertainty(callable_, cameras, box=model.box, **run)
            clocks["python"].append(clock)
        difference = ob.compare(python, rust, points=100_000)["on_surfaces"]
        cpu = {name: min(clock.cpu for clock in all_) for name, all_ in clocks.items()}
        wall = {name: min(clock.wall for clock in all_) for name, all_ in clocks.items()}
        calls = callable_.calls
        large = sum(n for n in calls if n >= 1 << 16) / sum(calls)
        attributes = ", ".join(f"`{name}`" for name in names if name != "step") or "none"
        rows.append(
            f"| {gradient} | {attributes} | {cpu['rust']:.1f} | {cpu['python']:.1f} | "
            f"**{cpu['python'] / cpu['rust']:.2f}** | {wall['python'] / wall['rust']:.2f} | {len(calls)} | "
            f"{100 * large:.1f} % | {difference['mean']:.1e} |"
        )
        print(rows[-1], flush=True)
    return rows


def mlp(torch):
    """An MLP of eight layers of 256, which sees a soft ball with waves of colour through its encoding."""
    torch.manual_seed(0)

    class Net(torch.nn.Module):
        def __init__(self):
            super().__init__()
            widths = [63, *[256] * 8]
            layers = [torch.nn.Linear(a, b) for a, b in itertools.pairwise(widths)]
            self.body = torch.nn.Sequential(*(part for layer in layers for part in (layer, torch.nn.ReLU())))
            self.color = torch.nn.Sequential(torch.nn.Linear(256 + 27, 128), torch.nn.ReLU(), torch.nn.Linear(128, 3))
            self.bump = torch.nn.Linear(256, 1)

        @staticmethod
        def encoded(x, count):
            waves = [f(2.0**k * x) for k in range(count) for f in (torch.sin, torch.cos)]
            return torch.cat([x, *waves], dim=-1)

        def density(self, x):
            return self.shaped(x, self.body(self.encoded(x, 10)))

        def shaped(self, x, features):
            # Weights that were not trained give no surface; a ball does, to which they add their texture.
            return 80 * torch.sigmoid(50 * (0.5 - x.norm(dim=-1)) + self.bump(features)[:, 0])

        def forward(self, x, d):
            features = self.body(self.encoded(x, 10))
            color = torch.sigmoid(self.color(torch.cat([features, self.encoded(d, 4)], dim=-1)))
            return self.shaped(x, features), color

    return Net().eval()


class Noted:
    """A field that notes how many points it is asked about, by method."""

    def __init__(self, field) -> None:
        self._field, self.calls = field, []
        self.density = lambda x: self._note("density", field.density, x)
        self.derivatives = lambda x, d: self._note("derivatives", field.derivatives, x, d)

    def __call__(self, x, d):
        return self._note("radiance", self._field, x, d)

    def _note(self, name, function, *arguments):
        self.calls.append((name, len(arguments[0])))
        return function(*arguments)


def alone(torch, net, name, x, d):
    """The passes that a question takes."""
    if name != "derivatives":
        with torch.no_grad():
            return net.density(x) if name == "density" else net(x, d)
    x = x.clone().requires_grad_(True)
    density, color = net(x, d)
    outputs = [density, *color.unbind(-1)]
    return [torch.autograd.grad(output.sum(), x, retain_graph=i < 3) for i, output in enumerate(outputs)]


def beside_forward_passes(rays: int, turns: int) -> list[str]:
    """Rows of the table; empty without torch."""
    try:
        import torch
    except ImportError:
        print("torch is not installed: its part of the report is left out")
        return []
    # Threads of torch that wait for each other spin, and a machine that others use makes them wait long.
    torch.set_num_threads(1)
    net = mlp(torch)
    box = [[-1, -1, -1], [1, 1, 1]]
    cameras = ob.open_model("scene:ball").cameras(resolution=(200, 200))
    rng = np.random.default_rng(0)
    rows = []
    for gradient in ["finite-difference", "analytic"]:
        run = {"rays": rays, "level": 6, "march_step": 1 / 64, "occupancy": 32, "gradient": gradient}
        whole, passes = [], []
        for _ in range(turns):
            field = Noted(ob.torch_field(net))
            with Clock() as clock:
                ob.uncertainty(field, cameras, box=box, progress=False, **run)
            whole.append(clock)
            # The same passes alone: tensors in, tensors out.
            most = max(n for _, n in field.calls)
            x, d = (torch.from_numpy(rng.uniform(-1, 1, (most, 3)).astype(np.float32)) for _ in range(2))
            with Clock() as clock:
                for name, n in field.calls:
                    alone(torch, net, name, x[:n], d[:n])
            passes.append(clock)
        whole, passes = (min(clocks, key=lambda clock: clock.cpu) for clocks in (whole, passes))
        points = sum(n for _, n in field.calls)
        what = "forward" if gradient == "finite-difference" else "forward, and autograd's backward,"
        rows.append(
            f"| {gradient} | {what} passes | {points / 1e6:.1f} | {passes.cpu:.1f} | {whole.cpu:.1f} | "
            f"**{whole.cpu / passes.cpu:.2f}** | {whole.wall / passes.wall:.2f} |"
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rays", type=int, default=409_600)
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--scene", default="lego")
    parser.add_argument("--torch-rays", type=int, default=1_024)
    arguments = parser.parse_args()
    folder = Path(os.environ["OCTOBAYES_DATA"]) / "ppng-pretrained" / "NeRFSynthetic"
    scene = next(path for path in sorted(folder.rglob("*.ppng")) if arguments.scene in str(path).lower())
    ppng = through_python(scene, arguments.rays, arguments.turns)
    torch_rows = beside_forward_passes(arguments.torch_rays, arguments.turns)
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True, check=False
    )
    torch_version = f", torch {sys.modules['torch'].__version__}" if "torch" in sys.modules else ""
    command = "python experiments/cost.py " + " ".join(
        f"--{k.replace('_', '-')} {v}" for k, v in vars(arguments).items()
    )
    text = f"""# What Python costs

Written by `{command}`, commit {commit.stdout.strip() or "unknown"}, Python
{platform.python_version()}, NumPy {np.__version__}{torch_version}, {os.cpu_count()} processors shared with others.
Ratios are of processor seconds of all threads, which others disturb least; the ratio by the wall, which they disturb
most, is beside it.

## A Plenoptic PNG through Python

`{scene.name}` ({arguments.scene}), {arguments.rays:,} rays, level 8. *Rust* is `ob.uncertainty(model)`. *Python* is a
callable that calls `model(x, d)` and has the attributes named. The least of {arguments.turns} turns each, taken
alternately. *In calls of 2^16*: the share of points asked about in calls of 2^16 points and more. *Mean difference*: of
log10 U on surfaces. The target is 1.25.

| gradient | attributes | Rust, s | Python, s | ratio | by the wall | calls | in calls of 2^16 | mean difference |
|---|---|---:|---:|---:|---:|---:|---:|---:|
{chr(10).join(ppng)}

Without `density` a callable computes colours that nobody needs, and misses the target. In Rust the model bounds its
density, and the callable cannot: its occupancy grid is sampled, {129**3 + 128**3:,} points more, which weigh less the
more rays there are.

## A torch MLP on the CPU

Eight layers of 256, as in the original NeRF, {arguments.torch_rays:,} rays, level 6. *Alone* are the same passes with
as many points, on tensors that are there; one thread of torch. The target is 1.15 times the forward passes.

| gradient | alone | million points | alone, s | run, s | ratio | by the wall |
|---|---|---:|---:|---:|---:|---:|
{chr(10).join(torch_rows) or "| torch was not installed | | | | | | |"}
"""
    (HERE / "cost.md").write_text(text)


if __name__ == "__main__":
    main()
