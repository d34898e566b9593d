"""What several tests share: a small scene in closed form, in NumPy and by name, and its cameras."""

from __future__ import annotations

import os
import struct
import zlib
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


def png(path: Path, pixels: np.ndarray) -> None:
    """Writes RGBA of 8 bits, or grey of 16."""
    height, width = pixels.shape[:2]
    depth, kind = (8, 6) if pixels.ndim == 3 else (16, 0)
    rows = pixels.astype(np.uint8 if pixels.ndim == 3 else ">u2").reshape(height, -1)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    )


def exr(path: Path, depth: np.ndarray) -> None:
    """Writes float32 ``[H, W]`` as the channel Z of an OpenEXR image, not compressed."""
    height, width = depth.shape

    def attribute(name: str, kind: str, content: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(content)) + content

    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"".join(
        [
            struct.pack("<II", 20000630, 2),
            attribute("channels", "chlist", b"Z\0" + struct.pack("<iB3xii", 2, 0, 1, 1) + b"\0"),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
            b"\0",
        ]
    )
    lines = [struct.pack("<ii", y, 4 * width) + row.astype("<f4").tobytes() for y, row in enumerate(depth)]
    first = len(head) + 8 * height
    offsets = b"".join(struct.pack("<Q", first + y * (8 + 4 * width)) for y in range(height))
    path.write_bytes(head + offsets + b"".join(lines))
