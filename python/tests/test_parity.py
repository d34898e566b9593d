"""The command line and the package are the same program: the same arguments, the same figures."""

from __future__ import annotations

import json
import os
import subprocess
import warnings
from pathlib import Path
from typing import Any

import pytest

import octobayes as ob

CORNERS = ["1 0 0", "-1 0 0", "0 1 0", "0 -1 0", "0 0 1", "0 0 -1"]
FACES = ["1 3 5", "3 2 5", "2 4 5", "4 1 5", "3 1 6", "2 3 6", "4 2 6", "1 4 6"]
MAPS = "--depth set/depth --depth-pattern {}.png --depth-encoding 0,6.5535"


def octobayes(arguments: str) -> str:
    """What the program prints."""
    program = os.environ["OCTOBAYES"]
    return subprocess.run([program, *arguments.split()], check=True, stdout=subprocess.PIPE, text=True).stdout


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Path:
    """A mesh, exact data, two models that were trained on it, and two fields of the first."""
    if "OCTOBAYES" not in os.environ:
        pytest.skip("parity: OCTOBAYES does not name the program")
    folder = tmp_path_factory.mktemp("parity")
    lines = [f"v {corner}" for corner in CORNERS] + [f"f {face}" for face in FACES]
    (folder / "mesh.obj").write_text("\n".join(lines))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        octobayes("synth mesh.obj -o set --count 6 --test-count 2 --resolution 24 --samples-per-pixel 4")
        octobayes("train set -o m.safetensors --steps 120 --members 2 --samples-per-step 4096 --log2-hashmap-size 12")
        run = "uncertainty m-0.safetensors --level 5 --rays 3000 --gradient auto --keep-sums"
        octobayes(f"{run} -o paper.oct")
        octobayes(f"{run} --scale data -o metric.oct")
    return folder


def judged(field: str, cameras: str = "set/transforms_test.json", **arguments: Any) -> dict[str, Any]:
    """The report of the package."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        named = {field: f"{field}.oct"}
        return ob.evaluate("m-0.safetensors", named, cameras, progress=False, **arguments)


#: What a machine measures of itself.
OWN = {"seconds", "peak_bytes"}
SMALL = "--level 5 --rays 3000 --occupancy 32"
SMALL_RUN = {"level": 5, "rays": 3000, "occupancy": 32, "progress": False}
CUBE = [[-0.7, -0.7, -0.7], [0.7, 0.7, 0.7]]

#: Options of the program, and the same arguments.
RUNS = {
    "own cameras": (
        "m-0.safetensors --gradient auto --keep-sums --audit",
        {"nerf": "m-0.safetensors", "gradient": "auto", "keep_sums": True, "audit": True},
    ),
    "scale of the data": (
        "m-0.safetensors --cameras set/transforms_train.json --scale data --background black --force",
        {
            "nerf": "m-0.safetensors",
            "cameras": "set/transforms_train.json",
            "scale": "data",
            "background": "black",
            "force": True,
        },
    ),
    "some cameras, another size": (
        "m-0.safetensors --cameras set/transforms_train.json --views 3 --resolution 20 "
        "--box=-0.7,-0.7,-0.7,0.7,0.7,0.7 --refine sensitivity,ray-count --pooling auto --seed 3 --covariance block "
        "--lambda 0.01 --tolerance 0.1",
        {
            "nerf": "m-0.safetensors",
            "cameras": "set/transforms_train.json",
            "views": 3,
            "resolution": 20,
            "box": CUBE,
            "refine": ["sensitivity", "ray-count"],
            "pooling": "auto",
            "seed": 3,
            "covariance": "block",
            "lambda_": 0.01,
            "tolerance": 0.1,
        },
    ),
    "a shard": ("m-0.safetensors --shard 1/2", {"nerf": "m-0.safetensors", "shard": "1/2"}),
    "error bars": ("m-0.safetensors --error-bars 3", {"nerf": "m-0.safetensors", "error_bars": 3}),
    "a dense grid": (
        "scene:courtyard --grid dense --fov 50 --resolution 24x20 --cutoff 1e-5",
        {"nerf": "scene:courtyard", "grid": "dense", "fov": 50, "resolution": (24, 20), "cutoff": 1e-5},
    ),
    "all of space": (
        "scene:courtyard --resolution 24 --contract linf:0,0,0,0.8 --scale data --noise 0.1",
        {
            "nerf": "scene:courtyard",
            "resolution": 24,
            "contract": ("linf", 0, 0, 0, 0.8),
            "scale": "data",
            "noise": 0.1,
        },
    ),
}


def comparable(report: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in report.items() if key not in OWN}


@pytest.mark.parametrize("name", RUNS)
def test_runs_are_the_same(name, desk, monkeypatch):
    monkeypatch.chdir(desk)
    options, arguments = RUNS[name]
    expected = json.loads(octobayes(f"uncertainty {options} {SMALL} -o theirs.oct --json"))
    predicted = json.loads(octobayes(f"uncertainty {options} {SMALL} --dry-run --json"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        field = ob.uncertainty(**arguments, **SMALL_RUN)
        needs = ob.forecast(**arguments, **SMALL_RUN)
    field.save("ours.oct")
    assert Path("ours.oct").read_bytes() == Path("theirs.oct").read_bytes()
    assert comparable(field.report) == comparable(expected)
    assert comparable(needs) == comparable(predicted)
    # A file knows all of this but what was measured beside the rays.
    known = ob.load("ours.oct").report
    assert {**known, "errors": None} == {key: expected[key] for key in known} | {"errors": None}


def test_accumulated_samples_are_the_same(desk, monkeypatch):
    monkeypatch.chdir(desk)
    octobayes(f"uncertainty m-0.safetensors {SMALL} -o theirs.oct --dump-samples theirs.npz")
    ob.uncertainty("m-0.safetensors", dump_samples="ours.npz", **SMALL_RUN)
    assert Path("ours.npz").read_bytes() == Path("theirs.npz").read_bytes()
    options = "--box=-1,-1,-1,1,1,1 --level 5 --scale data --noise 0.05"
    expected = json.loads(octobayes(f"uncertainty theirs.npz {options} -o theirs.oct --json"))
    field = ob.accumulate(
        "theirs.npz", box=[[-1] * 3, [1] * 3], level=5, scale="data", noise=0.05, training_pixels=3456, progress=False
    )
    field.save("ours.oct")
    assert Path("ours.oct").read_bytes() == Path("theirs.oct").read_bytes()
    assert comparable(field.report) == comparable(expected)


def test_remarks_are_the_same_in_the_words_of_either(desk, monkeypatch, caplog):
    monkeypatch.chdir(desk)
    words = "uncertainty scene:courtyard --resolution 24 --scale data --noise 0.1 --level 5 --rays 1024 --occupancy 32"
    program = os.environ["OCTOBAYES"]
    done = subprocess.run([program, *words.split(), "-o", "x.oct"], check=True, stderr=subprocess.PIPE, text=True)
    theirs = [line for line in done.stderr.splitlines() if not line.startswith("note: 40 cameras")]
    run = {"level": 5, "rays": 1024, "occupancy": 32, "resolution": 24, "progress": False}
    with caplog.at_level("INFO", logger="octobayes"), pytest.warns(RuntimeWarning) as caught:
        ob.uncertainty("scene:courtyard", scale="data", noise=0.1, **run)
    ours = [f"warning: {warning.message}" for warning in caught]
    ours += [f"note: {record.getMessage()}" for record in caplog.records if record.name == "octobayes"]
    arguments = {"--scale data": "scale='data'", "--pooling auto": "pooling='auto'", "--rays": "rays="}
    for option, argument in arguments.items():
        theirs = [line.replace(option, argument) for line in theirs]
    assert sorted(ours) == sorted(theirs) and len(ours) == 2
    with pytest.raises(ValueError, match="^noise: expected scale='data' beside it, found scale='paper'"):
        ob.uncertainty("scene:courtyard", noise=0.1, **run)


def test_evaluations_are_the_same(desk, monkeypatch):
    monkeypatch.chdir(desk)
    maps = {"depth": "set/depth", "depth_pattern": "{}.png", "depth_encoding": (0, 6.5535)}
    members = ["m-0.safetensors", "m-1.safetensors"]
    for field, more, arguments, parts in (
        (
            "paper",
            f"--cameras set/transforms_test.json {MAPS} --training-depth set/depth --ensemble {' '.join(members)} "
            "--clean-up sheet.png --ray-average u-spread,weighted-mean",
            {
                **maps,
                "training_depth": "set/depth",
                "ensemble": members,
                "clean_up": True,
                "ray_average": ["u-spread", "weighted-mean"],
            },
            ["readings", "baselines", "never_seen", "ensemble", "clean_up"],
        ),
        (
            "metric",
            f"--cameras set {MAPS} --covariance block",
            {"cameras": "set", **maps, "covariance": "block"},
            ["readings", "baselines", "depth_readings"],
        ),
        ("metric", "--cameras set --clean-up sheet.png", {"cameras": "set", "clean_up": True}, ["clean_up"]),
    ):
        expected = json.loads(octobayes(f"evaluate m-0.safetensors {field}.oct {more} --json"))
        assert judged(field, **arguments) == expected
        assert all(expected[part] for part in parts), parts


def test_calibrated_fields_are_the_same(desk, monkeypatch):
    monkeypatch.chdir(desk)
    command = f"evaluate m-0.safetensors metric.oct --cameras set {MAPS} --covariance block"
    expected = json.loads(octobayes(f"{command} --calibrate theirs.oct --probability 0.8 --json"))
    maps = {"depth": "set/depth", "depth_pattern": "{}.png", "depth_encoding": (0, 6.5535)}
    field, found = ob.calibrate(
        "m-0.safetensors", "metric.oct", "set", covariance="block", probability=0.8, stride=1, progress=False, **maps
    )
    assert found["calibrated"] == expected["calibrated"]
    field.save("ours.oct")
    assert Path("ours.oct").read_bytes() == Path("theirs.oct").read_bytes()


def test_depths_are_confirmed_by_the_cameras_that_a_model_stores(desk, monkeypatch):
    monkeypatch.chdir(desk)
    maps = {"depth": "set/depth", "depth_pattern": "{}.png", "depth_encoding": (0, 6.5535)}
    report = judged("metric", **maps, covariance="block", stride=1)
    deviation = next(entry for entry in report["readings"] if entry["name"] == "metric block, depth deviation")
    counted = deviation["confirmed"]["share"] * report["pixels"]
    test = "set/transforms_test.json"
    views = [ob.render("m-0.safetensors", None, test, frame=k, confirm=True, progress=False) for k in range(2)]
    confirmed = sum(int(view["depth_confirmed"].sum()) for view in views)
    assert all(view["depth_confirmed"].dtype == bool for view in views)
    # The evaluation leaves pixels without a true depth out, and no others.
    assert 0 < counted <= confirmed <= sum(int((view["opacity"] > 0).sum()) for view in views)
    assert "depth_confirmed" not in ob.render("m-0.safetensors", "metric.oct", test, depth_error=True, progress=False)
    with pytest.raises(ValueError, match="^confirm: expected a model that stores its training cameras, found one that"):
        ob.render("scene:courtyard", None, test, confirm=True, progress=False)


def test_what_is_no_ensemble_is_refused(courtyard, field, tmp_path):
    for members in (["scene:courtyard"], ["scene:courtyard", lambda x, d: (x, d)]):
        with pytest.raises(ValueError, match="ensemble: expected two or more models, or files of models, found "):
            ob.evaluate(courtyard, field, tmp_path / "none.json", ensemble=members, progress=False)
