"""Fields of PyTorch and JAX, where these are installed; pytest's summary says where not."""

import numpy as np
import pytest
from conftest import SMALL

import octobayes as ob

BOX = [[-1, -1, -1], [1, 1, 1]]
RUN = {**SMALL, "level": 5, "rays": 4_096, "march_step": 1 / 64}


def blob(np, x, d):
    """A soft ball, with colours that depend on the direction; for any module with NumPy's functions."""
    r = (x**2).sum(-1) ** 0.5
    density = 40 / (1 + np.exp(40 * (r - 0.5)))
    color = 0.5 + 0.4 * np.sin(5 * x + d)
    return density, color


def derivatives_of_blob(x, d):
    """The derivatives in closed form."""
    r = np.linalg.norm(x, axis=1, keepdims=True)
    e = np.exp(40 * (r - 0.5))
    slope = -40 * 40 * e / (1 + e) ** 2 * x / r
    color_gradient = np.zeros((len(x), 3, 3))
    color_gradient[:, range(3), range(3)] = 2 * np.cos(5 * x + d)
    return slope, color_gradient


def torch_blob():
    torch = pytest.importorskip("torch", reason="torch is not installed: its fields are not tested")

    class Blob(torch.nn.Module):
        forwards = 0

        def forward(self, x, d):
            self.forwards += 1
            assert x.dtype == torch.float32
            density, color = blob(torch, x, d)
            return density[:, None], color

    module = Blob()
    return module, ob.torch_field(module, step=1 / 64, box=BOX)


def jax_blob():
    jax = pytest.importorskip("jax", reason="jax is not installed: its fields are not tested")
    return None, ob.jax_field(lambda x, d: blob(jax.numpy, x, d), step=1 / 64, box=BOX)


@pytest.fixture(params=[torch_blob, jax_blob], ids=["torch", "jax"])
def made(request):
    return request.param()


def numpy_blob(x, d):
    return blob(np, x, d)


numpy_blob.step = 1 / 64


def test_values_and_derivatives_are_those_of_the_function(made, points):
    _, f = made
    d = np.tile(np.float32([0.6, 0.0, 0.8]), (len(points), 1))
    density, _, slope, color_gradient = (np.asarray(part) for part in f.derivatives(points, d))
    assert density.reshape(-1).shape == (1000,) and slope.shape == (1000, 3) and color_gradient.shape == (1000, 3, 3)
    own_slope, own_tint = derivatives_of_blob(points.astype(np.float64), d)
    # exp in f32 of arguments up to 50 is off by 50 * 2^-24 = 3e-6, relative.
    np.testing.assert_allclose(slope, own_slope, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(color_gradient, own_tint, atol=2e-5)
    for value, own in zip(f(points, d), blob(np, points, d)):
        np.testing.assert_allclose(np.asarray(value).reshape(own.shape), own, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("gradient", ["finite-difference", "analytic"])
def test_u_is_that_of_the_function_in_numpy(made, gradient, cameras, points):
    _, f = made
    own = ob.uncertainty(numpy_blob, cameras, box=BOX, **RUN, step=1 / 64)
    found = ob.uncertainty(f, cameras, gradient=gradient, **RUN, **({} if gradient == "analytic" else {"step": 1 / 64}))
    seen = own.log10(points) < np.log10(own.prior) - 0.5
    assert seen.sum() > 50
    # Truncation: h = 1/1024, and h^2 s'''/6 s' is at most 1600 h^2 / 3 = 5e-4 for a logistic of scale 1/40.
    # Noise: 3e-6 of the density over h, beside slopes of 400: 3e-6 * 40 * 1024 / 400 = 3e-4. Together 4e-4 decades, and
    # what either moves across the octree's tolerance, 0.01.
    assert abs(found.log10(points) - own.log10(points)).max() < 0.012
    assert np.median(abs(found.log10(points) - own.log10(points))[seen]) < 4e-4


def test_derivatives_take_one_forward_pass(points):
    module, f = torch_blob()
    f.derivatives(points, points)
    assert module.forwards == 1


def test_a_networks_own_attributes_are_used(cameras):
    torch = pytest.importorskip("torch", reason="torch is not installed: its fields are not tested")

    class Net(torch.nn.Module):
        step = 1 / 64
        background = "black"

        def __init__(self):
            super().__init__()
            torch.manual_seed(0)
            self.body = torch.nn.Sequential(torch.nn.Linear(3, 32), torch.nn.Softplus(beta=20), torch.nn.Linear(32, 3))
            self.densities = 0

        def density(self, x):
            self.densities += 1
            return 40 * torch.sigmoid(40 * (0.5 - x.norm(dim=-1)))

        def forward(self, x, d):
            return self.density(x), torch.sigmoid(3 * self.body(x))

    net = Net()
    u = ob.uncertainty(ob.torch_field(net), cameras, box=BOX, gradient="analytic", **{**RUN, "march_step": None})
    assert net.densities > 10 and u.record["background"] == [0, 0, 0] and u.record["march_step"] == 1 / 64
    assert u.record["gradient"] == "analytic" and "Net" in u.record["source"]


def test_a_module_without_gradients_says_so(points):
    torch = pytest.importorskip("torch", reason="torch is not installed: its fields are not tested")
    f = ob.torch_field(lambda x, d: (x.detach()[:, 0], x.detach()))
    with pytest.raises(ValueError, match="nerf: expected a module that can be differentiated by position"):
        f.derivatives(points, points)
    del torch


def test_what_is_no_function_gets_a_sentence():
    pytest.importorskip("torch", reason="torch is not installed: its fields are not tested")
    with pytest.raises(ValueError, match="module: expected a torch.nn.Module or a function of tensors, found 3"):
        ob.torch_field(3)
    with pytest.raises(ValueError, match="f: expected a function of JAX arrays, found 3"):
        ob.jax_field(3)
