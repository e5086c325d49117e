"""A drawing as a MuJoCo model: skin, raw figure, props, floor and light.

Nothing is simulated: every segment and prop is a body that is put where the clip says.
"""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters import Body, Prop, Shape, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import matrix_from_wxyz

from .drawing import Drawing
from .figures import segment_poses, segment_starts, skin_triangles

FLOOR_GROUP = 1
"""Group of the geoms that a camera at rest sees the same in every frame."""

_SKIN = (0.80, 0.76, 0.70)  # nearly gray: a figure inside keeps its colors
_TRANSLUCENT = 0.35  # opacity of the skin where a figure is drawn inside it
_JOINT, _BONE = 0.032, 0.012  # m, radii of the raw figure
_BONE_COLOR = (0.25, 0.25, 0.28)
_SKY = ((0.97, 0.98, 0.99), (0.80, 0.85, 0.91))  # at the horizon, overhead
_TILES = ((0.80, 0.81, 0.82), (0.85, 0.86, 0.87))
_LINES = (0.66, 0.67, 0.69)
_TILES_A_METER = 1.0  # squares of half a meter, two of them a period of the texture
_FACETS = (16, 8)  # around and along round shapes: more are slow and hardly visible
_LIGHT_AWAY = 4.0  # m, above everything
_LEAST_REACH = 1.5  # m from the middle of the clip that is lit
_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}


class ClipModel:
    """The model of a drawing, posed frame by frame.

    Most light comes from ``toward``, the direction to the camera; the skin is
    translucent where the raw take is drawn inside the character.
    """

    def __init__(
        self,
        drawing: Drawing,
        *,
        size: tuple[int, int],
        samples: int,
        toward: Array,
        translucent: bool = False,
    ) -> None:
        clip, spec = drawing.clip, mujoco.MjSpec()
        spec.visual.global_.offwidth, spec.visual.global_.offheight = size
        spec.visual.quality.offsamples = samples
        spread = clip.positions - clip.root.mean(axis=0)
        spec.stat.extent = max(_LEAST_REACH, np.linalg.norm(spread, axis=-1).max())
        spec.stat.center = middle = to_mujoco(clip.root).mean(axis=0)
        _add_floor_and_sky(spec)
        level = toward * [1.0, 0.0, 1.0]
        _add_light(spec, to_mujoco(level / np.linalg.norm(level)), middle)
        _add_character(spec, clip.body, _TRANSLUCENT if translucent else 1.0)
        for prop in clip.props:
            _add_prop(spec, prop)
        self._raw = drawing.figures.get("raw")
        for name in figure_names(clip.skeleton) if self._raw is not None else ():
            spec.worldbody.add_geom(name=name, size=[0.01, 0.01, 0.01])
        self.model = model = spec.compile()
        self.data = mujoco.MjData(model)
        poses = [segment_poses(clip)]
        poses += [
            (
                np.broadcast_to(p.positions, (len(clip), 3))[:, None],
                np.broadcast_to(p.rotations, (len(clip), 4))[:, None],
            )
            for p in clip.props
        ]
        self._positions = to_mujoco(np.concatenate([p for p, _ in poses], axis=1))
        self._rotations = to_mujoco(np.concatenate([q for _, q in poses], axis=1))
        if self._raw is not None:
            ids = [model.geom(name).id for name in figure_names(clip.skeleton)]
            self._joints, self._bones = np.split(np.array(ids), [len(clip.skeleton)])
            model.geom_type[self._bones] = mujoco.mjtGeom.mjGEOM_CAPSULE
            model.geom_size[self._joints] = _JOINT
            model.geom_size[self._bones, 0] = _BONE
            model.geom_rgba[self._bones, :3] = _BONE_COLOR

    def pose(self, frame: int) -> None:
        """Put everything where it is in a frame of the clip."""
        self.data.mocap_pos[:] = self._positions[frame]
        self.data.mocap_quat[:] = self._rotations[frame]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        if self._raw is None:
            return
        sticks, model, data = self._raw.at(frame), self.model, self.data
        model.geom_rgba[self._joints, :3] = sticks.joint_colors
        model.geom_rgba[self._joints, 3] = sticks.joint_there
        model.geom_rgba[self._bones, 3] = sticks.bone_there
        model.geom_size[self._bones, 1] = 0.5 * np.maximum(sticks.lengths, 1e-6)
        data.geom_xpos[self._joints] = to_mujoco(sticks.joints)
        data.geom_xpos[self._bones] = to_mujoco(sticks.centers)
        turned = matrix_from_wxyz(to_mujoco(sticks.rotations))
        data.geom_xmat[self._bones] = turned.reshape(-1, 9)


def figure_names(skeleton: Skeleton) -> list[str]:
    """Return the names of the raw figure's geoms: the joints, then the bones."""
    joints = [f"joint:{joint}" for joint in skeleton.joints]
    return joints + [f"bone:{skeleton.joints[j]}" for j in skeleton.segments]


def _add_floor_and_sky(spec: mujoco.MjSpec) -> None:
    horizon, overhead = _SKY
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=horizon,
        rgb2=overhead,
        width=128,
        height=128,
    )
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=_TILES[0],
        rgb2=_TILES[1],
        markrgb=_LINES,
        width=512,
        height=512,
    )
    tiles = spec.add_material(
        name="tiles", texuniform=True, texrepeat=[_TILES_A_METER] * 2, specular=0.0
    )
    tiles.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        material="tiles",
        group=FLOOR_GROUP,
    )
    visual = spec.visual
    visual.headlight.ambient = [0.42] * 3
    visual.headlight.diffuse = [0.30] * 3
    visual.headlight.specular = [0.0] * 3
    visual.map.znear, visual.map.zfar = 0.02, 60.0  # of the extent
    visual.map.fogstart, visual.map.fogend = 4.0, 14.0
    visual.map.shadowclip = 1.5
    visual.quality.shadowsize = 4096
    visual.quality.numslices, visual.quality.numstacks = _FACETS
    visual.rgba.fog = visual.rgba.haze = [*horizon, 1.0]


def _add_light(spec: mujoco.MjSpec, front: Array, middle: Array) -> None:
    """Add light from the front, the left and above."""
    left = np.array([-front[1], front[0], 0.0])
    away = -0.5 * front - 0.45 * left - [0.0, 0.0, 1.0]
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=middle - _LIGHT_AWAY * away,  # shadows fall around where it points to
        dir=away,
        diffuse=[0.45] * 3,
        ambient=[0.0] * 3,
        specular=[0.12] * 3,
        castshadow=True,
    )


def _add_character(spec: mujoco.MjSpec, body: Body, opacity: float) -> None:
    """Add the skin and a body for each segment, where the T-pose has them."""
    skeleton = body.skeleton
    starts = to_mujoco(body.rest_positions)[segment_starts(skeleton)]
    for joint, start in zip(skeleton.joints, starts, strict=True):
        spec.worldbody.add_body(name=f"segment:{joint}", mocap=True, pos=start)
    skin, triangles = skin_triangles(body)
    moved = [
        np.nonzero((skin.segments == j) & (skin.weights > 0.0))
        for j in range(len(skeleton))
    ]
    bones = [j for j, (points, _) in enumerate(moved) if len(points)]
    mesh = spec.add_skin(name="skin")
    mesh.vert = to_mujoco(skin.points).ravel()
    mesh.face = triangles.ravel()
    mesh.bodyname = [f"segment:{skeleton.joints[j]}" for j in bones]
    mesh.bindpos = starts[bones].ravel()
    mesh.bindquat = np.tile([1.0, 0.0, 0.0, 0.0], len(bones))
    mesh.vertid = [moved[j][0].tolist() for j in bones]
    mesh.vertweight = [skin.weights[moved[j]].tolist() for j in bones]
    mesh.rgba = [*_SKIN, opacity]


def _add_prop(spec: mujoco.MjSpec, prop: Prop) -> None:
    body = spec.worldbody.add_body(name=f"prop:{prop.name}", mocap=True)
    for k, shape in enumerate(prop.shapes):
        geom = body.add_geom(
            type=_KINDS[shape.kind],
            pos=to_mujoco(shape.position),
            quat=to_mujoco(shape.rotation),
            rgba=[*shape.color, 1.0],
        )
        if shape.kind == "mesh":
            geom.meshname = f"prop:{prop.name}:{k}"
            mesh = spec.add_mesh(name=geom.meshname)
            mesh.uservert = to_mujoco(shape.points).ravel()
            mesh.userface = shape.triangles.ravel()
            # It may be open.
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        else:
            geom.size = _mujoco_size(shape)


def _mujoco_size(shape: Shape) -> Array:
    """Return the size as MuJoCo has it: of round shapes radius, then half height."""
    depth, width, height = to_mujoco(shape.size)
    if shape.kind in ("cylinder", "capsule"):
        return np.array([width, height, 0.0])
    return np.array([depth, width, height])
