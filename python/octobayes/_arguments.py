"""Arguments as the Rust part expects them, or a sentence that names argument, expected and found."""

from __future__ import annotations

import math
import numbers
import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def found(value: Any) -> str:
    """A short description of a value for an error message."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return f"an array of shape {_shape(shape)} and type {dtype}"
    try:
        text = repr(value)
    except ValueError:  # a whole number of more digits than Python prints
        return f"a whole number of {value.bit_length()} bits"
    return text if len(text) <= 80 else f"{text[:77]}... ({type(value).__name__})"


def wrong(name: str, expected: str, value: Any) -> ValueError:
    """The error for an argument of the wrong value."""
    return ValueError(f"{name}: expected {expected}, found {value if isinstance(value, str) else found(value)}")


def _shape(shape: Iterable[Any]) -> str:
    return "[" + ", ".join("N" if side is None else str(side) for side in shape) + "]"


def array(name: str, value: Any) -> NDArray[Any]:
    """Anything with ``__array__`` or DLPack as a NumPy array, without a copy where that can be."""
    try:
        return _array(value)
    except Exception as error:
        raise wrong(name, "an array of real numbers", value) from error


def _array(value: Any) -> NDArray[Any]:
    if hasattr(value, "detach"):  # a torch tensor: NumPy takes neither gradients nor other devices
        value = value.detach().cpu()
        if str(value.dtype) == "torch.bfloat16":
            value = value.float()
        return np.asarray(value)
    if not hasattr(value, "__array__") and hasattr(value, "__dlpack__"):
        return np.from_dlpack(value)
    return np.asarray(value)


def floats(
    name: str, value: Any, shape: Sequence[int | None], dtype: type = np.float32, finite: bool = True
) -> NDArray[Any]:
    """A C-contiguous array of ``dtype`` and ``shape`` (``None``: any side)."""
    expected = f"an array of real numbers of shape {_shape(shape)}"
    try:
        given = _array(value)
    except Exception as error:
        raise wrong(name, expected, value) from error
    # bfloat16 of JAX is of kind V, and converts.
    if given.dtype.kind not in "fiu" and str(given.dtype) != "bfloat16":
        raise wrong(name, expected, given)
    if given.ndim != len(shape) or any(want not in (None, side) for want, side in zip(shape, given.shape)):
        raise wrong(name, expected, given)
    values: NDArray[Any] = np.ascontiguousarray(given, dtype=dtype)
    if finite and not np.isfinite(values).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise wrong(name, "finite numbers", f"{values[at]} at {list(at)}")
    return values


def points(name: str, value: Any) -> tuple[NDArray[np.float32], tuple[int, ...]]:
    """Points as float32 ``[N, 3]``, and the shape that answers have: that of ``value`` without its last axis."""
    given = array(name, value)
    if given.ndim == 0 or given.shape[-1] != 3:
        raise wrong(name, "an array of real numbers of shape [N, 3]", given)
    return floats(name, given.reshape(-1, 3), (None, 3)), given.shape[:-1]


#: Largest count without a limit of its own, as on the command line.
MOST = 10**15


def _is_finite(value: Any) -> bool:
    """Whether it is a number that a float holds."""
    try:
        return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def whole(name: str, value: Any, low: int, high: int = MOST) -> int:
    """A whole number within a range."""
    # 4e5 is a float for NumPy and for people, but a number of rays all the same.
    if not _is_finite(value) or value != int(value) or not low <= value <= high:
        is_too_large = isinstance(value, numbers.Real) and value > high
        upto = f"to {high}" if high != MOST or is_too_large else "or more"
        raise wrong(name, f"a whole number, {low} {upto}", value)
    return int(value)


def real(name: str, value: Any, low: float | None = None, above: float | None = None) -> float:
    """A finite number, from ``low`` or ``above`` on."""
    limit = f", {low:g} or more" if low is not None else f" above {above:g}" if above is not None else ""
    if not _is_finite(value) or (low is not None and value < low) or (above is not None and value <= above):
        raise wrong(name, f"a finite number{limit}", value)
    return float(value)


def names(name: str, value: Any) -> list[str]:
    """One name or several."""
    listed = [value] if isinstance(value, str) else list(value)
    if not listed or not all(isinstance(item, str) for item in listed):
        raise wrong(name, "a name or a list of names", value)
    return listed


def degrees(name: str, value: Any) -> float:
    """An angle of view."""
    angle = real(name, value, above=0)
    if angle >= 180:
        raise wrong(name, "an angle above 0 and below 180 degrees", f"{angle:g}")
    return angle


def flag(name: str, value: Any) -> bool:
    """True or False, but not what Python takes for it, such as the text 'false'."""
    if not isinstance(value, (bool, np.bool_)):
        raise wrong(name, "True or False", repr(value))
    return bool(value)


def box(name: str, value: Any) -> list[list[float]]:
    """``(low, high)``, two corners."""
    corners = floats(name, value, (2, 3), np.float64)
    if not (corners[0] < corners[1]).all():
        raise wrong(name, "a lower and an upper corner", str(corners.tolist()))
    return corners.tolist()


def color(name: str, value: Any) -> list[float]:
    """A name or red, green and blue."""
    known = {"white": [1.0, 1.0, 1.0], "black": [0.0, 0.0, 0.0]}
    if isinstance(value, str):
        if value not in known:
            raise wrong(name, "'white', 'black' or red, green and blue", value)
        return known[value]
    rgb = floats(name, value, (3,), np.float32)
    if rgb.min() < 0 or rgb.max() > 1:
        raise wrong(name, "red, green and blue from 0 to 1", str(rgb.tolist()))
    return [float(c) for c in rgb]


def path(name: str, value: Any) -> str:
    """A path as text."""
    if not isinstance(value, (str, os.PathLike)):
        raise wrong(name, "a path", value)
    return os.fspath(value)
