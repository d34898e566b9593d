"""Writes a file of ray samples for `octobayes accumulate`: what any other framework would do with its own Jacobians."""
import numpy as np

rng = np.random.default_rng(7)
n, rays_total = 400, 150
positions = rng.uniform(-1.1, 1.1, (n, 3)).astype(np.float32)  # scene units; some lie outside the box
positions[:40] = np.round(positions[:40] * 4) / 4               # some lie on lattice planes and faces
jacobian = (rng.normal(size=(n, 3, 3)) * 10.0 ** rng.uniform(-4, 2, (n, 1, 1))).astype(np.float32)  # dC_c / dx_k
ray = np.sort(rng.integers(0, rays_total, n)).astype(np.uint32)
np.savez("samples.npz", positions=positions, jacobian=jacobian, ray=ray, rays_total=rays_total)
