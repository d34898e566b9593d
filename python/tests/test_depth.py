"""Standard deviations in scene units, of displacements and of depth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL, in_python, png

import octobayes as ob


@pytest.fixture(scope="module")
def metric(courtyard, cameras) -> ob.Uncertainty:
    return ob.uncertainty(courtyard, cameras, scale="data", noise=0.0316, covariance="block", keep_sums=True, **SMALL)


def test_the_scale_of_the_data_is_a_length(metric, courtyard, cameras):
    # Where nothing was seen: the root of 3, times 0.02 of the box's edge of 2.
    assert metric.query(np.float32([[50, 50, 50]]))[0] == pytest.approx(3**0.5 * 0.04, rel=1e-6)
    sharper = ob.uncertainty(courtyard, cameras, scale="data", noise=0.01, covariance="block", **SMALL)
    x = np.float32([[0.0, 0.0, -0.5]])
    assert sharper.query(x)[0] <= metric.query(x)[0]


def test_depth_has_an_error_beside_it(metric, courtyard, cameras, field):
    view = ob.render(courtyard, metric, cameras[0], depth_error=True, progress=False)
    error, shown = view["depth_error"], view["opacity"] > 0.5
    assert error.shape == (48, 48) and error.dtype == np.float32
    assert (error[shown] > 1e-3).all() and (error[shown] < 3).all() and np.isnan(error[view["opacity"] == 0]).all()
    assert "depth_error" not in ob.render(courtyard, metric, cameras[0], progress=False)
    # Those of a callable are the same.
    again = ob.render(lambda x, d: courtyard(x, d), metric, cameras[0], depth_error=True, progress=False)
    same = shown & (again["opacity"] > 0.5)
    assert np.median(np.abs(np.log(again["depth_error"][same] / error[same]))) < 0.05
    with pytest.raises(ValueError, match="expected a field in the scale of its data"):
        ob.render(courtyard, field, cameras[0], depth_error=True, progress=False)


@pytest.fixture(scope="module")
def photographs(courtyard, cameras, tmp_path_factory) -> Path:
    """A data set of what the model shows."""
    folder = tmp_path_factory.mktemp("photographs")
    frames = []
    for i, camera in enumerate(cameras):
        color = 255 * ob.render(courtyard, None, camera, progress=False)["color"].clip(0, 1)
        png(folder / f"{i}.png", np.round(np.dstack([color, np.full(color.shape[:2], 255)])))
        frames.append({"file_path": f"{i}.png", "transform_matrix": np.asarray(camera["pose"]).tolist()})
    lens = {"fl_x": float(cameras[0]["focal"][0]), "w": 48, "h": 48}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return folder / "transforms.json"


def test_depths_have_deviations_and_trust(metric, courtyard, photographs):
    with_images = ob.depth(courtyard, photographs, metric, photographs=[1, 2], progress=False)
    alone = ob.depth(courtyard, photographs, metric, photographs=[1, 2], images=False, progress=False)
    assert [(view["camera"], view["name"]) for view in alone] == [(1, "1.png"), (2, "2.png")]
    for view, other in zip(alone, with_images):
        assert view["depth"].shape == (48, 48) and view["depth"].dtype == np.float32
        np.testing.assert_array_equal(view["depth"], other["depth"])
        shown = view["trust"] > 0
        assert set(np.unique(view["trust"])) <= set(ob.TRUST) and (view["trust"] == 255).sum() > 100
        for name in ("depth", "sigma"):
            assert np.isfinite(view[name][shown]).all() and np.isnan(view[name][~shown]).all()
        assert (view["sigma"][shown] > 0).all() and not np.array_equal(view["sigma"][shown], other["sigma"][shown])
    # From the field alone they are those of pictures; along the axis they are shorter, but in the middle.
    camera = {"pose": json.loads(photographs.read_text())["frames"][1]["transform_matrix"]}
    camera |= {"focal": json.loads(photographs.read_text())["fl_x"], "size": (48, 48)}
    picture = ob.render(courtyard, metric, camera, depth_error=True, progress=False)
    shown = alone[0]["trust"] > 0
    np.testing.assert_allclose(alone[0]["sigma"][shown], picture["depth_error"][shown], rtol=1e-5)
    axis = ob.depth(courtyard, photographs, metric, photographs=[1], images=False, z_depth=True, progress=False)[0]
    shown = axis["trust"] > 0
    shorter = axis["depth"][shown] / alone[0]["depth"][shown]
    assert shorter.max() <= 1 and shorter.min() < 0.97
    np.testing.assert_allclose(axis["sigma"][shown] / alone[0]["sigma"][shown], shorter, rtol=1e-5)
    # Every other pixel.
    strided = ob.depth(courtyard, photographs, metric, photographs=[1], images=False, stride=2, progress=False)[0]
    np.testing.assert_array_equal(strided["depth"], alone[0]["depth"][::2, ::2])


def test_a_callable_and_a_field_of_its_own(courtyard, photographs):
    callable_ = in_python(courtyard, "box", "step")
    views = ob.depth(callable_, photographs, noise=0.05, photographs=[0], progress=False)
    assert (views[0]["trust"] == 255).any() and np.isfinite(views[0]["sigma"][views[0]["trust"] > 0]).all()


def test_lengths_have_deviations(metric, courtyard, photographs):
    view = ob.depth(courtyard, photographs, metric, photographs=[0], images=False, progress=False)[0]
    frames = json.loads(photographs.read_text())
    pose, focal = np.array(frames["frames"][0]["transform_matrix"]), frames["fl_x"]
    rows, columns = np.nonzero(view["trust"] == 255)

    def surface(k):
        row, column = rows[k], columns[k]
        ray = np.array([(column + 0.5 - 24) / focal, -(row + 0.5 - 24) / focal, -1.0])
        return pose[:3, 3] + view["depth"][row, column] * (pose[:3, :3] @ (ray / np.linalg.norm(ray)))

    a, b = surface(0), surface(len(rows) // 2)
    found = ob.measure(courtyard, a, b, photographs, metric, images=False, progress=False)
    low, high = found["interval_90"]
    assert found["length"] == pytest.approx(np.linalg.norm(a - b), abs=0.1) and low < found["length"] < high
    assert high - found["length"] == pytest.approx(1.645 * found["sigma"])
    ends = [np.array(point["position"]) for point in found["points"]]
    assert found["length"] == pytest.approx(np.linalg.norm(ends[0] - ends[1]))
    with pytest.raises(ValueError, match="a: expected a point on a surface that a training camera sees"):
        ob.measure(courtyard, pose[:3, 3] * 0.9, b, photographs, metric, images=False, progress=False)
    with pytest.raises(ValueError, match="b: expected three finite numbers"):
        ob.measure(courtyard, a, (1, 2), photographs)


def test_wrong_arguments_of_depth_get_a_sentence(metric, field, courtyard, photographs):
    for wrong, sentence in (
        ({"photographs": [9999]}, "photographs: expected"),
        ({"stride": 0}, "stride: expected"),
        ({"noise": 0.1}, "noise: expected None beside u"),
        ({"u": field}, "the scale of its data"),
        ({"photographs": 3}, "photographs: expected numbers of training cameras"),
        # Before the field is computed, which would need a noise.
        ({"u": None, "stride": 0}, "stride: expected"),
    ):
        with pytest.raises(ValueError, match=sentence):
            ob.depth(courtyard, photographs, **{"u": metric, "progress": False, **wrong})


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"scale": "metric"}, "scale: expected 'paper' or 'data'"),
        ({"noise": 0.1}, "noise: expected scale='data' beside it"),
        ({"scale": "data"}, "the error that training left"),
        (
            {"scale": "data", "noise": 0.0316, "lambda_": 1e-9},
            "lambda_: expected none: the scale of the training pixels has",
        ),
    ],
)
def test_scales_that_make_no_sense_get_a_sentence(courtyard, cameras, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        ob.uncertainty(courtyard, cameras, **arguments, **SMALL)
