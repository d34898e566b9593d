"""Where can a trained radiance field (NeRF) be trusted?

Takes a finished radiance field, as a Python callable or a model file, and its training cameras. Computes, for every
point in space, how far the scene could be displaced there without any training image noticing (Bayes' Rays, CVPR 2024).

    import octobayes as ob
    u = ob.uncertainty(nerf, cameras="transforms.json", box=(low, high), level=8, rays=409_600)
    u.log10(points)

Arrays are NumPy's; anything with ``__array__`` or DLPack is accepted. Lengths are in scene units. Wrong arguments raise
``ValueError`` with a sentence that names argument, expected and found.
"""

from __future__ import annotations

from . import nerfstudio
from ._api import (
    accumulate,
    calibrate,
    compare,
    evaluate,
    forecast,
    load,
    merge,
    open_model,
    render,
    splat_columns,
    uncertainty,
)
from ._autodiff import jax_field, torch_field
from ._clean import Cleaned, clean
from ._depth import TRUST, depth, measure
from ._export import export
from ._model import Model
from ._octobayes import __version__
from ._plan import next_view
from ._splats import Splats
from ._uncertainty import Uncertainty

__all__ = [
    "TRUST",
    "Cleaned",
    "Model",
    "Splats",
    "Uncertainty",
    "__version__",
    "accumulate",
    "calibrate",
    "clean",
    "compare",
    "depth",
    "evaluate",
    "export",
    "forecast",
    "jax_field",
    "load",
    "measure",
    "merge",
    "nerfstudio",
    "next_view",
    "open_model",
    "render",
    "splat_columns",
    "torch_field",
    "uncertainty",
]
