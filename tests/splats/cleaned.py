"""cleaned.py OCTOBAYES SPLAT_TRANSFORM MODEL.ply CAMERAS.json: splat-transform reads what `clean` writes.

The same model is cleaned into every format. splat-transform makes a `.ply` of each, whose splats must be those of the
`.ply` that `clean` writes, within the steps of the format.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from plyfile import PlyData
from tools import run

NAMES = ("means", "scales", "opacities", "colors")


def halves_of_steps(extension: str, of: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest differences of positions (scene units), logarithms of scales, opacities and colours 0 to 1."""
    if extension == ".spz":
        halves = (0.5 / 4096, 0.5 / 16, 0.5 / 255, 0.5 / 255 / 0.15 * 0.2821)
    elif extension == ".splat":
        halves = (0.0, 0.0, 0.5 / 255, 0.5 / 255)
    else:
        # No chunk has a wider range than all splats together.
        width = {name: np.ptp(of[name], axis=0).max() for name in NAMES}
        halves = (0.5 * width["means"] / 1023, 0.5 * width["scales"] / 1023, 0.5 / 255, 0.5 * width["colors"] / 255)
    return dict(zip(NAMES, halves))


def read(path: Path) -> dict[str, np.ndarray]:
    vertex = PlyData.read(path)["vertex"]
    columns = lambda *names: np.stack([vertex[name].astype(float) for name in names], axis=1)
    return {
        "means": columns("x", "y", "z"),
        "scales": columns("scale_0", "scale_1", "scale_2"),
        "opacities": 1 / (1 + np.exp(-columns("opacity"))),
        "colors": 0.5 + 0.2820948 * columns("f_dc_0", "f_dc_1", "f_dc_2"),
    }


def partners(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> np.ndarray:
    """For each splat of ``a`` the nearest of ``b`` in place, size and colour."""
    rows = [np.concatenate([100 * of["means"], of["scales"], of["colors"]], axis=1) for of in (a, b)]
    return np.array([np.argmin(((rows[1] - row) ** 2).sum(1)) for row in rows[0]])


def main() -> None:
    program, converter, model, cameras = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        plain = place / "clean.ply"
        words = [program, "clean", model, "--cameras", cameras, "--background", "white", "-o"]
        run(*words, plain)
        expected = read(plain)
        before = len(read(Path(model))["means"])
        removed = len(read(place / "clean.removed.ply")["means"])
        assert len(expected["means"]) + removed == before and removed > 0
        for extension in (".spz", ".splat", ".compressed.ply"):
            halves = halves_of_steps(extension, expected)
            written, converted = place / f"out{extension}", place / "converted.ply"
            run(*words, written)
            run("node", converter, "-w", written, converted)
            found = read(converted)
            assert len(found["means"]) == len(expected["means"]), extension
            index = partners(expected, found)
            assert len(set(index)) == len(index), f"{extension}: every splat has a partner of its own"
            # Scales and colours have ends.
            ends = {("scales", ".spz"): (-10, 6), ("colors", ".spz"): (-0.4403, 1.4403), ("colors", ".splat"): (0, 1)}
            for name, half in halves.items():
                low, high = ends.get((name, extension), (-np.inf, np.inf))
                worst = np.abs(np.clip(expected[name], low, high) - found[name][index]).max()
                # Both programs compute in f32, of numbers below 16.
                assert worst <= half + 4e-6, f"{extension}, {name}: {worst} beyond {half}"
            print(f"{Path(model).name} -> {extension}: {len(index)} splats as splat-transform reads them")


main()
