"""Rankings of views in Python: what comes back, what follows from what is known, and what is refused."""

from __future__ import annotations

import json
import os
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import in_python

import octobayes as ob

RUN = {"level": 5, "rays": 8_192, "occupancy": 32, "scale": "data", "noise": 0.05, "keep_sums": True}
QUIET = {"occupancy": 32, "pixels": 256, "progress": False}


def look_at(eye: np.ndarray) -> np.ndarray:
    """Camera-to-world: columns right, up, back, position."""
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return np.vstack([np.column_stack([right, np.cross(back, right), back, eye]), [0, 0, 0, 1]])


def around(angles: np.ndarray) -> np.ndarray:
    return np.stack([look_at(2.8 * np.array([np.cos(a), np.sin(a), 0.4])) for a in angles])


@pytest.fixture(scope="module")
def front() -> dict:
    """Three cameras on one side."""
    return {"pose": around(np.array([-0.4, 0.0, 0.4])), "fov": 45, "size": (32, 24)}


@pytest.fixture(scope="module")
def known(courtyard, front) -> ob.Uncertainty:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return ob.uncertainty(courtyard, front, progress=False, **RUN)


def test_a_purpose_sets_what_was_not_given(courtyard, front, caplog):
    small = {"rays": 4096, "occupancy": 32, "progress": False}
    with caplog.at_level("INFO", logger="octobayes"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        paper = ob.uncertainty(courtyard, front, level=4, **small)
        made = ob.uncertainty(courtyard, front, for_="next-view", level=4, noise=0.05, **small)
    assert any("for_='next-view' sets scale='data', keep_sums=" in text for text in caplog.messages)
    poses = around(np.linspace(0, 2 * np.pi, 4, endpoint=False))
    assert ob.next_view(courtyard, made, poses, take=1, cameras=front, **QUIET)["steps"]
    with pytest.raises(ValueError, match="for_='next-view'"):
        ob.next_view(courtyard, paper, poses, take=1, cameras=front, **QUIET)


def test_poses_go_in_and_the_chosen_ones_come_out(courtyard, front, known):
    poses = around(np.linspace(0, 2 * np.pi, 8, endpoint=False))
    found = ob.next_view(courtyard, known, poses, take=3, cameras=front, map=True, **QUIET)
    index = [step["index"] for step in found["steps"]]
    assert found["complete"] and len(set(index)) == 3
    np.testing.assert_array_equal(found["poses"], poses[index])
    assert found["gains"].shape == (8,) and index[0] == found["gains"].argmax()
    # The sides that no camera saw are worth most, that of the training cameras least.
    assert index[0] in (2, 3, 4, 5, 6) and found["gains"].argmin() in (0, 1, 7)
    steps = [step["gain"] for step in found["steps"]]
    assert steps[0] == found["gains"][index[0]] and steps == sorted(steps, reverse=True) and steps[-1] > 0
    assert found["steps"][0]["gain_per_pixel"] * 32 * 24 == pytest.approx(steps[0])
    assert found["map"].shape == (24, 32) and found["map"].dtype == np.float32 and found["map"].max() > 0
    chosen = found["cameras"][0]
    assert chosen["size"].tolist() == [32, 24]
    assert chosen["focal"][0] == pytest.approx(16 / np.tan(np.radians(22.5)))
    # The same as cameras of their own, whatever form poses have.
    listed = [{"pose": pose, "fov": 45, "size": (32, 24)} for pose in poses]
    as_dictionaries = ob.next_view(courtyard, known, listed, take=3, **QUIET)
    short = ob.next_view(courtyard, known, poses[:, :3], take=3, cameras=front, **QUIET)
    for other in (as_dictionaries, short):
        np.testing.assert_array_equal(other["gains"], found["gains"])
    assert as_dictionaries["candidates"][3]["name"] == "camera 3"


def test_a_planners_loop_learns_from_each_view(courtyard, front, known):
    poses = around(np.linspace(0, 2 * np.pi, 8, endpoint=False))
    listed = [{"pose": pose, "fov": 45, "size": (32, 24)} for pose in poses]
    first = ob.next_view(courtyard, known, listed, **QUIET)
    taken = [{"pose": pose, "fov": 45, "size": (32, 24)} for pose in front["pose"]] + first["cameras"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        later = ob.uncertainty(courtyard, taken, box=known.box, progress=False, **RUN)
    second = ob.next_view(courtyard, later, listed, **QUIET)
    best = first["steps"][0]["index"]
    # No other candidate loses as much as the one that was photographed.
    left = second["gains"] / first["gains"]
    assert second["steps"][0]["index"] != best and left.argmin() == best and left[best] < 0.8, left


def test_callables_are_ranked_as_the_model_that_they_are(courtyard, front, known):
    poses = around(np.array([0.5, 2.5, 4.5]))
    expected = ob.next_view(courtyard, known, poses, take=2, cameras=front, **QUIET)
    model = in_python(courtyard, "density", "step", "box")
    # A callable has no derivatives of its own; those of the field are differences of the same step.
    found = ob.next_view(model, known, poses, take=2, cameras=front, **QUIET)
    assert [s["index"] for s in found["steps"]] == [s["index"] for s in expected["steps"]]
    # Both are of the same numbers up to the rounding of f32, which differences of a thousandth of the box enlarge.
    np.testing.assert_allclose(found["gains"], expected["gains"], rtol=1e-4)
    assert model.calls


@pytest.mark.parametrize("gain", ["logdet", "trace", "coverage"])
def test_candidates_are_made_for_every_gain(gain, courtyard, front, known):
    for made in ({"orbit": 6}, {"sphere": 9, "upper": True}, {"near": 7}):
        found = ob.next_view(courtyard, known, gain=gain, take=2, cameras=front, **made, **QUIET)
        kind, count = next(iter(made.items()))
        assert found["gain"] == gain and len(found["gains"]) == count and len(found["poses"]) == 2
        assert found["candidates"][0]["name"] == f"{kind} 0"


def test_made_candidates_are_level(courtyard, front, known):
    for given, up in ((None, [0, 0, 1]), ([0, -3, 4], [0, -0.6, 0.8])):
        found = ob.next_view(courtyard, known, orbit=6, take=6, up=given, cameras=front, **QUIET)
        heights = found["poses"][:, :3, 3] @ np.array(up)
        assert len(heights) > 2 and np.ptp(heights) < 1e-9
        assert np.abs(found["poses"][:, :3, 0] @ np.array(up)).max() < 1e-9


def test_views_of_nothing_say_why(courtyard, front, known):
    away = look_at(np.array([3.0, 0.0, 0.0]))
    away[:3, [0, 2]] *= -1
    near = look_at(np.array([3.0, 0.0, 0.0]))
    with pytest.warns(RuntimeWarning, match="candidates see little of the model"):
        found = ob.next_view(courtyard, known, np.stack([away, near]), cameras=front, **QUIET)
    assert found["candidates"][0]["why_nothing"] == "past-the-box" and found["gains"][0] == 0.0
    with pytest.raises(ValueError, match="OpenCV's camera axes .*found 1 of 1 candidates: gain 0, looks past the box"):
        ob.next_view(courtyard, known, away[None], cameras=front, map=True, **QUIET)


def test_candidates_with_other_axes_are_told(courtyard, front, known):
    poses = around(np.linspace(0.0, 3.0, 4))
    poses[:, :3, 1:3] *= -1
    with pytest.raises(ValueError, match="^candidates: expected views that add something; .*OpenCV's camera axes"):
        ob.next_view(courtyard, known, poses, cameras=front, **QUIET)


def test_what_cannot_be_ranked_is_refused_by_name(courtyard, front, known, field):
    poses = around(np.array([1.0]))
    refused = [
        ({"u": field, "candidates": poses}, "^scale='data': expected a field computed with it"),
        ({}, "^candidates: expected candidates, sphere, orbit or near, one of them, found none"),
        ({"candidates": poses, "orbit": 3}, "found candidates and orbit"),
        ({"orbit": 3, "upper": True}, "^upper: expected sphere beside it"),
        ({"candidates": np.zeros((2, 5))}, r"^candidates: expected an array of poses \[C, 4, 4\] or \[C, 3, 4\]"),
        ({"candidates": np.full((1, 4, 4), np.nan)}, "^candidates: expected finite numbers"),
        ({"orbit": 3, "up": [0, 0, 0]}, "^up: expected a direction, such as 0,0,1, found 0,0,0"),
        ({"orbit": 3, "up": [0, 1]}, r"^up: expected an array of real numbers of shape \[3\]"),
        ({"candidates": poses, "up": [0, 0, 1]}, "^up: expected sphere, orbit or near beside it, found candidates"),
        ({"orbit": 0}, "^orbit: expected a whole number, 1 to 100000"),
        ({"orbit": 3, "gain": "entropy"}, "^gain: expected .*'logdet'.*found 'entropy'"),
        ({"orbit": 3, "gain": "coverage", "map": True}, "^map: expected a gain of"),
        ({"orbit": 3, "take": 0}, "^take: expected"),
    ]
    for arguments, said in refused:
        given = {"u": known, "cameras": front, **QUIET, **arguments}
        with pytest.raises(ValueError, match=said):
            ob.next_view(courtyard, **given)
    bare = in_python(courtyard, "box")
    with pytest.raises(ValueError, match="^cameras: expected a camera file or cameras"):
        ob.next_view(bare, known, poses, **QUIET)


def test_ctrl_c_and_progress_reach_the_work(courtyard, front, known):
    stages = []
    ob.next_view(courtyard, known, orbit=3, cameras=front, **{**QUIET, "progress": lambda *now: stages.append(now)})
    assert stages

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ob.next_view(courtyard, known, orbit=64, cameras=front, occupancy=64, pixels=4096, progress=stop)


@pytest.mark.parametrize("gain", ["logdet", "trace", "coverage"])
def test_the_program_says_the_same(gain, tmp_path, monkeypatch):
    if "OCTOBAYES" not in os.environ:
        pytest.skip("parity: OCTOBAYES does not name the program")
    monkeypatch.chdir(tmp_path)

    def octobayes(arguments: str) -> str:
        program = os.environ["OCTOBAYES"]
        return subprocess.run([program, *arguments.split()], check=True, stdout=subprocess.PIPE, text=True).stdout

    run = "--level 5 --rays 8192 --occupancy 32 --scale data --noise 0.05 --keep-sums --resolution 32"
    octobayes(f"uncertainty scene:courtyard {run} -o field.oct")
    options = f"--gain {gain} --take 3 --pixels 200 --seed 5"
    u, model = ob.load("field.oct"), ob.open_model("scene:courtyard")
    arguments = {"gain": gain, "take": 3, "pixels": 200, "seed": 5, "progress": False}

    def figures(ranking: dict) -> dict:
        steps = [{key: value for key, value in step.items() if key != "seconds"} for step in ranking["steps"]]
        parts = ("candidates", "gain", "pixels", "seed", "complete")
        return {**{key: ranking[key] for key in parts}, "steps": steps}

    box = [[-0.5, -0.5, -0.5], [0.5, 0.4, 0.3]]
    for words, made in (
        ("--orbit 7", {"orbit": 7}),
        ("--sphere 9 --upper", {"sphere": 9, "upper": True}),
        ("--near 8 --object=-0.5,-0.5,-0.5,0.5,0.4,0.3", {"near": 8, "object": box}),
    ):
        command = f"next-view scene:courtyard field.oct {words} {options} --resolution 40"
        expected = json.loads(octobayes(f"{command} -o ranking.json --chosen next.json --json"))
        found = ob.next_view(model, u, resolution=40, **made, **arguments)
        assert figures(found) == figures(expected)
        written = json.loads(Path("next.json").read_text())["frames"]
        np.testing.assert_allclose(found["poses"], [frame["transform_matrix"] for frame in written], atol=1e-12)
    command = f"next-view scene:courtyard field.oct --candidates next.json {options} --resolution 20"
    expected = json.loads(octobayes(f"{command} -o ranking.json --json"))
    assert figures(ob.next_view(model, u, "next.json", resolution=20, **arguments)) == figures(expected)
