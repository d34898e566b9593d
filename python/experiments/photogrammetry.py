"""What photogrammetry says of its own points, beside `octobayes depth`. Writes photogrammetry.md beside itself.

    pip install pycolmap
    OCTOBAYES_DATA=... python experiments/photogrammetry.py WORK [--scenes kitchen,spot] [--steps 3000]

Both get the same photographs with their poses: photographs of a kitchen with registered depth of a sensor, ray-traced
meshes, and lego. COLMAP (pycolmap) matches SIFT features of 40 images and triangulates their tracks with fixed poses.
σ of a point along the ray of an image that shows it is √(dᵀ C d), C = v (Σ JᵀJ)⁻¹, with J the derivatives of its
projections (pixels) and v the variance of all reprojection errors, by their degrees of freedom. A hash grid of
`octobayes train` is fitted to the same images, and `ob.depth` looks through their cameras.

WORK keeps what is done; a run that was interrupted goes on from there.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from PIL import Image

import octobayes as ob

HERE = Path(__file__).parent
#: Photographs of a scene.
COUNT = 40
#: Every so many pixels of a photograph are looked at along x and y.
STRIDE = 2
#: Nominal coverage, and the deviations of a normal error that have it.
NOMINAL = (50, 68, 90, 95)
WITHIN = (0.67449, 0.99446, 1.64485, 1.95996)
MESHES = {"spot": "y", "stanford-bunny": "y", "armadillo": "y", "nefertiti": "z"}
#: Focal lengths of the kitchen's cameras, pixels of 640 x 480, and from the depth camera to that of colour, metres.
COLOR_FOCAL, DEPTH_FOCAL = 525.0, 585.0
REGISTRATION = np.array(
    [
        [0.99996518, 0.00267651, -0.00790410, -0.02555894],
        [-0.00274093, 0.99996303, -0.00815045, 0.00010110],
        [0.00788199, 0.00817183, 0.99993555, 0.00203183],
    ]
)
#: Readings of one pixel of the kitchen that differ by more, metres, straddle an edge.
EDGE = 0.05


class Scene:
    """Photographs with poses, in a folder with a transforms.json; the true distance at each pixel, NaN if unknown."""

    def __init__(
        self, name: str, folder: Path, box: str | None, truth: list[np.ndarray], rounding: float = 0.0
    ) -> None:
        self.name, self.folder, self.box, self.truth = name, folder, box, truth
        #: The deviation of the truth: that of a step of its maps.
        self.rounding = rounding
        file = json.loads((folder / "transforms.json").read_text())
        self.frames = file["frames"]
        with Image.open(folder / self.frames[0]["file_path"]) as image:
            self.width, self.height = image.size
        angle = file.get("camera_angle_x")
        self.focal = file["fl_x"] if angle is None else 0.5 * self.width / np.tan(0.5 * angle)

    def pose(self, i: int) -> np.ndarray:
        """World to camera, OpenCV axes, [3, 4]."""
        pose = np.array(self.frames[i]["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        return np.linalg.inv(pose)[:3]

    def true(self, i: int, at: np.ndarray) -> np.ndarray:
        """True distances at image points [n, 2]: of the pixel that each lies in."""
        known = self.truth[i]
        scale = known.shape[1] / self.width
        x, y = np.clip((at * scale).astype(int), 0, [known.shape[1] - 1, known.shape[0] - 1]).T
        return known[y, x]


def write_transforms(folder: Path, focal: float, frames: list[dict[str, Any]]) -> None:
    (folder / "transforms.json").write_text(json.dumps({"fl_x": focal, "fl_y": focal, "frames": frames}))


def rays(width: int, height: int, focal: float) -> np.ndarray:
    """The lengths of [x, y, 1] at the middles of all pixels."""
    x = (np.arange(width) + 0.5 - width / 2) / focal
    y = (np.arange(height) + 0.5 - height / 2) / focal
    return np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2)


def kitchen(data: Path, work: Path) -> Scene:
    source, folder = data / "rgbd-7scenes-kitchen", work / "kitchen"
    folder.mkdir(exist_ok=True)
    frames, truth, points = [], [], []
    for file in sorted(source.glob("*.color.jpg")):
        pose = np.loadtxt(str(file).replace("color.jpg", "pose.txt"))
        shutil.copy(file, folder / file.name)
        frames.append({"file_path": file.name, "transform_matrix": (pose @ np.diag([1, -1, -1, 1])).tolist()})
        known = registered(np.array(Image.open(str(file).replace("color.jpg", "depth.png"))))
        truth.append(known * rays(320, 240, COLOR_FOCAL / 2))
        v, u = np.nonzero(known == known)
        seen = np.stack([(u + 0.5 - 160) / (COLOR_FOCAL / 2), (v + 0.5 - 120) / (COLOR_FOCAL / 2), np.ones(len(u))], 1)
        points.append((seen * known[v, u, None]) @ pose[:3, :3].T + pose[:3, 3])
    write_transforms(folder, COLOR_FOCAL, frames)
    low, high = np.percentile(np.concatenate(points), [0.5, 99.5], axis=0)
    box = ",".join(f"{v:.3f}" for v in [*(low - 0.2), *(high + 0.2)])
    return Scene("kitchen", folder, box, truth)


def registered(depth: np.ndarray) -> np.ndarray:
    """Depth along the axis of the colour camera at half its size, metres, NaN where readings are few or differ."""
    v, u = np.nonzero((depth > 0) & (depth < 65535))
    z = depth[v, u] / 1000
    seen = np.stack([(u + 0.5 - 320) / DEPTH_FOCAL * z, (v + 0.5 - 240) / DEPTH_FOCAL * z, z])
    x, y, z = REGISTRATION[:, :3] @ seen + REGISTRATION[:, 3:]
    column = np.floor(0.5 * COLOR_FOCAL * x / z + 160).astype(int)
    row = np.floor(0.5 * COLOR_FOCAL * y / z + 120).astype(int)
    inside = (column >= 0) & (column < 320) & (row >= 0) & (row < 240)
    pixel, z = (row * 320 + column)[inside], z[inside]
    order = np.lexsort((z, pixel))
    pixel, z = pixel[order], z[order]
    first = np.flatnonzero(np.r_[True, pixel[1:] != pixel[:-1]])
    count = np.diff(np.r_[first, len(pixel)])
    is_sound = (count >= 3) & (z[first + count - 1] - z[first] <= EDGE)
    out = np.full(320 * 240, np.nan)
    out[pixel[first][is_sound]] = z[first + count // 2][is_sound]
    return out.reshape(240, 320)


def mesh(data: Path, work: Path, name: str, program: str) -> Scene:
    folder = work / name
    if not (folder / "transforms.json").exists():
        shutil.rmtree(folder, ignore_errors=True)
        command = [program, "synth", data / "meshes" / f"{name}.obj", "-o", folder, "--up", MESHES[name]]
        subprocess.run([*command, "--count", str(COUNT), "--test-count", "1", "--resolution", "400"], check=True)
        shutil.copy(folder / "transforms_train.json", folder / "transforms.json")
    file = json.loads((folder / "transforms.json").read_text())
    truth = []
    for frame in file["frames"]:
        # The map is linear from 0 to 6.5535; only the object counts, as the disc that it stands on is easy.
        stem = Path(frame["file_path"]).stem
        known = np.array(Image.open(folder / "depth" / f"{stem}.png")) * 1e-4
        is_object = np.array(Image.open(folder / frame["object_mask_path"]).convert("L")) > 0
        truth.append(np.where((known > 0) & is_object, known, np.nan))
    return Scene(name, folder, None, truth)


def lego(data: Path, work: Path) -> Scene:
    source, folder = data / "nerf-lego-400", work / "lego"
    folder.mkdir(exist_ok=True)
    file = json.loads((source / "transforms_test.json").read_text())
    frames, truth = [], []
    for frame in file["frames"][:COUNT]:
        stem = Path(frame["file_path"]).name
        shutil.copy(source / "test" / f"{stem}.png", folder / f"{stem}.png")
        frames.append({"file_path": f"{stem}.png", "transform_matrix": frame["transform_matrix"]})
        known = 8 - 8 * np.array(Image.open(source / "test" / f"{stem}_depth_0001.png"))[..., 0].astype(float) / 255
        # Maps were made smaller: pixels at silhouettes mix object and background.
        is_opaque = np.array(Image.open(folder / f"{stem}.png").convert("RGBA"))[..., 3] == 255
        truth.append(np.where((known < 7.9) & is_opaque, known, np.nan))
    width = truth[0].shape[1]
    write_transforms(folder, 0.5 * width / np.tan(0.5 * file["camera_angle_x"]), frames)
    return Scene("lego", folder, None, truth, rounding=8 / 255 / np.sqrt(12))


def triangulated(scene: Scene, work: Path) -> dict[str, np.ndarray]:
    """COLMAP's observations: error, σ along the ray, track length and distance of each."""
    work.mkdir(exist_ok=True)
    images, database = work / "images", work / "database.db"
    if not images.exists():
        images.mkdir()
        for frame in scene.frames:
            with Image.open(scene.folder / frame["file_path"]) as image:
                image = image.convert("RGBA")
                over = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
                over.convert("RGB").save(images / f"{Path(frame['file_path']).stem}.png")
    database.unlink(missing_ok=True)
    options = pycolmap.ImageReaderOptions()
    options.camera_model = "PINHOLE"
    options.camera_params = f"{scene.focal},{scene.focal},{scene.width / 2},{scene.height / 2}"
    pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=options)
    pycolmap.match_exhaustive(database)
    posed, stems = work / "posed", {Path(f["file_path"]).stem: i for i, f in enumerate(scene.frames)}
    shutil.rmtree(posed, ignore_errors=True)
    posed.mkdir()
    with pycolmap.Database.open(database) as opened:
        listed = [(image.image_id, image.name) for image in opened.read_all_images()]
        camera = opened.read_all_cameras()[0].camera_id
    lines = []
    for number, name in listed:
        pose = scene.pose(stems[Path(name).stem])
        x, y, z, w = pycolmap.Rotation3d(pose[:, :3]).quat
        lines.append(f"{number} {w} {x} {y} {z} {' '.join(map(str, pose[:, 3]))} {camera} {name}\n\n")
    (posed / "images.txt").write_text("".join(lines))
    (posed / "cameras.txt").write_text(
        f"{camera} PINHOLE {scene.width} {scene.height} {options.camera_params.replace(',', ' ')}\n"
    )
    (posed / "points3D.txt").write_text("")
    reconstruction = pycolmap.Reconstruction()
    reconstruction.read_text(posed)
    found = pycolmap.triangulate_points(reconstruction, database, images, work)
    return observations(scene, found, stems)


def observations(scene: Scene, found: Any, stems: dict[str, int]) -> dict[str, np.ndarray]:
    poses = {number: scene.pose(stems[Path(image.name).stem]) for number, image in found.images.items()}
    rows, squares, freedom = [], 0.0, 0
    for point in found.points3D.values():
        information, seen = np.zeros((3, 3)), []
        for element in point.track.elements:
            pose = poses[element.image_id]
            at = found.images[element.image_id].points2D[element.point2D_idx].xy
            x = pose[:, :3] @ point.xyz + pose[:, 3]
            jacobian = scene.focal / x[2] * np.array([[1, 0, -x[0] / x[2]], [0, 1, -x[1] / x[2]]]) @ pose[:, :3]
            residual = scene.focal * x[:2] / x[2] + [scene.width / 2, scene.height / 2] - at
            information += jacobian.T @ jacobian
            squares += residual @ residual
            freedom += 2
            camera = stems[Path(found.images[element.image_id].name).stem]
            seen.append((camera, at, np.linalg.norm(x), pose[:, :3].T @ x))
        freedom -= 3
        covariance = np.linalg.inv(information)
        for camera, at, distance, ray in seen:
            along = ray / distance
            true = scene.true(camera, at[None])[0]
            deviation = np.sqrt(along @ covariance @ along)
            rows.append((camera, *at, distance, true, deviation, len(seen)))
    camera, u, v, distance, true, deviation, track = np.array(rows).T
    sigma = deviation * np.sqrt(squares / freedom)
    columns = {"camera": camera, "u": u, "v": v, "distance": distance, "true": true, "sigma": sigma, "track": track}
    known = np.isfinite(true)
    return {name: column[known] for name, column in columns.items()}


def rendered(scene: Scene, work: Path, program: str, steps: int) -> dict[str, dict[int, np.ndarray]]:
    """What `ob.depth` sees, with photographs and from the field alone, by the numbers of the scene's frames: those that
    `train` did not hold out."""
    model = work / f"{scene.name}.safetensors"
    if not model.exists():
        box = [] if scene.box is None else [f"--box={scene.box}"]
        subprocess.run([program, "train", scene.folder, "-o", model, "--steps", str(steps), *box], check=True)
    cameras = str(scene.folder / "transforms.json")
    field = work / f"{scene.name}.oct"
    if not field.exists():
        ob.uncertainty(str(model), cameras, for_="depth", rays=500_000, gradient="auto", progress=False).save(field)
    views = ob.depth(str(model), cameras, str(field), stride=STRIDE, progress=False)
    alone = ob.depth(str(model), cameras, str(field), images=False, stride=STRIDE, progress=False)
    numbers = {frame["file_path"]: i for i, frame in enumerate(scene.frames)}
    found = {"depth": (views, "depth"), "trust": (views, "trust")}
    found |= {"with photographs": (views, "sigma"), "field alone": (alone, "sigma")}
    return {key: {numbers[view["name"]]: view[name] for view in of} for key, (of, name) in found.items()}


def curve(order: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Mean error left when shares of 0, 1, ... 99 % that are largest by `order` are removed."""
    left = np.cumsum(error[np.argsort(order, kind="stable")])
    count = ((1 - np.arange(100) / 100) * len(error)).astype(int).clip(1)
    return left[count - 1] / count


def areas(order: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """AUSE of the mean absolute error: over the common maximum of both curves, and over their start."""
    own, best = curve(order, error), curve(error, error)
    area = np.trapezoid(own - best, dx=0.01)
    return area / max(own.max(), best.max()), area / best[0]


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    rank = [np.argsort(np.argsort(v, kind="stable")) for v in (a, b)]
    return float(np.corrcoef(*rank)[0, 1])


def row(
    name: str,
    order: np.ndarray,
    off: np.ndarray,
    share: float,
    sigma: np.ndarray | None = None,
    rounding: float = 0.0,
) -> dict[str, Any]:
    """`off`: by how much depths are too large, with the rounding of the truth, which is counted beside `sigma`."""
    error = np.abs(off)
    common, start = areas(order, error)
    found = {"name": name, "share": share, "pixels": len(error), "error": float(np.median(error))}
    found["too large"] = float(np.median(off))
    found |= {"ause": common, "start": start, "rho": correlation(order, error)}
    if sigma is not None:
        found["held"] = [float((error <= w * np.hypot(sigma, rounding)).mean()) for w in WITHIN]
        found["width"] = float(np.median(2 * WITHIN[2] * sigma))
    return found


def judged(scene: Scene, work: Path, program: str, steps: int) -> list[dict[str, Any]]:
    colmap = triangulated(scene, work / f"{scene.name}-colmap")
    seen = rendered(scene, work, program, steps)
    # Both are judged on the same images.
    is_seen = np.isin(colmap["camera"], list(seen["depth"]))
    colmap = {name: column[is_seen] for name, column in colmap.items()}
    error = colmap["distance"] - colmap["true"]
    pixels = sum(np.isfinite(scene.true(i, middles(depth))).sum() for i, depth in seen["depth"].items())
    # A pixel of the photograph is answered if a point lies in it.
    answered = np.unique(np.stack([colmap["camera"], colmap["u"] // 1, colmap["v"] // 1]), axis=1).shape[1]
    share = answered / (pixels * STRIDE**2)
    rows = [
        row("COLMAP: σ", colmap["sigma"], error, share, colmap["sigma"], scene.rounding),
        row("COLMAP: track length", -colmap["track"], error, share),
        row("COLMAP: distance", colmap["distance"], error, share),
        row("COLMAP: random", np.random.default_rng(0).random(len(error)), error, share),
    ]
    places, whole = [], []
    for i, depth in seen["depth"].items():
        chosen = colmap["camera"] == i
        x, y = (np.round((colmap[axis][chosen] - 0.5) / STRIDE).astype(int) for axis in "uv")
        at = np.clip(y, 0, depth.shape[0] - 1) * depth.shape[1] + np.clip(x, 0, depth.shape[1] - 1)
        places.append((i, at, colmap["true"][chosen]))
        true = scene.true(i, middles(depth))
        at = np.flatnonzero(np.isfinite(true) & (seen["trust"][i].ravel() == 255))
        whole.append((i, at, true[at]))
    for where, chosen, answered in (("the same pixels", places, share), ("trusted pixels", whole, None)):
        for kind in ("with photographs", "field alone"):
            take = [[seen[name][i].ravel()[at] for i, at, _ in chosen] for name in ("depth", kind)]
            depth, sigma = (np.concatenate(values) for values in take)
            true = np.concatenate([true for _, _, true in chosen])
            known = np.isfinite(depth) & np.isfinite(sigma)
            of_all = known.sum() / pixels if answered is None else answered * known.mean()
            wrong = (depth - true)[known]
            rows.append(row(f"σ, {kind}, {where}", sigma[known], wrong, of_all, sigma[known], scene.rounding))
        rows.append(row(f"distance, {where}", depth[known], wrong, of_all))
    return rows


def middles(depth: np.ndarray) -> np.ndarray:
    """Middles of the photograph's pixels that a map has, image points."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]] * STRIDE + 0.5
    return np.stack([u.ravel(), v.ravel()], 1)


def written(found: dict[str, Any]) -> list[str]:
    """A row as text."""
    held = [f"{100 * share:.1f}" for share in found["held"]] if "held" in found else [""] * len(NOMINAL)
    numbers = [f"{found[name]:.3f}" for name in ("ause", "start", "rho")]
    lengths = [f"{found[name]:.4f}" for name in ("error", "too large")]
    width = f"{found['width']:.4f}" if "width" in found else ""
    return [found["name"], str(found["pixels"]), f"{100 * found['share']:.2g}", *lengths, *numbers, *held, width]


def main_table(results: dict[str, list[dict[str, Any]]]) -> str:
    """Per scene: COLMAP at its points, ours there, and ours wherever a depth is trusted."""
    head = ["scene", "whose depths", "% answered", "median error", "too large by", "90 % holds", "AUSE", "by the start"]
    lines = [head, ["---"] * len(head)]
    names = {
        "COLMAP: σ": "COLMAP",
        "σ, with photographs, the same pixels": "`depth`, the same pixels",
        "σ, with photographs, trusted pixels": "`depth`, trusted pixels",
    }
    for scene, rows in results.items():
        for found in rows:
            if found["name"] in names:
                _, _, share, error, off, ause, start, _, _, _, ninety, _, _ = written(found)
                lines.append([scene, names[found["name"]], share, error, off, ninety, ause, start])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def write_all(path: Path, results: dict[str, list[dict[str, Any]]]) -> None:
    """All rows, as CSV."""
    head = ["scene", "order", "pixels", "answered_%", "median_error", "median_too_large", "ause_common", "ause_start"]
    head += ["rank_correlation", *(f"{p}_%_holds" for p in NOMINAL), "median_width_of_90_%"]
    with path.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(head)
        rows.writerows([scene, *written(found)] for scene, all_rows in results.items() for found in all_rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--scenes", default=",".join(["kitchen", *MESHES, "lego"]))
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--octobayes", default="octobayes", help="the program")
    given = parser.parse_args()
    data, work = Path(os.environ["OCTOBAYES_DATA"]), given.work
    work.mkdir(parents=True, exist_ok=True)
    results = {}
    for name in given.scenes.split(","):
        kept, start = work / f"{name}.json", time.perf_counter()
        if not kept.exists():
            make = {"kitchen": kitchen, "lego": lego}.get(name)
            scene = make(data, work) if make else mesh(data, work, name, given.octobayes)
            kept.write_text(json.dumps(judged(scene, work, given.octobayes, given.steps)))
            print(f"{name}: {time.perf_counter() - start:.0f} s")
        results[name] = json.loads(kept.read_text())
    report = HERE / "photogrammetry.md"
    text = report.read_text() if report.exists() else "<!-- begin generated -->\n<!-- end generated -->\n"
    before, rest = text.split("<!-- begin generated -->")
    after = rest.split("<!-- end generated -->")[1]
    stamp = f"*octobayes {ob.__version__}, pycolmap {pycolmap.__version__}, {platform.machine()}, "
    stamp += f"{time.strftime('%Y-%m-%d')}; {COUNT} images, {given.steps} steps of training, seed 0.*"
    block = f"<!-- begin generated -->\n{stamp}\n\n{main_table(results)}\n<!-- end generated -->"
    report.write_text(before + block + after)
    write_all(HERE / "photogrammetry.csv", results)


if __name__ == "__main__":
    main()
