"""Models that the library reads, as callables."""

import json

import numpy as np
import pytest

import octobayes as ob


def test_a_model_answers_like_any_callable(courtyard, points):
    directions = np.tile(np.float32([0, 0, 1]), (len(points), 1))
    density, color = courtyard(points, directions)
    assert density.shape == (1000,) and density.dtype == np.float32 and density.max() > 100
    assert color.shape == (1000, 3) and color.dtype == np.float32
    assert np.array_equal(courtyard.density(points), density)
    assert courtyard.box.tolist() == [[-1, -1, -1], [1, 1, 1]] and courtyard.step > 0


def voxels(folder, n=24):
    """A smooth blob in a voxel grid, whose derivatives are known."""
    axis = np.linspace(-1, 1, n)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = np.maximum(0, 40 * (1 - 2 * np.sqrt(x**2 + y**2 + z**2))).astype(np.float32)
    color = np.stack([0.5 + 0.4 * np.sin(5 * v) for v in (x, y, z)], axis=-1).astype(np.float32)
    path = folder / "blob.npz"
    np.savez(path, density=density, color=color, box=np.float32([[-1, -1, -1], [1, 1, 1]]))
    return path


def test_derivatives_are_those_of_the_values(points, tmp_path):
    model = ob.open_model(voxels(tmp_path))
    assert model.is_differentiable
    x = points[np.linalg.norm(points, axis=1) < 0.4]
    d = np.tile(np.float32([0, 0, 1]), (len(x), 1))
    density, color, slope, color_gradient = model.derivatives(x, d)
    assert slope.shape == (len(x), 3) and color_gradient.shape == (len(x), 3, 3)
    own_density, own_color = model(x, d)
    np.testing.assert_allclose(density, own_density, rtol=1e-6)
    np.testing.assert_allclose(color, own_color, rtol=1e-6)
    h = 1e-3
    for axis in range(3):
        step = h * np.eye(3, dtype=np.float32)[axis]
        (up, c_up), (down, c_down) = model(x + step, d), model(x - step, d)
        # Trilinear functions are straight along an axis, but for points within h of a cell's face.
        near = abs(((x[:, axis] + 1) / 2 * 23 + 0.5) % 1 - 0.5) < 2 * h * 23 / 2
        # f32 densities up to 40 are rounded by 2e-6, and divided by 2 h.
        np.testing.assert_allclose(((up - down) / (2 * h))[~near], slope[~near, axis], atol=0.02)
        np.testing.assert_allclose(((c_up - c_down) / (2 * h))[~near], color_gradient[~near][:, :, axis], atol=1e-3)


def test_a_scene_without_derivatives_says_so(courtyard, points):
    assert not courtyard.is_differentiable
    with pytest.raises(ValueError, match="derivatives: expected a model that differentiates itself"):
        courtyard.derivatives(points, points)


#: Layers of nerf-pytorch's network, with their outputs and inputs.
LAYERS = {
    "layer1": (128, 63), "layers_xyz.0": (128, 128), "layers_xyz.1": (128, 128), "layers_xyz.2": (128, 128),
    "fc_alpha": (1, 128), "fc_feat": (128, 128), "layers_dir.0": (64, 155), "fc_rgb": (3, 64),
}  # fmt: skip


@pytest.mark.parametrize("is_archive", [True, False], ids=["archive", "before 1.6"])
def test_checkpoints_of_torch_are_read_without_it(points, tmp_path, is_archive):
    torch = pytest.importorskip("torch")
    torch.manual_seed(5)
    fine = {}
    for name, (outputs, inputs) in LAYERS.items():
        # A view across its storage, as some programs save them.
        fine[f"{name}.weight"] = (2 * torch.randn(inputs, outputs) / inputs**0.5).T
        fine[f"{name}.bias"] = torch.rand(2, outputs)[1]
    coarse = {name: torch.zeros(values.shape) for name, values in fine.items()}
    adam = {"state": {0: {"step": 3, "exp_avg": torch.zeros(7)}}, "param_groups": [{"lr": 5e-4, "params": [0]}]}
    state = {"iter": 7, "model_coarse_state_dict": coarse, "model_fine_state_dict": fine, "optimizer_state_dict": adam}
    path = tmp_path / "checkpoint7.ckpt"
    torch.save(state | {"loss": torch.tensor(0.1)}, path, _use_new_zipfile_serialization=is_archive)

    header, raw = {}, b""
    for name, values in fine.items():
        bytes_ = values.contiguous().numpy().tobytes()
        offsets = [len(raw), len(raw) + len(bytes_)]
        header[f"fine.{name}"] = {"dtype": "F32", "shape": list(values.shape), "data_offsets": offsets}
        raw += bytes_
    text = json.dumps(header).encode()
    (tmp_path / "model.safetensors").write_bytes(len(text).to_bytes(8, "little") + text + raw)

    directions = np.tile(np.float32([0.6, 0, 0.8]), (len(points), 1))
    found, expected = (ob.open_model(tmp_path / name)(points, directions) for name in (path.name, "model.safetensors"))
    assert expected[0].max() > 0.1 and np.ptp(expected[1]) > 0.1
    assert all(np.array_equal(a, b) for a, b in zip(found, expected))


def test_wrong_arguments_get_a_sentence(courtyard, points, tmp_path):
    with pytest.raises(
        ValueError, match=r"d: expected an array of real numbers of shape \[1000, 3\], found an array of shape \[999"
    ):
        courtyard(points, points[1:])
    with pytest.raises(ValueError, match=r"x: expected .*\[N, 3\], found an array of shape \[3000\]"):
        courtyard(points.ravel(), points)
    with pytest.raises(ValueError, match=r"found `\.bin`"):
        ob.open_model(tmp_path / "model.bin")
    with pytest.raises(FileNotFoundError, match="none.npz"):
        ob.open_model(tmp_path / "none.npz")
    with pytest.raises(ValueError, match="coordinates: expected 'ngp' or 'blender', found 'colmap'"):
        ob.open_model("scene:courtyard", coordinates="colmap")
    with pytest.raises(ValueError, match="name: expected a path, found 3"):
        ob.open_model(3)
