"""Arguments that would give a wrong answer without a word get a sentence, or are taken as they are meant."""

import numpy as np
import pytest
from conftest import SMALL

import octobayes as ob

POSE = np.eye(4)


@pytest.mark.parametrize(
    ("camera", "sentence"),
    [
        ({"camera_angle_x": 40}, r"camera_angle_x'\]: expected radians, below pi \(degrees: fov\), found 40"),
        ({"fov": 180}, r"fov'\]: expected an angle above 0 and below 180 degrees, found 180"),
        ({"fov": 0}, r"fov'\]: expected a finite number above 0, found 0"),
        ({"fov": np.nan}, r"fov'\]: expected a finite number above 0, found nan"),
        ({"focal": 30, "fl_x": 30}, "expected 'focal' or 'fl_x', found both"),
        ({"focal": 30, "transform_matrix": POSE}, "expected 'pose' or 'transform_matrix', found both"),
        ({"focal": 30, "w": 8}, "expected 'size' or 'w', found both"),
        ({"focal": 30, "fov": 90}, r"a focal length of 30 pixels, and an angle of view of 90 degrees, which is 24"),
        ({"fl_y": 30, "fov": 90}, "expected 'fl_x' beside 'fl_y', found keys"),
        ({"fl_x": -30}, r"fl_x'\]: expected a finite number above 0, found -30"),
        ({"focal": 30, "k1": np.nan}, r"k1'\]: expected a finite number, found nan"),
        ({"focal": 30, "k5": 0.1}, r"k5'\]: expected one of .*, found k5"),
    ],
)
def test_cameras_that_contradict_themselves_are_refused(camera, sentence, courtyard):
    with pytest.raises(ValueError, match=sentence):
        ob.render(courtyard, None, {"pose": POSE, "size": (48, 48), **camera}, progress=False)


def test_an_angle_and_a_focal_length_may_agree(courtyard, cameras):
    camera = {"transform_matrix": cameras[0]["pose"], "w": 48, "h": 48, "fl_x": 24.0}
    view = ob.render(courtyard, None, camera, progress=False)
    # Rounded, as files have it.
    again = ob.render(courtyard, None, {**camera, "camera_angle_x": 1.571}, progress=False)
    assert np.array_equal(view["color"], again["color"])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"keep_sums": "false"}, "keep_sums: expected True or False, found 'false'"),
        ({"restart": 1}, "restart: expected True or False, found 1"),
        ({"restart": True}, "restart: expected a checkpoint beside it, found none"),
        (
            {"shard": (0, 2), "error_bars": 4},
            "error_bars: expected None with shard, which is one group of rays, found 4",
        ),
        ({"shard": (0.5, 2)}, r"shard: expected 'I/N' or .* found \(0.5, 2\)"),
        ({"for_": "depths"}, "for_: expected 'ranking', 'depth', .* found 'depths'"),
        ({"for_": "splats"}, "for_='splats': expected Gaussian splats, found another model"),
        ({"level": True}, "level: expected a whole number, 1 to 16, found True"),
        ({"seed": -1}, "seed: expected a whole number, 0 to"),
        # Numbers that no type of the library holds: Python's own error names no argument.
        ({"seed": 2**64}, "seed: expected a whole number, 0 to"),
        ({"rays": 10**400}, "rays: expected a whole number, 1 to"),
        ({"rays": 10**5000}, "rays: expected a whole number, 1 to .* found a whole number of 16610 bits"),
        ({"rays": -(2**70)}, "rays: expected a whole number, 1 or more"),
        ({"memory": 2**64}, "memory: expected a whole number, 1 to"),
        ({"tolerance": 10**400}, "tolerance: expected a finite number"),
        ({"views": [2**70]}, "views: expected"),
        ({"box": ([-(10**400)] * 3, [1.5, 1, 1])}, "box: expected an array of real numbers"),
        ({"box": ([1, 1, 1], [-1, -1, -1])}, "box: expected a lower and an upper corner, found"),
        ({"resolution": 47.5}, r"resolution: expected a width, or \(width, height\), found 47.5"),
    ],
)
def test_runs_refuse_what_they_would_not_do(arguments, sentence, courtyard, cameras):
    with pytest.raises(ValueError, match=sentence):
        ob.uncertainty(courtyard, cameras, **{**SMALL, **arguments})


def test_flags_are_true_or_false(courtyard, cameras, field, tmp_path):
    for job in (
        lambda: ob.render(courtyard, field, cameras[0], depth_error="no", progress=False),
        lambda: ob.render(courtyard, field, cameras[0], confirm="no", progress=False),
        lambda: ob.merge([field], keep_sums="no"),
        lambda: ob.export(field, tmp_path / "u.ply", courtyard, cameras, mesh="no", progress=False),
        lambda: ob.evaluate(courtyard, field, "x.json", depth=tmp_path, z_depth="no", progress=False),
    ):
        with pytest.raises(ValueError, match=r"^\w+: expected True or False, found 'no'"):
            job()


def test_samples_outside_the_box_are_refused_and_warned_of():
    n = 100
    samples = {"positions": np.full((n, 3), 5.0), "jacobian": np.ones((n, 3, 3)), "ray": np.arange(n), "rays_total": n}
    box = {"box": ([-1, -1, -1], [1, 1, 1]), "level": 3, "progress": False}
    with pytest.raises(ValueError, match=r"samples: .* inside the box \(box=\); .* found 0 of 100 samples"):
        ob.accumulate(samples, **box)
    samples["positions"][:40] = 0.5
    with pytest.warns(RuntimeWarning, match="40 of 100 samples lie in the box"):
        ob.accumulate(samples, **box)
    samples["rays_total"] = 50
    with pytest.raises(ValueError, match=r"samples\['ray'\]\[50\]: expected .* below rays_total = 50, found 50"):
        ob.accumulate(samples, **box)
    samples["rays_total"] = [100, 100]
    with pytest.raises(ValueError, match=r"samples\['rays_total'\]: expected a whole number, .* found an array"):
        ob.accumulate(samples, **box)
    n = 65_537
    ray = {"positions": np.zeros((n, 3)), "jacobian": np.ones((n, 3, 3)), "ray": np.zeros(n, int), "rays_total": 1}
    with pytest.raises(ValueError, match=r"samples\['ray'\]\[65536\]: expected at most 65536 samples of a ray"):
        ob.accumulate(ray, **box)


def test_directions_of_any_length_are_those_of_length_one(tmp_path):
    rng = np.random.default_rng(5)
    grid = {"density": rng.uniform(0, 9, (4, 4, 4)), "color": rng.uniform(0, 1, (4, 4, 4, 3))}
    grid["box"] = np.array([[-1, -1, -1], [1, 1, 1]])
    np.savez(tmp_path / "grid.npz", **{name: part.astype("f4") for name, part in grid.items()})
    model = ob.open_model(tmp_path / "grid.npz")
    x, d = rng.uniform(-1, 1, (2, 50, 3)).astype(np.float32)
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    taken = model._asked(x, 7 * d)[1]
    # A rounding of f32 for each component, twice.
    assert abs(taken - unit).max() <= 2 * np.finfo(np.float32).eps
    assert np.array_equal(model._asked(x, unit)[1], unit)
    assert np.array_equal(model(x, d)[1], model(x, 7 * d)[1])
    d[3] = 0
    with pytest.raises(ValueError, match=r"d: expected directions, which have a length, found .* at \[3\]"):
        model(x, d)


def test_what_is_assumed_is_said(courtyard, cameras, field, tmp_path):
    ob.export(field, tmp_path / "u.npy")
    with pytest.warns(RuntimeWarning, match="taken for sums of 4096000 rays, the official default"):
        ob.load(tmp_path / "u.npy", box=courtyard.box)
    above = float(np.log10(field.prior)) + 1
    with pytest.warns(RuntimeWarning, match="no density lies above"):
        ob.render(courtyard, field, cameras[0], threshold=above, progress=False)
    for share in (99, -0.1, np.nan):
        with pytest.raises(ValueError, match="share: expected"):
            field.surface_quantile(share)


def test_all_rays_are_one_through_every_training_pixel():
    scene = ob.open_model("scene:courtyard")
    cameras = scene.cameras(resolution=(24, 16))
    u = ob.uncertainty(scene, cameras, level=4, rays="all", occupancy=48, progress=False)
    assert u.record["rays"] == len(cameras) * 24 * 16
    with pytest.raises(ValueError, match="every pixel"):
        ob.uncertainty(scene, cameras, level=4, rays="all", error_bars=4, occupancy=48, progress=False)
    with pytest.raises(ValueError, match="rays: expected"):
        ob.uncertainty(scene, cameras, level=4, rays="some", occupancy=48, progress=False)
