"""A model of nerfstudio against nerfstudio itself: needs nerfstudio, and trains a small nerfacto for some steps."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import octobayes as ob
from octobayes._cameras import LENS

needs_nerfstudio = pytest.mark.nerfstudio

LAUNCHER = """
import sys
sys.path.insert(0, {here!r})
from test_nerfstudio import without_lpips

if __name__ == "__main__":
    without_lpips()
    from nerfstudio.scripts.train import entrypoint
    entrypoint()
"""


def without_lpips() -> None:
    """Replaces an evaluation metric whose weights come from the internet."""
    import torch
    from torchmetrics.image import lpip

    class NoLpips(torch.nn.Module):
        def __init__(self, *_: object, **__: object) -> None:
            super().__init__()

    lpip.LearnedPerceptualImagePatchSimilarity = NoLpips


def dataset(folder) -> None:
    """Twelve pictures of the courtyard through a distorted lens, in units and axes of their own."""
    from PIL import Image

    scene = ob.open_model("scene:courtyard")
    lens = {"k1": 0.06, "k2": -0.02, "k3": 0.03, "k4": -0.01, "p1": 0.001, "p2": -0.002, "camera_model": "OPENCV"}
    frames = []
    for i, camera in enumerate(scene.cameras(resolution=(40, 30))[:12]):
        camera |= {key: lens[key] for key in LENS}
        color = ob.render(scene, None, camera, progress=False)["color"]
        Image.fromarray((255 * color).round().astype(np.uint8)).save(folder / f"{i:02}.png")
        pose = camera["pose"].copy()
        pose[:3, 3] = 5 * pose[:3, 3] + [3, -2, 1]
        frames.append({"file_path": f"{i:02}.png", "transform_matrix": pose.tolist()})
    width, height = (int(side) for side in camera["size"])
    numbers = {"fl_x": camera["focal"][0], "fl_y": camera["focal"][1], "cx": camera["center"][0]}
    numbers |= {"cy": camera["center"][1], "w": width, "h": height}
    (folder / "transforms.json").write_text(json.dumps(numbers | lens | {"frames": frames}))


@pytest.fixture(scope="module", params=["contracted", "box"])
def run(request, tmp_path_factory):
    pytest.importorskip("nerfstudio", reason="nerfstudio is not installed (pip install nerfstudio)")
    folder = tmp_path_factory.mktemp("nerfstudio")
    dataset(folder)
    (folder / "launch.py").write_text(LAUNCHER.format(here=str(request.path.parent)))
    model = "--pipeline.model."
    options = [
        "nerfacto", "--data", str(folder), "--output-dir", str(folder / "outputs"), "--timestamp", "run",
        "--machine.device-type", "cpu", "--vis", "tensorboard", "--max-num-iterations", "6",
        f"{model}implementation", "torch", f"{model}log2-hashmap-size", "12",
        f"{model}num-proposal-samples-per-ray", "16", "16", "--pipeline.datamanager.train-num-rays-per-batch", "64",
    ]  # fmt: skip
    if request.param == "box":
        # Matter from the beginning: without any, a run is refused.
        options += [f"{model}disable-scene-contraction", "True", f"{model}average-init-density", "100"]
        options += [f"{model}background-color", "white"]
    command = [sys.executable, str(folder / "launch.py"), *options, "nerfstudio-data", "--downscale-factor", "1"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    without_lpips()
    config = next((folder / "outputs").rglob("config.yml"))
    return request.param, config, *ob.nerfstudio.load(config)


def nerfstudio_cameras(cameras):
    import torch
    from nerfstudio.cameras.cameras import Cameras

    poses = torch.tensor(np.stack([camera["pose"][:3] for camera in cameras]), dtype=torch.float32)
    first = cameras[0]
    lens = torch.tensor([first[key] for key in LENS], dtype=torch.float32)
    (fx, fy), (cx, cy), (width, height) = first["focal"], first["center"], first["size"]
    return Cameras(poses, fx, fy, cx, cy, width, height, distortion_params=lens.expand(len(cameras), 6))


@needs_nerfstudio
def test_density_and_color_are_those_of_nerfstudio(run):
    import torch
    from nerfstudio.field_components.field_heads import FieldHeadNames

    _, _, field, cameras = run
    bundle = nerfstudio_cameras(cameras).generate_rays(camera_indices=torch.arange(11)[:, None])
    with torch.no_grad():
        samples, _, _ = field.model.proposal_sampler(
            field.model.collider(bundle.flatten()[:: len(bundle.flatten()) // 4400]),
            density_fns=field.model.density_fns,
        )
        truth = field.model.field(samples)
    x = samples.frustums.get_positions().reshape(-1, 3).numpy()
    # Beyond, a contracted field is a backdrop.
    near = (abs(x) < field.box[1] - 0.1).all(axis=1)
    x, d = x[near], samples.frustums.directions.reshape(-1, 3).numpy()[near]
    density, color = field(x, d)
    own = truth[FieldHeadNames.DENSITY].reshape(-1)[near]
    assert len(x) >= 10_000 and own.max() > 0
    assert torch.allclose(density, own, rtol=1e-5, atol=1e-5)
    assert (color - truth[FieldHeadNames.RGB].reshape(-1, 3)[near]).abs().max() <= 1e-5
    assert torch.equal(field.density(x), density)


@needs_nerfstudio
def test_derivatives_are_differences(run):
    kind, _, field, _ = run
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.9, 0.9, (200, 3)).astype(np.float32) * (3 if kind == "contracted" else 1)
    d = np.tile(np.float32([[0.6, 0, 0.8]]), (200, 1))
    _, _, slope, color_gradient = (np.asarray(part) for part in field.derivatives(x, d))
    h = 1e-4
    for axis in range(3):
        ends = [field(x + sign * h * np.eye(3, dtype=np.float32)[axis], d) for sign in (1, -1)]
        along = (ends[0][0] - ends[1][0]).numpy() / (2 * h), (ends[0][1] - ends[1][1]).numpy() / (2 * h)
        # Hash grids have kinks at the faces of their cells, which some of the steps cross.
        for differences, own in zip(along, (slope[:, axis], color_gradient[:, :, axis])):
            assert np.median(abs(own)) > 0
            assert np.median(abs(differences - own)) <= 0.05 * np.median(abs(own))


@needs_nerfstudio
def test_rays_are_those_of_nerfstudio(run):
    """Distortion, pixel centres, downscaling and pose corrections, seen as colours of an opaque field."""
    _, _, field, cameras = run
    rays = nerfstudio_cameras(cameras).generate_rays(camera_indices=3, keep_shape=True)
    wall = lambda x, d: (np.full(len(x), 1e6, np.float32), 0.5 * (d + 1))
    shown = ob.render(wall, None, cameras[3], box=field.box, occupancy=4, march_step=0.5, progress=False)
    assert abs(2 * shown["color"] - 1 - rays.directions.numpy()).max() <= 1e-5


@needs_nerfstudio
def test_pictures_are_those_of_nerfstudio(run):
    """Also of what is beyond the cube, for the contracted model."""
    import torch

    kind, _, field, cameras = run
    rays = nerfstudio_cameras(cameras).generate_rays(camera_indices=3, keep_shape=True)
    with torch.no_grad():
        truth = field.model.get_outputs_for_camera_ray_bundle(rays)["rgb"].numpy()
    shown = ob.render(field, None, cameras[3], march_step=field.step, occupancy=16, progress=False)
    # A model of six steps is fog as far as it goes, which nerfstudio crosses in 48 samples.
    assert 10 * np.log10(((shown["color"] - truth) ** 2).mean()) <= -25
    if kind == "contracted":
        assert shown["opacity"].min() > 0.999


@needs_nerfstudio
def test_original_units(run):
    _, config, field, cameras = run
    frames = json.loads((config.parents[4] / "transforms.json").read_text())["frames"]
    originals = np.array([np.array(frame["transform_matrix"])[:3, 3] for frame in frames])
    _, plain = ob.nerfstudio.load(config, pose_corrections=False)
    positions = np.array([camera["pose"][:3, 3] for camera in plain])
    back = field.to_original(positions)
    assert abs(back[:, None] - originals).sum(axis=2).min(axis=1).max() <= 1e-4
    assert abs(field.to_scene(back) - positions).max() <= 1e-5
    moved = max(abs(a["pose"] - b["pose"]).max() for a, b in zip(plain, cameras))
    assert 0 < moved < 0.1, "six steps move the poses a little"


@needs_nerfstudio
def test_the_command_writes_both_files(run, tmp_path):
    from octobayes._nerfstudio_command import main

    kind, config, field, _ = run
    few = ["--load-config", str(config), "--lod", "4", "--reach", "2", "--occupancy", "16", "--march-step", "0.05"]
    assert main([*few, "--rays", "600", "-o", str(tmp_path / "field.oct")]) == 0
    assert main([*few, "--iters", "9", "--output-path", str(tmp_path / "unc.npy")]) == 0
    u = ob.load(tmp_path / "field.oct")
    assert u.record["rays"] == 600 and (u.box is None) == (kind == "contracted")
    space = {"contract": field.contract} if field.contract else {"box": field.box}
    grid = ob.load(tmp_path / "unc.npy", rays=9 * 64, **space)
    assert np.load(tmp_path / "unc.npy").shape == (17**3,) and np.load(tmp_path / "unc.npy").max() > 0
    # 3 / 2λ in place of 1 / λ.
    assert u.prior == pytest.approx(1.5**0.5 * grid.prior, rel=1e-6)


def test_what_cannot_be_opened_is_said(tmp_path, capsys):
    from octobayes._nerfstudio_command import main

    with pytest.raises(FileNotFoundError, match=r"config: expected the config.yml of a run of nerfstudio"):
        ob.nerfstudio.load(tmp_path / "config.yml")
    assert main(["--load-config", str(tmp_path / "config.yml")]) == 2
    assert capsys.readouterr().err.startswith("error: config: expected")
    assert main(["--load-config", "x", "-o", "field.txt"]) == 2


class Parser:
    """A data parser as far as a run's training cameras are concerned."""

    def __init__(self, masks):
        self.asked, self.factors = [], []
        cameras = SimpleNamespace(
            width=[16, 16],
            height=[8, 8],
            rescale_output_resolution=lambda scaling_factor: self.factors.append(scaling_factor),
        )
        self.outputs = SimpleNamespace(cameras=cameras, image_filenames=["a.png", "b.png"], mask_filenames=masks)

    def setup(self):
        return self

    def get_dataparser_outputs(self, split):
        self.asked.append(split)
        return self.outputs


@pytest.mark.parametrize(
    ("masks", "ignored", "applied"),
    [
        (None, False, False),
        ([], False, False),
        (["m0.png", "m1.png"], True, False),
        (["m0.png", "m1.png"], False, True),
    ],
)
def test_masks_of_a_run_go_with_its_cameras(masks, ignored, applied, tmp_path, monkeypatch):
    """Without nerfstudio: what is asked of its data parser, and what becomes of the answer."""
    parser = Parser(masks)
    manager = SimpleNamespace(
        dataparser=parser,
        train_num_rays_per_batch=64,
        camera_res_scale_factor=0.5,
        pixel_sampler=SimpleNamespace(ignore_mask=ignored),
    )
    trained = SimpleNamespace(get_density=None, get_outputs=None)
    model = SimpleNamespace(field=trained, eval=lambda: model)
    answer = SimpleNamespace(pipeline=SimpleNamespace(datamanager=manager)), SimpleNamespace(model=model), None, 0
    utilities = ModuleType("nerfstudio.utils.eval_utils")
    utilities.eval_setup = lambda path, test_mode: answer
    for name in ("nerfstudio", "nerfstudio.utils"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, utilities.__name__, utilities)
    monkeypatch.setattr(ob.nerfstudio, "_readable", lambda: warnings.catch_warnings())
    monkeypatch.setattr(ob.nerfstudio, "_field", lambda *_: SimpleNamespace())
    monkeypatch.setattr(ob.nerfstudio, "cameras", lambda cameras, corrections: [{}, {}])
    (tmp_path / "config.yml").write_text("")
    _, cameras = ob.nerfstudio.load(tmp_path / "config.yml")
    found = [(camera.get("mask_path"), camera.get("image_size")) for camera in cameras]
    assert found == ([("m0.png", (16, 8)), ("m1.png", (16, 8))] if applied else [(None, None)] * 2)
    # The training split, of the size that was trained on.
    assert (parser.asked, parser.factors) == (["train"], [0.5])
    assert [camera["file_path"] for camera in cameras] == ["a.png", "b.png"]
