"""What a model would be better without: splats and volumes, with and without masks."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import png
from test_splats import N, ball, camera, write

import octobayes as ob

AROUND = [camera(0.52 * k) for k in range(12)]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A ball of splats, and behind these 20 that float around it."""
    rows = ball()
    floaters = rows[:20].copy()
    angle = np.arange(20) * 0.3
    floaters[:, :3] = 1.3 * np.stack([np.cos(angle), np.sin(angle), 0.2 + 0 * angle], axis=1)
    floaters[:, 6] = -0.5
    floaters[:, 7:10] = -3.4
    return write(tmp_path_factory.mktemp("scene") / "scene.ply", np.concatenate([rows, floaters]))


def test_floaters_go_and_the_file_has_what_stays(path, tmp_path):
    cleaned = ob.clean(path, AROUND, progress=False)
    assert not cleaned.kept[N:].any() and cleaned.kept[:N].mean() > 0.9
    assert set(cleaned.reason[N:]) == {"floating"} and (cleaned.kept == (cleaned.reason == "kept")).all()
    assert list(cleaned.columns) == ["score", "front_share", "weight", "views"]
    assert all(len(column) == N + 20 for column in cleaned.columns.values())
    assert cleaned.columns["front_share"][N:].min() > 0.5 > cleaned.columns["front_share"][cleaned.kept].mean()
    sizes = [(~ob.clean(path, AROUND, strength=word, progress=False).kept).sum() for word in ("careful", "strong")]
    assert sizes[0] <= (~cleaned.kept).sum() <= sizes[1]
    for name in ["left.ply", "left.spz", "left.splat", "left.compressed.ply"]:
        cleaned.save(tmp_path / name)
        assert len(ob.open_model(tmp_path / name)) == cleaned.kept.sum()
    means = ob.open_model(path).means
    assert (cleaned.position == means).all()
    assert (ob.open_model(tmp_path / "left.ply").means == means[cleaned.kept]).all()


def test_pixels_that_masks_leave_out_do_not_count(path, tmp_path):
    png(tmp_path / "left.png", np.tile(np.arange(48) < 24, (40, 1)) * 65535)
    masked = [view | {"mask_path": tmp_path / "left.png"} for view in AROUND]
    half, all = (ob.clean(path, cameras, progress=False).columns["weight"].sum() for cameras in (masked, AROUND))
    # The ball is in the middle of every image.
    assert 0.4 * all < half < 0.6 * all


def test_a_voxel_grid_keeps_all_but_its_fog(tmp_path):
    n, fog = 48, np.array([0.95, 0.0, 0.0])
    axis = np.linspace(-1.5, 1.5, n)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    is_fog = np.linalg.norm(points - fog, axis=-1) < 0.16
    density = np.where(np.linalg.norm(points, axis=-1) < 0.7, 80.0, 1.5 * is_fog)
    grid = {"density": density, "color": np.full((n, n, n, 3), 0.5), "box": np.array([[-1.5] * 3, [1.5] * 3])}
    np.savez(tmp_path / "grid.npz", **{name: part.astype("f4") for name, part in grid.items()})
    cleaned = ob.clean(tmp_path / "grid.npz", AROUND, progress=False)
    assert len(cleaned.position) == len(cleaned.kept) == len(cleaned.columns["views"])
    gone = cleaned.position[~cleaned.kept]
    weight = cleaned.columns["weight"][~cleaned.kept]
    # Half the diagonal of a cell, and the diagonal of a voxel over which the fog ends.
    of_fog = np.linalg.norm(gone - fog, axis=1) < 0.16 + np.sqrt(3) * (1.5 / 48 + 3 / 47)
    assert weight[of_fog].sum() > 0.95 * weight.sum() > 0
    cleaned.save(tmp_path / "clean.npz", progress=False)
    left = np.load(tmp_path / "clean.npz")["density"]
    assert (left[~is_fog] == density.astype("f4")[~is_fog]).all()
    assert (left[is_fog] == 0).mean() > 0.9
    with pytest.raises(ValueError, match="`.npz`, a voxel grid of any volume"):
        cleaned.save(tmp_path / "clean.ply", progress=False)


def test_what_cannot_be_cleaned_is_refused(path, courtyard):
    with pytest.raises(ValueError, match="careful, normal, strong"):
        ob.clean(path, AROUND, strength="hard")
    with pytest.raises(ValueError, match="other than the model"):
        ob.clean(path, AROUND, progress=False).save(path)
    with pytest.raises(ValueError, match="nerf: expected a model file"):
        ob.clean(lambda x, d: courtyard(x, d), AROUND)
