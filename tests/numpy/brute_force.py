"""The posterior of samples.npz by brute force in NumPy, without the crate.

Its result is expected.npy for crates/cli/tests/cli/accumulate.rs.

For every vertex of the 8^3 lattice over [-1, 1]^3: S = sum over rays of J^T J, J = sum over the ray's samples of
phi_v(x) G. Rows of the result: lattice x, y, z, then S as xx, xy, xz, yy, yz, zz; vertices that no sample touches are
left out.
"""
import numpy as np

data = np.load("samples.npz")
M = 8
u = (data["positions"].astype(np.float64) + 1.0) / 2.0 * M
inside = ((u >= 0) & (u <= M)).all(axis=1)
rows = []
for x in range(M + 1):
    for y in range(M + 1):
        for z in range(M + 1):
            phi = np.clip(1.0 - np.abs(u - [x, y, z]), 0.0, None).prod(axis=1) * inside
            S = np.zeros((3, 3))
            for r in np.unique(data["ray"]):
                k = data["ray"] == r
                J = (phi[k, None, None] * data["jacobian"][k].astype(np.float64)).sum(axis=0)
                S += J.T @ J
            if S.any():
                rows.append([x, y, z, S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]])
np.save("expected.npy", np.array(rows))
