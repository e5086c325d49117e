"""Rooms and their props: the scenes that ship and users' own.

A scene is MJCF: z up, the person at the origin facing +x. Its movable props are the
bodies with a free joint; everything else stands still.
"""

from __future__ import annotations

from pathlib import Path

import mujoco

from kinefilter.characters import Body, InputError, Tracking
from kinefilter.characters.humanoid import build_humanoid

_FOLDER = Path(__file__).parent

SCENES = tuple(sorted(path.stem for path in _FOLDER.glob("*.xml")))
"""Names of the scenes that ship: the settings of Shum et al. 2013, table II."""

SAMPLE = _FOLDER / "takes" / "wave_punch_bend.csv"
"""The take that ships."""

_ATTACHED = "attached--"  # taken off again: no name of a scene begins so
_SKIN = [0.37, 0.53, 0.60, 1.0]  # a quiet color that no prop has


def load_scene(
    scene: str | Path, body: Body | None = None, *, tracking: Tracking | None = None
) -> mujoco.MjSpec:
    """Return a scene, with the character in it if a body is given.

    The character is that of ``build_humanoid``, all names, actuators, options and the
    settings of its floor unchanged, and comes first in the model: its first seven
    coordinates are its root's. The floor takes on the look of the scene's.

    Args:
        scene: One of SCENES, or the path of an MJCF file.
        body: Whose character stands in the scene, in T-pose at the origin.
        tracking: Gains and bounds of the pull on the character.

    Raises:
        InputError: There is no such scene, the file is no MJCF that MuJoCo can load, or
            a name in it is one of the character's.
    """
    path = _path(scene)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        _find_assets(spec, path)
        if body is not None:
            spec = _merged(build_humanoid(body, tracking), spec)
        spec.copy().compile()
    except (ValueError, mujoco.FatalError) as error:
        why = " ".join(str(error).split())
        raise InputError(
            f"{path}: MuJoCo cannot load this scene: {why}; check that it is MJCF, "
            "that its files are beside it, and that no name is one of the character's"
        ) from error
    return spec


def scene_xml(scene: str | Path, body: Body | None = None) -> str:
    """Return a scene as one MJCF text, which plain MuJoCo loads from anywhere.

    It includes no other MJCF file. Meshes and textures of users' scenes stay in their
    files and are named by absolute paths.

    Args:
        scene: One of SCENES, or the path of an MJCF file.
        body: Whose character stands in the scene.

    Raises:
        InputError: As ``load_scene``.
    """
    spec = load_scene(scene, body)
    spec.compiler.savecompiled = False  # every number exactly as it was written
    return str(spec.to_xml())


def _path(scene: str | Path) -> Path:
    if scene in SCENES:
        return _FOLDER / f"{scene}.xml"
    path = Path(scene)
    if path.suffix != ".xml":
        raise InputError(
            f"unknown scene {str(scene)!r}; known: {', '.join(SCENES)}, "
            "or the path of an MJCF file that ends in .xml"
        )
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    return path


def _merged(character: mujoco.MjSpec, scene: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return the character's spec with everything in the scene but its floor."""
    for part in character.geoms:
        if part.name != "floor":
            part.rgba = _SKIN
    _take_floor(character.geom("floor"), scene)
    character.modelname = scene.modelname
    character.visual, character.stat = scene.visual, scene.stat
    scene.option = character.option
    character.meshdir, character.texturedir = scene.meshdir, scene.texturedir
    frame = character.worldbody.add_frame()
    character.attach(scene, frame=frame, prefix=_ATTACHED)
    # An attached model needs a prefix, and every later reader the names without. Only
    # the root of its default classes would then have a namesake.
    character.compiler.savecompiled = False
    text = str(character.to_xml())
    text = text.replace(f'class="{_ATTACHED}main"', 'class="main:scene"')
    return mujoco.MjSpec.from_string(text.replace(_ATTACHED, ""))


def _find_assets(scene: mujoco.MjSpec, path: Path) -> None:
    """Let the meshes and textures of a file be found from everywhere."""
    if any(a.file for a in (*scene.meshes, *scene.hfields, *scene.skins)):
        scene.meshdir = str((path.parent / scene.meshdir).resolve())
    if any(texture.file or any(texture.cubefiles) for texture in scene.textures):
        scene.texturedir = str((path.parent / scene.texturedir).resolve())


def _take_floor(floor: mujoco.MjsGeom, scene: mujoco.MjSpec) -> None:
    """Give the character's floor the look of the scene's, and remove that one.

    The floor of a scene is a level plane at height 0.
    """
    for plane in _level_planes(scene):
        floor.rgba, floor.size = plane.rgba, plane.size
        if plane.material:
            floor.material = f"{_ATTACHED}{plane.material}"
        scene.delete(plane)


def _level_planes(scene: mujoco.MjSpec) -> list[mujoco.MjsGeom]:
    """Return the planes at height 0 that face up."""
    model = scene.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return [
        geom
        for geom in scene.geoms
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE
        and data.geom_xmat[geom.id][8] > 1.0 - 1e-9
        and abs(data.geom_xpos[geom.id][2]) < 1e-9
    ]
