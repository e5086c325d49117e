"""The commands ``view``, ``render`` and ``report``."""

from __future__ import annotations

import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.edits import Edit, EditsFile, edits_beside
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.export import WHOLE_CLIPS
from kinefilter.pipeline.formats.files import check_file
from kinefilter.pipeline.look.drawing import Drawing, read_finite_clip
from kinefilter.pipeline.look.options import Look
from kinefilter.pipeline.progress import Progress

from .terminal import check_calibration, check_output, err, keep, out, progress_bars

if TYPE_CHECKING:
    from kinefilter.pipeline.batch.manifest import ClipRow, Row
    from kinefilter.pipeline.draft import Unedited
    from kinefilter.pipeline.look.comparison import Comparison
    from kinefilter.pipeline.look.viewer import CleanAgain


@dataclass(frozen=True)
class View:
    """View and correct a motion in the browser.

    Prints the address of a page that plays the raw, cleaned and simulated motion with
    skin, contacts and forces. The page jumps to doubtful seconds. There you can mark
    limbs or joints as wrong, swap left and right, set foot contacts and drag joints
    into place, then save these edits for clean --edits or clean again at once. Edits
    are read from and saved to the file of --edits, by default NAME.edits.toml beside
    the take. Takes of several sensors become one motion, as with clean, and the page
    shows where each sensor stands and what it saw. Needs pip install
    "kinefilter[view]".
    """

    motion: Annotated[Positional[tuple[Path, ...]], arg(metavar="TAKE...|CLIP|FOLDER")]
    """A take in any of the formats of --format, which is cleaned first, or one take per
    sensor; or a clip (.npz, USD or GLB), which is shown as it is. With --take, .bvh and
    .csv are clips too. Or a folder of clips from batch, which are listed with the worst
    first; those whose takes are found with --take can be cleaned again there."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    format: TakeFormat | None = None
    """Format of the take; default: detected from its content."""
    take_fps: float | None = None
    """Frames per second of a take without time stamps; default: 30."""
    body: int | None = None
    """Number of the person in the take, from 1; default: the one seen in most
    frames."""
    take: UseAppendAction[tuple[Path, ...]] = ()
    """The take that the clip was made from, shown beside it; for a folder of clips, the
    folder of the takes. For several sensors, repeat the option in the order given to
    clean."""
    other: Path | None = None
    """Another clip of the same take, such as one cleaned with other options, shown as a
    green figure and in the curves."""
    calibration: Path | None = None
    """Calibration of several sensors, from 'merge --save-calibration'."""
    bind: str = "127.0.0.1"
    """Address to listen on; the default accepts connections from this machine only.
    Anyone who can connect may view and save."""
    port: int = 0
    """Port to listen on; 0 picks a free one."""
    open: bool = False
    """Open the page in the default browser."""

    def run(self) -> int:
        """Read or clean the motion, and serve the page until interrupted."""
        require("viser", "viewing", "view")
        from kinefilter.pipeline.batch.outcome_tables import figures_of
        from kinefilter.pipeline.look.viewer import Viewer
        from kinefilter.pipeline.look.viewer_server import check_address, opened_server

        if not self.motion:
            raise InputError("nothing to view; give a take or a clip")
        check_address(self.bind, self.port)
        clips: list[tuple[Row, ClipRow]] = []
        if len(self.motion) == 1 and self.motion[0].is_dir():
            clips = self._listed(self.motion[0])
        else:
            self._check()

        def names() -> Iterator[str]:
            for row, clip in clips:
                take, *figures = figures_of(row, clip).items()
                yield f"{take[1]} ({', '.join(map(' '.join, figures))})"

        with suppress(KeyboardInterrupt):  # the regular way to quit
            paths = enumerate(self.motion[0] / clip.output for _, clip in clips)
            number = next((k for k, path in paths if path.is_file()), 0)
            opened = self._opened(clips, number)
            with opened_server(self.bind, self.port) as server:
                viewer = Viewer(server, *opened, listed=[*names()], shown=number)
                shown = ", ".join(map(str, self.motion))
                out.print(f"{viewer.address} shows {shown}; press Ctrl-C to quit")
                if self.open:
                    webbrowser.open(viewer.address)
                while (chosen := viewer.run()) is not None:
                    try:
                        number, opened = chosen, self._opened(clips, chosen)
                    except InputError as error:  # the page stays with what it shows
                        err.print(f"kinefilter: {error}")
                    server.gui.reset()
                    viewer = Viewer(server, *opened, listed=[*names()], shown=number)
        return 0

    def _listed(self, folder: Path) -> list[tuple[Row, ClipRow]]:
        """Return the clips of a batch, the worst first."""
        from kinefilter.pipeline.batch.manifest import read_rows
        from kinefilter.pipeline.batch.outcome_tables import worst_first
        from kinefilter.pipeline.batch.task import find_takes

        reading = self.body, self.format, self.take_fps
        if self.config != CleanConfig() or self.other or any(reading):
            raise InputError(
                f"{folder}: clips are shown as they are; of the options, only --take, "
                "--calibration, --bind, --port and --open apply to a folder"
            )
        if not (clips := worst_first(read_rows(folder))):
            raise InputError(f"{folder}: its manifest lists no clips")
        if self.take and not any(find_takes(row, self.take) for row, _ in clips):
            raise InputError(
                f"--take {self.take[0]}: has no take of these clips; give the folder "
                f"that contains {clips[0][0].take}"
            )
        return clips

    def _opened(
        self, clips: list[tuple[Row, ClipRow]], number: int
    ) -> tuple[Drawing, Path, CleanAgain | None]:
        """Return a drawing, its file of edits, and what cleans it again.

        Of a list of clips, the drawing has the take if it is found and of one sensor.
        Cleaning again replaces the clip in the folder, and its row in ``clips``.
        """
        if not clips:
            drawing, draw = self._drawing(EditsFile(self._save).read())
            return drawing, self._save, draw
        from kinefilter.pipeline.batch.task import clean_again, find_takes

        (row, clip), (folder,) = clips[number], self.motion
        path, takes = folder / clip.output, find_takes(row, self.take)
        shown = tuple(takes) if len(takes) == 1 else ()
        one = replace(self, motion=(path,), take=shown, body=clip.body)

        def again(edits: Sequence[Edit], progress: Progress) -> Drawing:
            for _ in progress("clean", 1):
                new = clean_again(clips[number][0], folder, takes)
            made = {clip.output: (new, clip) for clip in new.clips}
            clips[:] = [made.get(each[1].output, each) for each in clips]
            return one._drawing(edits)[0]

        save = edits_beside(takes[0] if takes else path)
        return one._drawing(())[0], save, again

    @property
    def _save(self) -> Path:
        """The file of edits of a motion that is not in a folder."""
        return self.config.edits or edits_beside(self.motion[0])

    def _check(self) -> None:
        for path in self.motion:
            check_file(path)
        config, takes = replace(self.config, edits=None), self.take or self.motion
        files = (config.database, config.model, config.contacts)
        used = (*files, self.calibration, self.other)
        check_output(self._save, *self.motion, *self.take, *used)
        if self._is_clip and config != CleanConfig():
            raise InputError(
                f"{self.motion[0]}: a clip is shown as it is; cleaning options are for "
                "takes"
            )
        body = None if self.take else self.body
        unused = {"format": self.format, "take-fps": self.take_fps, "body": body}
        for option, given in unused.items():
            if self._is_clip and given is not None:
                raise InputError(f"--{option} does not apply to a clip; leave it out")
        if self.take and not self._is_clip:
            raise InputError(
                f"--take {self.take[0]} requires a clip, but {self.motion[0]} is a take"
            )
        if self._is_clip and len(self.motion) > 1:
            raise InputError(
                f"{self.motion[0]}: only one clip can be shown; give the takes that it "
                "was made from with --take"
            )
        check_calibration(self.calibration, takes)

    @property
    def _is_clip(self) -> bool:
        """True if the motion is a clip; .bvh and .csv may also be takes."""
        names = (path.name.removesuffix(".gz") for path in self.motion)
        suffixes = {Path(name).suffix.lower() for name in names}
        with_take = bool(self.take) and self.take != self.motion
        # VRMA and FBX count as clips, so that the error says what to give instead.
        kinds = (*WHOLE_CLIPS, ".vrma", ".fbx", *(".bvh", ".csv") * with_take)
        return not suffixes.isdisjoint(kinds)

    def _compared(self, drawing: Drawing) -> Drawing:
        if self.other is None:
            return drawing
        from kinefilter.pipeline.look.comparison import same_times

        other = same_times(read_finite_clip(self.other), drawing.clip, self.other)
        return replace(drawing, other=other)

    def _drawing(self, edits: Sequence[Edit]) -> tuple[Drawing, CleanAgain | None]:
        """Return the drawing, and a function that cleans it with other edits."""
        from kinefilter.pipeline.cleaner import Cleaner
        from kinefilter.pipeline.merge import clean_session, read_calibration

        if self._is_clip:
            if self.take:
                return self._compared(_comparison(self.motion[0], self)), None
            return self._compared(Drawing(read_finite_clip(self.motion[0]))), None
        calibration = read_calibration(self.calibration)
        recordings = [
            read_recording(path, format=self.format, fps=self.take_fps)
            for path in self.motion
        ]
        for note in recordings[0].notes:
            out.print(note)
        config = replace(self.config, edits=None)
        cleaner, take = Cleaner(config), recordings[0].take(self.body)
        before: list[Unedited] = []

        def draw(edits: Sequence[Edit], progress: Progress) -> Drawing:
            if len(recordings) == 1:
                if not before:
                    before.append(cleaner.unedited(take, progress))
                result = cleaner.clean(
                    take, edits=edits, before=before[0], progress=progress
                )
                return self._compared(Drawing.of(result, take))
            result, merged = clean_session(
                recordings,
                config,
                body=self.body,
                calibration=calibration,
                edits=edits,
                progress=progress,
            )
            for note in merged.all_notes():
                out.print(note)
            return self._compared(Drawing.of(result, merged.take, merged))

        with progress_bars() as progress:
            return draw(edits, progress), draw


@dataclass(frozen=True)
class Render:
    """Render clips as videos, GIFs or image sequences.

    Needs no display: rendering uses EGL or, without a GPU, OSMesa (Debian's
    libosmesa6).
    """

    clips: Positional[tuple[Path, ...]]
    """Clips: .npz, USD, GLB, .bvh or .csv; the last two contain neither props nor
    reliability."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Output: out.mp4, out.gif or frames/%05d.png; {clip} stands for the clip's
    name, after its folder's if others share it."""
    look: OmitArgPrefixes[Look] = field(default_factory=Look)
    jobs: int | None = None
    """Number of rendering processes; default: one per core."""

    def run(self) -> int:
        """Render, and print what was written."""
        from kinefilter.pipeline.look.video import render_clips

        if not self.clips:
            raise InputError("no clips given; give one or more to render")
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}: must be at least 1")
        keep(self.out, *self.clips, self.look.compare)
        with progress_bars() as progress:
            done = render_clips(
                self.clips, self.out, self.look, jobs=self.jobs, progress=progress
            )
        out.print(str(done.backend))
        for path in done.written:
            out.print(f"wrote {path}")
        for failure in done.failures:
            err.print(f"kinefilter: {failure}; skipped")
        return 1 if done.failures else 0


@dataclass(frozen=True)
class Report:
    """Write a self-contained web page that compares a clip with its take.

    The raw and the cleaned motion play side by side above reliability and origin of
    every joint, contacts, distances moved, and metrics marked as passed or failed. For
    several sensors, the page also shows where each stands, what it saw, its distance
    from the merged take, and its share of each joint. clean --report writes the same
    page.
    """

    clip: Positional[Path]
    """Clip: .npz, USD, GLB, .bvh or .csv."""
    take: UseAppendAction[tuple[Path, ...]]
    """The take that the clip was made from. For several sensors, repeat the option in
    the order given to clean."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Page to write, .html."""
    body: int | None = None
    """Number of the person in the take, from 1; default: the one seen in most
    frames."""
    calibration: Path | None = None
    """Calibration of several sensors, from 'merge --save-calibration'."""
    fail_on: UseAppendAction[tuple[str, ...]] = ()
    """A limit such as "skate>0.003", in place of the page's own for this metric; if it
    is exceeded, the exit code is 1. May be repeated. A metric that the clip offers
    nothing to measure of, such as flight_error where nobody jumps, is named and does
    not fail."""

    def run(self) -> int:
        """Write the page, and print which limits were exceeded."""
        from kinefilter.pipeline.look import page
        from kinefilter.pipeline.metrics import METRICS

        if not self.take:
            raise InputError(
                "no --take given; give the take that the clip was made from"
            )
        check_calibration(self.calibration, self.take)
        others = (self.clip, *self.take, self.calibration)
        check_output(self.out, *others, suffix=".html")
        gates = [page.parse_limit(text) for text in dict.fromkeys(self.fail_on)]
        comparison = _comparison(self.clip, self)
        after = comparison.after
        unknown = [gate for gate in gates if isnan(after[gate.metric])]
        kind = Path(self.clip.name.lower().removesuffix(".gz")).suffix
        for gate in unknown:
            if gate.metric == "float_mm" and kind in (".bvh", ".csv"):
                raise InputError(
                    f"{self.clip}: --fail-on {gate} needs to know when feet are "
                    f"planted, which {kind} does not hold; give the clip as .npz, USD "
                    "or .glb"
                )
        page.write_report(comparison, self.out, gates)
        out.print(f"wrote {self.out}")
        for gate in unknown:
            meaning = METRICS[gate.metric]
            err.print(f"kinefilter: {gate} not checked: nothing to measure ({meaning})")
        failed = [gate for gate in gates if gate.fails(after)]
        for gate in failed:
            value, meaning = after[gate.metric], METRICS[gate.metric]
            err.print(f"kinefilter: failed {gate}: it is {value:.4g} ({meaning})")
        return 1 if failed else 0


def _comparison(clip: Path, options: View | Report) -> Comparison:
    """Return a clip beside the take that the options name."""
    from kinefilter.pipeline.look.comparison import read_comparison

    body, calibration = options.body, options.calibration
    with progress_bars() as progress:
        return read_comparison(
            clip, *options.take, body=body, calibration=calibration, progress=progress
        )
