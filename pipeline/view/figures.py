"""What a browser shows of a motion: stick figures, the skin and things."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from kinefilter.characters import Clip, Prop, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, between
from kinefilter.characters.skin import skin_of
from kinefilter.pipeline.render.reliability_colors import reliability_colors

from .solids import surface_of, upright_cylinder

Color = tuple[float, float, float]

_JOINT, _BONE = 0.026, 0.011  # m, radii of what is drawn
_AXIS = np.array([0.0, 1.0, 0.0])  # of the cylinder that a bone is
_BONE_COLOR = (0.32, 0.33, 0.37)
_SKIN = (0.84, 0.80, 0.75)  # nearly gray: a figure inside keeps its colors
_TRANSLUCENT = 0.4  # of the skin, where a figure is inside it


class Layer(Protocol):
    """Something that is shown or hidden as a whole."""

    def show(self, frame: int) -> None:
        """Put it where it is in a frame."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""


class StickFigure:
    """Spheres and cylinders where a motion has joints and bones.

    Args:
        scene: Where it is drawn.
        name: What it is called there.
        skeleton: The joints.
        positions: Joint positions [m], world frame, NaN: missing, shape (T, J, 3).
        color: Of every joint and bone; None: bones are gray, joints say by their color
            how reliable they are.
        reliability: Rates that give these colors, shape (T, J).
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        skeleton: Skeleton,
        positions: Array,
        *,
        color: Color | None = None,
        reliability: Array | None = None,
    ) -> None:
        self._positions, self._reliability = positions, reliability
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._frame = scene.add_frame(f"/{name}", show_axes=False)
        self._joints = _instances(
            scene,
            f"/{name}/joints",
            trimesh.creation.icosphere(subdivisions=2, radius=_JOINT),
            len(skeleton),
            color or _BONE_COLOR,
        )
        self._bones = _instances(
            scene,
            f"/{name}/bones",
            upright_cylinder(_BONE, 1.0, sections=12),
            len(self._ends),
            color or _BONE_COLOR,
        )

    def show(self, frame: int) -> None:
        """Put joints and bones where they are in a frame; none where one is missing."""
        points = self._positions[frame]
        known = np.isfinite(points).all(axis=1)
        points = np.where(known[:, None], points, 0.0)
        bones = points[self._ends] - points[self._starts]
        lengths = np.linalg.norm(bones, axis=1)
        there = known[self._ends] & known[self._starts]
        scales = np.stack([there, there * lengths, there], axis=1)
        self._joints.batched_positions = _float32(points)
        self._joints.batched_scales = _float32(np.repeat(known[:, None], 3, axis=1))
        self._bones.batched_positions = _float32(
            0.5 * (points[self._ends] + points[self._starts])
        )
        self._bones.batched_wxyzs = _float32(between(_AXIS, bones))
        self._bones.batched_scales = _float32(scales)
        if self._reliability is not None:
            colors = reliability_colors(np.nan_to_num(self._reliability[frame]))
            self._joints.batched_colors = _bytes(colors)

    def move(self, way: Array) -> None:
        """Draw it so far [m] from where it is, shape (3,)."""
        self._frame.position = way

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        self._frame.visible = visible


class SkinFigure:
    """The skin of a clip's body, moved by its bones.

    Args:
        scene: Where it is drawn.
        clip: The motion.
    """

    def __init__(self, scene: viser.SceneApi, clip: Clip) -> None:
        skin, skeleton = skin_of(clip.body), clip.skeleton
        rest = clip.body.rest_positions
        starts = [p if p >= 0 else j for j, p in enumerate(skeleton.parents)]
        weights = np.zeros((len(skin.points), len(skeleton)))
        np.put_along_axis(weights, skin.segments, skin.weights, axis=1)
        quads = skin.quads
        self._positions = clip.positions[:, starts]
        self._rotations = clip.rotations
        self._mesh = scene.add_mesh_skinned(
            "/mesh",
            skin.points,
            np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
            bone_wxyzs=np.tile(IDENTITY, (len(skeleton), 1)),
            bone_positions=rest[starts],
            skin_weights=weights,
            color=_color(_SKIN),
        )

    def show(self, frame: int) -> None:
        """Move every bone to where it is in a frame."""
        places, turns = self._positions[frame], self._rotations[frame]
        for bone, place, turn in zip(self._mesh.bones, places, turns, strict=True):
            bone.position = place
            bone.wxyz = turn

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        self._mesh.visible = visible

    def set_translucent(self, translucent: bool) -> None:
        """Let one see what is inside, or not."""
        self._mesh.opacity = _TRANSLUCENT if translucent else None


class Things:
    """The props of a clip.

    Args:
        scene: Where they are drawn.
        props: The things.
    """

    def __init__(self, scene: viser.SceneApi, props: tuple[Prop, ...]) -> None:
        self._props = props
        self._frames = [
            scene.add_frame(f"/thing {n}", show_axes=False) for n in range(len(props))
        ]
        for n, prop in enumerate(props):
            for k, shape in enumerate(prop.shapes):
                mesh = surface_of(shape)
                scene.add_mesh_simple(
                    f"/thing {n}/{k}",
                    mesh.vertices,
                    mesh.faces,
                    color=_color(shape.color),
                    flat_shading=shape.kind in ("box", "mesh"),
                    position=shape.position,
                    wxyz=shape.rotation,
                )

    def show(self, frame: int) -> None:
        """Put everything where it is in a frame."""
        for prop, handle in zip(self._props, self._frames, strict=True):
            k = frame if prop.moves else 0
            handle.position, handle.wxyz = prop.positions[k], prop.rotations[k]

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of it."""
        for handle in self._frames:
            handle.visible = visible


def _instances(
    scene: viser.SceneApi, name: str, mesh: trimesh.Trimesh, count: int, color: Color
) -> viser.BatchedMeshHandle:
    """Return many of a mesh, none of which has a place yet."""
    return scene.add_batched_meshes_simple(
        name,
        mesh.vertices,
        mesh.faces,
        batched_wxyzs=np.tile(IDENTITY, (count, 1)),
        batched_positions=np.zeros((count, 3)),
        batched_scales=np.zeros((count, 3)),
        batched_colors=_bytes(np.tile(color, (count, 1))),
        lod="off",
    )


def _float32(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _bytes(colors: Array | Color) -> NDArray[np.uint8]:
    return np.rint(np.asarray(colors) * 255.0).astype(np.uint8)


def _color(color: Array | Color) -> tuple[int, int, int]:
    red, green, blue = _bytes(color).tolist()
    return red, green, blue
