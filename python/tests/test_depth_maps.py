"""Depth maps: values that are no measurements, and which map belongs to which frame."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL, exr, png

import octobayes as ob

NAMES = ["images/front/0.png", "images/front/1.png", "images/back/0.png", "images/back/1.png"]
FIGURES = ["pixels", "depth_error", "readings", "baselines", "psnr"]


@pytest.fixture(scope="module")
def metric(courtyard, cameras) -> ob.Uncertainty:
    return ob.uncertainty(courtyard, cameras, scale="data", noise=0.0316, keep_sums=True, **SMALL)


@pytest.fixture(scope="module")
def desk(courtyard, cameras, tmp_path_factory) -> tuple[Path, list[np.ndarray]]:
    """A camera file with opaque images, and what a sensor measures, which is off; NaN in a stripe and behind all."""
    folder = tmp_path_factory.mktemp("desk")
    frames, depths = [], []
    for name, camera in zip(NAMES, cameras):
        view = ob.render(courtyard, None, camera, progress=False)
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        png(folder / name, np.dstack([255 * view["color"].clip(0, 1), np.full((48, 48), 255)]))
        depth = np.where(view["opacity"] > 0.5, view["depth"] + 0.003 * np.arange(48), np.nan)
        depth[:, 20:25] = np.nan
        depths.append(depth)
        frames.append({"file_path": name, "transform_matrix": np.asarray(camera["pose"]).tolist()})
    lens = {"fl_x": float(cameras[0]["focal"][0]), "w": 48, "h": 48}
    (folder / "transforms_test.json").write_text(json.dumps({**lens, "frames": frames}))
    return folder, depths


def write(folder: Path, depths: list[np.ndarray], nothing: float) -> Path:
    for name, depth in zip(NAMES, depths):
        file = folder / Path(name).relative_to("images").with_suffix(".exr")
        file.parent.mkdir(parents=True, exist_ok=True)
        exr(file, np.where(np.isnan(depth), nothing, depth))
    return folder


def test_values_that_are_no_measurements_change_no_figure(courtyard, metric, desk, tmp_path):
    folder, depths = desk
    missing = np.isnan(np.stack(depths))
    said = f"{100 * missing.mean():.1f} % of depth readings are not measurements"
    found = []
    for nothing in (0.0, 1e10, 65504.0, 1000.0, np.inf, -1.0):
        maps = {"depth": write(tmp_path / str(nothing), depths, nothing), "depth_pattern": "{}.exr", "progress": False}
        with pytest.warns(RuntimeWarning, match=f"^{said}"):
            judged = ob.evaluate(courtyard, metric, folder / "transforms_test.json", **maps)
        with pytest.warns(RuntimeWarning, match=f"^{said}"):
            field, calibrated = ob.calibrate(courtyard, metric, folder / "transforms_test.json", stride=1, **maps)
        readings = judged["depth_readings"]
        assert readings == calibrated["depth_readings"] and readings["measured"] == (~missing).sum()
        assert sum(readings.values()) == missing.size
        found.append(([judged[key] for key in FIGURES], field.conformal))
    assert all(figures == found[0] for figures in found[1:])


def test_a_far_plane_within_reach_of_the_model_is_told(courtyard, metric, desk, tmp_path):
    """It cannot be told from a measurement for certain, so it counts as one."""
    folder, depths = desk
    maps = {"depth": write(tmp_path, depths, 7.0), "depth_pattern": "{}.exr", "progress": False}
    assert max(np.nanmax(depth) for depth in depths) < 7.0
    with pytest.warns(RuntimeWarning, match="% of the depths are exactly 7, the largest of all: if it stands for no"):
        judged = ob.evaluate(courtyard, metric, folder / "transforms_test.json", **maps)
    assert judged["depth_readings"]["measured"] == np.stack(depths).size


def test_depths_that_cannot_be_right_are_refused(courtyard, metric, desk, tmp_path):
    folder, depths = desk
    for name, change, sentence in (
        ("millimetres", 1000.0, "100.0 % of depth readings are not measurements"),
        ("behind", None, "half of the depths are off by more than 2"),
    ):
        wrong = [depth + 2.5 if change is None else change * depth for depth in depths]
        maps = {"depth": write(tmp_path / name, wrong, 0.0), "depth_pattern": "{}.exr", "progress": False}
        for judge in (ob.evaluate, ob.calibrate):
            with pytest.raises(ValueError, match=f"depth maps: expected .*found {sentence}"):
                judge(courtyard, metric, folder / "transforms_test.json", **maps)


def test_a_map_belongs_to_one_frame(courtyard, metric, desk, tmp_path):
    folder, depths = desk
    maps = write(tmp_path, depths, 0.0)
    for judge in (ob.evaluate, ob.calibrate):
        with pytest.raises(ValueError, match="for both `images/front/0.png` and `images/back/0.png`"):
            judge(
                courtyard,
                metric,
                folder / "transforms_test.json",
                depth=maps / "front",
                depth_pattern="{}.exr",
                progress=False,
            )
        with pytest.raises(ValueError, match="depth: expected a folder of depth maps, or a camera file that names"):
            judge(courtyard, metric, folder / "transforms_test.json", progress=False)


def test_calibration_reads_the_covariance_that_it_is_told(courtyard, metric, desk, tmp_path):
    folder, depths = desk
    maps = {"depth": write(tmp_path, depths, 0.0), "depth_pattern": "{}.exr", "progress": False}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        own, _ = ob.calibrate(courtyard, metric, folder / "transforms_test.json", **maps)
        told, _ = ob.calibrate(courtyard, metric, folder / "transforms_test.json", covariance="block", **maps)
        block = metric.with_covariance("block")
        expected, _ = ob.calibrate(courtyard, block, folder / "transforms_test.json", **maps)
    assert told.conformal == expected.conformal != own.conformal
