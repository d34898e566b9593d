"""Gaussian splats: arrays, runs, pictures, evaluation, and the file with columns."""

from __future__ import annotations

import copy
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import png

import octobayes as ob

N = 400
RUN = {"background": "black", "level": 5, "rays": 6000, "progress": False}
ORIGINAL = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
ORIGINAL += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]


def ball(away: float = 0.0) -> np.ndarray:
    """Rows of numbers in the order of ORIGINAL: a ball of splats, every third of them farther out by ``away``."""
    i = np.arange(N)
    z = 1 - (2 * i + 1) / N
    flat = np.sqrt(1 - z * z)
    normal = np.stack([flat * np.cos(2.4 * i), flat * np.sin(2.4 * i), z], axis=1)
    # The turn from z to the normal, by half of the angle between them.
    rotation = np.stack([1 + z, -normal[:, 1], normal[:, 0], 0 * z], axis=1)
    rotation /= np.linalg.norm(rotation, axis=1)[:, None]
    means = (0.7 + away * (i % 3 == 0))[:, None] * normal
    color = np.sin(np.outer(i, [1.0, 2.0, 3.0]))
    scales = np.broadcast_to([-2.7, -2.8, -4.2], (N, 3))
    return np.concatenate([means, color, 1.0 + i[:, None] % 5, scales, rotation], axis=1).astype("<f4")


def write(path: Path, rows: np.ndarray) -> Path:
    properties = "".join(f"property float {name}\n" for name in ORIGINAL)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    path.write_bytes(header.encode() + rows.tobytes())
    return path


def camera(angle: float) -> dict:
    eye = np.array([2.2 * np.cos(angle), 2.2 * np.sin(angle), 0.5])
    back = eye / np.linalg.norm(eye)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return {"pose": pose, "focal": 56.0, "size": (48, 40)}


CAMERAS = [camera(0.5 * i) for i in range(4)]


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("scene") / "scene.ply", ball())


@pytest.fixture(scope="module")
def splats(path) -> ob.Splats:
    return ob.open_model(path)


@pytest.fixture(scope="module")
def field(splats) -> ob.Uncertainty:
    return ob.uncertainty(splats, CAMERAS, scale="data", noise=0.03, covariance="block", keep_sums=True, **RUN)


def test_arrays_are_the_files(splats, path):
    rows = ball()
    assert isinstance(splats, ob.Splats) and len(splats) == N and not callable(splats)
    assert splats.name == str(path) and f"{N} splats" in repr(splats)
    assert (splats.means == rows[:, :3]).all() and splats.means.dtype == np.float32
    assert np.allclose(splats.scales, np.exp(rows[:, 7:10]), rtol=1e-6)
    assert np.allclose(splats.opacities, 1 / (1 + np.exp(-rows[:, 6])), rtol=1e-6)
    assert np.allclose(splats.rotations, rows[:, 10:], atol=1e-6)
    assert splats.sh.shape == (N, 1, 3) and (splats.sh[:, 0] == rows[:, 3:6]).all()
    assert np.allclose(splats.box, [rows[:, :3].min(0), rows[:, :3].max(0)])
    assert splats.mode == "classic" and ob.open_model(path, splat_mode="mip").mode == "mip"
    assert (copy.copy(splats).means == splats.means).all()
    for array in [splats.means, splats.scales, splats.rotations, splats.opacities, splats.sh]:
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


@pytest.mark.skipif("OCTOBAYES" not in os.environ, reason="OCTOBAYES does not name the program")
def test_a_run_is_that_of_the_command_line(splats, path, field, tmp_path):
    frames = [{"file_path": f"r_{i}", "transform_matrix": c["pose"].tolist()} for i, c in enumerate(CAMERAS)]
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps({"fl_x": 56.0, "fl_y": 56.0, "cx": 24, "cy": 20, "w": 48, "h": 40, "frames": frames}))
    words = "--scale data --noise 0.03 --covariance block --keep-sums --background black --level 5 --rays 6000"
    out = tmp_path / "scene.oct"
    subprocess.run(
        [os.environ["OCTOBAYES"], "uncertainty", path, "--cameras", file, *words.split(), "-o", out], check=True
    )
    other = ob.load(out)
    assert (other.query(splats.means) == field.query(splats.means)).all()
    assert ob.uncertainty(path, file, **RUN).record["model_checksum"] == other.record["model_checksum"]


def test_splats_have_a_level_of_their_own_and_their_own_derivatives(splats):
    small = {"rays": 2000, "progress": False}
    assert ob.uncertainty(splats, CAMERAS, **small).finest_level == 6
    assert ob.uncertainty(splats, CAMERAS, gradient="auto", level=4, **small).finest_level == 4
    with pytest.raises(ValueError, match="gradient: expected the default"):
        ob.uncertainty(splats, CAMERAS, gradient="analytic", **small)


def test_pictures_show_splats_and_what_is_left_of_them(splats, field):
    view = ob.render(splats, field, CAMERAS[1], depth_error=True, progress=False)
    shown = view["opacity"] > 0.9
    assert shown.mean() > 0.1 and view["color"].shape == (40, 48, 3)
    assert np.isfinite(view["log10_uncertainty"][shown]).all() and (view["depth_error"][shown] > 0).all()
    # The ball's front is 1.4 to 2.3 away.
    assert ((view["depth"][shown] > 1.4) & (view["depth"][shown] < 2.4)).all()
    cleaned = ob.render(splats, field, CAMERAS[1], threshold="70%", progress=False)
    assert (cleaned["opacity"] > 0.9).sum() < shown.sum()


def test_columns_are_those_of_the_file(splats, field, tmp_path):
    columns = ob.splat_columns(splats, field, CAMERAS, progress=False)
    assert list(columns) == ["uncertainty", "log10_uncertainty", "seen", "weight", "views", "front_share"]
    assert list(ob.splat_columns(splats, field)) == ["uncertainty", "log10_uncertainty", "seen"]
    assert (columns["uncertainty"] == field.query(splats.means)).all()
    towards = splats.means @ np.float32([0.7, 0.5, 0.2])
    front, back = towards > 0.4, towards < -0.4
    assert columns["weight"][front].mean() > 20 * columns["weight"][back].mean()
    assert columns["views"][front].mean() > 3.5 > 3 > columns["views"][back].mean()
    # A closed ball: nothing floats.
    assert ((columns["front_share"] >= 0) & (columns["front_share"] < 0.9)).all()
    assert (columns["seen"][front] > 0).all() and (columns["seen"][back] == 0).mean() > 0.7
    assert ((field.seen(splats.means) == "unseen") == (columns["seen"] == 0)).all()
    out = tmp_path / "scene-u.ply"
    ob.export(field, out, splats, CAMERAS, progress=False)
    plyfile = pytest.importorskip("plyfile")
    vertices = plyfile.PlyData.read(out)["vertex"]
    assert [p.name for p in vertices.properties] == ORIGINAL + list(columns)
    for name, values in columns.items():
        assert np.allclose(vertices[name], values, rtol=1e-6), name
    assert (np.stack([vertices[axis] for axis in "xyz"], 1) == splats.means).all()
    # Without cameras three columns, and with a threshold fewer splats.
    ob.export(field, out, splats, threshold="80%", progress=False)
    left = ob.open_model(out)
    assert N / 10 < len(left) < N
    most = np.log10(field.query(left.means)).max()
    assert ((columns["log10_uncertainty"] <= most) & (columns["seen"] > 0)).sum() == len(left)


@pytest.fixture(scope="module")
def held_out(tmp_path_factory) -> Path:
    """Images and depth of other splats, from two other cameras."""
    folder = tmp_path_factory.mktemp("held out")
    truth = ob.open_model(write(folder / "truth.ply", ball(0.03)))
    frames = []
    for i, angle in enumerate([0.25, 0.75]):
        view = ob.render(truth, None, camera(angle), background="black", progress=False)
        color = np.clip(255 * view["color"], 0, 255)
        png(folder / f"t_{i}.png", np.round(np.dstack([color, 255 * (view["opacity"] > 0.9)])))
        png(folder / f"t_{i}_depth.png", np.round(1e4 * view["depth"]))
        frames.append({"file_path": f"t_{i}", "transform_matrix": camera(angle)["pose"].tolist()})
    file = folder / "transforms_test.json"
    file.write_text(json.dumps({"fl_x": 56.0, "fl_y": 56.0, "cx": 24, "cy": 20, "w": 48, "h": 40, "frames": frames}))
    return file


def maps(held_out: Path) -> dict:
    return {"depth": held_out.parent, "depth_pattern": "{}_depth.png", "depth_encoding": (0, 6.5535)}


def test_splats_are_judged_and_calibrated(splats, field, held_out, path):
    report = ob.evaluate(splats, field, held_out, **maps(held_out), clean_up=True, progress=False)
    names = [row["name"] for row in report["readings"] + report["baselines"]]
    assert "u block, depth deviation" in names and "random" in names
    # A third of the splats lie 0.03 too near.
    assert report["pixels"] > 200 and 0.001 < report["depth_error"]["mean"] < 0.1
    assert len(report["clean_up"]) == 11
    calibrated, again = ob.calibrate(splats, field, held_out, **maps(held_out), probability=0.8, progress=False)
    assert calibrated.conformal["factor"] == again["calibrated"]["conformal"]["factor"] > 0
    ensemble = ob.evaluate(splats, field, held_out, **maps(held_out), ensemble=[splats, path], progress=False)
    # The members are the same splats.
    rows = {row["name"]: row for row in ensemble["baselines"]}
    assert rows["ensemble depth variance"]["rank_correlation"] == 0


def test_what_splats_do_not_have_is_refused(splats, field, path, held_out, courtyard):
    for name, value in {
        "gradient": "forward-difference",
        "step": 0.1,
        "cutoff": 1e-3,
        "audit": True,
        "march_step": 0.1,
        "occupancy": 32,
        "target_error": 0.1,
        "refine": "density",
    }.items():
        with pytest.raises(ValueError, match="splats|volume"):
            ob.uncertainty(splats, CAMERAS, **{**RUN, name: value})
    for name, value in {"march_step": 0.1, "occupancy": 32}.items():
        with pytest.raises(ValueError, match=name):
            ob.render(splats, field, CAMERAS[0], **{name: value})
        with pytest.raises(ValueError, match=name):
            ob.evaluate(splats, field, held_out, **maps(held_out), **{name: value})
    with pytest.raises(ValueError, match="cameras"):
        ob.uncertainty(splats, **RUN)
    with pytest.raises(ValueError, match="splats"):
        ob.export(field, path.parent / "x.ply", splats, mesh=True)
    with pytest.raises(ValueError, match="splats"):
        ob.evaluate(splats, field, held_out, **maps(held_out), ensemble=[splats, courtyard], progress=False)
    with pytest.raises(ValueError, match="coordinates"):
        ob.open_model(path, "ngp")
    with pytest.raises(ValueError, match="splat_mode"):
        ob.open_model("scene:ball", splat_mode="mip")
    with pytest.raises(ValueError, match="splats"):
        ob.splat_columns(courtyard, field)
    with pytest.raises(ValueError, match="splat_mode: expected 'classic', 'mip', 'mip-splatting', found 'fast'"):
        ob.open_model(path, splat_mode="fast")


def test_views_that_no_camera_has_are_worth_most(splats, field):
    angles = [0.25, 0.75, 2.0, 3.0, 4.0, 5.0]
    found = ob.next_view(splats, field, [camera(a) for a in angles], take=2, pixels=512, progress=False)
    first = [step["index"] for step in found["steps"]]
    # The training cameras are at angles from 0 to 1.5.
    assert set(first) <= {2, 3, 4, 5} and set(np.argsort(found["gains"])[:2].tolist()) == {0, 1}
    one = ob.next_view(splats, field, [camera(3.0)], take=1, pixels=512, progress=False)
    assert one["gains"][0] == found["gains"][3] > 0
    with pytest.raises(ValueError, match="occupancy.*splats are projected"):
        ob.next_view(splats, field, [camera(3.0)], occupancy=32, progress=False)
