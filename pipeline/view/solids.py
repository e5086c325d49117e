"""Surfaces of simple solids, round ones about their y axis."""

from __future__ import annotations

import numpy as np
import trimesh

from kinefilter.characters import Shape


def upright_cylinder(radius: float, height: float, *, sections: int) -> trimesh.Trimesh:
    """Return a cylinder about the y axis [m], centered."""
    return _upright(
        trimesh.creation.cylinder(radius=radius, height=height, sections=sections)
    )


def surface_of(shape: Shape) -> trimesh.Trimesh:
    """Return the surface of a shape in its own frame [m]."""
    radius, half = float(shape.size[0]), float(shape.size[1])
    mesh: trimesh.Trimesh
    if shape.kind == "mesh":
        mesh = trimesh.Trimesh(shape.points, shape.triangles, process=False)
    elif shape.kind == "box":
        mesh = trimesh.creation.box(extents=2.0 * shape.size)
    elif shape.kind == "ellipsoid":
        mesh = trimesh.creation.icosphere(subdivisions=3)
        mesh.vertices = mesh.vertices * shape.size
    elif shape.kind == "capsule":
        mesh = _upright(trimesh.creation.capsule(radius=radius, height=2.0 * half))
    else:
        mesh = upright_cylinder(radius, 2.0 * half, sections=32)
    return mesh


def _upright(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a mesh turned so that its z axis, about which it is round, is y."""
    turn = np.eye(4)
    turn[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    mesh.apply_transform(turn)
    return mesh
