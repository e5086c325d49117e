"""Drawing with MuJoCo: a model of skin, raw figure, props, floor and light.

Nothing is simulated: segments and props are bodies placed where the clip has them.
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from kinefilter.characters import Body, Prop, Skeleton
from kinefilter.characters.arrays import Array, Singles
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import matrix_from_wxyz
from kinefilter.characters.skin import seams_of, skin_of

from .cameras import CameraPath
from .drawing import Drawing
from .video_files import Pixels

_FLOOR_GROUP = 1  # of the geoms (stage.xml) that do not change while the camera stays
_SKIN = (0.80, 0.76, 0.70)  # nearly gray, so that a figure inside keeps its colors
_TRANSLUCENT = 0.35  # opacity of the skin with a figure inside
_SEAMS, _SEAM = 256, (4, 7)  # pixels of the texture, and half the widths of its lines
_SEAM_COLOR = (110, 60, 40)
_JOINT, _BONE = 0.032, 0.012  # m, radii of the raw figure
_BONE_COLOR = (0.25, 0.25, 0.28)
_LIGHT_AWAY = 4.0  # m, above everything
_LEAST_REACH = 1.5  # m around the middle of the clip that are lit
_MORE_GEOMS = 100  # that MuJoCo itself may add to those of the model


class ClipModel:
    """The model of a drawing, posed frame by frame.

    Most light comes from ``toward``, the direction to the camera. ``seams`` are lines
    on the skin that show twist; ``translucent`` shows the raw take inside it.
    """

    def __init__(
        self,
        drawing: Drawing,
        *,
        size: tuple[int, int],
        samples: int,
        toward: Array,
        seams: bool = False,
        translucent: bool = False,
    ) -> None:
        stage = Path(__file__).with_name("stage.xml")  # sky, floor and fog
        clip, spec = drawing.clip, mujoco.MjSpec.from_file(str(stage))
        spec.visual.global_.offwidth, spec.visual.global_.offheight = size
        spec.visual.quality.offsamples = samples
        spread = clip.positions - clip.root.mean(axis=0)
        spec.stat.extent = max(_LEAST_REACH, np.linalg.norm(spread, axis=-1).max())
        spec.stat.center = middle = to_mujoco(clip.root).mean(axis=0)
        level = toward * [1.0, 0.0, 1.0]
        front = to_mujoco(level / np.linalg.norm(level))
        left = np.array([-front[1], front[0], 0.0])
        away = -0.5 * front - 0.45 * left - [0.0, 0.0, 1.0]
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=middle - _LIGHT_AWAY * away,  # shadows fall around where it aims
            dir=away,
            diffuse=[0.45] * 3,
            specular=[0.12] * 3,
        )
        skin = _add_character(spec, clip.body, _TRANSLUCENT if translucent else 1.0)
        if seams:
            _add_seams(spec, skin, clip.body)
        for prop in clip.props:
            _add_prop(spec, prop)
        self._raw = drawing.figures.get("raw")
        names = figure_names(clip.skeleton) if self._raw is not None else []
        for name in names:
            spec.worldbody.add_geom(name=name, size=[0.01, 0.01, 0.01])
        self.model = model = spec.compile()
        self.data = mujoco.MjData(model)
        starts = np.maximum(clip.skeleton.parents, 0)  # of the segments
        count, positions = len(clip), clip.positions[:, starts]
        places = [np.broadcast_to(p.positions, (count, 3))[:, None] for p in clip.props]
        self._positions = to_mujoco(np.concatenate([positions, *places], axis=1))
        turns = [np.broadcast_to(p.rotations, (count, 4))[:, None] for p in clip.props]
        self._rotations = to_mujoco(np.concatenate([clip.rotations, *turns], axis=1))
        ids = np.array([model.geom(name).id for name in names], dtype=np.intp)
        self._joints, self._bones = np.split(ids, [len(clip.skeleton)])
        model.geom_type[self._bones] = mujoco.mjtGeom.mjGEOM_CAPSULE
        model.geom_size[self._joints] = _JOINT
        model.geom_size[self._bones, 0] = _BONE
        model.geom_rgba[self._bones, :3] = _BONE_COLOR

    def pose(self, frame: int) -> None:
        """Move everything to where it is in a frame of the clip."""
        self.data.mocap_pos[:] = self._positions[frame]
        self.data.mocap_quat[:] = self._rotations[frame]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        if self._raw is None:
            return
        sticks, model, data = self._raw.at(frame), self.model, self.data
        model.geom_rgba[self._joints, :3] = sticks.joint_colors
        model.geom_rgba[self._joints, 3] = sticks.joint_present
        model.geom_rgba[self._bones, 3] = sticks.bone_present
        model.geom_size[self._bones, 1] = 0.5 * np.maximum(sticks.lengths, 1e-6)
        data.geom_xpos[self._joints] = to_mujoco(sticks.joints)
        data.geom_xpos[self._bones] = to_mujoco(sticks.centers)
        turned = matrix_from_wxyz(to_mujoco(sticks.rotations))
        data.geom_xmat[self._bones] = turned.reshape(-1, 9)


class OffscreenRenderer:
    """Draws frames off screen; floor and sky only once if the camera stays.

    Without a GPU, floor and sky are most of the work. Drawing the rest alone and
    combining both by depth gives the same pixels. With shadows or samples, everything
    is drawn in every frame.
    """

    def __init__(
        self, clip_model: ClipModel, camera: CameraPath, *, shadows: bool = False
    ) -> None:
        model = clip_model.model
        self._clip_model, self._path = clip_model, camera
        width, height = model.vis.global_.offwidth, model.vis.global_.offheight
        self._context = mujoco.GLContext(width, height)
        self._context.make_current()
        self._buffer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._buffer)
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._view = mujoco.MjvScene(model, maxgeom=model.ngeom + _MORE_GEOMS)
        self._view.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        self._view.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._camera = mujoco.MjvCamera()
        model.vis.global_.fovy = camera.fov
        opaque = bool((model.skin_rgba[:, 3] == 1.0).all())
        samples = model.vis.quality.offsamples
        self._background: tuple[Pixels, Singles] | None = None
        if camera.stays and opaque and not (shadows or samples):
            self._pose(0)
            self._background = self._draw(floor=True, rest=False)

    def render(self, frame: int) -> Pixels:
        """Return the picture of a frame, shape (height, width, 3)."""
        self._context.make_current()
        self._pose(frame)
        if self._background is None:
            return self._draw(floor=True, rest=True)[0][::-1]
        behind, depths = self._background
        pixels, depth = self._draw(floor=False, rest=True)
        return np.where((depth < depths)[..., None], pixels, behind)[::-1]

    def close(self) -> None:
        """Release OpenGL's resources."""
        self._buffer.free()
        self._context.free()

    def _pose(self, frame: int) -> None:
        self._clip_model.pose(frame)
        position, target = (to_mujoco(p) for p in self._path.at(frame))
        x, y, z = target - position
        self._camera.lookat[:] = target
        self._camera.distance = np.linalg.norm(target - position)
        self._camera.azimuth = np.degrees(np.arctan2(y, x))
        self._camera.elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))

    def _draw(self, *, floor: bool, rest: bool) -> tuple[Pixels, Singles]:
        """Return colors and, unless all is drawn, depths, from the lowest row up."""
        options: Any = mujoco.MjvOption()
        options.geomgroup[:] = options.skingroup[:] = rest
        options.geomgroup[_FLOOR_GROUP] = floor
        self._view.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = floor
        model, data, view = self._clip_model.model, self._clip_model.data, self._view
        # Otherwise the scene's light and floor follow the previous camera.
        mujoco.mjv_updateCamera(model, data, self._camera, view)
        every = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, options, None, self._camera, every, view)
        mujoco.mjr_render(self._rect, view, self._buffer)
        shape = (self._rect.height, self._rect.width)
        pixels = np.empty((*shape, 3), dtype=np.uint8)
        depth = np.empty(shape, dtype=np.float32)
        wanted = None if floor and rest else depth
        mujoco.mjr_readPixels(pixels, wanted, self._rect, self._buffer)
        return pixels, depth


def figure_names(skeleton: Skeleton) -> list[str]:
    """Return the names of the raw figure's geoms: joints, then bones."""
    joints = [f"joint:{joint}" for joint in skeleton.joints]
    return joints + [f"bone:{skeleton.joints[j]}" for j in skeleton.segments]


def _add_character(spec: mujoco.MjSpec, body: Body, opacity: float) -> mujoco.MjsSkin:
    skeleton = body.skeleton
    starts = to_mujoco(body.rest_positions)[np.maximum(skeleton.parents, 0)]
    for joint, start in zip(skeleton.joints, starts, strict=True):
        spec.worldbody.add_body(name=f"segment:{joint}", mocap=True, pos=start)
    skin = skin_of(body)
    movers = np.where(skin.weights > 0.0, skin.segments, -1)
    moved = [np.nonzero(movers == j) for j in range(len(skeleton))]
    bones = [j for j, (points, _) in enumerate(moved) if len(points)]
    mesh = spec.add_skin(name="skin")
    mesh.vert = to_mujoco(skin.points).ravel()
    mesh.face = skin.triangles.ravel()
    mesh.bodyname = [f"segment:{skeleton.joints[j]}" for j in bones]
    mesh.bindpos = starts[bones].ravel()
    mesh.bindquat = np.tile([1.0, 0.0, 0.0, 0.0], len(bones))
    mesh.vertid = [moved[j][0].tolist() for j in bones]
    mesh.vertweight = [skin.weights[moved[j]].tolist() for j in bones]
    mesh.rgba = [*_SKIN, opacity]
    return mesh


def _add_seams(spec: mujoco.MjSpec, skin: mujoco.MjsSkin, body: Body) -> None:
    """Draw lines on a skin: two along each segment, and one around its middle."""
    pixels = np.full((_SEAMS, _SEAMS, 3), 255, dtype=np.uint8)
    across, along = (slice(_SEAMS // 2 - w, _SEAMS // 2 + w) for w in _SEAM)
    pixels[across] = pixels[:, along] = _SEAM_COLOR
    texture = spec.add_texture(name="seams", type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.height, texture.width, texture.nchannel = pixels.shape
    texture.data = pixels.tobytes()
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "seams"
    spec.add_material(name="seams", textures=textures, rgba=skin.rgba)
    skin.material, skin.texcoord = "seams", seams_of(body).ravel()


def _add_prop(spec: mujoco.MjSpec, prop: Prop) -> None:
    body = spec.worldbody.add_body(name=f"prop:{prop.name}", mocap=True)
    for k, shape in enumerate(prop.shapes):
        geom = body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
            pos=to_mujoco(shape.position),
            quat=to_mujoco(shape.rotation),
            rgba=[*shape.color, 1.0],
        )
        if shape.kind == "mesh":
            geom.meshname = f"prop:{prop.name}:{k}"
            mesh = spec.add_mesh(name=geom.meshname)
            mesh.uservert = to_mujoco(shape.points).ravel()
            mesh.userface = shape.triangles.ravel()
            # The mesh may be open.
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        else:
            depth, width, height = to_mujoco(shape.size)
            if shape.kind in ("cylinder", "capsule"):  # radius, then half height
                depth, width, height = width, height, 0.0
            geom.size = [depth, width, height]
