"""A field in Python as the Rust part asks it: always from the thread that called, in batches, with checked answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._arguments import array, floats, real, wrong
from ._arguments import box as as_box

Floats = NDArray[np.float32]


def _density(name: str, value: Any, n: int) -> Floats:
    given = array(value)
    if given.shape == (n, 1):
        given = given[:, 0]
    # What is not finite drops the ray, and is counted.
    return floats(name, given, (n,), finite=False)


def _parts(name: str, answer: Any, count: int) -> tuple[Any, ...]:
    """The arrays of an answer."""
    if not isinstance(answer, (tuple, list)) or len(answer) != count:
        kinds = {2: "(density, color)", 4: "(density, color, d_density, d_color)"}
        raise wrong(name, f"a tuple {kinds[count]}", answer)
    return tuple(answer)


class Gate:
    """What the Rust part knows of a callable, and how it asks it."""

    def __init__(self, nerf: Callable[..., Any], *, box: Any, step: Any, batch: int, description: str) -> None:
        self._nerf = nerf
        self._density: Any = getattr(nerf, "density", None)
        self._derivatives: Any = getattr(nerf, "derivatives", None)
        box = box if box is not None else getattr(nerf, "box", None)
        if box is None:
            raise wrong("box", "two corners (low, high) outside which the callable's density is zero", "none")
        corners = np.asarray(as_box("box", box))
        if step is None:
            step = getattr(nerf, "step", None)
        if step is None:
            step = float(np.linalg.norm(corners[1] - corners[0])) / 1024
        self.traits = {
            "box": corners.tolist(),
            "step": real("nerf.step", step, above=0),
            "batch": batch,
            "pixel_offset": real("nerf.pixel_offset", getattr(nerf, "pixel_offset", 0.5), low=0),
            "has_density": self._density is not None,
            "has_derivatives": self._derivatives is not None,
            "description": description,
        }

    def density(self, x: Floats) -> Floats:
        """Density ``[N]`` at ``x`` ``[N, 3]``."""
        return _density("the result of nerf.density", self._density(x), len(x))

    def radiance(self, x: Floats, d: Floats) -> tuple[Floats, Floats]:
        """Density ``[N]`` and colour ``[N, 3]`` at ``x`` ``[N, 3]`` seen along ``d`` ``[N, 3]``."""
        density, color = _parts("the result of nerf", self._nerf(x, d), 2)
        n = len(x)
        return (
            _density("density, the first result of nerf", density, n),
            floats("color, the second result of nerf", color, (n, 3), finite=False),
        )

    def derivatives(self, x: Floats, d: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Density, colour, and their derivatives by position: ``[N]``, ``[N, 3]``, ``[N, 3]``, ``[N, 3, 3]``."""
        density, color, slope, tint = _parts("the result of nerf.derivatives", self._derivatives(x, d), 4)
        n, of = len(x), "result of nerf.derivatives"
        return (
            _density(f"density, the first {of}", density, n),
            floats(f"color, the second {of}", color, (n, 3), finite=False),
            floats(f"d_density, the third {of}", slope, (n, 3), finite=False),
            floats(f"d_color, the fourth {of}", tint, (n, 3, 3), finite=False),
        )
