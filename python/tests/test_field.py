"""Queries, files, comparisons and merges of finished fields."""

import numpy as np
import pytest
from conftest import SMALL

import octobayes as ob


def test_queries_have_one_answer_per_point(field, points):
    u = field.query(points)
    assert u.shape == (1000,) and u.dtype == np.float64 and (u > 0).all()
    assert np.array_equal(field.log10(points), np.log10(u))
    rays = field.rays(points)
    assert rays.shape == (1000,) and (rays >= 0).all() and rays.max() > 10
    assert field.level(points).dtype == np.uint8 and field.level(points).max() == 6
    assert field.inside(points).all() and not field.inside([2.0, 0.0, 0.0])
    # Any leading shape, lists, other types of numbers, and arrays that are not contiguous.
    assert np.array_equal(field.query(points.reshape(10, 100, 3)), u.reshape(10, 100))
    assert field.query(points[0].tolist()).shape == ()
    assert np.array_equal(field.query(points.astype(np.float64)), u)
    assert np.array_equal(field.query(np.asfortranarray(points)), u)
    assert np.array_equal(field.query(np.hstack([points, points])[:, 3:]), u)
    assert np.array_equal(field.query(points[::2]), u[::2])


def test_the_front_is_known_and_the_back_is_not(field):
    front, back = field.query([[0.75, -0.5, -0.35], [0.3, -0.5, -0.4]])
    assert front < 0.1 * back and back > 0.9 * field.prior
    assert list(field.seen([[0.75, -0.5, -0.35], [0.3, -0.5, -0.4]])) == ["constrained", "unseen"]


def test_ray_coverage_counts_of_a_coarse_grid(field, points):
    ray_coverage = field.ray_coverage
    assert ray_coverage.ndim == 3 and len(set(ray_coverage.shape)) == 1 and ray_coverage.dtype == np.uint32
    cells = ((points + 1) / 2 * len(ray_coverage)).astype(int).clip(0, len(ray_coverage) - 1)
    assert np.array_equal(field.ray_coverage_at(points), ray_coverage[tuple(cells.T)])


def test_matrices_have_the_trace_of_the_squared_uncertainty(field, points):
    for kind in ["diagonal", "block", "trace"]:
        matrices = field.covariance(points, kind)
        assert matrices.shape == (1000, 3, 3)
        assert np.array_equal(matrices, matrices.swapaxes(1, 2))
        u = field.with_covariance(kind).query(points)
        # A few roundings of f64.
        np.testing.assert_allclose(np.trace(matrices, axis1=1, axis2=2), u**2, rtol=1e-12)
        assert (np.linalg.eigvalsh(matrices)[:, 0] >= -1e-12 * u**2).all()
    assert field.covariance(points[0]).shape == (3, 3)


def test_without_sums_there_is_a_sentence(courtyard, cameras, points):
    u = ob.uncertainty(courtyard, cameras, **SMALL)
    assert not u.keeps_sums
    for read in [lambda: u.covariance(points), lambda: u.with_covariance("block")]:
        with pytest.raises(ValueError, match="keep_sums: expected a field that keeps its sums.*found one of"):
            read()
    with pytest.raises(ValueError, match="log10_error: expected a field with error bars"):
        u.log10_error(points)


def test_files_come_back(field, points, tmp_path):
    path = tmp_path / "field.oct"
    field.save(path)
    again = ob.load(path)
    assert np.array_equal(again.query(points), field.query(points))
    assert again.record == field.record and again.summary == field.summary
    assert ob.compare(field, str(path), points=1000)["in_box"]["max"] == 0.0
    with pytest.raises(FileNotFoundError, match="none.oct: cannot open"):
        ob.load(tmp_path / "none.oct")
    with pytest.raises(ValueError, match="path: expected a name that ends in .oct"):
        field.save(tmp_path / "field.npy")
    (tmp_path / "broken.oct").write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match="broken.oct"):
        ob.load(tmp_path / "broken.oct")


def test_the_official_grid_there_and_back(field, points, tmp_path):
    path = tmp_path / "unc.npy"
    ob.export(field, path)
    assert np.load(path).shape == (65**3,)
    again = ob.load(path, box=field.box, rays=field.record["rays"])
    inner = points[(abs(points) < 0.9).all(axis=1)]
    own = field.with_covariance("trace").log10(inner)
    # The octree leaves out what moves log10 U by less than its tolerance.
    assert abs(again.log10(inner) - own).max() <= 0.01 + 1e-6
    with pytest.raises(ValueError, match="box: expected the box of the official grid"):
        ob.load(path)


def test_the_official_grid_of_contracted_space(courtyard, cameras, points, tmp_path):
    path, space = tmp_path / "unc.npy", {"contract": ("linf", 0, 0, 0, 1)}
    field = ob.uncertainty(courtyard, cameras, covariance="trace", **space, **SMALL)
    ob.export(field, path)
    again = ob.load(path, rays=field.record["rays"], **space)
    spread = np.concatenate([points, 4 * points])
    assert np.ptp(field.log10(spread)) > 1
    assert abs(again.log10(spread) - field.log10(spread)).max() <= 0.01 + 1e-6


def test_shards_merge_into_the_whole_run(courtyard, cameras, points, tmp_path):
    whole = ob.uncertainty(courtyard, cameras, **SMALL)
    parts = [ob.uncertainty(courtyard, cameras, shard=(i, 2), **SMALL) for i in range(2)]
    assert all(part.is_part for part in parts)
    merged = ob.merge(parts)
    assert not merged.is_part
    # Sums differ by the order of f64 additions, deviations are f32.
    np.testing.assert_allclose(merged.log10(points), whole.log10(points), atol=1e-6)
    np.testing.assert_array_equal(ob.merge(parts, scratch=tmp_path).log10(points), merged.log10(points))
    with pytest.raises(ValueError, match="fields to merge: .*rays in common"):
        ob.merge([parts[0], parts[0]])


def test_error_bars_and_other_seeds(courtyard, cameras, points):
    u = ob.uncertainty(courtyard, cameras, error_bars=4, **SMALL)
    errors = u.log10_error(points)
    assert errors.shape == (1000,) and np.nanmax(errors) > 0
    seeds = [ob.uncertainty(courtyard, cameras, seed=seed, keep_sums=True, **SMALL) for seed in (1, 2, 3)]
    joined = ob.merge(seeds, error_bars=True)
    assert joined.has_error_bars and joined.record["rays"] == 3 * SMALL["rays"]


def test_samples_accumulate_to_the_run_that_wrote_them(courtyard, cameras, points, tmp_path):
    path = tmp_path / "samples.npz"
    u = ob.uncertainty(courtyard, cameras, dump_samples=path, **SMALL)
    arguments = {"box": courtyard.box, "level": 6, "progress": False}
    from_file = ob.accumulate(path, **arguments)
    assert np.array_equal(from_file.query(points), u.query(points))
    samples = dict(np.load(path))
    from_arrays = ob.accumulate(samples, **arguments)
    assert np.array_equal(from_arrays.query(points), u.query(points))
    samples["ray"] = samples["ray"][::-1]
    with pytest.raises(ValueError, match=r"samples\['ray'\]\[\d+\]: expected from \d+ \(non-decreasing\)"):
        ob.accumulate(samples, **arguments)
    del samples["jacobian"]
    with pytest.raises(ValueError, match=r"samples: expected keys .*, found none of \['jacobian'\]"):
        ob.accumulate(samples, **arguments)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (
            np.zeros((4, 2)),
            r"points: expected an array of real numbers of shape \[N, 3\], found an array of shape \[4, 2\]",
        ),
        (np.zeros(()), r"points: expected an array of real numbers of shape \[N, 3\], found an array of shape \[\]"),
        (np.zeros((4, 3), bool), r"points: expected .* found an array of shape \[4, 3\] and type bool"),
        (np.zeros((4, 3), complex), r"points: expected .* found an array of shape \[4, 3\] and type complex128"),
        ([["a", "b", "c"]], r"points: expected .* found an array of shape \[1, 3\] and type <U1"),
        ([[0.0, np.nan, 0.0]], r"points: expected finite numbers, found nan at \[0, 1\]"),
        ([[0.0, 0.0, np.inf]], r"points: expected finite numbers, found inf at \[0, 2\]"),
    ],
)
def test_wrong_points_get_a_sentence(field, wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        field.query(wrong)
