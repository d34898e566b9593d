"""Progress, and arrays from elsewhere."""

import sys

import numpy as np
import pytest
from conftest import SMALL

import octobayes as ob


def test_progress_counts_up_to_the_end(courtyard, cameras):
    seen = []
    ob.uncertainty(courtyard, cameras, **{**SMALL, "rays": 100_000, "progress": lambda *now: seen.append(now)})
    assert {stage for stage, _, _ in seen} >= {"rays"} and seen[-1] == ("rays", 100_000, 100_000)
    done = [done for stage, done, _ in seen if stage == "rays"]
    assert done == sorted(done) and len(done) > 2


def test_tqdm_shows_a_bar(courtyard, cameras, capfd):
    pytest.importorskip("tqdm", reason="tqdm is not installed: its bar is not tested")
    ob.uncertainty(courtyard, cameras, **{**SMALL, "progress": True})
    assert "rays" in capfd.readouterr().err
    # Nobody watches a test: by default there is no bar.
    ob.uncertainty(courtyard, cameras, **{**SMALL, "progress": None})
    assert capfd.readouterr().err == ""


def test_without_tqdm_a_bar_is_an_error_and_its_absence_none(courtyard, cameras, monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    with pytest.raises(ImportError, match="progress: expected tqdm to be installed"):
        ob.uncertainty(courtyard, cameras, **{**SMALL, "progress": True})
    monkeypatch.setattr("octobayes._progress._is_watched", lambda: True)
    ob.uncertainty(courtyard, cameras, **{**SMALL, "progress": None})


class WithDlpack:
    """An array of another library, which only speaks DLPack."""

    def __init__(self, values):
        self._values = values

    def __dlpack__(self, **arguments):
        return self._values.__dlpack__(**arguments)

    def __dlpack_device__(self):
        return self._values.__dlpack_device__()


class WithArray:
    """An array of another library, which only speaks NumPy's protocol."""

    def __init__(self, values):
        self._values = values

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self._values, dtype=dtype)


@pytest.mark.parametrize("kind", [WithDlpack, WithArray])
def test_other_arrays_are_arrays(kind, field, points):
    assert np.array_equal(field.query(kind(points)), field.query(points))


def test_tensors_are_arrays(field, points):
    torch = pytest.importorskip("torch", reason="torch is not installed: its tensors are not tested")
    own = field.query(points)
    assert np.array_equal(field.query(torch.from_numpy(points)), own)
    assert np.array_equal(field.query(torch.from_numpy(points).requires_grad_()), own)
    half = torch.from_numpy(points).bfloat16()
    assert np.array_equal(field.query(half), field.query(half.float().numpy()))


def test_arrays_of_jax_are_arrays(field, points):
    jax = pytest.importorskip("jax", reason="jax is not installed: its arrays are not tested")
    assert np.array_equal(field.query(jax.numpy.asarray(points)), field.query(points))
    half = jax.numpy.asarray(points, dtype="bfloat16")
    assert np.array_equal(field.query(half), field.query(np.asarray(half, dtype=np.float32)))


def test_rays_until_two_halves_agree(courtyard, cameras):
    u = ob.uncertainty(courtyard, cameras, **{**SMALL, "rays": 131_072, "target_error": 0.5})
    assert 65_536 <= u.record["rays"] <= 131_072
