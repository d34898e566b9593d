"""The result: U as a function of position."""

from __future__ import annotations

import json
import os
import tempfile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _octobayes
from ._arguments import path as as_path
from ._arguments import points as as_points
from ._arguments import real, wrong


class Uncertainty:
    """U(x), how far the scene could be displaced at x without any training image noticing, in scene units.

    A ranking, not an error in metres: large where no training image constrains the place. Points have the shape
    ``[N, 3]`` (or ``[..., 3]``), in scene units; answers have one value per point. Made by
    :func:`octobayes.uncertainty`, :func:`octobayes.load`, :func:`octobayes.merge` and :func:`octobayes.accumulate`.
    """

    def __init__(self, field: _octobayes.Uncertainty) -> None:
        self._field = field

    def __reduce__(self) -> tuple[Any, ...]:
        """As the bytes of an .oct file, so that fields pass between processes."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "field.oct")
            self._field.save(path)
            with open(path, "rb") as file:
                return _unpickled, (file.read(),)

    def _estimates(self, points: ArrayLike) -> list[NDArray[Any]]:
        x, shape = as_points("points", points)
        return [values.reshape(shape) for values in self._field.query(x)]

    def query(self, points: ArrayLike) -> NDArray[np.float64]:
        """U, float64 ``[N]``, scene units. Outside the box it is the prior."""
        return self._estimates(points)[0]

    def log10(self, points: ArrayLike) -> NDArray[np.float64]:
        """log10 U, float64 ``[N]``."""
        return np.log10(self.query(points))

    def log10_error(self, points: ArrayLike) -> NDArray[np.float64]:
        """Root mean square error of log10 U due to the number of rays, float64 ``[N]``, decades.

        NaN where too few rays passed for an estimate. Raises ValueError without error bars (``error_bars=`` of
        :func:`octobayes.uncertainty`).
        """
        if not self._field.has_error_bars:
            raise wrong("log10_error", "a field with error bars (error_bars=8)", "one without")
        return self._estimates(points)[1]

    def rays(self, points: ArrayLike) -> NDArray[np.float64]:
        """Number of training rays that support the estimate, float64 ``[N]``, interpolated; NaN where unknown."""
        return self._estimates(points)[2]

    def level(self, points: ArrayLike) -> NDArray[np.uint8]:
        """Level of the octree's leaf around each point, uint8 ``[N]``; 0 outside the box."""
        return self._estimates(points)[3]

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point is inside the field's box, bool ``[N]``."""
        return self._estimates(points)[4]

    def seen(self, points: ArrayLike) -> NDArray[np.str_]:
        """Whether training rays constrain each point, ``[N]`` of text.

        'constrained': moving it changes training pixels. 'free': rays passed and hit nothing. 'unseen': no ray came.
        Raises ValueError if it is not known where rays passed.
        """
        names, _, shape = self._seen(points)
        return np.array(names, dtype="<U11").reshape(shape)

    def ray_coverage_at(self, points: ArrayLike) -> NDArray[np.uint32]:
        """Number of training rays that reached the space around each point with half of their light, uint32 ``[N]``.

        Raises ValueError if it is not known where rays passed.
        """
        _, counts, shape = self._seen(points)
        return counts.reshape(shape)

    def _seen(self, points: ArrayLike) -> tuple[list[str], NDArray[np.uint32], tuple[int, ...]]:
        x, shape = as_points("points", points)
        found = self._field.seen(x)
        if found is None:
            raise wrong("ray coverage", "a field that knows where rays passed", "one that does not")
        return found[0], found[1], shape

    @property
    def ray_coverage(self) -> NDArray[np.uint32] | None:
        """uint32 ``[M, M, M]`` (x, y, z): rays that reached each cell of a coarse grid over the box.

        ``None`` if unknown.
        """
        return self._field.ray_coverage

    def covariance(self, points: ArrayLike, kind: str | None = None) -> NDArray[np.float64]:
        """Covariance matrices of the displacement, float64 ``[N, 3, 3]``, squared scene units; their trace is U².

        kind: 'diagonal', 'block' or 'trace', as in :func:`octobayes.uncertainty`; the field's own by default. Only
        'block' has entries off the diagonal. Raises ValueError if the field does not keep its sums
        (``keep_sums=True``).
        """
        x, shape = as_points("points", points)
        return self._field.covariance(x, kind).reshape(*shape, 3, 3)

    def with_covariance(self, kind: str) -> Uncertainty:
        """The same field, read with another covariance. Raises ValueError if it does not keep its sums."""
        return Uncertainty(self._field.with_covariance(kind))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes an ``.oct`` file, complete or not at all. Raises OSError if that cannot be."""
        path = as_path("path", path)
        if not path.endswith(".oct"):
            raise wrong("path", "a name that ends in .oct (octobayes.export writes .npy)", path)
        self._field.save(path)

    def surface_quantile(self, share: float) -> float | None:
        """log10 U that the most certain ``share`` (0 to 1) of visible surfaces does not exceed; ``None`` if unknown."""
        if real("share", share, low=0) > 1:
            raise wrong("share", "a share from 0 to 1", share)
        return self._field.surface_quantile(share)

    @property
    def surface(self) -> NDArray[np.float32]:
        """float32 ``[n, 3]``: some points on visible surfaces, scene units."""
        return self._field.surface

    @property
    def prior(self) -> float:
        """U where nothing was learnt, scene units."""
        return self._field.prior

    @property
    def finest_level(self) -> int:
        """The finest level: 2^level cells along each axis of the box."""
        return self._field.level

    @property
    def box(self) -> NDArray[np.float64] | None:
        """``[2, 3]``: corners of the box, scene units; ``None`` if the field covers all of space, contracted."""
        box = self._field.box
        return None if box is None else np.array(box)

    @property
    def keeps_sums(self) -> bool:
        """Whether the 3x3 sums are kept, from which other covariances can be read."""
        return self._field.keeps_sums

    @property
    def has_error_bars(self) -> bool:
        """Whether :meth:`log10_error` is known."""
        return self._field.has_error_bars

    @property
    def conformal(self) -> dict[str, Any] | None:
        """The interval of depth of :func:`octobayes.calibrate`; ``None`` if there is none.

        'probability' that it holds, 'factor' (its half width in deviations), 'pixels' and 'views' it was made on.
        """
        found = self._field.conformal()
        return None if found is None else json.loads(found)

    @property
    def is_part(self) -> bool:
        """Whether these are only some of the rays of a run; :func:`octobayes.merge` joins parts."""
        return self._field.is_part

    @property
    def record(self) -> dict[str, Any]:
        """Everything that the numbers depend on: rays, seed, λ, steps, ..."""
        return json.loads(self._field.record())

    @property
    def report(self) -> dict[str, Any]:
        """What ``octobayes uncertainty --json`` prints of the run that computed the field.

        That is record, summary, log10 U on visible surfaces, seconds, memory, and under 'errors' how far log10 U is
        from its limit. Of a field that was read or merged: what of this the field knows itself.
        """
        return json.loads(self._field.report())

    @property
    def summary(self) -> dict[str, Any]:
        """Size and structure: vertices, bytes, leaves by level."""
        return json.loads(self._field.summary())

    def __repr__(self) -> str:
        summary, record = self.summary, self.record
        return (
            f"<octobayes.Uncertainty {summary['grid']} of level {summary['level']} over {self._field.domain}: "
            f"{summary['vertices']} vertices, {record['rays']} rays>"
        )


def _unpickled(content: bytes) -> Uncertainty:
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "field.oct")
        with open(path, "wb") as file:
            file.write(content)
        return Uncertainty(_octobayes.load(path, {}))
