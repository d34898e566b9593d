"""Radiance fields of PyTorch and JAX, differentiated by them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._arguments import wrong

Floats = NDArray[np.float32]


class _Field:
    """What both frameworks share: the optional attributes."""

    def __init__(self, density: Any, attributes: dict[str, Any], source: Any) -> None:
        for name, value in attributes.items():
            value = getattr(source, name, None) if value is None else value
            if value is not None:
                setattr(self, name, value)
        if density is None and callable(getattr(source, "density", None)):
            density = source.density
        if density is not None:
            self._of_density = density
            self.density = self._density
        self.__qualname__ = getattr(source, "__qualname__", type(source).__qualname__)

    def _density(self, x: Floats) -> Floats:
        raise NotImplementedError


class TorchField(_Field):
    """See :func:`torch_field`."""

    def __init__(self, module: Any, device: Any, density: Any, attributes: dict[str, Any]) -> None:
        import torch

        super().__init__(density, attributes, module)
        self._torch, self._module, self._device = torch, module, device

    def _tensor(self, values: Floats) -> Any:
        return self._torch.from_numpy(values).to(self._device)

    @staticmethod
    def _answer(density: Any, n: int) -> Any:
        # Networks often end in a layer of one output.
        return density.reshape(n) if tuple(density.shape) == (n, 1) else density

    def __call__(self, x: Floats, d: Floats) -> tuple[Any, Any]:
        """Density ``[N]`` and colour ``[N, 3]``."""
        with self._torch.no_grad():
            return self._module(self._tensor(x), self._tensor(d))

    def _density(self, x: Floats) -> Any:
        with self._torch.no_grad():
            return self._of_density(self._tensor(x))

    def derivatives(self, x: Floats, d: Floats) -> tuple[Any, Any, Any, Any]:
        """Density, colour and their derivatives: one forward pass, and one backward pass for each of four outputs."""
        torch, n = self._torch, len(x)
        with torch.enable_grad():
            at = self._tensor(x).requires_grad_(True)
            density, color = self._module(at, self._tensor(d))
            outputs = [self._answer(density, n), *color.unbind(-1)]
            if not any(output.requires_grad for output in outputs):
                raise wrong(
                    "nerf", "a module that can be differentiated by position", "one whose results have no gradient"
                )
            slopes = []
            for i, output in enumerate(outputs):
                slope = None
                if output.requires_grad:
                    # A point's output depends on that point only: the gradient of the sum has a row for each.
                    (slope,) = torch.autograd.grad(output.sum(), at, retain_graph=i < 3, allow_unused=True)
                slopes.append(torch.zeros_like(at) if slope is None else slope)
        return density.detach(), color.detach(), slopes[0], torch.stack(slopes[1:], dim=1)


def torch_field(
    module: Callable[..., Any],
    device: Any = None,
    *,
    density: Callable[..., Any] | None = None,
    step: float | None = None,
    background: Any = None,
    box: Any = None,
) -> TorchField:
    """A ``torch.nn.Module`` (or function of tensors) as a field for :func:`octobayes.uncertainty`.

    module: ``(x[N, 3], d[N, 3]) -> (density[N] or [N, 1], color[N, 3])``, float32 tensors on ``device`` (default: that
    of the module's parameters, else the CPU). Put it into evaluation mode yourself. density: ``x[N, 3] -> density[N]``,
    if that is cheaper (default: the module's method ``density``, if it has one). step, background and box: as
    attributes of a callable. ``gradient='analytic'`` takes derivatives by autograd: one forward pass and four backward
    passes.
    """
    if not callable(module):
        raise wrong("module", "a torch.nn.Module or a function of tensors", module)
    if device is None:
        parameters = module.parameters() if hasattr(module, "parameters") else iter(())
        device = next((parameter.device for parameter in parameters), "cpu")
    return TorchField(
        module, device, density, {"step": step, "background": background, "box": box, "pixel_offset": None}
    )


class JaxField(_Field):
    """See :func:`jax_field`."""

    def __init__(self, f: Any, density: Any, jit: bool, attributes: dict[str, Any]) -> None:
        import jax
        import jax.numpy as jnp

        super().__init__(density, attributes, f)

        def derivatives(x: Any, d: Any) -> Any:
            # One forward pass; a point's output depends on that point only, so that ones pull back a row for each.
            (density, color), pull = jax.vjp(lambda x: f(x, d), x)
            flat = density.size
            ones, none = jnp.ones_like(density), jnp.zeros_like(color)
            first = pull((ones, none))[0]
            channels = jnp.eye(3, dtype=color.dtype)[:, None, :].repeat(flat, 1)
            rest = jax.vmap(lambda channel: pull((jnp.zeros_like(density), channel))[0])(channels)
            return density, color, first, rest.swapaxes(0, 1)

        compiled = jax.jit if jit else lambda function: function
        self._f, self._of_derivatives = compiled(f), compiled(derivatives)
        if hasattr(self, "_of_density"):
            self._of_density = compiled(self._of_density)

    def _padded(self, function: Any, *arrays: Floats) -> tuple[Any, ...]:
        """Calls with one of a few lengths, because each is compiled by itself; at most a quarter is in vain."""
        n = len(arrays[0])
        power = max(12, (n - 1).bit_length() - 1)
        length = next(length for length in (((4 + k) << power) // 4 for k in range(5)) if length >= n)
        answer = function(*(np.concatenate([a, np.broadcast_to(a[-1:], (length - n, 3))]) for a in arrays))
        answer = answer if isinstance(answer, (tuple, list)) else (answer,)
        return tuple(np.asarray(part)[:n] for part in answer)

    def __call__(self, x: Floats, d: Floats) -> tuple[Any, ...]:
        """Density ``[N]`` and colour ``[N, 3]``."""
        return self._padded(self._f, x, d)

    def _density(self, x: Floats) -> Any:
        return self._padded(self._of_density, x)[0]

    def derivatives(self, x: Floats, d: Floats) -> tuple[Any, ...]:
        """Density, colour and their derivatives, by one forward pass and four pull-backs."""
        return self._padded(self._of_derivatives, x, d)


def jax_field(
    f: Callable[..., Any],
    *,
    density: Callable[..., Any] | None = None,
    jit: bool = True,
    step: float | None = None,
    background: Any = None,
    box: Any = None,
) -> JaxField:
    """A JAX function as a field for :func:`octobayes.uncertainty`.

    f: ``(x[N, 3], d[N, 3]) -> (density[N], color[N, 3])``, float32; close over the parameters. density: ``x[N, 3] ->
    density[N]``, if that is cheaper. jit: compile it (points are padded to a few lengths). step, background and box: as
    attributes of a callable. ``gradient='analytic'`` takes derivatives by ``jax.vjp``: one forward pass.
    """
    if not callable(f):
        raise wrong("f", "a function of JAX arrays", f)
    return JaxField(f, density, jit, {"step": step, "background": background, "box": box, "pixel_offset": None})
