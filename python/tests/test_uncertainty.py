"""Runs: callables against models, batches, cameras, arguments."""

import json
import threading

import numpy as np
import pytest
from conftest import SMALL, in_python, png
from test_model import voxels

import octobayes as ob

#: Nothing is left out and nothing estimated, so that a run depends on the field's values alone.
EXACT = {"grid": "dense", "level": 5, "rays": 4_096, "cutoff": 0, "march_step": 1 / 48, "progress": False}


class Ball:
    """`scene:ball` again, in NumPy: radius 1/2, density 80 with a quintic ramp, waves of colour."""

    box = [[-1, -1, -1], [1, 1, 1]]

    def __call__(self, x, d):
        x = x.astype(np.float64)
        t = np.clip(0.5 - 0.5 * (np.linalg.norm(x, axis=1) - 0.5) / 0.04, 0, 1)
        phase = np.array([0.4, 1.1, 1.9])
        waves = np.sin(9 * x[:, :1] + phase) * np.sin(9 * x[:, 1:2] + 2 * phase) * np.sin(9 * x[:, 2:] - phase)
        density = 80 * t**3 * (t * (6 * t - 15) + 10)
        color = np.where(density[:, None] > 0, [0.6, 0.5, 0.3] + 0.25 * waves, 0.5)
        return density.astype(np.float32), color.astype(np.float32)


def test_a_closed_form_has_the_same_u_in_numpy_and_in_rust(points):
    rust = ob.open_model("scene:ball")
    cameras = rust.cameras(resolution=(40, 40))
    run = {**EXACT, "step": 1 / 16, "rays": 8_192}
    a, b = (ob.uncertainty(f, cameras, box=Ball.box, **run) for f in (rust, Ball()))
    known = b.log10(points) < np.log10(b.prior) - 0.5
    assert known.sum() > 50
    # Rust rounds to f32: a density by fewer than 50 roundings of 2^-24 (its documentation), 80 * 3e-6, which central
    # differences over h = 1/256 turn into an error of 80 * 3e-6 / h = 0.06 beside slopes of 80 * 1.875 / 0.08 = 1875;
    # a colour by a few of 2^-24, 2e-7 / h = 5e-5 beside 2.25. Errors of one sample are thus 3e-5 of what counts in its
    # ray. They are random, but no bound is known for how much of a ray cancels at a vertex; ten times that is allowed:
    # 3e-4 / ln 10.
    assert abs(a.log10(points) - b.log10(points)).max() < 1.3e-4


@pytest.mark.parametrize("names", [(), ("density",), ("density", "derivatives")])
def test_a_model_called_back_from_python_gives_the_same_bits(names, cameras, points, tmp_path):
    model = ob.open_model(voxels(tmp_path))
    gradient = "analytic" if "derivatives" in names else "finite-difference"
    run = {**EXACT, "gradient": gradient}
    rust = ob.uncertainty(model, cameras, **run)
    callable_ = in_python(model, *names)
    python = ob.uncertainty(callable_, cameras, box=model.box, batch=5_000, **run)
    assert (rust.query(points) < 0.1 * rust.prior).sum() > 50
    assert np.array_equal(rust.query(points), python.query(points))
    assert rust.record["gradient"] == python.record["gradient"] == gradient


def test_python_is_entered_from_one_thread_in_large_batches(courtyard, cameras):
    sizes, threads = [], set()

    def nerf(x, d):
        assert x.dtype == d.dtype == np.float32 and x.shape == d.shape and x.flags.c_contiguous
        np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)
        sizes.append(len(x))
        threads.add(threading.get_ident())
        return courtyard(x, d)

    nerf.step = courtyard.step
    batch = 1 << 14
    stages = []

    def tell(stage, done, total):
        stages.append((stage, done, total))
        sizes.append(stage)

    run = {**SMALL, "rays": 131_072, "progress": tell}
    ob.uncertainty(nerf, cameras, box=courtyard.box, batch=batch, **run)
    assert threads == {threading.get_ident()}
    points = [size for size in sizes if isinstance(size, int)]
    assert max(points) < 2 * batch
    # Only the last rays of a group that still go on ask about fewer.
    drawn = sizes[len(sizes) - sizes[::-1].index("occupancy") :]
    drawn = [size for size in drawn if isinstance(size, int)]
    large = sum(size for size in drawn if size >= batch)
    assert len(drawn) > 20 and large > 0.9 * sum(drawn), (len(drawn), large, sum(drawn))
    assert stages[-1] == ("rays", 131_072, 131_072)


def test_default_batches_are_two_to_the_sixteen(courtyard, cameras):
    sizes = []

    def nerf(x, d):
        sizes.append(len(x))
        return courtyard(x, d)

    ob.uncertainty(nerf, cameras, box=courtyard.box, **{**SMALL, "rays": 65_536})
    large = [size for size in sizes if size >= 1 << 16]
    assert sum(large) > 0.8 * sum(sizes) and max(sizes) < 1 << 17


def test_cameras_are_a_file_dictionaries_or_arrays(courtyard, cameras, field, points, tmp_path):
    def same(cameras, **more):
        u = ob.uncertainty(courtyard, cameras, **SMALL, **more)
        assert np.array_equal(u.query(points), field.query(points))

    same(None, resolution=(48, 48))
    arrays = {key: np.stack([camera[key] for camera in cameras]) for key in ("pose", "focal", "center")}
    same({**arrays, "size": (48, 48)})
    same({"pose": arrays["pose"], "focal": arrays["focal"][0], "size": (48, 48)})
    same([{"pose": c["pose"][:3], "focal": c["focal"][0], "size": (48, 48)} for c in cameras])
    frames = [{"transform_matrix": c["pose"].tolist(), "file_path": f"{i}"} for i, c in enumerate(cameras)]
    lens = {"fl_x": cameras[0]["focal"][0], "fl_y": cameras[0]["focal"][1], "w": 48, "h": 48}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    file = ob.uncertainty(courtyard, tmp_path / "transforms.json", **SMALL)
    # Reading a file divides poses by their scale, which is 1 but for rounding; some rays pass another side of a step.
    np.testing.assert_allclose(file.log10(points), field.log10(points), atol=0.02)
    some = ob.uncertainty(courtyard, str(tmp_path / "transforms.json"), views=5, **SMALL)
    assert (some.query(points) < 0.1 * some.prior).sum() < (field.query(points) < 0.1 * field.prior).sum()


def test_all_of_space_contracted(courtyard, cameras):
    ball = {"contract": ("l2", 0, 0, 0, 1)}
    for nerf, more in [(courtyard, {}), (in_python(courtyard), {"box": courtyard.box})]:
        u = ob.uncertainty(nerf, cameras, **ball, **more, **SMALL)
        assert u.box is None and u.inside([50.0, 0, 0])


def test_a_callable_brings_what_it_knows(courtyard, cameras):
    f = in_python(courtyard, "box", "step", "pixel_offset")
    f.background, f.cameras = "black", cameras
    u = ob.uncertainty(f, **SMALL)
    assert u.record["background"] == [0, 0, 0] and u.record["march_step"] == courtyard.step
    assert "InPython" in u.record["source"]
    assert ob.uncertainty(f, background="white", **SMALL).record["background"] == [1, 1, 1]


def test_a_model_file_is_named_by_its_content(courtyard, cameras):
    u = ob.uncertainty("scene:courtyard", cameras, **SMALL)
    assert u.record["model_checksum"] is not None and "scene:courtyard seen by 40 cameras" in u.record["source"]


def test_what_is_not_finite_is_dropped_and_told(courtyard, cameras):
    def broken(share):
        def nerf(x, d):
            density, color = courtyard(x, d)
            density[x[:, 0] > share] = np.nan
            return density, color

        nerf.step = courtyard.step
        return nerf

    with pytest.warns(RuntimeWarning, match="rays dropped, the field is not finite; first at"):
        ob.uncertainty(broken(0.99999), cameras, box=courtyard.box, **SMALL)
    with pytest.raises(FloatingPointError, match="the field is not finite: .* first at position"):
        ob.uncertainty(broken(0.5), cameras, box=courtyard.box, **SMALL)


def test_cameras_that_see_nothing_are_refused(courtyard, cameras):
    away = [{**c, "pose": c["pose"] @ np.diag([1, -1, -1, 1])} for c in cameras]
    with pytest.raises(ValueError, match="cameras: expected rays that meet matter.*OpenCV"):
        ob.uncertainty(courtyard, away, **SMALL)


def test_a_run_goes_on_after_an_exception(courtyard, cameras, points, tmp_path):
    path = tmp_path / "run.chk"
    run = {**SMALL, "rays": 65_536, "batch": 1 << 13, "checkpoint": path}

    class Tired(Exception):
        pass

    def tire(stage, done, total):
        if stage == "rays" and done > 20_000:
            raise Tired

    f = in_python(courtyard, "step")
    with pytest.raises(Tired):
        ob.uncertainty(f, cameras, box=courtyard.box, **{**run, "progress": tire})
    assert [p.name for p in tmp_path.iterdir()] == ["run.chk"]
    before = sum(f.calls)
    resumed = ob.uncertainty(f, cameras, box=courtyard.box, **run)
    assert list(tmp_path.iterdir()) == []
    whole = ob.uncertainty(f, cameras, box=courtyard.box, **{**run, "checkpoint": None})
    assert np.array_equal(resumed.query(points), whole.query(points)) and before > 0


WRONG = [
    ({"level": 0}, "level: expected a whole number, 1 to 16, found 0"),
    ({"level": 7.5}, "level: expected a whole number, 1 to 16, found 7.5"),
    ({"rays": "many"}, "rays: expected a whole number, 1 or more, found many"),
    ({"rays": 0}, "rays: expected a whole number, 1 or more, found 0"),
    (
        {"gradient": "exact"},
        "gradient: expected 'finite-difference', 'analytic', 'auto', 'forward-difference', found 'exact'",
    ),
    ({"covariance": "normal"}, "covariance: expected 'diagonal', 'trace', 'block', found 'normal'"),
    ({"refine": ["density", "ages"]}, "refine: expected 'sensitivity', 'density', 'ray-count', found 'ages'"),
    ({"grid": "sparse"}, "grid: expected 'octree' or 'dense', found 'sparse'"),
    ({"tolerance": -1}, "tolerance: expected a finite number, 0 or more, found -1"),
    ({"tolerance": float("nan")}, "tolerance: expected a finite number, 0 or more, found nan"),
    ({"lambda_": 0}, "lambda_: expected a finite number above 0, found 0"),
    ({"background": "grey"}, "background: expected 'white', 'black' or red, green and blue, found grey"),
    ({"background": (0, 0, 2)}, r"background: expected red, green and blue from 0 to 1, found \[0.0, 0.0, 2.0\]"),
    ({"box": [[0, 0, 0], [1, 1, -1]]}, "box: expected a lower and an upper corner, found"),
    ({"box": [0, 1]}, r"box: expected an array of real numbers of shape \[2, 3\], found an array of shape \[2\]"),
    ({"shard": "2/2"}, r"shard: expected 'I/N' or \(I, N\) with 0 <= I < N, found 2/2"),
    ({"contract": ()}, r"contract: expected \(norm, x, y, z, radius\)"),
    ({"target_error": 0.1, "shard": "0/2"}, "target_error: expected None with shard"),
    ({"error_bars": 1}, "error_bars: expected a whole number, 2 to 64, found 1"),
    ({"batch": 0}, "batch: expected a whole number, 1 or more, found 0"),
    ({"progress": 3}, r"progress: expected a callable \(stage, done, total\), True, False or None, found 3"),
    ({"cameras": []}, "cameras: expected at least one, found none"),
    ({"cameras": [3]}, "cameras: expected a camera file, or cameras as dictionaries.* found 3"),
    ({"cameras": [{"pose": np.eye(4)}]}, r"cameras\[0\]\['size'\]: expected a whole number, 1 to 65536, found None"),
    ({"cameras": [{"pose": np.eye(4), "size": (8, 8)}]}, r"cameras\[0\]: expected a camera with focal"),
    ({"cameras": [{"pose": np.eye(2), "size": (8, 8), "focal": 9}]}, r"cameras\[0\]\['pose'\]: expected .*\[4, 4\]"),
    ({"cameras": [{"pose": np.diag([1, 2, 1, 1]), "size": (8, 8), "focal": 9}]}, r"cameras\[0\], pose: expected a 4x4"),
    ({"cameras": [{"pose": np.eye(4), "size": (8, 8), "focal": -9}]}, r"cameras\[0\], camera: expected .* focal"),
    ({"cameras": [{"pose": np.eye(4), "size": 8, "focal": 9}]}, r"cameras\[0\]\['size'\]: expected width and height"),
    ({"cameras": [{"pose": np.eye(4), "size": (8, 8), "focal": "9"}]}, r"cameras\[0\]\['focal'\]: expected an array"),
    (
        {"cameras": [{"pose": np.eye(4), "size": (8, 8), "focal": [9] * 3}]},
        r"cameras\[0\]\['focal'\]: expected .*\[1\]",
    ),
    ({"cameras": [{"pose": np.eye(4), "lens": 3}]}, r"cameras\[0\]\['lens'\]: expected one of .*found lens"),
    ({"cameras": "none.json"}, "none.json: cannot read"),
    ({"nerf": 3}, "nerf: expected a model file, a model of open_model or a callable .* found 3"),
    ({"nerf": lambda x, d: None, "box": None}, r"box: expected two corners \(low, high\)"),
]


@pytest.mark.parametrize(("changes", "sentence"), WRONG)
def test_wrong_arguments_get_a_sentence(changes, sentence, courtyard, cameras):
    arguments = {"nerf": courtyard, "cameras": cameras, **SMALL, **changes}
    error = FileNotFoundError if sentence.startswith("none.json") else ValueError
    with pytest.raises(error, match=sentence):
        ob.uncertainty(arguments.pop("nerf"), arguments.pop("cameras"), **arguments)


ANSWERS = [
    (lambda x: None, r"the result of nerf: expected a tuple \(density, color\), found None"),
    (lambda x: np.zeros(len(x)), r"the result of nerf: expected a tuple \(density, color\), found an array of shape"),
    (lambda x: (np.zeros(3), np.zeros((len(x), 3))), r"density, the first result of nerf: expected .* found .*\[3\]"),
    (
        lambda x: (np.zeros(len(x)), np.zeros(len(x))),
        r"color, the second result of nerf: expected .* of shape \[\d+, 3\]",
    ),
    (lambda x: (np.zeros(len(x), complex), x), "density, the first result of nerf: expected .* type complex128"),
    (lambda x: (["a"] * len(x), x), "density, the first result of nerf: expected an array of real numbers"),
]


@pytest.mark.parametrize(("answer", "sentence"), ANSWERS)
def test_wrong_answers_of_the_callable_get_a_sentence(answer, sentence, cameras):
    with pytest.raises(ValueError, match=sentence):
        ob.uncertainty(lambda x, d: answer(x), cameras, box=Ball.box, **SMALL)


def test_answers_may_have_other_types_and_layouts(courtyard, cameras, points):
    def other(x, d):
        density, color = courtyard(x, d)
        return density.astype(np.float64)[:, None], np.asfortranarray(color)

    def plain(x, d):
        return courtyard(x, d)

    a, b = (ob.uncertainty(f, cameras, box=courtyard.box, **SMALL) for f in (plain, other))
    assert np.array_equal(a.query(points), b.query(points))


def beside(folder, cameras, pictures):
    """A transforms.json of these cameras with pictures ``[H, W, 3]`` in [0, 1] beside it."""
    frames = []
    for i, (camera, picture) in enumerate(zip(cameras, pictures)):
        png(folder / f"r_{i}.png", np.round(255 * np.dstack([picture, np.ones(picture.shape[:2])])))
        (fl_x, fl_y), (w, h), (cx, cy) = camera["focal"], camera["size"], camera["center"]
        matrix = np.asarray(camera["pose"]).tolist()
        intrinsics = {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy, "w": int(w), "h": int(h)}
        frames.append({"file_path": f"r_{i}", "transform_matrix": matrix, **intrinsics})
    path = folder / "transforms.json"
    path.write_text(json.dumps({"frames": frames}))
    return str(path)


def test_images_beside_a_camera_file_are_compared_with_the_model(courtyard, cameras, tmp_path, recwarn):
    shown = [ob.render(courtyard, None, camera, progress=False)["color"].clip(0, 1) for camera in cameras[:4]]
    run = {"level": 4, "rays": 1024, "occupancy": 32, "progress": False}
    path = beside(tmp_path, cameras, shown)
    ob.uncertainty(courtyard, path, **run)
    assert [str(w.message) for w in recwarn] == []
    beside(tmp_path, cameras, [picture * [0.02, 0, 0] for picture in shown])
    with pytest.raises(ValueError, match="images beside the cameras: expected .*at least 8 dB.*force"):
        ob.uncertainty(courtyard, path, **run)
    with pytest.warns(RuntimeWarning, match="match the images"):
        ob.uncertainty(courtyard, path, force=True, **run)
