"""A clip as a MuJoCo model: the skin, the things around it, a floor and light.

Nothing is simulated: every segment and every thing is a body that is put where the clip
says.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from kinefilter.characters import Body, Clip, Prop, Shape
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.skin import skin_of

FLOOR_GROUP = 1
"""Group of the geoms that a camera at rest sees the same in every frame."""

_SKIN = (0.80, 0.76, 0.70)  # nearly gray: a figure inside keeps its colors
_TRANSLUCENT = 0.35  # of the skin, where a figure is drawn inside it
_SKY = ((0.97, 0.98, 0.99), (0.80, 0.85, 0.91))  # at the horizon, overhead
_TILES = ((0.80, 0.81, 0.82), (0.85, 0.86, 0.87))
_LINES = (0.66, 0.67, 0.69)
_TILES_A_METER = 1.0  # squares of half a meter, two of them a period of the texture
_FACETS = (16, 8)  # around and along what is round: more cost more than they show
_LIGHT_AWAY = 4.0  # m, above everything
_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}


class Scene:
    """The model of a clip, posed frame by frame.

    Args:
        clip: What is shown.
        props: What is around it, in the frames of the clip.
        size: Width and height of the pictures in pixels.
        samples: Samples a pixel.
        facing: Where most of the light comes from, unit vector, world frame.
        reach: How far [m] from its middle there is something to see.
        translucent: Whether something is drawn inside the character.
        figure: Names of spheres that whoever draws a figure of them gives a shape.
    """

    def __init__(
        self,
        clip: Clip,
        props: tuple[Prop, ...],
        *,
        size: tuple[int, int],
        samples: int,
        facing: Array,
        reach: float,
        translucent: bool = False,
        figure: Sequence[str] = (),
    ) -> None:
        spec = mujoco.MjSpec()
        spec.visual.global_.offwidth, spec.visual.global_.offheight = size
        spec.visual.quality.offsamples = samples
        spec.stat.extent = max(reach, 1.0)
        middle = to_mujoco(clip.positions[:, clip.skeleton.root]).mean(axis=0)
        spec.stat.center = middle
        _add_room(spec)
        _add_light(spec, to_mujoco(facing), middle)
        _add_character(spec, clip.body, _TRANSLUCENT if translucent else 1.0)
        for prop in props:
            _add_prop(spec, prop)
        for name in figure:
            spec.worldbody.add_geom(name=name, size=[0.01, 0.01, 0.01])
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        parents = clip.skeleton.parents
        starts = [p if p >= 0 else j for j, p in enumerate(parents)]
        poses = [(clip.positions[:, starts], clip.rotations)]
        poses += [
            (
                np.broadcast_to(p.positions, (len(clip), 3))[:, None],
                np.broadcast_to(p.rotations, (len(clip), 4))[:, None],
            )
            for p in props
        ]
        self._positions = to_mujoco(np.concatenate([p for p, _ in poses], axis=1))
        self._rotations = to_mujoco(np.concatenate([q for _, q in poses], axis=1))

    def pose(self, frame: int) -> None:
        """Put everything where it is in a frame of the clip."""
        self.data.mocap_pos[:] = self._positions[frame]
        self.data.mocap_quat[:] = self._rotations[frame]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)


def _add_room(spec: mujoco.MjSpec) -> None:
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
    skeleton, skin = body.skeleton, skin_of(body)
    rest = to_mujoco(body.rest_positions)
    starts = rest[[p if p >= 0 else j for j, p in enumerate(skeleton.parents)]]
    for joint, start in zip(skeleton.joints, starts, strict=True):
        spec.worldbody.add_body(name=f"segment:{joint}", mocap=True, pos=start)
    moved = [
        np.nonzero((skin.segments == j) & (skin.weights > 0.0))
        for j in range(len(skeleton))
    ]
    bones = [j for j, (points, _) in enumerate(moved) if len(points)]
    quads = skin.quads
    mesh = spec.add_skin(name="skin")
    mesh.vert = to_mujoco(skin.points).ravel()
    mesh.face = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).ravel()
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
            _add_mesh(spec, geom.meshname, shape)
        else:
            geom.size = _mujoco_size(shape)


def _mujoco_size(shape: Shape) -> Array:
    """Return a solid's size as MuJoCo has it: round ones by radius, then height."""
    depth, width, height = to_mujoco(shape.size)
    if shape.kind in ("cylinder", "capsule"):
        return np.array([width, height, 0.0])
    return np.array([depth, width, height])


def _add_mesh(spec: mujoco.MjSpec, name: str, shape: Shape) -> None:
    mesh = spec.add_mesh(name=name)
    mesh.uservert = to_mujoco(shape.points).ravel()
    mesh.userface = shape.triangles.ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it may be open
