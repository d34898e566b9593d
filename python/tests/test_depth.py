"""Standard deviations in scene units, of displacements and of depth."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SMALL

import octobayes as ob


@pytest.fixture(scope="module")
def metric(courtyard, cameras) -> ob.Uncertainty:
    return ob.uncertainty(courtyard, cameras, scale="data", psnr=30, covariance="block", keep_sums=True, **SMALL)


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
    # At least what a march step of 2 root 3 / 1024 leaves open, and less than the box.
    assert (error[shown] > 2 * 3**0.5 / 1024 / 12**0.5 * 0.99).all() and (error[shown] < 3).all()
    assert np.isnan(error[view["opacity"] == 0]).all()
    assert "depth_error" not in ob.render(courtyard, metric, cameras[0], progress=False)
    # A callable is differentiated by differences; its errors are the same.
    again = ob.render(lambda x, d: courtyard(x, d), metric, cameras[0], depth_error=True, progress=False)
    same = shown & (again["opacity"] > 0.5)
    assert np.median(np.abs(np.log(again["depth_error"][same] / error[same]))) < 0.05
    with pytest.raises(ValueError, match="in the scale of its data"):
        ob.render(courtyard, field, cameras[0], depth_error=True, progress=False)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"scale": "metric"}, "scale: expected 'paper' or 'data'"),
        ({"noise": 0.1}, "noise: expected scale='data' beside it"),
        ({"scale": "data"}, "the noise that training left"),
        ({"scale": "data", "psnr": 30, "noise": 0.1}, "noise: expected None with psnr"),
        ({"scale": "data", "psnr": 30, "lambda_": 1e-9}, "lambda_: expected None with scale='data'"),
    ],
)
def test_scales_that_make_no_sense_get_a_sentence(courtyard, cameras, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        ob.uncertainty(courtyard, cameras, **arguments, **SMALL)
