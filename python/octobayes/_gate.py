"""A field in Python as the Rust part calls it: always from the calling thread, in batches, with checked values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._arguments import array, floats, real, wrong
from ._arguments import box as as_box

Floats = NDArray[np.float32]

#: What colours may exceed 0 or 1 by. Spherical harmonics without a clamp, padded sigmoids and the like exceed them by
#: less; another scale (0 to 255, -1 to 1) exceeds them by more.
OVERSHOOT = 0.05
#: What colours exceed 0 or 1 by for roundings alone.
ROUNDING = 1e-6


def _density(name: str, value: Any, n: int) -> Floats:
    given = array(name, value)
    if given.shape == (n, 1):
        given = given[:, 0]
    # What is not finite drops the ray, and is counted; but -inf is a logarithm's, and says so.
    density = floats(name, given, (n,), finite=False)
    if (density < 0).any():
        i = int(np.nanargmin(density))
        expected = "0 or more (apply the activation that training applied, such as softplus or exp)"
        raise wrong(name, expected, f"{density[i]:g} at [{i}]")
    return density


def _parts(name: str, answer: Any, count: int) -> tuple[Any, ...]:
    """The arrays of an answer."""
    if not isinstance(answer, (tuple, list)) or len(answer) != count:
        kinds = {2: "(density, color)", 4: "(density, color, d_density, d_color)"}
        raise wrong(name, f"a tuple {kinds[count]}", answer)
    return tuple(answer)


def remarks(overshoot: float) -> list[tuple[str, bool]]:
    """The warning about colours that exceeded 0 or 1 by as much, if that is worth one."""
    if overshoot <= ROUNDING:
        return []
    return [(f"colors of nerf exceed the range from 0 to 1 by up to {overshoot:.2g}; they were clamped to it", False)]


class Gate:
    """A callable's properties and methods, as the Rust part uses them."""

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
        #: The most by which a colour exceeded 0 or 1.
        self.overshoot = 0.0

    def _color(self, name: str, value: Any, n: int) -> tuple[Floats, NDArray[np.bool_] | None]:
        """Colour ``[N, 3]`` within [0, 1], and where it had to be clamped; ``None`` if nowhere."""
        given = array(name, value)
        if given.dtype.kind in "iu":
            raise wrong(name, "values from 0 to 1", f"integers of type {given.dtype}, up to {given.max(initial=0)}")
        color = floats(name, given, (n, 3), finite=False)
        if color.min(initial=0) >= 0 and color.max(initial=0) <= 1:
            return color, None
        # What is not finite passes: it drops the ray, and is counted.
        with np.errstate(invalid="ignore"):
            excess = np.maximum(-color, color - 1)
        excess[~np.isfinite(color)] = 0
        most = float(excess.max(initial=0))
        if most <= 0:
            return color, None
        if most > OVERSHOOT:
            at = np.unravel_index(int(excess.argmax()), color.shape)
            raise wrong(name, "values from 0 to 1", f"{color[at]:g} at {[int(i) for i in at]}")
        self.overshoot = max(self.overshoot, most)
        return np.clip(color, 0, 1), excess > 0

    def density(self, x: Floats) -> Floats:
        """Density ``[N]`` at ``x`` ``[N, 3]``."""
        return _density("the result of nerf.density", self._density(x), len(x))

    def radiance(self, x: Floats, d: Floats) -> tuple[Floats, Floats]:
        """Density ``[N]`` and colour ``[N, 3]`` at ``x`` ``[N, 3]`` seen along ``d`` ``[N, 3]``."""
        density, color = _parts("the result of nerf", self._nerf(x, d), 2)
        n = len(x)
        return (
            _density("density, the first result of nerf", density, n),
            self._color("color, the second result of nerf", color, n)[0],
        )

    def derivatives(self, x: Floats, d: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Density, colour, and their derivatives by position: ``[N]``, ``[N, 3]``, ``[N, 3]``, ``[N, 3, 3]``.

        A channel that was clamped has no derivative there, like the differences of clamped colours.
        """
        density, color, slope, color_gradient = _parts("the result of nerf.derivatives", self._derivatives(x, d), 4)
        n, of = len(x), "result of nerf.derivatives"
        density = _density(f"density, the first {of}", density, n)
        color, is_clamped = self._color(f"color, the second {of}", color, n)
        slope = floats(f"d_density, the third {of}", slope, (n, 3), finite=False)
        color_gradient = floats(f"d_color, the fourth {of}", color_gradient, (n, 3, 3), finite=False)
        if is_clamped is not None:
            color_gradient = np.where(is_clamped[:, :, None], np.float32(0), color_gradient)
        return density, color, slope, color_gradient
