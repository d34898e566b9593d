"""columns.py OCTOBAYES SPLAT_TRANSFORM MODEL.ply CAMERAS.json: other programs read what `export` writes beside splats.

plyfile opens the written file and finds all properties in their order. `splat-transform -V log10_uncertainty,lt,X`
keeps exactly the splats below X.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from plyfile import PlyData
from tools import run

COLUMNS = ["uncertainty", "log10_uncertainty", "seen", "weight", "views", "front_share"]


def vertices(path: Path) -> PlyData:
    return PlyData.read(path)["vertex"]


def main() -> None:
    program, converter, model, cameras = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        field, written, kept = (Path(folder) / name for name in ["f.oct", "u.ply", "kept.ply"])
        run(program, "uncertainty", model, "--cameras", cameras, "--level", "5", "--rays", "50000", "-o", field)
        run(program, "export", model, field, "--cameras", cameras, "-o", written)
        before, after = vertices(Path(model)), vertices(written)
        names = [p.name for p in before.properties]
        assert [p.name for p in after.properties] == names + COLUMNS, after.properties
        # Quaternions are written with length 1.
        length = np.sqrt(sum(before[f"rot_{k}"].astype(float) ** 2 for k in range(4)))
        for name in names:
            is_rotation = name.startswith("rot_")
            expected = before[name] / length if is_rotation else before[name]
            assert np.allclose(expected, after[name], rtol=0, atol=3e-7 * is_rotation), f"{name} has changed"
        log10 = after["log10_uncertainty"]
        assert np.allclose(np.log10(after["uncertainty"]), log10, atol=1e-5)
        assert (after["weight"] >= 0).all() and after["views"].max() > 1
        assert ((after["front_share"] >= 0) & (after["front_share"] <= 1)).all() and after["front_share"].max() > 0.5
        # Between two values, so that no rounding decides.
        low, high = np.sort(log10)[[len(log10) // 2, len(log10) // 2 + 1]]
        threshold = 0.5 * (float(low) + float(high))
        run("node", converter, written, "-V", f"log10_uncertainty,lt,{threshold!r}", kept)
        found, expected = vertices(kept), log10 < threshold
        assert 0 < expected.sum() < len(log10)
        # splat-transform may write splats in another order.
        places = [np.stack([of[axis] for axis in "xyz"] + [of["log10_uncertainty"]], axis=1) for of in (after, found)]
        wanted, got = (rows[np.lexsort(rows.T)] for rows in (places[0][expected], places[1]))
        assert wanted.shape == got.shape and (wanted == got).all(), f"{wanted.shape} expected, {got.shape} kept"
        print(f"{Path(model).name}: plyfile reads {len(after.properties)} properties; {len(got)} of {len(log10)} kept")


main()
