"""The binary named by OCTOBAYES at work on scenes of its own; the tests open what it wrote with other readers."""

import json
import os
import subprocess

import numpy as np
import pytest

BINARY = os.environ.get("OCTOBAYES", "octobayes")


class Desk:
    """A folder with fields, and the binary at work in it."""

    def __init__(self, folder):
        self.folder = folder

    def path(self, name):
        return str(self.folder / name)

    def run(self, line):
        done = subprocess.run([BINARY, *line.split()], cwd=self.folder, capture_output=True, text=True)
        assert done.returncode == 0, f"{line}: {done.stderr}"
        return done.stdout

    def info(self, name):
        return json.loads(self.run(f"info {name} --json"))

    def query(self, field, points):
        """The answers of `query` at points [N, 3]: log10 U, and the columns of its CSV by name."""
        np.save(self.path("points.npy"), np.asarray(points, dtype=np.float32))
        self.run(f"query {field} points.npy -o answers.csv")
        return np.genfromtxt(self.path("answers.csv"), delimiter=",", names=True, dtype=None, encoding="utf-8")


COMMON = "--rays 20000 --resolution 48 --occupancy 48"
# Name of the field: the options of `uncertainty`.
FIELDS = {
    "octree.oct": f"scene:courtyard {COMMON} --level 6 --keep-sums",
    "dense.oct": f"scene:courtyard {COMMON} --level 4 --grid dense",
    "contracted.oct": f"scene:courtyard {COMMON} --level 6 --contract l2:0,0,0,0.6",
    "ball.oct": f"scene:ball {COMMON} --level 6 --keep-sums --scale data --noise 0.02",
}


@pytest.fixture(scope="session")
def desk(tmp_path_factory):
    desk = Desk(tmp_path_factory.mktemp("desk"))
    for name, options in FIELDS.items():
        desk.run(f"uncertainty {options} -o {name}")
    return desk
