"""Drawings in the browser's scene: skin, figures, props, contacts and force."""

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from kinefilter.characters import Body, Clip, Prop
from kinefilter.characters.arrays import Array
from kinefilter.characters.props import UPRIGHT
from kinefilter.characters.rotations import IDENTITY
from kinefilter.characters.skin import skin_of
from kinefilter.pipeline.edits import EditHistory
from kinefilter.pipeline.target.feet import ankles_and_toes

from .cameras import camera_over, camera_path
from .drawing import Color, Drawing, Sensor, StickFigure, left_of

Layer = tuple[Any, Callable[[int], None]]  # what is shown, and what moves it to a frame

_JOINT, _BONE = 0.026, 0.011  # m, radii of stick figures
_BONE_COLOR = (82, 84, 94)
_SKIN = (214, 204, 191)  # nearly gray, so that figures inside keep their colors
_TRANSLUCENT = 0.4  # opacity of the skin with a figure inside
_DISK, _THICK = 0.055, 0.006  # m, radius and height of the disk under a planted foot
_PLANTED = (0, 100, 36)
_BAR = 0.025  # m, radius of the force bar; its height is 1 m per body weight
_ASIDE = 0.55  # m from the pelvis to the bar
_FORCE = (214, 92, 60)
_LEAST_FORCE = 0.01  # body weights: a shorter bar would be invisible
_ASPECT = 1.0  # of the scene beside the panel, at least
_FRAMES = 1000  # frames of a long motion, at least, that the first view must hold
_ROOM = 0.15  # m between a joint and the skin's farthest point
_EDGE = 0.012  # m, thickness of the edges of the sensors' frusta
_NAME, _TOGETHER = 0.2, 1.0  # m between the names of sensors closer than the second
_SKY = ((0.80, 0.86, 0.92), (0.97, 0.98, 0.99))  # overhead, at the horizon
_SKY_ROWS = 64
_FLOOR = 12.0  # m, side of the square that shows shadows
_GROUPS = count()  # for names of props: under a name used before, browsers keep poses


class ViewerScene:
    """A drawing in a browser, in layers (Drawing.layers) that are shown or hidden."""

    def __init__(
        self, server: viser.ViserServer, drawing: Drawing, edits: EditHistory
    ) -> None:
        scene, clip = server.scene, drawing.clip
        scene.reset()
        self._offset = drawing.raw_offset
        self._sun = set_stage(server, drawing)
        self._skin, pose = add_skin(scene, clip.body)
        turns, places = clip.rotations, clip.positions
        self._layers: dict[str, Layer] = {
            "skin": (self._skin, lambda frame: pose(places[frame], turns[frame])),
            "contacts": _add_contacts(scene, clip, edits),
        }
        for name, figure in drawing.figures.items():
            self._layers[name] = _add_sticks(scene, name, figure)
        _add_frusta(scene, drawing.sensors)
        self._inside = drawing.figures.keys() - {"raw"}
        for name, add in (("forces", _add_force), ("props", _add_moving_props)):
            if name in drawing.layers:
                self._layers[name] = add(scene, clip)
        self._shown = set(self._layers)

    def choose(self, names: set[str], *, beside: bool, shadows: bool) -> None:
        """Show these layers only, with the raw take beside or over the character."""
        self._sun.cast_shadow = shadows
        self._shown = names & set(self._layers)
        for name, (handle, _) in self._layers.items():
            handle.visible = name in names
        if "raw" in self._layers:
            self._layers["raw"][0].position = self._offset * beside
        apart = beside and self._offset.any()
        inside = self._inside | (set() if apart else {"raw"})
        self._skin.opacity = _TRANSLUCENT if self._shown & inside else None

    def show(self, frame: int) -> None:
        """Move everything that is shown to where it is in a frame."""
        for name in self._shown:
            self._layers[name][1](frame)


def _add_contacts(scene: viser.SceneApi, clip: Clip, edits: EditHistory) -> Layer:
    parts = np.transpose(ankles_and_toes(clip.skeleton)).ravel()
    places = clip.positions[:, parts] * [1.0, 0.0, 1.0] + [0.0, 0.5 * _THICK, 0.0]
    disk = cylinder(_DISK, _THICK, sections=32)
    disks = add_batch(scene, "/contacts", disk, len(parts), _PLANTED)
    disks.cast_shadow = False

    def update(frame: int) -> None:
        disks.batched_positions = places[frame]
        disks.batched_scales = edits.contacts[frame][:, None].repeat(3, axis=1)

    return disks, update


def _add_sticks(scene: viser.SceneApi, name: str, figure: StickFigure) -> Layer:
    group = scene.add_frame(f"/{name}", show_axes=False)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=_JOINT)
    stick = cylinder(_BONE, 1.0, sections=12)
    color, count = figure.color or _BONE_COLOR, len(figure.skeleton)
    joints = add_batch(scene, f"/{name}/joints", ball, count, color)
    bones = add_batch(scene, f"/{name}/bones", stick, count - 1, color)

    def update(frame: int) -> None:
        now = figure.at(frame)
        there = now.bone_present
        joints.batched_positions = now.joints
        joints.batched_scales = now.joint_present[:, None].repeat(3, axis=1)
        bones.batched_positions, bones.batched_wxyzs = now.centers, now.rotations
        bones.batched_scales = np.stack([there, there * now.lengths, there], axis=1)
        if now.joint_colors is not None:
            joints.batched_colors = _bytes(now.joint_colors)

    return group, update


def _add_frusta(scene: viser.SceneApi, sensors: Sequence[Sensor]) -> None:
    """Add frusta to the sensors' figures, and their names below, one under another."""
    for k, sensor in enumerate(sensors):
        name, edges, foot = sensor.name, sensor.edges, sensor.edges[-1, 1]
        away = [np.linalg.norm(foot - other.edges[-1, 1]) for other in sensors[:k]]
        place = foot - [0.0, _NAME * sum(a < _TOGETHER for a in away), 0.0]
        frustum = f"/{name}/frustum"
        scene.add_line_segments(frustum, edges, sensor.color, thickness=_EDGE)
        scene.add_label(f"/{name}/name", name, position=place, anchor="top-center")


def add_skin(
    scene: viser.SceneApi, body: Body, name: str = "/mesh"
) -> tuple[viser.MeshSkinnedHandle, Callable[[Array, Array], None]]:
    """Add a body's skin; also return the function that poses it.

    It takes joint positions [m] (J, 3) and rotations, quaternions wxyz (J, 4).
    """
    starts, joints = np.maximum(body.skeleton.parents, 0), len(body.skeleton)
    skin = skin_of(body)
    weights = np.zeros((len(skin.points), joints))
    np.put_along_axis(weights, skin.segments, skin.weights, axis=1)
    mesh = scene.add_mesh_skinned(
        name,
        skin.points,
        skin.triangles,
        bone_wxyzs=np.tile(IDENTITY, (joints, 1)),
        bone_positions=body.rest_positions[starts],
        skin_weights=weights,
        color=_SKIN,
    )

    def pose(positions: Array, rotations: Array) -> None:
        for joint, bone in enumerate(mesh.bones):
            bone.position, bone.wxyz = positions[starts[joint]], rotations[joint]

    return mesh, pose


def _add_moving_props(scene: viser.SceneApi, clip: Clip) -> Layer:
    group, frames = add_props(scene, clip.props)

    def update(frame: int) -> None:
        for prop, handle in zip(clip.props, frames, strict=True):
            k = frame if prop.moves else 0
            handle.position, handle.wxyz = prop.positions[k], prop.rotations[k]

    return group, update


def add_props(
    scene: viser.SceneApi, props: Sequence[Prop]
) -> tuple[viser.FrameHandle, list[viser.FrameHandle]]:
    """Add props at their first poses; return the handle of all, and of each."""
    name = f"/props{next(_GROUPS)}"
    group = scene.add_frame(name, show_axes=False)
    frames = []
    for n, prop in enumerate(props):
        frames.append(scene.add_frame(f"{name}/{n}", show_axes=False))
        frames[n].position, frames[n].wxyz = prop.positions[0], prop.rotations[0]
        for k, shape in enumerate(prop.shapes):
            mesh = shape.surface()
            scene.add_mesh_simple(
                f"{name}/{n}/{k}",
                mesh.vertices,
                mesh.faces,
                color=tuple(_bytes(shape.color).tolist()),
                flat_shading=shape.kind in ("box", "mesh"),
                position=shape.position,
                wxyz=shape.rotation,
            )
    return group, frames


def _add_force(scene: viser.SceneApi, clip: Clip) -> Layer:
    """Add a bar beside the character, 1 m high per body weight of external force."""
    mesh = cylinder(_BAR, 1.0, sections=24)
    mesh.apply_translation([0.0, 0.5, 0.0])
    group = scene.add_frame("/force", show_axes=False)
    bar = scene.add_mesh_simple("/force/bar", mesh.vertices, mesh.faces, color=_FORCE)
    label = scene.add_label("/force/label", "", anchor="bottom-center")
    places = clip.root * [1.0, 0.0, 1.0] + _ASIDE * left_of(clip)

    def update(frame: int) -> None:
        force = float(np.nan_to_num(clip.external_force[frame]))
        height = max(force, _LEAST_FORCE)
        group.position = places[frame]
        bar.scale = (1.0, height, 1.0)
        label.position = (0.0, height, 0.0)
        label.text = f"{force:.2f} body weights"

    return group, update


def set_stage(
    server: viser.ViserServer, drawing: Drawing
) -> viser.DirectionalLightHandle:
    """Set up sky, floor, lights and a camera on a drawing; return the sun."""
    scene, clip = server.scene, drawing.clip
    scene.set_up_direction("+y")
    sky = _bytes(np.linspace(*_SKY, _SKY_ROWS))[:, None]
    # No environment map as a light: without a GPU, filtering it takes seconds.
    scene.configure_environment_map(None)
    scene.set_background_image(sky.repeat(2, axis=1), "png")
    scene.add_grid(
        "/floor",
        _FLOOR,
        _FLOOR,
        plane="xz",
        cell_color=(205, 207, 211),
        section_color=(170, 173, 180),
        infinite_grid=True,
        fade_distance=25.0,
        shadow_opacity=0.2,
    )
    scene.configure_default_lights(False)
    scene.add_light_hemisphere(
        "/sky", sky_color=(255,) * 3, ground_color=(190, 186, 180), intensity=1.7
    )
    some = clip.positions[:: max(1, len(clip) // _FRAMES)]
    joints = np.concatenate([some, some + drawing.raw_offset], axis=1)
    points = np.concatenate([joints + _ROOM, joints - _ROOM], axis=1)
    if drawing.sensors:
        edges = np.array([sensor.edges for sensor in drawing.sensors])
        names = edges[:, -1, 1] - [0.0, _NAME * len(edges), 0.0]
        points = np.vstack([some.reshape(-1, 3), edges.reshape(-1, 3), names])
        camera = camera_over(points, edges[:, 0, 0], aspect=_ASPECT)
    else:
        camera = camera_path("front", clip, points, aspect=_ASPECT, rate=clip.fps)
    if not server.get_clients():  # a camera that is already in use stays
        server.initial_camera.position, server.initial_camera.look_at = camera.at(0)
        server.initial_camera.fov = np.radians(camera.fov)
    front = camera.toward * [1.0, 0.0, 1.0]
    front /= np.linalg.norm(front)
    left = np.array([-front[2], 0.0, front[0]])  # of the picture
    return scene.add_light_directional(
        "/sun",
        intensity=2.0,
        cast_shadow=True,
        position=tuple(0.5 * front + 0.45 * left + [0.0, 1.0, 0.0]),
    )


def add_batch(
    scene: viser.SceneApi, name: str, mesh: trimesh.Trimesh, count: int, color: Color
) -> Any:
    """Add copies of a mesh, with scale 0 until they are placed; viser casts arrays."""
    return scene.add_batched_meshes_simple(
        name,
        mesh.vertices,
        mesh.faces,
        batched_wxyzs=np.tile(IDENTITY, (count, 1)),
        batched_positions=np.zeros((count, 3)),
        batched_scales=np.zeros((count, 3)),
        batched_colors=np.full((count, 3), color, dtype=np.uint8),
        lod="off",
    )


def cylinder(radius: float, height: float, *, sections: int) -> trimesh.Trimesh:
    """Return a cylinder along y, centered on the origin [m]."""
    make: Callable[..., trimesh.Trimesh] = trimesh.creation.cylinder
    return make(radius, height, sections, transform=UPRIGHT)


def _bytes(colors: Any) -> NDArray[np.uint8]:
    return np.rint(np.asarray(colors) * 255.0).astype(np.uint8)
