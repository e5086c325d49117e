"""Settings in TOML files: what they may say, and who is the stronger."""

from __future__ import annotations

from pathlib import Path

import pytest
from batch_takes import Here, short_take

from kinefilter import CleanConfig, Export
from kinefilter.characters import InputError
from kinefilter.pipeline.batch import run
from kinefilter.pipeline.batch.plan import Job, find_sources, plan_jobs
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.cli import given_options, main
from kinefilter.pipeline.formats import read_bvh, write_take_csv
from kinefilter.pipeline.settings import (
    Settings,
    fingerprint,
    overlaid,
    parse_settings,
    read_settings,
)


def _parsed(text: str, folder: Path | None = Path("/folder")) -> Settings:
    return overlaid(Settings(), parse_settings(text, "f.toml", folder))


def test_every_kind_of_value_is_taken() -> None:
    found = _parsed(
        'method = "none"\ncutoff = 4\nadapt = true\nfloor = 0.1\nseed = 3\n'
        'rotation-order = "xyz"\nfps = 24.0\nbody = 2\nformat = "ntu"\n'
        "take-fps = 60.0\n"
        'database = "cmu.npz"\nscene = "box"\ncalibration = "places.json"\n'
        'sessions = "{name}_{sensor}.csv"\nsensors = ["side", "front"]\n'
    )
    config = CleanConfig(
        method="none",
        cutoff=4.0,
        adapt=True,
        floor=0.1,
        seed=3,
        database=Path("/folder/cmu.npz"),
        scene="box",
    )
    export = Export(rotation_order="xyz", fps=24.0)
    names = "{name}_{sensor}.csv", ("side", "front")
    places = Path("/folder/places.json")
    assert found == Settings(config, export, "ntu", 60.0, 2, places, *names)
    assert isinstance(found.config.cutoff, float)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colour = 3", "f.toml: unknown key 'colour'; known: adapt, begin, body"),
        ("cutoff = '4'", "f.toml: cutoff = '4': expected a number"),
        ("cutoff = true", "expected a number"),
        ("physics = 1", "expected true or false"),
        ("seed = 1.5", "expected a whole number"),
        ("feet = 'sometimes'", 'expected "auto", "always", "never"'),
        ("floor = 'low'", 'expected "auto", "none" or a number'),
        ("body = 'everyone'", 'expected a whole number or "all"'),
        ("model = 3", "expected the path of a file"),
        ("[clean]\ncutoff = 3", "unknown key 'clean'"),
        ("cutoff = 0.01", "f.toml: --cutoff 0.01"),
        ("cutoff =", "f.toml: not TOML"),
    ],
)
def test_what_a_file_must_not_say_is_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        _parsed(text)
    assert words in str(caught.value)


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    file = tmp_path / "sub" / "f.toml"
    file.parent.mkdir()
    file.write_text('model = "m.npz"\nrig = "r.toml"\nscene = "../s.xml"\n')
    values = read_settings(file).values
    assert values["model"] == tmp_path / "sub" / "m.npz"
    assert values["rig"] == str(tmp_path / "sub" / "r.toml")
    assert Path(str(values["scene"])).resolve() == tmp_path / "s.xml"
    assert _parsed('rig = "unreal"').export.rig == "unreal"
    with pytest.raises(InputError, match="absolute path"):
        parse_settings('model = "m.npz"', "s3://bucket/kinefilter.toml", None)
    absolute = parse_settings('model = "/m.npz"', "s3://bucket/kinefilter.toml", None)
    assert absolute.values["model"] == Path("/m.npz")


def _jobs(root: Path, given: frozenset[str] = frozenset()) -> dict[str, Job]:
    sources = find_sources([str(root)], str(root / "out"))
    own = Settings(CleanConfig(seed=9) if given else CleanConfig())
    settings = overlaid(own, read_settings(root / "all.toml"), given)
    out = store_at(str(root / "out"))
    jobs = plan_jobs(sources, out, settings, ".bvh", given=given)
    return {job.take: job for job in jobs}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a folder of folders of takes, with files of settings."""
    for folder, text in (
        ("all.toml", 'cutoff = 1.0\nseed = 1\nfeet = "always"\n'),
        ("kinefilter.toml", "seed = 2\ntilt = 2.0\n"),
        ("a/kinefilter.toml", "seed = 3\n"),
        ("a/b/kinefilter.toml", "tilt = 4.0\n"),
    ):
        (tmp_path / folder).parent.mkdir(exist_ok=True)
        (tmp_path / folder).write_text(text)
    for name in ("x.csv", "a/x.csv", "a/b/x.csv", "c/x.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("a take")
    return tmp_path


def test_folders_inherit_and_the_nearer_file_is_stronger(root: Path) -> None:
    found = {
        take: (job.settings.config.seed, job.settings.config.tilt)
        for take, job in _jobs(root).items()
    }
    assert found == {
        "x.csv": (2, 2.0),
        "a/x.csv": (3, 2.0),
        "a/b/x.csv": (3, 4.0),
        "c/x.csv": (2, 2.0),
    }
    for job in _jobs(root).values():
        assert job.settings.config.cutoff == 1.0
        assert job.settings.config.feet == "always"


def test_what_was_given_is_stronger_than_any_file(root: Path) -> None:
    jobs = _jobs(root, frozenset({"seed", "cutoff"}))
    assert {job.settings.config.seed for job in jobs.values()} == {9}
    assert {job.settings.config.cutoff for job in jobs.values()} == {6.0}
    assert {job.settings.config.tilt for job in jobs.values()} == {2.0, 4.0}


def test_a_wrong_file_of_a_folder_is_named(root: Path) -> None:
    (root / "a" / "b" / "kinefilter.toml").write_text("speed = 2\n")
    with pytest.raises(InputError, match=r"b/kinefilter\.toml: unknown key 'speed'"):
        _jobs(root)


def test_what_is_written_depends_on_the_settings_alone(tmp_path: Path) -> None:
    one, two = tmp_path / "one.npz", tmp_path / "two.npz"
    one.write_bytes(b"model")
    two.write_bytes(b"model")

    def printed(model: Path, suffix: str = ".bvh", seed: int = 0) -> str:
        return fingerprint(Settings(CleanConfig(model=model, seed=seed)), suffix)

    assert printed(one) == printed(two)
    assert len({printed(one), printed(one, ".usdc"), printed(one, seed=1)}) == 3
    before = printed(two)
    two.write_bytes(b"another")
    assert printed(two) != before


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("batch in -o out --cutoff 3", {"cutoff"}),
        ("clean --no-physics --rotation-order=xyz", {"physics", "rotation_order"}),
        ("clean --rotation_order xyz", {"rotation_order"}),
        ("clean -- --cutoff", set()),
    ],
)
def test_options_that_a_command_line_gives_are_known(
    line: str, names: set[str]
) -> None:
    fields = {"cutoff", "physics", "rotation_order", "seed"}
    assert given_options(line.split()) & fields == names


def test_clean_takes_a_file_of_settings_and_options_overrule_it(tmp_path: Path) -> None:
    take, file, out = (tmp_path / name for name in ("t.csv", "f.toml", "c.bvh"))
    write_take_csv(short_take(30), take)
    file.write_text('method = "none"\nphysics = false\nfps = 20\nunits = "cm"\n')
    command = ["clean", str(take), "-o", str(out), "--config", str(file)]
    assert main(command) == 0
    assert read_bvh(out).frame_time == pytest.approx(1 / 20)
    assert main([*command, "--fps", "40"]) == 0
    assert read_bvh(out).frame_time == pytest.approx(1 / 40)


def test_batch_lets_options_overrule_every_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "open_crew", Here)
    takes, out = tmp_path / "takes", tmp_path / "clips"
    for name in ("a", "b"):
        (takes / name).mkdir(parents=True)
        write_take_csv(short_take(30), takes / name / "t.csv")
    (takes / "kinefilter.toml").write_text('method = "none"\nphysics = false\n')
    (takes / "a" / "kinefilter.toml").write_text("fps = 20\n")
    (tmp_path / "all.toml").write_text("fps = 25\n")
    command = ["batch", str(takes), "-o", str(out), "--to", "bvh"]
    command += ["--config", str(tmp_path / "all.toml")]

    def rates() -> list[float]:
        clips = [read_bvh(out / name / "t.bvh") for name in ("a", "b")]
        return [1.0 / clip.frame_time for clip in clips]

    assert main(command) == 0
    assert rates() == pytest.approx([20, 25], rel=1e-4)
    assert main([*command, "--fps", "40"]) == 0
    assert rates() == pytest.approx([40, 40], rel=1e-4)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--method none --database x.npz", "--method none does not use --database"),
        ("--preset liu-2016 --database x.npz", "liu-2016 does not use --database"),
        ("--model x.npz --database x.npz", "a --model alone does not use --database"),
        ("--no-reconstruct --same-person x.csv", "--same-person needs --reconstruct"),
        ("--preset shum-2013 --same-person x.csv", "which --preset shum-2013 turns"),
        ("--preset liu-2016 --scene box", "which --preset liu-2016 turns off"),
        ("--no-physics --scene box", "--scene needs --physics, which --no-physics"),
    ],
)
def test_options_without_effect_are_refused(
    options: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take, out = tmp_path / "t.csv", tmp_path / "t.npz"
    write_take_csv(short_take(30), take)
    assert main(["clean", str(take), "-o", str(out), *options.split()]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


def test_the_take_itself_is_no_other_take_of_the_person(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take, other = tmp_path / "t.csv", tmp_path / "other.csv"
    for path in (take, other):
        write_take_csv(short_take(30), path)
    words = ["clean", str(take), "-o", str(tmp_path / "t.npz"), "--no-physics"]
    assert main([*words, "--same-person", str(other)]) == 0
    assert "is ignored" not in capsys.readouterr().out
    assert main([*words, "--same-person", str(other), str(take)]) == 0
    assert "the take itself, which is ignored" in capsys.readouterr().out
