"""`.npz` in NumPy and `.htg` in VTK: the leaves, and what the field says in them."""

import numpy as np
import pytest
import vtk
from vtk.util.numpy_support import vtk_to_numpy

BOXES = ["octree.oct", "dense.oct"]
ALL = [*BOXES, "contracted.oct"]


def leaves(desk, field):
    desk.run(f"export {field} -o leaves.npz")
    return np.load(desk.path("leaves.npz"))


@pytest.mark.parametrize("field", BOXES)
def test_leaves_fill_the_box_once(desk, field):
    found, info = leaves(desk, field), desk.info(field)
    bounds = np.array(box_of(info))
    assert np.isclose(found["edge"].prod(axis=1).sum(), np.prod(bounds[1] - bounds[0]), rtol=1e-9)
    size = (bounds[1] - bounds[0]) / 2.0 ** found["level"][:, None]
    assert np.allclose(found["edge"], size, rtol=1e-9)
    assert np.allclose(found["center"], bounds[0] + (found["index"] + 0.5) * size, rtol=0, atol=1e-9)
    # No two leaves are the same cell.
    cells = np.column_stack([found["level"], found["index"]])
    assert len(np.unique(cells, axis=0)) == len(cells)
    if info["octree"]:
        assert len(cells) == sum(info["octree"]["leaves_per_level"])


def box_of(info):
    box = info["domain"]["Box"]
    return [box["min"], box["max"]]


@pytest.mark.parametrize("field", ALL)
def test_leaves_say_what_queries_say(desk, field):
    found = leaves(desk, field)
    # Far away in a contraction neighbouring floats are other places.
    near = np.abs(found["center"]).max(axis=1) < 100
    asked = desk.query(field, found["center"][near])
    assert np.allclose(found["log10_uncertainty"][near], asked["log10_uncertainty"], atol=2e-5)
    assert np.allclose(found["rays"][near], asked["rays"], rtol=1e-3, atol=0.01)
    assert (np.array(["unseen", "free", "constrained"])[found["seen"][near]] == asked["seen"]).mean() > 0.999
    if field != "dense.oct":
        assert np.array_equal(found["level"][near], asked["level"])
    assert found["log10_uncertainty"].max() <= found["prior_log10_uncertainty"] + 1e-4


def test_covariances_have_the_uncertainty_as_trace(desk):
    found = leaves(desk, "octree.oct")
    matrices = found["covariance"].astype(float)
    assert np.array_equal(matrices, matrices.transpose(0, 2, 1))
    assert np.allclose(0.5 * np.log10(np.trace(matrices, axis1=1, axis2=2)), found["log10_uncertainty"], atol=1e-5)
    assert "covariance" not in leaves(desk, "dense.oct"), "its sums were not kept"


def walk(grid):
    """All cells of a hyper tree grid: level, centre, index into its arrays, and whether it is a leaf."""
    cursor = vtk.vtkHyperTreeGridNonOrientedGeometryCursor()
    grid.InitializeNonOrientedGeometryCursor(cursor, 0, False)
    cells = []

    def visit():
        bounds = [0.0] * 6
        cursor.GetBounds(bounds)
        center = [0.5 * (bounds[2 * k] + bounds[2 * k + 1]) for k in range(3)]
        cells.append((cursor.GetLevel(), *center, cursor.GetGlobalNodeIndex(), cursor.IsLeaf()))
        if not cursor.IsLeaf():
            for child in range(8):
                cursor.ToChild(child)
                visit()
                cursor.ToParent()

    visit()
    cells = np.array(cells)
    return cells[:, 0].astype(int), cells[:, 1:4], cells[:, 4].astype(int), cells[:, 5].astype(bool)


@pytest.mark.parametrize("field", ALL)
def test_vtk_reads_the_octree_as_it_is(desk, field):
    desk.run(f"export {field} -o tree.htg")
    reader = vtk.vtkXMLHyperTreeGridReader()
    reader.SetFileName(desk.path("tree.htg"))
    reader.Update()
    grid = reader.GetOutput()
    found = leaves(desk, field)
    assert grid.GetNumberOfLeaves() == len(found["level"])
    data = grid.GetCellData()
    names = ["log10_uncertainty", "level", "rays", "seen"]
    arrays = {name: vtk_to_numpy(data.GetArray(name)) for name in names}
    level, center, index, is_leaf = walk(grid)
    assert len(np.unique(index)) == grid.GetNumberOfCells()
    assert np.array_equal(arrays["level"][index], level)
    # The same leaves in the same order: VTK descends as we do.
    assert np.array_equal(level[is_leaf], found["level"])
    for name in names:
        assert np.array_equal(arrays[name][index[is_leaf]], found[name]), name
    if field in BOXES:
        assert np.allclose(center[is_leaf], found["center"], atol=1e-9)
        split = desk.query(field, center[~is_leaf])
        assert np.allclose(arrays["log10_uncertainty"][index[~is_leaf]], split["log10_uncertainty"], atol=2e-5)
    else:
        unfolded = np.linalg.norm(found["center"], axis=1) < 0.59
        assert unfolded.sum() > 100
        assert np.allclose(center[is_leaf][unfolded], found["center"][unfolded], atol=1e-9)
