"""Gaussian splats as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _octobayes
from ._model import Opened

Floats = NDArray[np.float32]


def _fixed(array: Floats) -> Floats:
    """A copy that refuses assignments, which would not reach the splats."""
    array.flags.writeable = False
    return array


class Splats(Opened):
    """Gaussian splats in Rust: a model, but no callable. See :func:`octobayes.open_model`.

    Arrays are read-only copies. With them, ``len(splats)`` is n.
    """

    def __init__(self, name: str, mode: str | None = None) -> None:
        self._model = _octobayes.Splats(name, mode)
        self._mode = mode

    def __reduce__(self) -> tuple[Any, ...]:
        """By its name: another process opens the file again."""
        return Splats, (self.name, self._mode)

    def __len__(self) -> int:
        return len(self._model)

    @property
    def means(self) -> Floats:
        """Centres ``[n, 3]``, scene units."""
        return _fixed(self._model.means)

    @property
    def scales(self) -> Floats:
        """Standard deviations along each splat's own axes ``[n, 3]``, scene units."""
        return _fixed(self._model.scales)

    @property
    def rotations(self) -> Floats:
        """Unit quaternions (w, x, y, z) from a splat's own axes to the scene's ``[n, 4]``."""
        return _fixed(self._model.rotations)

    @property
    def opacities(self) -> Floats:
        """Opacities at the centres ``[n]``, from 0 to 1."""
        return _fixed(self._model.opacities)

    @property
    def sh(self) -> Floats:
        """Coefficients of spherical harmonics ``[n, (degree + 1)**2, 3]``, in the order of the original code."""
        return _fixed(self._model.sh)

    @property
    def mode(self) -> str:
        """How splats smaller than a pixel are drawn: 'classic', 'mip' or 'mip-splatting'."""
        return self._model.mode
