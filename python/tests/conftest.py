"""What several tests share: a small scene in closed form, in NumPy and by name, and its cameras."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import octobayes as ob

#: Settings of a run that takes a second.
SMALL = {"level": 6, "rays": 16_384, "occupancy": 48, "progress": False}


@pytest.fixture(scope="session")
def courtyard() -> ob.Model:
    return ob.open_model("scene:courtyard")


@pytest.fixture(scope="session")
def cameras(courtyard: ob.Model) -> list[dict]:
    return courtyard.cameras(resolution=(48, 48))


@pytest.fixture(scope="session")
def field(courtyard: ob.Model, cameras: list[dict]) -> ob.Uncertainty:
    return ob.uncertainty(courtyard, cameras, keep_sums=True, **SMALL)


@pytest.fixture(scope="session")
def points() -> np.ndarray:
    return np.random.default_rng(3).uniform(-1, 1, (1000, 3)).astype(np.float32)


@pytest.fixture(scope="session")
def data() -> Path:
    folder = os.environ.get("OCTOBAYES_DATA")
    if folder is None:
        pytest.skip("real data: OCTOBAYES_DATA is not set")
    return Path(folder)


def in_python(model: ob.Model, *names: str):
    """The model as a callable in Python, with these of its attributes and no more."""

    class InPython:
        calls: list[int] = []

        def __call__(self, x, d):
            self.calls.append(len(x))
            return model(x, d)

    callable_ = InPython()
    callable_.calls = []
    for name in names:
        setattr(callable_, name, getattr(model, name))
    return callable_
