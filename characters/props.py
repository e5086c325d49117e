"""Props of a scene: solid shapes and their motion."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, get_args

import numpy as np

from .arrays import Array, Indices, check_arrays, check_choice, check_kind, freeze
from .errors import InputError
from .rotations import rotate

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
"""Corners of a cube with edges of length 2, shape (8, 3)."""
UPRIGHT = np.eye(4)[[0, 2, 1, 3]] * [[1.0], [1.0], [-1.0], [1.0]]
"""Homogeneous matrix (4, 4) that turns the z axis to y."""
ShapeKind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]


@dataclass(frozen=True, eq=False)
class Shape:
    """A solid in the frame of its prop."""

    kind: ShapeKind
    """Kind of solid; the axis of cylinders and capsules is their own y axis."""
    size: Array
    """Half extents along its own axes [m], shape (3,); y excludes a capsule's caps."""
    position: Array  # center in the prop's frame [m], shape (3,)
    rotation: Array  # rotation in the prop's frame, unit quaternion wxyz, shape (4,)
    color: Array  # red, green and blue in sRGB, 0 to 1, shape (3,)
    points: Array  # points of a mesh [m], shape (P, 3); empty for other kinds
    triangles: Indices  # indices of points, counterclockwise from outside, shape (F, 3)

    def __post_init__(self) -> None:
        shapes: dict[str, Any] = {"rotation": (4,)}
        shapes |= dict.fromkeys(("size", "position", "color"), (3,))
        shapes |= dict.fromkeys(("points", "triangles"), (None, 3))
        check_arrays(self, "a prop", shapes, finite=True)
        check_choice(self.kind, get_args(ShapeKind), "kind of shape")
        corners = self.triangles
        if not np.isin(corners, np.arange(len(self.points))).all():
            raise InputError(
                f"a prop's triangles must be indices of its {len(self.points)} points, "
                "counted from 0"
            )
        object.__setattr__(self, "triangles", corners.astype(np.intp))
        if self.kind == "mesh" and not len(self.points):
            raise InputError("a mesh has no points; add some or leave it out")
        freeze(self)

    @property
    def half_extents(self) -> Array:
        """Half the size of its bounding box along its own axes [m], shape (3,)."""
        if self.kind == "mesh":
            return np.asarray(np.abs(self.points).max(axis=0))
        cap = float(self.size[0]) if self.kind == "capsule" else 0.0
        return np.asarray(self.size + np.array([0.0, cap, 0.0]))

    @property
    def corners(self) -> Array:
        """Corners of that box in the prop's frame [m], shape (8, 3)."""
        return self.position + rotate(self.rotation, CORNERS * self.half_extents)

    def surface(self) -> Any:
        """Return its surface [m] in the frame of its own axes, as trimesh.Trimesh."""
        import trimesh  # slow to import

        radius, half = float(self.size[0]), float(self.size[1])
        if self.kind == "mesh":
            return trimesh.Trimesh(self.points, self.triangles, process=False)
        make = trimesh.creation
        if self.kind == "box":
            return make.box(extents=2.0 * self.size)
        if self.kind == "cylinder":
            return make.cylinder(radius, 2.0 * half, 32, transform=UPRIGHT)
        if self.kind == "capsule":
            return make.capsule(2.0 * half, radius, transform=UPRIGHT)
        mesh = make.icosphere(subdivisions=3)
        mesh.vertices = mesh.vertices * self.size
        return mesh


@dataclass(frozen=True, eq=False)
class Prop:
    """A rigid object of one or more shapes, and its motion."""

    name: str  # name, unique in a clip
    shapes: tuple[Shape, ...]
    positions: Array
    """Position [m], world frame, shape (T, 3), or (1, 3) if it never moves."""
    rotations: Array  # rotation, unit quaternions wxyz, shape (T, 4) or (1, 4)

    def __post_init__(self) -> None:
        check_kind(self.name, str, "the name of a prop")
        check_kind(self.shapes, tuple, f"prop {self.name}: its shapes")
        for shape in self.shapes:
            check_kind(shape, Shape, f"prop {self.name}: a shape")
        check_arrays(self, "a prop", {"positions": (None, 3)}, finite=True)
        turns = {"rotations": (len(self.positions), 4)}
        check_arrays(self, "a prop", turns, finite=True)
        freeze(self)

    @property
    def moves(self) -> bool:
        """True if it has a position for every frame."""
        return len(self.positions) > 1

    def at(self, frames: Any) -> Prop:
        """Return the prop in some frames of the clip: a slice, indices or flags."""
        if not self.moves:
            return self
        places, turns = self.positions[frames], self.rotations[frames]
        return Prop(self.name, self.shapes, places, turns)
