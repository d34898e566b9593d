"""Files for other tools; that these tools read them is tested where the command line writes them."""

import csv

import numpy as np
import pytest

import octobayes as ob


def header(path):
    return path.read_bytes().split(b"end_header")[0].decode().splitlines()


def test_leaves_say_what_the_field_says(field, tmp_path):
    ob.export(field, tmp_path / "field.npz")
    leaves = np.load(tmp_path / "field.npz")
    assert {"center", "edge", "level", "log10_uncertainty"} <= set(leaves.files), leaves.files
    centers = leaves["center"].astype(np.float32)
    assert abs(leaves["log10_uncertainty"] - field.log10(centers)).max() < 1e-5
    ob.export(field, tmp_path / "field.htg")
    assert b"HyperTreeGrid" in (tmp_path / "field.htg").read_bytes()[:400]


def test_surfaces_of_models_and_callables_are_the_same(field, courtyard, cameras, tmp_path):
    def nerf(x, d):
        return courtyard(x, d)

    nerf.box, nerf.step, nerf.pixel_offset = courtyard.box, courtyard.step, courtyard.pixel_offset
    written = []
    for name, model in (("model", courtyard), ("callable", nerf)):
        path = tmp_path / f"{name}.ply"
        ob.export(field, path, model, cameras, pixels=4000, progress=False)
        count = next(int(line.split()[-1]) for line in header(path) if line.startswith("element vertex"))
        assert "property float scalar_log10_uncertainty" in header(path), header(path)
        written.append(count)
        assert 500 < count < 4500
    assert written[0] == written[1]


def test_a_clean_mesh_is_smaller(field, courtyard, tmp_path):
    counts = []
    for threshold in (None, "50%"):
        path = tmp_path / "mesh.ply"
        ob.export(field, path, courtyard, mesh=True, cells=48, threshold=threshold, progress=False)
        counts.append(next(int(line.split()[-1]) for line in header(path) if line.startswith("element face")))
    assert 0 < counts[1] < 0.9 * counts[0], counts


def test_a_report_has_a_row_for_each_camera(field, courtyard, cameras, tmp_path):
    ob.export(field, tmp_path / "report.csv", courtyard, cameras, pixels=4000, progress=False)
    with open(tmp_path / "report.csv") as file:
        rows = list(csv.DictReader(file))
    assert sum("camera" in str(list(row.values())[:2]) for row in rows) == len(cameras), rows[:2]


def test_what_cannot_be_written_is_said(field, courtyard, tmp_path):
    for path, arguments, message in (
        ("field.xyz", {}, "path: expected a name that ends in .npy, .npz, .htg, .ply, .csv"),
        ("field.ply", {}, "nerf: expected a model beside the field"),
        ("field.csv", {"mesh": True}, "mesh: expected a mesh only in a .ply"),
        ("field.npz", {"ellipsoids": True}, "ellipsoids: expected ellipsoids only with points"),
        ("field.htg", {"threshold": 3.0}, "threshold: expected surfaces to clean"),
        ("field.ply", {"nerf": courtyard, "mesh": True, "cells": 4}, "cells: expected"),
    ):
        with pytest.raises(ValueError, match=message):
            ob.export(field, tmp_path / path, **arguments)
        assert not list(tmp_path.iterdir())
