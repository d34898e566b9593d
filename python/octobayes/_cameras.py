"""Cameras: files, arrays, dictionaries."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _octobayes
from ._arguments import array, degrees, floats, real, whole, wrong
from ._arguments import path as as_path

#: Pose (row by row), focal lengths, principal point, image size, k1, k2, k3, k4, p1, p2.
NUMBERS = 28
#: Coefficients of the lens, in this order.
LENS = ("k1", "k2", "k3", "k4", "p1", "p2")

#: Path of a camera's image, which need not exist; path of its mask, and whether that keeps what is not black; their
#: size.
Beside = tuple[Path, "tuple[Path, bool] | None", list[int]]

#: Pairs of names for one value. A camera gives it by one of them.
SYNONYMS = (("pose", "transform_matrix"), ("size", "w"), ("size", "h"), ("center", "cx"), ("center", "cy"))
SYNONYMS += (("focal", "fl_x"), ("focal", "fl_y"), ("fov", "camera_angle_x"))

#: Share by which a focal length and an angle of view may differ, both given: files round either.
AGREE = 0.01

EXPECTED = (
    "a camera file, or cameras as dictionaries: pose (4x4, camera-to-world, OpenGL axes), focal (pixels) or fov "
    "(degrees), size (width, height)"
)


def size(resolution: Any) -> tuple[int | None, int | None]:
    """Width and height of ``resolution``: a width, or both; ``None`` where it says nothing."""
    if resolution is None:
        return None, None
    if isinstance(resolution, (int, np.integer)):
        return whole("resolution", resolution, 1, 65_536), None
    try:
        width, height = resolution
    except (TypeError, ValueError) as error:
        raise wrong("resolution", "a width, or (width, height)", resolution) from error
    return whole("resolution", width, 1, 65_536), whole("resolution", height, 1, 65_536)


def one(name: str, camera: Mapping[str, Any]) -> NDArray[np.float64]:
    """The numbers of one camera."""
    known = {"pose", "transform_matrix", "focal", "fov", "center", "size", "fl_x", "fl_y", "cx", "cy", "w", "h"}
    known |= {*LENS, "camera_angle_x", "mask_path", "image_size"}
    unknown = sorted(set(camera) - known - {"file_path", "name"})
    if unknown:
        raise wrong(f"{name}['{unknown[0]}']", f"one of {', '.join(sorted(known))}", unknown[0])
    for one, other in SYNONYMS:
        if camera.get(one) is not None and camera.get(other) is not None:
            raise wrong(name, f"'{one}' or '{other}'", "both")
    pose = camera.get("pose", camera.get("transform_matrix"))
    if pose is None:
        raise wrong(name, "a camera with a pose", f"keys {sorted(camera)}")
    given = array(f"{name}['pose']", pose)
    pose = floats(f"{name}['pose']", given, (3 if given.shape[:1] == (3,) else 4, 4), np.float64)
    if len(pose) == 3:
        pose = np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])
    sides = camera.get("size", (camera.get("w"), camera.get("h")))
    if np.shape(sides) != (2,):
        raise wrong(f"{name}['size']", "width and height in pixels", sides)
    width, height = (whole(f"{name}['size']", side, 1, 65_536) for side in sides)
    fov = None
    if camera.get("fov") is not None:
        fov = degrees(f"{name}['fov']", camera["fov"])
        if fov <= math.pi:
            meant = f"{fov:g} radians would be {math.degrees(fov):.1f} degrees (camera_angle_x)"
            warnings.warn(f"{name}['fov'] is {fov:g} degrees; {meant}", stacklevel=2)
    elif camera.get("camera_angle_x") is not None:
        angle = real(f"{name}['camera_angle_x']", camera["camera_angle_x"], above=0)
        if angle >= math.pi:
            raise wrong(f"{name}['camera_angle_x']", "radians, below pi (degrees: fov)", f"{angle:g}")
        fov = math.degrees(angle)
    of_view = None if fov is None else 0.5 * width / math.tan(0.5 * math.radians(fov))
    if "focal" in camera:
        focal = np.atleast_1d(array(f"{name}['focal']", camera["focal"]))
        focal = np.broadcast_to(floats(f"{name}['focal']", focal, (2 if len(focal) == 2 else 1,), np.float64), (2,))
    elif "fl_x" in camera:
        focal = np.array([real(f"{name}['fl_x']", camera["fl_x"], above=0)] * 2)
        focal[1] = real(f"{name}['fl_y']", camera.get("fl_y", focal[0]), above=0)
    elif "fl_y" in camera:
        raise wrong(name, "'fl_x' beside 'fl_y'", f"keys {sorted(camera)}")
    elif of_view is not None:
        focal = np.full(2, of_view)
    else:
        raise wrong(name, "a camera with focal (pixels) or fov (degrees)", f"keys {sorted(camera)}")
    if of_view is not None and abs(of_view - focal[0]) > AGREE * focal[0]:
        both = f"a focal length of {focal[0]:g} pixels, and an angle of view of {fov:g} degrees, which is {of_view:g}"
        raise wrong(name, "a focal length and an angle of view that agree, or one of them", both)
    center = camera.get("center", (camera.get("cx", 0.5 * width), camera.get("cy", 0.5 * height)))
    center = floats(f"{name}['center']", center, (2,), np.float64)
    lens = [real(f"{name}['{key}']", camera.get(key, 0.0)) for key in LENS]
    return np.concatenate([pose.ravel(), focal, center, [width, height], lens])


def _split(cameras: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """One dictionary of arrays as a list: what has an entry per camera is divided, the rest is shared."""
    pose = array("cameras['pose']", cameras.get("pose", cameras.get("transform_matrix")))
    if pose.ndim != 3:
        return [cameras]
    # An array of two numbers belongs to all cameras; to each belongs what has one row per pose.
    each = {"focal": 2, "center": 2, "size": 2}

    def part(key: str, value: Any, i: int) -> Any:
        if key in ("pose", "transform_matrix"):
            return pose[i]
        given = array(f"cameras['{key}']", value)
        if key in each:
            is_each = given.ndim == 2 or (key == "focal" and given.ndim == 1 and len(given) == len(pose) != 2)
        else:
            is_each = given.ndim == 1
        if is_each and len(given) != len(pose):
            raise wrong(f"cameras['{key}']", f"one entry for each of {len(pose)} poses", str(len(given)))
        return given[i] if is_each else value

    return [{key: part(key, value, i) for key, value in cameras.items()} for i in range(len(pose))]


def selected(views: Any) -> Any:
    """Which frames of a file: None, 'all', how many, or their numbers."""
    if views is None or (isinstance(views, str) and views == "all"):
        return views
    return whole("views", views, 1) if np.ndim(views) == 0 else [whole("views", i, 0) for i in views]


@dataclass(frozen=True)
class Cameras:
    """Cameras, and what lies beside them."""

    #: float64 ``[C, 28]``.
    rows: NDArray[np.float64]
    names: list[str]
    beside: list[Beside]
    #: What they are, in words.
    source: str
    #: Whether nobody knows the size of their images.
    is_assumed: bool = False
    is_file: bool = False

    def options(self) -> dict[str, Any]:
        """What the Rust part gets of them, beside their numbers."""
        return {name: getattr(self, name) for name in ("names", "beside", "is_assumed", "is_file")}


def rows(
    cameras: Any,
    views: Any = None,
    resolution: Any = None,
    *,
    model: Any = None,
    fov: float | None = None,
    every_frame: bool = False,
) -> Cameras:
    """The training cameras, or all, of a file; cameras that are given; or, for None, those of the model."""
    width, height = size(resolution)
    is_file = isinstance(cameras, (str, os.PathLike))
    if is_file or cameras is None:
        options = {
            "views": selected(views),
            "width": width,
            "height": height,
            "fov": None if fov is None else degrees("fov", fov),
        }
        path = os.fspath(cameras) if is_file else None
        *found, said = _octobayes.read_cameras(None if model is None else model._model, path, every_frame, options)
        for text, _ in said:
            warnings.warn(text, RuntimeWarning, stacklevel=4)
        return Cameras(*found, is_file)
    if views is not None:
        raise wrong("views", "None with cameras that are not a file", views)
    if isinstance(cameras, Mapping):
        cameras = _split(cameras)
    try:
        listed = list(cameras)
        given = [camera if isinstance(camera, Mapping) else _refuse(camera) for camera in listed]
    except TypeError as error:
        raise wrong("cameras", EXPECTED, cameras) from error
    if not given:
        raise wrong("cameras", "at least one", "none")
    numbers = np.stack([one(f"cameras[{i}]", camera) for i, camera in enumerate(given)])
    sizes = numbers[:, 20:22].astype(int).tolist()
    if width is not None:
        numbers = resized(numbers, width, height)
    names = [
        os.fspath(camera.get("file_path") or camera.get("name") or name)
        for camera, name in zip(given, named(len(given)))
    ]
    return Cameras(numbers, names, _masks(given, sizes), f"{len(numbers)} cameras")


def _masks(cameras: Sequence[Mapping[str, Any]], sizes: Sequence[list[int]]) -> list[Beside]:
    """The mask of every camera, if any has one, with its size: ``image_size``, or else the camera's."""
    if not any("mask_path" in camera for camera in cameras):
        return []

    def beside(i: int, camera: Mapping[str, Any]) -> Beside:
        given = [whole(f"cameras[{i}]['image_size']", side, 1, 65_536) for side in camera.get("image_size", sizes[i])]
        mask = camera.get("mask_path")
        return Path(), None if mask is None else (Path(as_path(f"cameras[{i}]['mask_path']", mask)), True), given

    return [beside(i, camera) for i, camera in enumerate(cameras)]


def named(count: int) -> list[str]:
    """Names of cameras that have none."""
    return [f"camera {i}" for i in range(count)]


def as_dictionary(row: NDArray[np.float64]) -> dict[str, Any]:
    """A camera's numbers as a dictionary."""
    each = {"focal": slice(16, 18), "center": slice(18, 20), "size": slice(20, 22)}
    numbers = {key: row[part] for key, part in each.items()}
    return {"pose": row[:16].reshape(4, 4), **numbers, **dict(zip(LENS, row[22:NUMBERS].tolist()))}


def _refuse(camera: Any) -> Mapping[str, Any]:
    raise wrong("cameras", EXPECTED, camera)


def resized(rows: NDArray[np.float64], width: int, height: int | None) -> NDArray[np.float64]:
    """The same views with another image size; without a height, with the same aspect ratio."""
    rows = rows.copy()
    for row in rows:
        old = row[20:22].copy()
        row[20:22] = width, height or max(1, round(width * old[1] / old[0]))
        row[16:18] *= row[20:22] / old
        row[18:20] *= row[20:22] / old
    return rows
