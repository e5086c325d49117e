"""A character that gives way, falls and gets up, and what kinefilter play does."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_session import UDP, Sender, do, sample_frame

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, TRACKINGS, Clip, InputError, Tracking
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.avatar import Avatar
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import read_clip, write_clip
from kinefilter.pipeline.live.live_config import LiveConfig
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.look.live_page import LivePage
from kinefilter.pipeline.look.player import Player
from kinefilter.pipeline.look.viewer_server import opened_server
from kinefilter.pipeline.physics.playground import RATE, Playground
from kinefilter.scenes import SAMPLE

FORWARD = np.array([0.0, 0.0, 1.0])
SPEED = 10.0  # m/s of a ball


@pytest.fixture(scope="module")
def motion() -> Clip:
    return clean(read_take(SAMPLE), CleanConfig("none", physics=False)).clip


def _chest(
    ground: Playground, seconds: float, force: Array | None = None, at: float = 1.0
) -> Array:
    """Return where the chest is in each frame [m], pushed for 0.3 s or not."""
    chest = ground.motion.skeleton.girdle
    found = []
    for frame in range(round(seconds * RATE)):
        if force is not None and frame == round(at * RATE):
            joint = ground.motion.skeleton.joints[chest]
            ground.character.push(joint, force, 0.3)
        ground.step(1.0 / RATE)
        found.append(ground.character.positions[chest])
    return np.array(found)


@pytest.fixture(scope="module")
def free(motion: Clip) -> Array:
    """Return where the chest is while nothing touches the character [m]."""
    return _chest(Playground(motion, "basic"), 2.5)


@pytest.mark.parametrize("degrees", [20.0, 130.0, 250.0])
def test_a_shoved_character_gives_way_and_is_back_in_time(
    motion: Clip, free: Array, degrees: float
) -> None:
    angle = np.radians(degrees)
    force = 300.0 * np.array([np.sin(angle), 0.0, np.cos(angle)])
    pushed = _chest(Playground(motion, "basic"), 2.5, force)
    away = np.linalg.norm(pushed - free, axis=1)
    assert 0.05 < away.max() < 0.15
    assert away[-1] < 0.01
    way = (pushed - free)[np.argmax(away)]
    assert way @ force > 0.9 * np.linalg.norm(way) * np.linalg.norm(force)


def test_a_hard_blow_fells_it_and_it_gets_up_to_the_performer(motion: Clip) -> None:
    ground = Playground(motion, "basic")
    lowest = _chest(ground, 4.0, 900.0 * FORWARD)[:, 1].min()
    assert lowest < 0.5
    _chest(ground, 10.0)
    assert ground.doing == "follows"
    target = ground._target(ground.motion)[0]
    assert np.abs(ground.character.positions - target).max() < 0.05


def test_a_ball_gives_the_body_its_momentum(motion: Clip) -> None:
    away = {}
    for tracking in ("faithful", "game"):
        free = _chest(Playground(motion, "basic", tracking), 1.5)
        ground = Playground(motion, "basic", tracking)
        ground.throw(free[0] + 1.5 * FORWARD, -SPEED * FORWARD)
        away[tracking] = np.linalg.norm(_chest(ground, 1.5) - free, axis=1).max()
    assert away["faithful"] < 0.03 < 0.05 < away["game"] < 0.15


def test_a_ragdoll_falls_and_a_faithful_character_is_the_default(motion: Clip) -> None:
    assert _chest(Playground(motion, "basic", "ragdoll"), 3.0)[-1, 1] < 0.5
    assert TRACKINGS["faithful"] == Tracking()
    assert CleanConfig().tracking == "faithful"
    avatar = Avatar(motion.body, tracking="game")
    assert avatar.physics.compliance is not None
    with pytest.raises(InputError, match="tracking"):
        CleanConfig(tracking="game", physics=False)


def test_a_reset_leaves_things_where_they_are(motion: Clip) -> None:
    ground = Playground(motion, "box")
    ground.throw([0.5, 1.0, 2.0], SPEED * FORWARD)
    _chest(ground, 1.0)
    before = ground.scene_props.now[0].copy()
    ground.character.data.qvel[:3] = 1e5
    ground.step(1.0 / RATE)
    assert ground.resets == 1
    assert np.abs(ground.scene_props.now[0] - before).max() < 0.5


def test_props_are_back_whenever_the_motion_begins(motion: Clip) -> None:
    ground = Playground(motion, "box")
    data = ground.character.data
    place, box = data.body("box").xpos.copy(), data.joint("box")
    box.qpos[:3] += [1.0, 1.0, 0.0]
    while ground.time * RATE < len(ground.motion) - 2:
        ground.step(1.0 / RATE)
    assert np.linalg.norm(data.body("box").xpos - place) > 1.0
    for _ in range(3):
        ground.step(1.0 / RATE)
    np.testing.assert_allclose(data.body("box").xpos, place, atol=0.01)


def test_what_was_played_is_a_clip_with_the_balls_that_flew(
    motion: Clip, tmp_path: Path
) -> None:
    ground = Playground(motion, "box")
    ground.record()
    ground.throw([0.0, 1.3, 3.0], -SPEED * FORWARD)
    chest = _chest(ground, 1.0)
    path = tmp_path / "played.npz"
    write_clip(ground.recorded()[0], path)
    clip = read_clip(path)
    np.testing.assert_allclose(
        clip.positions[:, clip.skeleton.girdle], chest, atol=1e-4
    )
    balls = [prop.name for prop in clip.props if "ball" in prop.name]
    assert balls == ["thrown ball 1"]


def test_what_was_played_in_slow_motion_has_frames_at_one_rate(motion: Clip) -> None:
    ground = Playground(motion, "basic")
    ground.record()
    for speed in (1.0, 0.1, 0.5):
        for _ in range(30):
            ground.step(speed / RATE)
    (clip,) = ground.recorded()
    np.testing.assert_allclose(np.diff(clip.time), 1.0 / RATE, atol=1e-9)
    assert clip.time[-1] == pytest.approx(1.6 - 1.0 / RATE, abs=1e-6)


def test_the_page_plays_records_and_changes(
    motion: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = tmp_path / "play.npz"
    ground = Playground(motion, "basic")
    with opened_server() as server:
        player = Player(server, ground, save)
        for action in (player._record, player._let_go, player._pause):
            action(None)
        assert ground.character.limp
        assert ground.recording == 0
        for name in ("play.npz", "play.2.npz"):
            if ground.recording is None:
                player._record(None)
            _chest(ground, 0.2)
            ground.step(0.1 / RATE)  # slowed down
            assert ("recorded", "0.2 s") in player._status_rows()
            player._record(None)
            assert (tmp_path / name).exists()
        player._record(None)
        _chest(ground, 0.2)
        with pytest.raises(InputError, match="recorded"):
            ground.change(scene="box")
        shown = {frame.name for frame in player._moving}
        player._change(scene="basketball")  # ends the recording
        # Under names it knows, a browser leaves things where the last scene had them.
        assert not shown & {frame.name for frame in player._moving}
        assert read_clip(tmp_path / "play.3.npz").props == ()
        player._show()
        assert "ball" in {prop.name for prop in ground.props}
        player._record(None)
        player._scenes.value = "box"
        with pytest.raises(InputError, match="nothing was recorded"):
            player._change(scene="box")
        assert player._scenes.value == "basketball" == ground.scene
        player._record(None)
        _chest(ground, 0.2)
        monkeypatch.setattr("kinefilter.pipeline.look.player.write_clip", _full_disk)
        with pytest.raises(InputError, match="full"):
            player._record(None)
        monkeypatch.undo()
        player._record(None)  # nothing of it is lost
        assert read_clip(tmp_path / "play.4.npz").time[-1] > 0.15
        player.stop()
        player.run()


def _full_disk(_clip: Clip, path: Path) -> None:
    raise InputError(f"{path}: the disk is full")


def test_a_recording_is_saved_when_play_is_ended(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def recorded(player: Player) -> None:
        player._record(None)
        _chest(player._playground, 0.2)
        raise KeyboardInterrupt  # as SIGTERM does

    monkeypatch.setattr(Player, "run", recorded)
    save = tmp_path / "play.npz"
    address = ["--port", "0"]
    assert main(["play", "basic", "--save", str(save), *address]) == 0
    assert "wrote" in capsys.readouterr().out
    assert len(read_clip(save)) == 6


def test_two_begin_beside_each_other_share_the_scene_and_are_recorded(
    motion: Clip, tmp_path: Path
) -> None:
    ground = Playground([motion, motion], "box")
    alone = Playground(motion, "box")
    assert ground.scene_props.moving == alone.scene_props.moving
    first, second = (character.positions for character in ground.characters)
    gap = second[:, 0].min() - first[:, 0].max()
    assert gap == pytest.approx(0.6, abs=0.02)
    np.testing.assert_allclose(first, alone.character.positions, atol=1e-9)
    chest = motion.skeleton.girdle
    with opened_server() as server:
        player = Player(server, ground, tmp_path / "play.npz")
        player._record(None)
        player._choose("2")
        player._let_go(None)
        assert [c.limp for c in ground.characters] == [False, True]
        for _ in range(45):
            ground.step(1.0 / RATE)
        player._show()
        player._record(None)
        player.stop()
    clips = [read_clip(tmp_path / f"play.{number}.npz") for number in (1, 2)]
    heights = [clip.positions[-1, chest, 1] for clip in clips]
    assert heights[1] < 0.6 < 1.0 < heights[0]
    ground.throw(first[chest] + FORWARD, -SPEED * FORWARD)
    assert ground.hit_by(second[chest] + [0.0, 3.0, 0.0], [0.0, 1.0, 0.0]) is None
    here = ground.characters[0].positions[chest]
    hit = ground.hit_by(here + 2.0 * FORWARD, -FORWARD)
    assert hit is not None
    assert hit[0] == 0
    ground.restart()
    assert [c.limp for c in ground.characters] == [False, False]


def test_who_stands_too_near_is_pushed(motion: Clip) -> None:
    chest, away = motion.skeleton.girdle, []
    for apart in (0.15, 3.0):
        other = replace(motion, root=motion.root + np.array([apart, 0.0, 0.0]))
        ground = Playground([motion, other], "basic", placed=True)
        for _ in range(30):
            ground.step(1.0 / RATE)
        target = ground._target(ground.motions[1])[0]
        gone = ground.characters[1].positions[chest] - target[chest]
        away.append(float(np.linalg.norm(gone)))
    assert away[1] < 0.01
    assert away[0] > away[1] + 0.01


def test_people_of_one_recording_keep_their_places(motion: Clip) -> None:
    moved = motion.root + np.array([1.0, 0.0, 0.5])
    other = replace(motion, root=moved)
    ground = Playground([motion, other], "basic", placed=True)
    first, second = (m.positions[0] for m in ground.motions)
    away = (second - first).mean(axis=0)
    assert np.linalg.norm(away) == pytest.approx(np.hypot(1.0, 0.5), abs=1e-6)


def test_people_in_front_of_a_sensor_play_on_the_page() -> None:
    async def session() -> None:
        what = LiveConfig((UDP,), (), skeleton="kinect_v1", scene="box", height=1.8)
        live, stop = Session(what, shown=True), asyncio.Event()
        scene = live.scene
        assert scene is not None
        with opened_server() as server:
            page, row = LivePage(server, live), itertools.count()
            with pytest.raises(InputError, match="nobody"):
                page._throw_at(None)  # type: ignore[arg-type]
            drawing = asyncio.ensure_future(page.follow())
            drawing.add_done_callback(lambda _: stop.set())
            used = asyncio.get_running_loop().create_future()
            running = asyncio.ensure_future(live.run(stop, used.set_result))
            sender = Sender((await used)[0])

            async def until(done: Callable[[], bool], *bodies: str) -> None:
                while not done():
                    sender.send(sample_frame(next(row), *bodies))
                    await asyncio.sleep(1 / 30)

            await until(lambda: len(page._figures) == 1, "1")
            assert len(page._moving) == len(scene.scene_props.moving) > 1
            page._let_go(None)
            heads = KINECT_V1.index("Head")
            await until(lambda: scene.characters[0].positions[heads, 1] < 0.8, "1")
            await until(lambda: len(page._figures) == 2, "1", "2")
            assert scene.characters[0].limp
            assert "people" in page._status.content
            page._report("nobody", error=True)
            await until(lambda: len(page._figures) == 1, "1")
            assert "nobody" not in page._message.content
            # Where a skin is removed and nothing replaces it, viser's page goes blank.
            assert "/mesh2" in server.scene._handle_from_node_name
            page.stop()
            await running
            await drawing

    do(session())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "unknown scene"),
        (["--save", "clip.txt"], "unknown extension"),
        (["--take", "absent.csv"], "absent.csv"),
        (["--port", "-1"], "--port -1"),
        (["--take", "a.csv", "--take", "b.csv", "--body", "all"], "single --take"),
        (["--take", "a.csv", "--in", UDP], "only one of them"),
        (["--height", "1.8"], "give --in"),
        (["--in", "http://127.0.0.1:1"], "not an address"),
    ],
)
def test_what_cannot_be_played_is_refused(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", *arguments]) == 2
    assert words in capsys.readouterr().err
