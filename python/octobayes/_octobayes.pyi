"""The part that is Rust. The package checks arguments: arrays are C-contiguous and of these types."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Box = list[list[float]]
Progress = Callable[[str, int, int], Any]
#: What a user should know, and whether it is only a note.
Said = tuple[str, bool]

__version__: str

def defaults() -> str:
    """JSON: the library's defaults by the names of arguments."""

def keeps_sums(options: dict[str, Any]) -> bool:
    """Whether a run with these options keeps its sums."""

class Model:
    """A radiance field in Rust."""

    def __new__(cls, name: str, coordinates: str | None = None) -> Model: ...
    def radiance(self, x: Floats, d: Floats) -> tuple[Floats, Floats]:
        """x [N, 3], d [N, 3] -> density [N], color [N, 3]."""
    def density(self, x: Floats) -> Floats:
        """x [N, 3] -> [N]."""
    def derivatives(self, x: Floats, d: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """x [N, 3], d [N, 3] -> density [N], color [N, 3], d_density [N, 3], d_color [N, 9] (channel, then axis)."""
    def cameras(self, fov: float | None = None, resolution: tuple[int, int] | None = None) -> Doubles | None:
        """[cameras, 28]: pose by rows, focal lengths, principal point, size, k1, k2, k3, k4, p1, p2."""
    def check(self, field: Uncertainty, name: str) -> list[Said]: ...
    @property
    def source(self) -> str: ...
    @property
    def checksum(self) -> int: ...
    @property
    def is_differentiable(self) -> bool: ...
    @property
    def box(self) -> Box: ...
    @property
    def step(self) -> float: ...
    @property
    def pixel_offset(self) -> float: ...
    @property
    def name(self) -> str: ...
    @property
    def description(self) -> str: ...

class Splats:
    """Gaussian splats in Rust."""

    def __new__(cls, name: str, mode: str | None = None) -> Splats: ...
    @staticmethod
    def is_file(name: str) -> bool: ...
    def check(self, field: Uncertainty, name: str) -> list[Said]: ...
    def __len__(self) -> int: ...
    @property
    def checksum(self) -> int: ...
    @property
    def means(self) -> Floats:
        """[n, 3]."""
    @property
    def scales(self) -> Floats:
        """[n, 3]."""
    @property
    def rotations(self) -> Floats:
        """[n, 4], w first."""
    @property
    def opacities(self) -> Floats:
        """[n]."""
    @property
    def sh(self) -> Floats:
        """[n, (degree + 1)**2, 3]."""
    @property
    def mode(self) -> str: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def box(self) -> Box: ...
    @property
    def name(self) -> str: ...
    @property
    def source(self) -> str: ...
    @property
    def description(self) -> str: ...

class Uncertainty:
    """A finished field."""

    def query(self, x: Floats) -> tuple[Doubles, Doubles, Doubles, NDArray[np.uint8], NDArray[np.bool_]]:
        """x [N, 3] -> U, error of log10 U, rays, level, inside; each [N]. NaN where unknown."""
    def seen(self, x: Floats) -> tuple[list[str], NDArray[np.uint32]] | None:
        """x [N, 3] -> names and counts of rays; None if unknown."""
    def covariance(self, x: Floats, kind: str | None = None) -> Doubles:
        """x [N, 3] -> [N, 3, 3], squared scene units."""
    def with_covariance(self, kind: str) -> Uncertainty: ...
    def save(self, path: str | os.PathLike[str]) -> None: ...
    def for_queries(self) -> Uncertainty: ...
    def surface_quantile(self, share: float) -> float | None: ...
    def threshold(self, threshold: float | str) -> tuple[float, list[Said]]: ...
    def record(self) -> str:
        """JSON."""
    def report(self) -> str:
        """JSON."""
    def summary(self) -> str:
        """JSON."""
    def conformal(self) -> str | None:
        """JSON."""
    @property
    def ray_coverage(self) -> NDArray[np.uint32] | None:
        """[M, M, M]."""
    @property
    def surface(self) -> Floats:
        """[n, 3]."""
    @property
    def prior(self) -> float: ...
    @property
    def level(self) -> int: ...
    @property
    def box(self) -> Box | None: ...
    @property
    def domain(self) -> str: ...
    @property
    def keeps_sums(self) -> bool: ...
    @property
    def has_error_bars(self) -> bool: ...
    @property
    def is_part(self) -> bool: ...

def uncertainty(
    nerf: Any, rows: Doubles, options: dict[str, Any], progress: Progress | None
) -> tuple[Any, list[Said], str]:
    """nerf: a Model, Splats or a Gate; rows: cameras [C, 28]. The field, or else JSON of what the run needs."""

def read_cameras(
    model: Model | None, path: str | os.PathLike[str] | None, every_frame: bool, options: dict[str, Any]
) -> tuple[Doubles, list[str], list[tuple[Path, tuple[Path, bool] | None, list[int]]], str, bool, list[Said]]:
    """Cameras [C, 28], names, images (which need not exist) with masks and sizes, source, and if sizes are assumed."""

def load(path: str | os.PathLike[str], options: dict[str, Any], rays: int | None = None) -> Uncertainty: ...
def compare(a: Uncertainty, b: Uncertainty, points: int, seed: int) -> tuple[str, list[Said]]:
    """JSON."""

def merge(
    fields: Sequence[Uncertainty], error_bars: bool, keep_sums: bool, scratch: str | None = None
) -> tuple[Uncertainty, list[Said]]: ...
def accumulate(samples: Any, options: dict[str, Any], progress: Progress | None) -> tuple[Uncertainty, list[Said]]:
    """samples: a path, or positions [N, 3], jacobians [N, 9], ray uint64 [N], weight [N], rays in all."""

def export_field(field: Uncertainty, path: str, kind: str) -> None: ...
def export_surfaces(
    nerf: Any,
    field: Uncertainty,
    path: str,
    rows: Doubles,
    names: Sequence[str],
    options: dict[str, Any],
    progress: Progress | None,
) -> None: ...
def seen_splats(
    splats: Splats, rows: Doubles, options: dict[str, Any], progress: Progress | None
) -> tuple[Doubles, NDArray[np.uint32], Doubles]:
    """weight [n], views [n], front_share [n]."""

class Cleaned:
    def columns(self) -> tuple[Floats, dict[str, Any]]:
        """Positions [n, 3]; reason, strength uint8 [n], score, front_share, weight [n], views uint32 [n]."""

    def write(self, path: str, strength: str, points: int, progress: Progress | None) -> None: ...

def clean(nerf: Model | Splats, rows: Doubles, options: dict[str, Any], progress: Progress | None) -> Cleaned: ...
def export_splats(
    splats: Splats,
    field: Uncertainty,
    path: str,
    rows: Doubles | None,
    options: dict[str, Any],
    progress: Progress | None,
) -> None: ...
def render(
    nerf: Any, uncertainty: Uncertainty | None, rows: Doubles, options: dict[str, Any], progress: Progress | None
) -> dict[str, Floats]:
    """color [H, W, 3], depth, opacity, log10_uncertainty, depth_error, depth_interval [H, W]."""

def depth(
    nerf: Any, uncertainty: Uncertainty, rows: Doubles, options: dict[str, Any], progress: Progress | None
) -> tuple[list[dict[str, Any]], list[Said]]:
    """camera, name, depth, sigma, trust [H, W] of each photograph."""

def measure(
    nerf: Any,
    uncertainty: Uncertainty,
    rows: Doubles,
    points: Sequence[Sequence[float]],
    options: dict[str, Any],
    progress: Progress | None,
) -> tuple[str, list[Said]]:
    """JSON, and what a user should know."""

def evaluate(
    nerf: Any,
    fields: Sequence[tuple[str, Uncertainty]],
    ensemble: Sequence[Model | Splats],
    options: dict[str, Any],
    progress: Progress | None,
) -> tuple[str, list[Said], Uncertainty | None]:
    """JSON, what a user should know, and the first field with its interval of depth, if calibrated."""

def next_view(
    nerf: Any,
    uncertainty: Uncertainty,
    candidates: Doubles | None,
    training: Doubles | None,
    options: dict[str, Any],
    progress: Progress | None,
) -> tuple[str, Doubles, Floats | None, list[Said]]:
    """JSON, all candidates [C, 28], the gain of each pixel of the first view [H, W], and what a user should know."""
