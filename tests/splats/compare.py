"""compare.py OCTOBAYES SPLAT_TRANSFORM FILES: compares how both programs read files of Gaussian splats.

splat-transform converts each file to a plain .ply file. `octobayes info --json` describes both files, and the quantiles
must agree: of means, scales and opacities.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROWS = ["largest_scales", "smallest_scales", "opacities"]
# Relative difference of an f32 that was decoded in other steps, and the opacity that stands for 1.
RELATIVE, OPAQUE = 1e-5, 2e-6
# splat-transform reads no .spz file of version 2 without gzip.
UNREAD = {"minimal-raw.spz"}


def info(program: str, path: Path) -> dict:
    run = subprocess.run([program, "info", path, "--json"], capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"{path}: {run.stderr}")
    return json.loads(run.stdout)


def differences(ours: dict, theirs: dict) -> list[str]:
    found = [key for key in ["count", "degree"] if ours[key] != theirs[key]]
    rows = {key: (ours[key], theirs[key]) for key in ROWS}
    rows |= {axis: (ours["means"][k], theirs["means"][k]) for k, axis in enumerate("xyz")}
    for name, (own, other) in rows.items():
        extent = max(abs(value) for value in own)
        limit = OPAQUE if name == "opacities" else RELATIVE * extent
        if any(abs(a - b) > limit for a, b in zip(own, other, strict=True)):
            found.append(f"{name}: {own} {other}")
    return found


def main() -> None:
    program, converter, *names = sys.argv[1:]
    failed, compared = False, 0
    with tempfile.TemporaryDirectory() as folder:
        for path in map(Path, names):
            if path.name in UNREAD:
                continue
            made = Path(folder) / f"{path.name}.ply"
            subprocess.run(["node", converter, path, made], check=True, capture_output=True)
            found = differences(info(program, path), info(program, made))
            compared += 1
            failed |= bool(found)
            print(f"{path.name}: {'; '.join(found) or 'equal'}")
    if failed or compared == 0:
        sys.exit(f"{compared} files compared, some differ" if failed else "no files")


main()
