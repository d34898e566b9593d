"""Models that the library reads, as Python callables."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _octobayes
from ._arguments import degrees, floats, points, wrong
from ._cameras import as_dictionary

Floats = NDArray[np.float32]


class Opened:
    """A model in Rust: a radiance field or Gaussian splats."""

    _model: Any

    @property
    def box(self) -> NDArray[np.float64]:
        """``[2, 3]``: corners of the box outside which nothing is, scene units. Of splats, that of all centres."""
        return np.array(self._model.box)

    @property
    def name(self) -> str:
        """The file or built-in scene."""
        return self._model.name

    def __repr__(self) -> str:
        return f"<octobayes.{type(self).__name__} {self.name}: {self._model.description}>"


class Model(Opened):
    """A radiance field in Rust: ``model(x, d) -> (density, color)``. See :func:`octobayes.open_model`."""

    def __init__(self, name: str, coordinates: str | None = None) -> None:
        self._model = _octobayes.Model(name, coordinates)
        self._coordinates = coordinates

    def __reduce__(self) -> tuple[Any, ...]:
        """By its name: another process opens the file again."""
        return Model, (self.name, self._coordinates)

    def __call__(self, x: ArrayLike, d: ArrayLike) -> tuple[Floats, Floats]:
        """Density and colour at points seen along directions.

        x: float32 ``[N, 3]``, scene units. d: float32 ``[N, 3]``, of any length but 0.
        Returns density ``[N]`` (1 / scene unit) and colour ``[N, 3]`` (red, green, blue in [0, 1]), float32.
        """
        return self._model.radiance(*self._asked(x, d))

    def density(self, x: ArrayLike) -> Floats:
        """Density alone, ``[N]`` (1 / scene unit), at ``x`` ``[N, 3]``."""
        return self._model.density(points("x", x)[0])

    def derivatives(self, x: ArrayLike, d: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
        """Density ``[N]``, colour ``[N, 3]``, ∂density/∂x ``[N, 3]`` and ∂color/∂x ``[N, 3, 3]`` (channel, axis).

        Raises ValueError if the model does not differentiate itself (:attr:`is_differentiable`).
        """
        density, color, slope, color_gradient = self._model.derivatives(*self._asked(x, d))
        return density, color, slope, color_gradient.reshape(-1, 3, 3)

    @staticmethod
    def _asked(x: ArrayLike, d: ArrayLike) -> tuple[Floats, Floats]:
        x = floats("x", x, (None, 3))
        d = floats("d", d, (len(x), 3))
        lengths = np.linalg.norm(d.astype(np.float64), axis=1)
        if (lengths == 0).any():
            raise wrong("d", "directions, which have a length", f"[0.0, 0.0, 0.0] at [{int(lengths.argmin())}]")
        # Models in Rust are asked with unit vectors only. What is one up to roundings stays as it is.
        if (np.abs(lengths - 1) > 1e-5).any():
            d = (d / lengths[:, None]).astype(np.float32)
        return x, d

    def cameras(
        self, fov: float | None = None, resolution: tuple[int, int] | None = None
    ) -> list[dict[str, Any]] | None:
        """The cameras that come with the model, as :func:`octobayes.uncertainty` takes them; ``None`` if it has none.

        fov: horizontal angle of view in degrees, and resolution: (width, height), where the model does not store them.
        """
        rows = self._model.cameras(None if fov is None else degrees("fov", fov), resolution)
        return None if rows is None else [as_dictionary(row) for row in rows]

    @property
    def step(self) -> float:
        """Distance between samples along a ray that resolves the model, scene units."""
        return self._model.step

    @property
    def pixel_offset(self) -> float:
        """Where in a pixel the training rays went; 0.5 is the centre."""
        return self._model.pixel_offset

    @property
    def is_differentiable(self) -> bool:
        """Whether the model computes its own derivatives."""
        return self._model.is_differentiable
