"""Commands of kinefilter run on what nobody should give them, and what they leave."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import random
import re
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from hostile_files import READERS, damaged, write_valid
from mutations import gently_mutated
from usd_positions import read_usd_positions

from kinefilter import clean, read_take, write_clip
from kinefilter.characters import KINECT_V2, InputError, Take, standard_body
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import read_bvh, read_clip, write_take_csv
from kinefilter.pipeline.formats.sheets import contact_table
from kinefilter.pipeline.lab.simulation import simulate, write_pairs
from kinefilter.pipeline.live.messages import format_frame
from kinefilter.pipeline.live.playback import frames_of
from kinefilter.pipeline.metrics import bone_length_cv, lowest_point
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.retarget.rig_map import RIGS
from kinefilter.scenes import SAMPLE
from kinefilter.scenes.library import Area, perform
from kinefilter.scenes.sensor import Sensor, observe

_DEEPEST = 0.011
"""m under the floor: what contact lets ordinary takes do (README), and rounding."""
_UNEVEN = 0.02  # share by which segments of a written clip may vary, rounding included
_ROOT = Path(__file__).parents[1]
_RIG_MAP = _ROOT / "retarget" / "rigs" / f"{RIGS[0]}.toml"
_ROOM = _ROOT / "scenes" / "basic.xml"


@dataclass
class Ran:
    """What a command said and left."""

    code: int
    said: str


@dataclass
class Attempt:
    """One try, and what it came to."""

    n: int
    rng: random.Random
    files: dict[str, Path]  # valid files by name
    folder: Path  # to work in, empty
    minutes: float  # that the whole script has
    what: str = ""  # for the table
    words: Sequence[str] = ()  # the command line, if it was one

    @cached_property
    def out(self) -> Path:
        """A folder to write to."""
        self.folder.joinpath("out").mkdir()
        return self.folder / "out"

    def command(self, template: str, **others: Path) -> list[str]:
        """Return a command line, its words as of ``filled``."""
        return [self.filled(word, **others) for word in template.split()]

    def filled(self, word: str, **others: Path | str) -> str:
        """Return a word with ``{out}`` and names of files in braces as paths."""
        known = {**self.files, "out": self.out, **others}
        pattern = "|".join(re.escape(f"{{{name}}}") for name in known)
        return re.sub(pattern, lambda hit: str(known[hit[0][1:-1]]), word)

    def run(self, words: Sequence[str]) -> Ran:
        """Run a command and check what it leaves; raises InputError if refused."""
        self.words = words
        ran = run(words)
        check_left(ran, self.out, words)
        if ran.code == 2:
            raise InputError(ran.said.strip())
        return ran


class LostError(Exception):
    """Something that must not happen did."""


def run(words: Sequence[str]) -> Ran:
    """Run a command in this process; raises LostError for anything but its codes."""
    said = io.StringIO()
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("error", RuntimeWarning)
        try:
            code = main(words)
        except SystemExit as ended:
            code = int(ended.code or 0)
    ran = Ran(code, said.getvalue())
    text = ran.said[-300:]
    if code not in (0, 1, 2):
        raise LostError(f"exit code {code}: {text}")
    if "Traceback" in ran.said or "Unrecognized option" in ran.said:
        raise LostError(text)
    if code == 2 and not ran.said.strip():
        raise LostError("exit code 2 without a word")
    ours = [line.startswith("kinefilter: ") for line in ran.said.splitlines()]
    if code == 2 and ours[0] and not all(ours):
        raise LostError(f"a refusal of several lines: {ran.said}")
    return ran


def check_left(ran: Ran, out: Path, words: Sequence[str]) -> None:
    """Raise LostError unless a folder holds what a command may leave, and it is sound.

    Args:
        ran: The command's end.
        out: Where it wrote, empty before.
        words: Its command line.
    """
    files = [path for path in sorted(out.rglob("*")) if path.is_file()]
    hidden = [path.name for path in files if path.name.startswith(".")]
    if hidden:
        raise LostError(f"left {hidden}")
    if ran.code == 2 and files and words[0] not in ("batch", "reproduce"):
        raise LostError(f"refused ({ran.said.strip()[-200:]}), but left {files}")
    written = {"--json", "-o", "--out"} & set(words)
    if ran.code == 0 and written and not files and words[0] not in _SENT:
        raise LostError(f"exit code 0, nothing written: {ran.said[-200:]}")
    for path in files:
        check_file(path, words)


def check_file(path: Path, words: Sequence[str]) -> None:
    """Raise LostError unless a written file is whole and, as a clip, sound."""
    suffix = path.suffix.lower()
    if suffix == ".json":
        json.loads(path.read_text(), parse_constant=_no_constant)
    elif suffix == ".xml":
        # By text, as MuJoCo takes a backslash in a name for a slash.
        mujoco.MjModel.from_xml_string(path.read_text(encoding="utf-8"))
    elif suffix == ".html":
        if "</html>" not in path.read_text(encoding="utf-8")[-100:]:
            raise LostError(f"{path.name} is cut off")
    elif path.stat().st_size == 0:
        raise LostError(f"{path.name} is empty")
    elif path.name in ("c", "contacts.csv"):
        contact_table(path)
    elif path.name.startswith("o") and suffix in _CLIPS:
        _check_clip(path, words)


_SENT = ("info", "replay", "live")  # out to somebody else, or on the terminal
_USD = (".usd", ".usda", ".usdc", ".usdz")
_CLIPS = (".bvh", ".csv", ".npz", ".glb", *_USD)


def _no_constant(word: str) -> float:
    raise LostError(f"{word} is no JSON")


def _check_clip(path: Path, words: Sequence[str]) -> None:
    if words[0] not in ("clean", "batch") or "--one-file" in words:
        return  # models, databases, takes, and what nothing reads back
    if "--rig" in words:
        if path.suffix not in (".glb", ".npz"):  # which nothing here reads of rigs
            bvh = path.suffix == ".bvh"
            places = read_bvh(path).positions if bvh else read_usd_positions(path)[2]
            if not np.isfinite(places).all():
                raise LostError(f"{path.name}: positions that are no numbers")
        return
    clip = read_clip(path)
    for name in ("root", "rotations", "positions", "time"):
        if not np.isfinite(getattr(clip, name)).all():
            raise LostError(f"{path.name}: {name} that are no numbers")
    lengths = clip.body.lengths
    if not (lengths >= 0.0).all() or lengths.max() > 3.0:
        raise LostError(f"{path.name}: segments of {lengths.min()} to {lengths.max()}")
    positions = clip.positions
    if path.suffix == ".csv":
        positions = read_take(path).positions
    uneven = bone_length_cv(positions, clip.body)
    if uneven > _UNEVEN:
        raise LostError(f"{path.name}: segments vary by {uneven:.1%}")
    low = float(np.nanmin(lowest_point(positions, clip.body)))
    if low < -_DEEPEST and "z" not in words:
        raise LostError(f"{path.name}: {-low:.3f} m under the floor")


# Valid files, and the commands for each


def prepare(folder: Path) -> dict[str, Path]:
    """Write valid files of every kind into a folder, and return them by name."""
    folder.mkdir(parents=True, exist_ok=True)
    sample, pair = read_take(SAMPLE), simulate("basic", "wave", sensor="v2")
    v1, v2 = part(sample, 40, 20), part(pair.take, 60, 20)
    clip = clean(v1).clip
    files = write_valid(folder, clip, v1, v2)
    write_take_csv(v1, folder / "take.csv")
    for name in ("clip.usd", "clip.usdz"):
        write_clip(clip, folder / name)
    for name in ("kinect-v2.csv", "ntu.skeleton", "azure.json", "clip.bvh", "arm.amc"):
        packed = gzip.compress(files[name].read_bytes(), mtime=0)
        stem, _, suffix = name.partition(".")
        (folder / f"{stem}-gz.{suffix}.gz").write_bytes(packed)
    half = replace(pair, take=part(pair.take, 40, 60), truth=pair.truth[40:100])
    people = [replace(half, clip=f"m0{k}_s01_e01") for k in (1, 2)]
    people += [replace(clip, subject="another") for clip in people]
    write_pairs(people, folder / "people.npz")
    _write_folders(folder, people, v1, v2)
    texts = {
        "rig.toml": _RIG_MAP.read_text(encoding="utf-8"),
        "options.toml": 'cutoff = 4.0\nmethod = "none"\nheight = 1.8\nfps = 24\n',
        "camera.toml": "position = [0.0, 1.5, 4.0]\ntarget = [0, 1, 0]\nfov = 40\n",
        "own.xml": _ROOM.read_text(encoding="utf-8").replace("</worldbody>", _CRATE),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    with (folder / "frames.jsonl").open("w", encoding="utf-8") as lines:
        lines.writelines(
            format_frame(f) + "\n" for f in frames_of([part(sample, 0, 99)])
        )
    words = [str(folder / "clip.npz"), f"raw={folder / 'take.csv'}"]
    run(["rate", *words, "-o", str(folder / "page.html")])
    _answer(folder)
    _write_two_views(folder)
    for name in ("layered.usda", "mixamo.bvh", "mixamo.usda"):
        rig = ["--rig", "mixamo"] * ("mixamo" in name)
        run(["clean", str(folder / "take.csv"), "-o", str(folder / name), *rig])
    return {path.name: path for path in sorted(folder.iterdir())}


def _answer(folder: Path) -> None:
    """Write a rater's answers to the page in a folder, and remove the page."""
    key = json.loads((folder / "page.key.json").read_text(encoding="utf-8"))
    rows = [{"shown": shown, "grades": [4, 7]} for shown in key["trials"]]
    answers = {"page": key["page"], "rater": "ann", "answers": rows}
    (folder / "answers.json").write_text(json.dumps(answers), encoding="utf-8")
    (folder / "page.html").unlink()


def _write_two_views(folder: Path) -> None:
    """Write three seconds of a person before two sensors, and where these are."""
    body, within = standard_body(KINECT_V2), Area((-1, 1), (-1, 1))
    act = perform("march", body, seed=1, within=within)
    paths = [folder / "front.csv", folder / "side.csv"]
    for path, azimuth in zip(paths, (0.0, 1.5), strict=True):
        take = observe(act, seed=1, sensor=Sensor(azimuth=azimuth))
        write_take_csv(part(take, 0, 90), path)
    saved = ["--save-calibration", str(folder / "calibration.json")]
    run(["merge", *map(str, paths), "-o", str(folder / "merged.csv"), *saved])


def _write_folders(
    folder: Path, people: Sequence[PairedTake], v1: Take, v2: Take
) -> None:
    """Write recordings of the studies, and sessions of two sensors."""
    recordings, sessions = folder / "recordings", folder / "sessions"
    for inner in ("takes/day", "ui-prmd"):
        (recordings / inner).mkdir(parents=True)
    sessions.mkdir()
    write_take_csv(v1, recordings / "takes" / "day" / "take.csv")
    for name in ("s01", "s02"):
        write_pairs(people[:2], recordings / "ui-prmd" / f"{name}.npz")
    for name in ("x_90deg_wave", "y_90deg_wave"):
        for sensor in "AB":
            write_take_csv(v2, sessions / f"{name}_{sensor}.csv")
        rows = "".join(f"{1e3 * t:.3f},{t:.6f},{t:.6f}\n" for t in v2.time)
        text = f"milliseconds,A,B\n{rows}"
        (sessions / f"{name}.sync.csv").write_text(text, encoding="utf-8")


_CRATE = """<body name="crate" pos="1 0 .2"><freejoint/>
<geom type="box" size=".2 .2 .2" mass="3"/></body></worldbody>"""


def part(take: Take, first: int, frames: int) -> Take:
    """Return some frames of a take."""
    kept = slice(first, first + frames)
    time, positions, state = take.time[kept], take.positions[kept], take.state[kept]
    return Take(time - time[0], positions, state, take.skeleton, take.source)


_TAKEN = (
    "info {}",
    "info {} --json",
    "clean {} -o {out}/o.bvh --json {out}/o.json",
    "clean {} -o {out}/o.npz --body all --save-contacts {out}/contacts.csv",
    "clean {} -o {out}/o.usdc --scoring learned",
    "clean {} -o {out}/o.csv --method none --no-reconstruct",
    "clean {} -o {out}/o.bvh --method local-pca --rig mixamo",
    "clean {} -o {out}/o.npz --report {out}/o.html --method none",
    "clean {take.csv} -o {out}/o.bvh --same-person {}",
    "report {clip.npz} --take {} -o {out}/o.html",
    "replay {} --out udp://127.0.0.1:9 --speed 1000",
)
_MERGED = ("merge {} {side.csv} -o {out}/o.csv", "merge {front.csv} {} -o {out}/o.csv")
_MOCAP = ("info {}", "database build {} -o {out}/o.npz --count 20")
_CLIP = ("info {}", "report {} --take {take.csv} -o {out}/o.html")
_TARGET = ("clean {take.csv} -o {out}/o.usda --rig mixamo --target {}",)
COMMANDS: dict[str, tuple[str, ...]] = {
    ".csv": (*_TAKEN, *_MERGED),
    "calibration.json": (
        "merge {front.csv} {side.csv} -o {out}/o.csv --calibration {}",
    ),
    ".skeleton": _TAKEN,
    ".json": _TAKEN,
    ".txt": _TAKEN,
    ".gz": _TAKEN,
    "clip-gz.bvh.gz": _MOCAP,
    "arm-gz.amc.gz": ("info {}",),
    ".bvh": (*_TAKEN, *_MOCAP, *_CLIP),
    ".amc": ("info {}",),
    "mixamo.bvh": _TARGET,
    "mixamo.usda": _TARGET,
    ".c3d": _MOCAP,
    ".usda": (*_CLIP, "clean {take.csv} -o {out}/o.usda --character {}"),
    **dict.fromkeys((".usd", ".usdc", ".usdz", ".glb"), _CLIP),
    "contacts.csv": ("info {}", "clean {take.csv} -o {out}/o.npz --contacts {}"),
    "edits.toml": ("clean {take.csv} -o {out}/o.npz --edits {}",),
    "clip.npz": (*_CLIP, "clean {take.csv} -o {out}/o.bvh --contacts {}"),
    "database.npz": (
        "database info {}",
        "clean {take.csv} -o {out}/o.bvh --method local-pca --database {}",
        "clean {take.csv} -o {out}/o.npz --database {}",
    ),
    "model.npz": ("info {}", "clean {take.csv} -o {out}/o.bvh --model {}"),
    "pairs.npz": ("info {}",),
    "people.npz": (
        "info {}",
        "train {} -o {out}/o.npz --method joint-offsets",
        "database build {} -o {out}/o.npz --count 20 --skeleton kinect_v2",
        "evaluate --test {} --methods none --json {out}/o.json --no-physics",
    ),
    "rig.toml": ("clean {take.csv} -o {out}/o.bvh --rig {}",),
    "options.toml": ("clean {take.csv} -o {out}/o.npz --config {}",),
    "answers.json": ("ratings {} --key {page.key.json}",),
    "page.key.json": ("ratings {answers.json} --key {} --json {out}/o.json",),
    "own.xml": (
        "character -o {out}/o.xml --scene {}",
        "clean {take.csv} -o {out}/o.npz --scene {}",
    ),
}


_LEFT_ALONE = ("take.csv", "camera.toml", "frames.jsonl", "recordings", "sessions")


def abuse_file(attempt: Attempt) -> None:
    """Damage a file and read it, or give it to a command.

    Raises InputError where it is refused, and LostError or whatever went wrong.
    """
    rng, files = attempt.rng, attempt.files
    names = [name for name in files if name not in _LEFT_ALONE]
    weights = [0.3 if Path(name).suffix in _USD else 1.0 for name in names]
    (name,) = rng.choices(names, weights)
    path = attempt.folder / "in" / name
    path.parent.mkdir()
    if name.startswith("arm"):
        shutil.copy(files["arm.asf"], path.parent)
    data = files[name].read_bytes()
    packed = data.startswith(b"\x1f\x8b")
    if rng.random() < 0.5 and (packed or b"\0" not in data):
        data = gently_mutated(gzip.decompress(data) if packed else data, rng)
        path.write_bytes(gzip.compress(data, mtime=0) if packed else data)
    else:
        path.write_bytes(damaged(name, data, rng))
    readers = READERS.get(name, [])
    templates = COMMANDS.get(name) or COMMANDS.get(path.suffix, ())
    if readers and (not templates or rng.random() < 0.7):
        attempt.what = f"read {name}"
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            rng.choice(readers)(path)
        return
    template = rng.choice(templates)
    attempt.what = f"{template.split()[0]} {name}"
    words = attempt.command(template.replace("{}", f"{{{name}}}"), **{name: path})
    attempt.run(words)
