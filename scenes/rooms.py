"""Scenes: the built-in rooms with their props, and users' own.

A scene is MJCF with z up; the person is at the origin and faces +x. Bodies with a free
joint are movable props; everything else is fixed.
"""

from collections.abc import Sequence
from pathlib import Path

import mujoco

from kinefilter.characters import Body, InputError, Tracking
from kinefilter.characters.humanoid import build_humanoids

_FOLDER = Path(__file__).parent

SCENES = tuple(sorted(path.stem for path in _FOLDER.glob("*.xml")))
"""Names of the built-in scenes: the settings of Shum et al. 2013, table II."""

SAMPLE = _FOLDER / "takes" / "wave_punch_bend.csv"  # the built-in sample take

_PREFIX = "attached--"  # removed again, so no name in a scene may begin with it
_SKIN = [0.37, 0.53, 0.60, 1.0]  # a muted color that no prop has


def load_scene(
    scene: str | Path,
    body: Body | Sequence[Body] | None = None,
    *,
    tracking: Tracking | None = None,
) -> mujoco.MjSpec:
    """Return a scene: one of SCENES, or the MJCF file at a path.

    If a body is given, the character of ``build_humanoid`` is at the origin in T-pose,
    and so are those of ``build_humanoids`` if several are. They keep all their names,
    actuators, options and the settings of their floor, which takes on the look of the
    scene's, and come first in the model. Raises an InputError if there is no such
    scene, MuJoCo cannot load it, or a name in it is also one of the character's.
    """
    path = _path(scene)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if any(asset.file for asset in (*spec.meshes, *spec.hfields, *spec.skins)):
            spec.meshdir = str((path.parent / spec.meshdir).resolve())
        if any(texture.file or any(texture.cubefiles) for texture in spec.textures):
            spec.texturedir = str((path.parent / spec.texturedir).resolve())
        if body is not None:
            bodies = [body] if isinstance(body, Body) else body
            spec = _merged(build_humanoids(bodies, tracking), spec)
        spec.copy().compile()
    except (ValueError, mujoco.FatalError) as error:
        why = " ".join(str(error).split())
        raise InputError(
            f"{path}: MuJoCo cannot load this scene: {why}; check that it is MJCF, "
            "that its files are next to it, and that no name is one of the character's"
        ) from error
    return spec


def scene_xml(scene: str | Path, body: Body | None = None) -> str:
    """Return ``load_scene`` as self-contained MJCF, but for users' asset files."""
    spec = load_scene(scene, body)
    spec.compiler.savecompiled = False  # keeps all numbers as they were written
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
    """Return the characters' spec with everything in the scene except its floor."""
    for part in character.geoms:
        if part.name != "floor":
            part.rgba = _SKIN
    _move_floor(scene, character.geom("floor"))
    character.modelname = scene.modelname
    character.visual, character.stat = scene.visual, scene.stat
    scene.option = character.option
    character.meshdir, character.texturedir = scene.meshdir, scene.texturedir
    character.attach(scene, frame=character.worldbody.add_frame(), prefix=_PREFIX)
    # Attaching needs a prefix, but all later readers need the names without it. Only
    # the root of the default classes would then have the name of another.
    character.compiler.savecompiled = False
    text = str(character.to_xml())
    text = text.replace(f'class="{_PREFIX}main"', 'class="main:scene"')
    return mujoco.MjSpec.from_string(text.replace(_PREFIX, ""))


def _move_floor(scene: mujoco.MjSpec, floor: mujoco.MjsGeom) -> None:
    """Remove the scene's floor (planes at height 0 that face up), but keep its look."""
    model = scene.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    planes = [  # listed first, because removing one changes the indices of others
        geom
        for geom in scene.geoms
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE
        and data.geom_xmat[geom.id][8] > 1.0 - 1e-9
        and abs(data.geom_xpos[geom.id][2]) < 1e-9
    ]
    for plane in planes:
        floor.rgba, floor.size = plane.rgba, plane.size
        if plane.material:
            floor.material = f"{_PREFIX}{plane.material}"
        scene.delete(plane)
