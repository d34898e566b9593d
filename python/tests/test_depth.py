"""Standard deviations in scene units, of displacements and of depth."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
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
    # At least what a march step of 2 root 3 / 1024 leaves open, and less than the box.
    assert (error[shown] > 2 * 3**0.5 / 1024 / 12**0.5 * 0.99).all() and (error[shown] < 3).all()
    assert np.isnan(error[view["opacity"] == 0]).all()
    assert "depth_error" not in ob.render(courtyard, metric, cameras[0], progress=False)
    # A callable is differentiated by differences; its errors are the same.
    again = ob.render(lambda x, d: courtyard(x, d), metric, cameras[0], depth_error=True, progress=False)
    same = shown & (again["opacity"] > 0.5)
    assert np.median(np.abs(np.log(again["depth_error"][same] / error[same]))) < 0.05
    with pytest.raises(ValueError, match="scale='data': expected a field computed with it"):
        ob.render(courtyard, field, cameras[0], depth_error=True, progress=False)


#: What the images are off by in one channel, of 255.
OFF = 20


@pytest.fixture(scope="module")
def images(courtyard, cameras, tmp_path_factory) -> list[Path]:
    """Training images whose red is not what the model shows."""
    folder = tmp_path_factory.mktemp("images")
    files = [folder / f"{i}.png" for i in range(len(cameras))]
    for camera, file in zip(cameras, files):
        color = 255 * ob.render(courtyard, None, camera, progress=False)["color"]
        # Where it stays within the range.
        color[..., 0] += np.where(color[..., 0] < 128, OFF, -OFF)
        png(file, np.round(np.dstack([color, np.full(color.shape[:2], 255)])))
    return files


def check_what_was_added(nerf, camera, without, joined) -> np.ndarray:
    """The residuals's share of the deviations, which are returned."""
    before, after = (
        ob.render(nerf, u, camera, depth_error=True, progress=False)["depth_error"] for u in (without, joined)
    )
    # One channel of three is off by as much everywhere, to half a step of the images; a 10th of the box's edge of 2.
    expected = 0.2 * OFF / 255 / 3**0.5
    # Elsewhere what was there hides it from f32.
    small = before < 0.1
    added = np.sqrt(after[small].astype(float) ** 2 - before[small].astype(float) ** 2)
    # The two other channels are off by half a step: a share of (0.5 / OFF)^2, 6e-4. f32 leaves 6e-8 (0.1 / added)^2.
    assert small.sum() > 500 and (np.abs(added / expected - 1) < 0.5 / OFF + 7e-4).all()
    return after


def test_deviations_count_what_images_show_and_the_model_does_not(metric, courtyard, cameras, images):
    settings = {"scale": "data", "noise": 0.0316, "covariance": "block", "keep_sums": True, **SMALL}
    joined = ob.uncertainty(courtyard, cameras, images=images, **settings)
    x = np.float32([[0.0, 0.0, -0.5], [0.3, 0.2, 0.1]])
    np.testing.assert_array_equal(joined.query(x), metric.query(x))
    after = check_what_was_added(courtyard, cameras[0], metric, joined)

    # By name, in a folder.
    named = [{**camera, "file_path": f"./{i}"} for i, camera in enumerate(cameras)]
    again = ob.uncertainty(courtyard, named, images=images[0].parent, **settings)
    view = ob.render(courtyard, again, cameras[0], depth_error=True, progress=False)
    np.testing.assert_array_equal(view["depth_error"], after)

    # Of two colours from 0 to 1, the standard deviation is at most √½, of more it is smaller. All images show one
    # scene: on a part of it they agree.
    spread, shown = view["color_spread"], view["opacity"] > 0
    known = np.isfinite(spread)
    assert spread.shape == shown.shape and spread.dtype == np.float32 and not known[~shown].any()
    assert (spread[known] >= 0).all() and (spread[known] <= 0.5**0.5 + 1e-6).all() and (spread[known] <= 0.05).any()
    for field, more in ((metric, {"depth_error": True}), (again, {})):
        assert "color_spread" not in ob.render(courtyard, field, cameras[0], progress=False, **more)

    # Of a callable, and through a file.
    callable_ = in_python(courtyard, "box", "step")
    plain = ob.uncertainty(callable_, cameras, **settings)
    ob.uncertainty(callable_, cameras, images=images, **settings).save(images[0].parent / "field.oct")
    check_what_was_added(callable_, cameras[0], plain, ob.load(images[0].parent / "field.oct"))


def test_images_that_are_not_there_get_a_sentence(courtyard, cameras, images):
    settings = {"scale": "data", "noise": 0.0316, **SMALL}
    with pytest.raises(ValueError, match="images: expected scale='data', in which depths have deviations"):
        ob.uncertainty(courtyard, cameras, images=images, **SMALL)
    with pytest.raises(ValueError, match=f"images: expected a file for each of {len(cameras)} cameras, found 1 files"):
        ob.uncertainty(courtyard, cameras, images=images[:1], **settings)
    with pytest.raises(ValueError, match="images: expected a folder, or a list of .* files, found 3"):
        ob.uncertainty(courtyard, cameras, images=3, **settings)
    with pytest.raises(ValueError, match="images: expected the folder from which the names .* found neither"):
        ob.uncertainty(courtyard, cameras, images=images[0].parent, **settings)
    with pytest.raises(OSError, match="missing.png"):
        ob.uncertainty(courtyard, cameras, images=["missing.png"] * len(cameras), **settings)
    with ThreadPoolExecutor() as pool, pytest.raises(ValueError, match="images: expected None with an executor"):
        ob.uncertainty(courtyard, cameras, images=images, executor=pool, shards=2, **settings)


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
