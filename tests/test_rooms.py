"""The scenes, as MuJoCo loads and steps them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from known_motions import pulled_through
from numpy.typing import NDArray
from skeletons import every_skeleton

import kinefilter.scenes.rooms
from kinefilter.characters import (
    KINECT_V1,
    Body,
    InputError,
    Skeleton,
    Tracking,
    standard_body,
)
from kinefilter.characters.humanoid import build_humanoid, to_mujoco
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.scenes import SCENES, load_scene, scene_xml
from kinefilter.scenes.library import movable_props, perform, prop_poses
from kinefilter.scenes.sensor import Sensor

FOLDER = Path(kinefilter.scenes.rooms.__file__).parent
BODY = standard_body(KINECT_V1)
MOVABLE = {
    "box": ("box",),
    "basketball": ("ball",),
    "chair": ("chair",),
    "office": ("phone", "cup"),
}

every_scene = pytest.mark.parametrize("scene", SCENES)
with_and_without_character = pytest.mark.parametrize(
    "body", [None, BODY], ids=["empty", "character"]
)


def _hold(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Let the character pull itself to its T-pose."""
    pulls = slice(0, 3 * len(KINECT_V1))
    stiffness = -model.actuator_biasprm[pulls, 1]
    data.ctrl[pulls] = stiffness * to_mujoco(BODY.rest_positions).ravel()


def _names(model: mujoco.MjModel) -> dict[str, list[str]]:
    return {
        "body": [model.body(i).name for i in range(model.nbody)],
        "geom": [model.geom(i).name for i in range(model.ngeom)],
        "joint": [model.joint(i).name for i in range(model.njnt)],
        "site": [model.site(i).name for i in range(model.nsite)],
        "actuator": [model.actuator(i).name for i in range(model.nu)],
    }


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> list[set[str]]:
    names = [model.geom(i).name for i in range(model.ngeom)]
    return [{names[c.geom1], names[c.geom2]} for c in data.contact[: data.ncon]]


@every_scene
def test_plain_mujoco_loads_every_scene_from_its_file(scene: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(FOLDER / f"{scene}.xml"))
    assert model.geom("floor").type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    assert model.nu == 0
    assert model.nlight > 0
    assert model.ncam > 0


@every_scene
@with_and_without_character
def test_a_scenes_text_is_the_scene_and_needs_no_other_file(
    scene: str, body: Body | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = scene_xml(scene, body)
    assert "include" not in text
    assert str(FOLDER) not in text
    model, loaded = mujoco.MjModel.from_xml_string(text), load_scene(scene, body)
    expected = loaded.compile()
    assert _names(model) == _names(expected)
    np.testing.assert_array_equal(model.qpos0, expected.qpos0)
    np.testing.assert_array_equal(model.body_mass, expected.body_mass)
    np.testing.assert_array_equal(model.geom_size, expected.geom_size)


@every_scene
@with_and_without_character
def test_every_scene_stays_at_rest_for_two_seconds(
    scene: str, body: Body | None
) -> None:
    model = load_scene(scene, body).compile()
    data = mujoco.MjData(model)
    if body is not None:
        _hold(model, data)
    deepest = 0.0
    for _ in range(round(2.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if data.ncon:
            deepest = min(deepest, float(data.contact.dist.min()))
    assert deepest > -0.002
    assert not any(warning.number for warning in data.warning)
    for name in MOVABLE.get(scene, ()):
        at = model.body(name).id
        assert np.linalg.norm(data.xpos[at] - model.body_pos[at]) < 0.01
        leaning = data.xmat[at].reshape(3, 3)[:, 2] @ [0.0, 0.0, 1.0]
        assert leaning > np.cos(np.radians(1.0))


@every_scene
def test_names_are_unique_and_the_movable_props_are_known(scene: str) -> None:
    for body in (None, BODY):
        spec = load_scene(scene, body)
        assert movable_props(spec) == MOVABLE.get(scene, ())
        names = _names(spec.compile())
        for kind in ("body", "geom", "actuator"):
            assert all(names[kind])
            assert len(set(names[kind])) == len(names[kind])


@every_scene
@every_skeleton
def test_the_character_in_a_scene_is_the_one_without(
    scene: str, skeleton: Skeleton
) -> None:
    body = standard_body(skeleton, height=1.62)
    tracking = Tracking(natural_frequency=50.0)
    alone = build_humanoid(body, tracking).compile()
    model = load_scene(scene, body, tracking=tracking).compile()
    for kind, names in _names(alone).items():
        assert _names(model)[kind][: len(names)] == names, kind
    assert model.nu == alone.nu
    assert model.nmocap == alone.nmocap
    compared = 0
    for name in dir(alone):
        values = getattr(alone, name)
        kind = name.split("_")[0]
        if kind not in ("actuator", "body", "dof", "jnt") or not _is_property(name):
            continue
        np.testing.assert_array_equal(
            getattr(model, name)[: len(values)], values, err_msg=name
        )
        compared += 1
    assert compared > 20
    for name in ("solref", "solimp", "friction", "contype", "conaffinity", "condim"):
        ours, theirs = getattr(model, f"geom_{name}"), getattr(alone, f"geom_{name}")
        np.testing.assert_array_equal(ours[: len(theirs)], theirs, err_msg=name)
    for name in ("timestep", "integrator", "cone", "gravity", "solver", "iterations"):
        np.testing.assert_array_equal(
            getattr(model.opt, name), getattr(alone.opt, name), err_msg=name
        )
    np.testing.assert_array_equal(model.qpos0[: alone.nq], alone.qpos0)


def _is_property(name: str) -> bool:
    """Tell whether it is an element's own, not an address or a weight in a model."""
    if name == "body_subtreemass":  # the world's is that of everything in it
        return False
    own = ("mass", "inertia", "pos", "quat", "gear", "prm", "range", "armature")
    return name.endswith((*own, "damping", "limited", "type", "ipos", "iquat"))


@every_scene
def test_there_is_one_floor_and_it_looks_like_the_scenes(scene: str) -> None:
    model = load_scene(scene, BODY).compile()
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    assert [model.geom(i).name for i in planes] == ["floor"]
    assert model.mat(model.geom("floor").matid[0]).name == "grid"


@every_scene
def test_the_scenes_floor_touches_as_the_characters_does(scene: str) -> None:
    ours = load_scene(scene).compile().geom("floor")
    theirs = build_humanoid(BODY).compile().geom("floor")
    for name in ("solref", "solimp", "friction", "contype", "conaffinity", "condim"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), name)


@every_scene
def test_a_person_in_t_pose_touches_nothing_but_the_floor(scene: str) -> None:
    for height in (1.5, 1.75, 1.95):
        body = standard_body(KINECT_V1, height=height)
        model = load_scene(scene, body).compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        for pair in _touching(model, data):
            assert "floor" in pair or not pair & set(KINECT_V1.joints), pair


def test_sizes_and_masses_are_the_documented_ones() -> None:
    models = {scene: load_scene(scene).compile() for scene in SCENES}
    box = models["box"]
    np.testing.assert_allclose(2.0 * box.geom("box").size, [0.3, 0.4, 0.3])
    assert box.body("box").mass[0] == pytest.approx(4.0)
    ball = models["basketball"]
    assert 0.75 <= 2.0 * np.pi * ball.geom("ball").size[0] <= 0.77  # FIBA, size 7
    assert 0.58 <= ball.body("ball").mass[0] <= 0.62 + 1e-9
    shell = 2.0 / 3.0 * 0.62 * ball.geom("ball").size[0] ** 2
    np.testing.assert_allclose(ball.body("ball").inertia, shell, rtol=0.01)
    assert _top(models["chair"], "chair:seat") == pytest.approx(0.45)
    assert _top(models["office"], "desk:top") == pytest.approx(0.74)
    assert _top(models["office"], "chair:seat") == pytest.approx(0.46)
    board = models["flip_chart"].geom("flip_chart:board")
    np.testing.assert_allclose(2.0 * board.size[1:], [0.7, 1.0])
    assert _top(models["flip_chart"], "flip_chart:board") == pytest.approx(1.9)


def _top(model: mujoco.MjModel, name: str) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(data.geom(name).xpos[2] + model.geom(name).size[2])


def test_the_scenes_sensor_camera_is_where_the_virtual_kinect_stands() -> None:
    model, sensor = load_scene("basic").compile(), Sensor()
    camera = model.camera("sensor")
    expected = [sensor.distance, 0.0, sensor.height]
    np.testing.assert_allclose(camera.pos, expected)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    line = -data.camera("sensor").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(line, [-1.0, 0.0, 0.0], atol=1e-12)


@with_and_without_character
@pytest.mark.parametrize("timestep", [1 / 1000, 1 / 480, 1 / 240])
def test_the_ball_bounces_as_fiba_asks(body: Body | None, timestep: float) -> None:
    # Dropped from 1.8 m at its bottom, it comes back to 1.2 to 1.4 m at its top.
    model = load_scene("basketball", body).compile()
    model.opt.timestep = timestep
    data = mujoco.MjData(model)
    radius = model.geom("ball").size[0]
    if body is not None:
        _hold(model, data)
    data.joint("ball").qpos[:3] = [1.5, 1.5, 1.8 + radius]
    heights = []
    for _ in range(round(1.5 / timestep)):
        mujoco.mj_step(model, data)
        heights.append(data.joint("ball").qpos[2])
    bounce = int(np.argmin(heights[: round(0.8 / timestep)]))
    assert 1.2 < max(heights[bounce:]) + radius < 1.4


@every_scene
def test_the_physics_filter_runs_in_every_scene(scene: str) -> None:
    frames = 20
    still = np.tile(BODY.rest_positions, (frames, 1, 1))
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(KINECT_V1), 1))

    def run(place: str | None) -> NDArray[np.float64]:
        time = np.arange(frames) / 30.0
        result = pulled_through(PulledCharacter(BODY, scene=place), time, still, turns)
        assert result.trace.status == "ok"
        return np.asarray(result.positions)

    # A person in T-pose touches no prop, so the scene changes nothing.
    np.testing.assert_allclose(run(scene), run(None), atol=1e-6)


USERS = """
<mujoco model="mine">
  <compiler angle="radian" meshdir="meshes"/>
  <option timestep="0.01" gravity="0 0 -1" integrator="RK4"/>
  <default><geom rgba="1 0 0 1"/><default class="red"/></default>
  <asset><mesh name="wedge" file="wedge.obj"/></asset>
  <worldbody>
    <geom name="ground" type="plane" size="3 3 1" rgba="0 1 0 1"/>
    <geom name="wall" type="plane" size="3 3 1" euler="0 1.5707963 0" pos="-2 0 0"/>
    <body name="crate" pos="1 0 1"><freejoint/><geom type="mesh" mesh="wedge"/></body>
    <body name="post" pos="1 2 0" euler="0 0 1.5"><geom class="red" size="0.3"/></body>
  </worldbody>
</mujoco>
"""
WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def _users(folder: Path) -> Path:
    (folder / "meshes").mkdir()
    (folder / "meshes" / "wedge.obj").write_text(WEDGE)
    path = folder / "mine.xml"
    path.write_text(USERS)
    return path


@pytest.mark.filterwarnings("error")
def test_a_users_scene_takes_the_character_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _users(tmp_path)
    text = scene_xml(str(path), BODY)
    monkeypatch.chdir(FOLDER)
    model = mujoco.MjModel.from_xml_string(text)
    alone = build_humanoid(BODY).compile()
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    assert [model.geom(i).name for i in planes] == ["floor", "wall"]
    np.testing.assert_array_equal(model.geom("floor").rgba, [0, 1, 0, 1])
    np.testing.assert_array_equal(model.opt.gravity, alone.opt.gravity)
    assert model.opt.timestep == alone.opt.timestep
    assert model.nmesh == 1
    assert movable_props(load_scene(path, BODY)) == ("crate",)
    users = load_scene(path).compile()
    np.testing.assert_allclose(model.body("post").quat, users.body("post").quat)
    np.testing.assert_allclose(model.body("crate").mass, users.body("crate").mass)
    np.testing.assert_array_equal(model.geom("wall").rgba, [1, 0, 0, 1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody>", "MuJoCo cannot load this scene"),
        ("no XML at all", "MuJoCo cannot load this scene"),
        ('<mujoco>\n<include file="a.xml"/></mujoco>', r"^[^\n]*a\.xml[^\n]*$"),
        ("<mujoco><worldbody><geom/></worldbody></mujoco>", "size"),
        ('<mujoco><worldbody><geom type="mesh" mesh="x"/></worldbody></mujoco>', "x"),
    ],
)
def test_a_file_that_is_no_scene_is_an_input_error(
    text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        load_scene(path)
    assert str(path) in str(error.value)


def test_a_name_of_the_characters_in_a_scene_is_an_input_error(tmp_path: Path) -> None:
    path = tmp_path / "clash.xml"
    path.write_text('<mujoco><worldbody><body name="Head"/></worldbody></mujoco>')
    load_scene(path)
    with pytest.raises(InputError, match="Head"):
        load_scene(path, BODY)


def test_an_unknown_scene_is_an_input_error_that_names_the_known() -> None:
    with pytest.raises(InputError, match=r"'kitchen'.*basketball"):
        load_scene("kitchen")
    with pytest.raises(InputError, match="no such file"):
        load_scene("kitchen.xml")


def test_the_character_is_no_prop() -> None:
    act = perform("wave", BODY, seed=0)
    assert list(prop_poses(load_scene("box", BODY), act)) == ["box"]
