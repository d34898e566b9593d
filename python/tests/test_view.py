"""Pictures, and whether U ranks the error of depth."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL, exr, in_python, png

import octobayes as ob


def test_a_view_has_colour_depth_opacity_and_uncertainty(courtyard, cameras, field):
    view = ob.render(courtyard, field, cameras[3], progress=False)
    assert {name: (array.shape, array.dtype.name) for name, array in view.items()} == {
        "color": ((48, 48, 3), "float32"),
        "depth": ((48, 48), "float32"),
        "opacity": ((48, 48), "float32"),
        "log10_uncertainty": ((48, 48), "float32"),
    }
    solid = view["opacity"] > 0.99
    assert 0.2 < solid.mean() < 1 and (view["depth"][solid] > 0.5).all()
    assert (
        np.isfinite(view["log10_uncertainty"][solid]).all()
        and np.isnan(view["log10_uncertainty"][view["depth"] == 0]).all()
    )
    # What the pixel shows lies where its ray has the depth.
    row, column = np.argwhere(solid)[200]
    focal, center = cameras[3]["focal"], cameras[3]["center"]
    x, y = (column + 0.5 - center[0]) / focal[0], (row + 0.5 - center[1]) / focal[1]
    along = cameras[3]["pose"][:3, :3] @ np.array([x, -y, -1])
    point = cameras[3]["pose"][:3, 3] + view["depth"][row, column] * along / np.linalg.norm(along)
    assert courtyard.density(point[None])[0] > 1


def test_what_hardly_shows_has_no_uncertainty(courtyard, cameras, field):
    """As in the command line's pictures, and not the prior of a veil of opacity 1e-8."""

    def foggy(x, d):
        density, color = courtyard(x, d)
        return density + 0.01, color

    foggy.step = courtyard.step
    view = ob.render(foggy, field, cameras[3], progress=False)
    faint, shown = view["opacity"] <= 0.05, np.isfinite(view["log10_uncertainty"])
    # The premise: a veil of fog, and matter.
    assert (faint & (view["opacity"] > 0)).mean() > 0.1 and shown.mean() > 0.1
    assert np.array_equal(shown, ~faint)


def test_what_lies_outside_the_box_has_no_uncertainty(courtyard, cameras):
    low, high = courtyard.box
    right = ob.uncertainty(courtyard, cameras, box=([low[0], 0, low[2]], high), **SMALL)
    view = ob.render(courtyard, right, cameras[3], progress=False)
    x, y = np.meshgrid(*[np.arange(48) + 0.5] * 2)
    (fx, fy), (cx, cy) = cameras[3]["focal"], cameras[3]["center"]
    along = np.stack([(x - cx) / fx, (cy - y) / fy, -np.ones_like(x)], axis=-1) @ cameras[3]["pose"][:3, :3].T
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    seen = cameras[3]["pose"][:3, 3] + view["depth"][..., None] * along
    matter = view["opacity"] > 0.99
    # But for f32 on the face itself.
    left, inside = matter & (seen[..., 1] < -1e-4), matter & (seen[..., 1] > 1e-4)
    assert left.sum() > 50 and inside.sum() > 50
    assert np.isnan(view["log10_uncertainty"][left]).all() and np.isfinite(view["log10_uncertainty"][inside]).all()


def test_a_callable_renders_the_same_view(courtyard, cameras, field):
    rust = ob.render(courtyard, field, cameras[0], progress=False)
    callable_ = in_python(courtyard, "step", "density")
    python = ob.render(callable_, field, cameras[0], progress=False)
    assert len(callable_.calls) < 100
    for name in rust:
        # The occupancy grid of a callable is sampled, not certain: what it skips moves a pixel by 1e-4 at most.
        np.testing.assert_allclose(python[name], rust[name], atol=1e-3 if name == "log10_uncertainty" else 2e-4)


def test_a_threshold_removes_what_is_uncertain(courtyard, cameras, field):
    behind = {**cameras[0], "pose": np.diag([-1, -1, 1, 1]) @ cameras[0]["pose"]}
    before = ob.render(courtyard, field, behind, progress=False)
    after = ob.render(courtyard, field, behind, threshold="90%", progress=False)
    assert after["opacity"].sum() < 0.9 * before["opacity"].sum()
    number = field.surface_quantile(0.9)
    again = ob.render(courtyard, field, behind, threshold=number, progress=False)
    assert np.array_equal(again["opacity"], after["opacity"])
    assert "log10_uncertainty" not in ob.render(courtyard, None, cameras[0], progress=False)


def test_a_threshold_that_leaves_nothing_is_told(courtyard, cameras, field, tmp_path):
    below = field.surface_quantile(0) - 0.5
    told = r"threshold: log10 U is above .* on 100 % of the visible surfaces.*; as a share, .*%"
    with pytest.warns(RuntimeWarning, match=told):
        view = ob.render(courtyard, field, cameras[0], threshold=below, progress=False)
    assert view["opacity"].max() < 0.5
    with pytest.warns(RuntimeWarning, match=told):
        ob.export(field, str(tmp_path / "x.ply"), courtyard, cameras, threshold=below, progress=False)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"threshold": "much"},
            "threshold: expected log10 U as a number, or a share of visible surfaces as 99%, found much",
        ),
        ({"u": None, "threshold": 3.0}, "threshold: expected an uncertainty to cut by, found none"),
        ({"u": 3}, "u: expected an Uncertainty or the path of an .oct file, found 3"),
        ({"camera": []}, "cameras: expected at least one, found none"),
        ({"ray_average": "mean"}, "ray_average: expected 'weighted-mean', .* found 'mean'"),
    ],
)
def test_wrong_arguments_get_a_sentence(changes, sentence, courtyard, cameras, field):
    arguments = {"u": field, "camera": cameras[0], "progress": False, **changes}
    with pytest.raises(ValueError, match=sentence):
        ob.render(courtyard, arguments.pop("u"), arguments.pop("camera"), **arguments)


def check_calibration(nerf, metric, test, files, frames, camera, folder):
    """The interval holds by counting on the views that it was made on, and goes with the field."""
    calibrated, said = ob.calibrate(nerf, metric, test, probability=0.8, stride=1, **files)
    found = calibrated.conformal
    said = said["calibrated"]
    assert metric.conformal is None and found == said["conformal"] and found["probability"] == 0.8
    # The normal distribution's.
    assert said["predicted_factor"] == pytest.approx(1.28155, abs=1e-4) and found["views"] == 4
    assert said["views_left_out"] == sorted(said["views_left_out"])
    ratios, pixels = [], 0
    for frame in frames:
        posed = {**camera, "pose": frame["transform_matrix"]}
        truth = ob.render(ob.open_model("scene:courtyard"), None, posed, progress=False)
        view = ob.render(nerf, calibrated, posed, depth_error=True, progress=False)
        np.testing.assert_allclose(view["depth_interval"], found["factor"] * view["depth_error"], rtol=1e-6)
        known = (truth["opacity"] > 0.99) & (view["opacity"] > 0)
        # Where nothing has grown, maps of 16 bits are what is wrong, by far more than f32.
        depth = (truth["depth"] / 10 * 65535).astype(np.uint16) * (10 / 65535)
        ratios.append((np.abs(view["depth"] - depth) / view["depth_interval"])[known])
        pixels += known.sum()
    assert found["pixels"] == pixels
    share = (np.concatenate(ratios) <= 1).mean()
    # To one pixel of 3932, and to depths in f32: 2.4e-7 at a depth of 3 is 2e-3 of an error on the edge, 1.2e-4.
    assert 0.8 - 2e-3 <= share <= 0.8 + 2e-3, share
    calibrated.save(folder / "calibrated.oct")
    assert ob.load(folder / "calibrated.oct").conformal == found
    for wrong in (0, 1, 1.5):
        with pytest.raises(ValueError, match="probability: expected"):
            ob.calibrate(nerf, metric, test, probability=wrong, **files)


def test_u_ranks_the_error_of_depth_better_than_chance(courtyard, cameras, field, tmp_path):
    # The truth is the scene; the model has grown where no camera looked: on the far side.
    frames = []
    for i in range(4):
        turned = np.eye(4)
        angle = i * np.pi / 2
        turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        camera = {**cameras[0], "pose": turned @ cameras[0]["pose"]}
        view = ob.render(courtyard, None, camera, progress=False)
        solid = view["opacity"] > 0.99
        png(tmp_path / f"r_{i}.png", np.dstack([255 * view["color"].clip(0, 1), 255 * solid]))
        png(tmp_path / f"r_{i}_depth.png", np.where(solid, view["depth"] / 10 * 65535, 0))
        frames.append({"file_path": f"r_{i}.png", "transform_matrix": camera["pose"].tolist()})
    lens = {"fl_x": float(cameras[0]["focal"][0]), "w": 48, "h": 48}
    (tmp_path / "transforms_test.json").write_text(json.dumps({**lens, "frames": frames}))

    def grown(x, d):
        density, color = courtyard(x, d)
        behind = (x[:, 0] < -0.2) & (np.linalg.norm(x - [-0.5, 0, -0.3], axis=1) < 0.45)
        return np.where(behind, 100, density), color

    grown.step = courtyard.step
    result = ob.evaluate(
        grown,
        {"field": field},
        tmp_path / "transforms_test.json",
        depth=tmp_path,
        depth_pattern="{}_depth.png",
        depth_encoding=(0, 10),
        progress=False,
    )
    area = {entry["name"]: entry["ause_pooled"]["mae"] for entry in result["readings"] + result["baselines"]}
    assert len(result["readings"]) == 3 and result["pixels"] > 2000
    assert area["field diagonal"] < 0.5 * area["random"], area
    # In the scale of the data depths have deviations, which are calibrated or not.
    metric = ob.uncertainty(courtyard, cameras, scale="data", noise=0.0316, keep_sums=True, **SMALL)
    files = {"depth": tmp_path, "depth_pattern": "{}_depth.png", "progress": False}
    test = tmp_path / "transforms_test.json"
    result = ob.evaluate(grown, {"m": metric}, test, depth_encoding=(0, 10), covariance="block", **files)
    deviation = next(entry for entry in result["readings"] if entry["name"] == "m block, depth deviation")
    shares = [found for _, found in deviation["calibration"]["coverage"]]
    assert shares == sorted(shares) and 0 < shares[0] < 1, shares
    # The same maps in scene units: what was between two of 65535 steps of 10 is no longer lost.
    for i, frame in enumerate(frames):
        camera = {**cameras[0], "pose": frame["transform_matrix"]}
        exr(tmp_path / f"r_{i}_depth.exr", ob.render(courtyard, None, camera, progress=False)["depth"])
    exact = ob.evaluate(grown, {"m": metric}, test, covariance="block", **{**files, "depth_pattern": "{}_depth.exr"})
    assert exact["pixels"] == result["pixels"]
    assert exact["depth_error"]["mean"] == pytest.approx(result["depth_error"]["mean"], abs=10 / 65535)
    check_calibration(grown, metric, test, {**files, "depth_encoding": (0, 10)}, frames, cameras[0], tmp_path)
    with pytest.raises(ValueError, match="depth_encoding: expected offset and scale of the depth maps"):
        ob.evaluate(grown, metric, test, **files)
    with pytest.raises(ValueError, match="depth_encoding: expected none"):
        ob.evaluate(grown, metric, test, depth_encoding=(0, 1), **{**files, "depth_pattern": "{}.exr"})
    with pytest.raises(FileNotFoundError, match="r_0_none.png"):
        ob.evaluate(
            grown,
            field,
            tmp_path / "transforms_test.json",
            depth=tmp_path,
            depth_pattern="{}_none.png",
            depth_encoding=(0, 10),
            progress=False,
        )


def test_the_readmes_examples_run(capsys):
    text = (Path(__file__).parent.parent / "README.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict[str, object] = {}
    for word, said in (("def nerf", "in front"), ("ob.depth(", "give or take")):
        example = next(block for block in blocks if word in block)
        exec(compile(example, "README.md", "exec"), names)
        assert said in capsys.readouterr().out


@pytest.mark.data
def test_a_plenoptic_png_through_python(data):
    model = ob.open_model(data / "ppng-pretrained" / "NeRFSynthetic" / "ppng_1" / "lego.ppng")
    cameras = model.cameras(fov=39.6, resolution=(100, 100))
    # With a cutoff, what is left out depends on the occupancy grid, which is certain in Rust and sampled in Python.
    run = {**SMALL, "level": 5, "grid": "dense", "rays": 2_048, "cutoff": 0, "pixel_offset": model.pixel_offset}
    rust = ob.uncertainty(model, cameras, **run)
    callable_ = in_python(model, "step", "density")
    python = ob.uncertainty(callable_, cameras, box=model.box, **run)
    surface = rust.surface
    assert len(surface) > 500 and np.array_equal(rust.query(surface), python.query(surface))
