"""A NeRF of one's own in PyTorch, trained on pictures from one side, and where it can be trusted.

    python examples/own_nerf.py          (torch and NumPy; about two minutes on two cores)

The pictures are of a built-in scene, so that nothing has to be downloaded, and so that the truth is known.
"""

import itertools

import numpy as np
import torch

import octobayes as ob

BOX = ([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
STEPS, RAYS, SAMPLES = 400, 384, 48
torch.manual_seed(0)

# 1. Pictures, with their cameras. The scene's own cameras all stand on one side.
scene = ob.open_model("scene:courtyard")
cameras = scene.cameras(resolution=(64, 64))
pictures = np.stack([ob.render(scene, None, camera, progress=False)["color"] for camera in cameras])


# 2. A small NeRF, as one writes it.
class Nerf(torch.nn.Module):
    def __init__(self, width: int = 96, octaves: int = 6) -> None:
        super().__init__()
        self.octaves = octaves
        sizes = [3 + 6 * octaves, width, width, width, 4]
        layers = [layer for a, b in itertools.pairwise(sizes) for layer in (torch.nn.Linear(a, b), torch.nn.ReLU())]
        self.body = torch.nn.Sequential(*layers[:-1])

    def forward(self, x: torch.Tensor, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        waves = [f(np.pi * 2**k * x) for k in range(self.octaves) for f in (torch.sin, torch.cos)]
        out = self.body(torch.cat([x, *waves], dim=-1))
        return 10 * torch.nn.functional.softplus(out[:, 0] - 1), torch.sigmoid(out[:, 1:])


def rays_of(camera: dict) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions through the middle of all pixels."""
    width, height = (int(side) for side in camera["size"])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = (x - camera["center"][0]) / camera["focal"][0], (y - camera["center"][1]) / camera["focal"][1]
    d = np.stack([x, -y, -np.ones_like(x)], axis=-1).reshape(-1, 3) @ camera["pose"][:3, :3].T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.broadcast_to(camera["pose"][:3, 3], d.shape), d


origins, directions = (
    torch.from_numpy(np.concatenate(parts)).float() for parts in zip(*(rays_of(camera) for camera in cameras))
)
colors = torch.from_numpy(pictures.reshape(-1, 3))

# 3. Training, against a white background.
nerf = Nerf()
adam = torch.optim.Adam(nerf.parameters(), lr=3e-3)
for step in range(STEPS):
    pick = torch.randint(len(colors), (RAYS,))
    o, d = origins[pick], directions[pick]
    a, b = (-1 - o) / d, (1 - o) / d
    near = torch.minimum(a, b).amax(-1).clamp(min=0)
    far = torch.maximum(a, b).amin(-1).clamp(min=near + 1e-3)
    spacing = (far - near) / SAMPLES
    t = near[:, None] + spacing[:, None] * (torch.arange(SAMPLES) + torch.rand(RAYS, 1))
    x = (o[:, None] + t[..., None] * d[:, None]).clamp(-1, 1)
    density, color = nerf(x.reshape(-1, 3), d[:, None].expand_as(x).reshape(-1, 3))
    depth = density.reshape(RAYS, SAMPLES) * spacing[:, None]
    before = torch.exp(-(depth.cumsum(-1) - depth))
    weights = before * -torch.expm1(-depth)
    seen = (weights[..., None] * color.reshape(RAYS, SAMPLES, 3)).sum(1) + 1 - weights.sum(-1, keepdim=True)
    loss = ((seen - colors[pick]) ** 2).mean()
    adam.zero_grad()
    loss.backward()
    adam.step()
    if step % 100 == 99:
        print(f"step {step + 1}: {-10 * torch.log10(loss):.1f} dB")

# 4. Where can it be trusted?
field = ob.torch_field(nerf.eval(), step=1 / 64)
u = ob.uncertainty(field, cameras, box=BOX, level=6, rays=20_000, occupancy=64, gradient="analytic")
front, back = u.log10([[0.75, -0.5, -0.35], [0.2, -0.5, -0.35]])
print(u)
print(f"log10 U = {front:.1f} on a ball's front, which the cameras saw; {back:.1f} behind it, which they did not")
view = ob.render(field, u, cameras[0])
print("a view:", {name: array.shape for name, array in view.items()})
assert front < back - 1
