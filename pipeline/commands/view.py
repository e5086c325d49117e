"""The commands that show motions: ``view``, ``render`` and ``report``."""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.edits import Edit, EditsFile
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.formats.export import WHOLE_CLIPS
from kinefilter.pipeline.look.drawing import Drawing, read_finite_clip
from kinefilter.pipeline.look.options import Look
from kinefilter.pipeline.progress import Progress

from .terminal import check_calibration, check_output, err, keep, out, progress_bars

if TYPE_CHECKING:
    from kinefilter.pipeline.draft import Unedited
    from kinefilter.pipeline.look.viewer import CleanAgain


@dataclass(frozen=True)
class View:
    """Look at a motion in the browser, and say where it is wrong.

    Prints the address of a page: play and scrub raw, cleaned and simulated motion,
    skin, contacts and forces, turn them with the mouse. Go to what is doubtful; say
    when a limb or joint is wrong, sides are exchanged or a foot stands, or drag a joint
    to where it is; save that for clean --edits, or clean again at once. Edits are read
    from the file of --edits and saved there, by default NAME.edits.toml beside what is
    shown. Takes of several sensors become one motion, as of clean, and the page shows
    where each sensor stands and what it saw. Needs pip install "kinefilter[view]".
    """

    motion: Annotated[Positional[tuple[Path, ...]], arg(metavar="TAKE...|CLIP")]
    """A take in any of the formats of --format, which is cleaned first, or one of each
    of several sensors; or a clip, .npz, USD or GLB, which is shown as it is. With
    --take, .bvh and .csv are clips too."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    format: TakeFormat | None = None
    """Layout of the take; default: detected from its content."""
    take_fps: float | None = None
    """Frames a second of a take that has no time stamps; default: 30."""
    body: int | None = None
    """Which person of the take, counted from 1; default: who is seen in most
    frames."""
    take: UseAppendAction[tuple[Path, ...]] = ()
    """The take that a clip was made of, to see beside it; of several sensors each, in
    the order of clean."""
    calibration: Path | None = None
    """Where and when several sensors are, as of 'merge --save-calibration'."""
    bind: str = "127.0.0.1"
    """Address to listen at; the default is reached from this machine alone. Whoever
    reaches it may look and save."""
    port: int = 0
    """Port to listen at; 0: any that is free."""
    open: bool = False
    """Open the page in this machine's browser."""

    def run(self) -> int:
        """Read or clean, serve, wait until it is ended."""
        require("viser", "viewing", "view")
        from kinefilter.pipeline.look.viewer import Viewer
        from kinefilter.pipeline.look.viewer_server import opened_server

        if not self.motion:
            raise InputError("nothing to view; name a take or a clip")
        # By default wave.edits.toml for wave.csv.gz.
        first = self.motion[0]
        stem = Path(first.name.removesuffix(".gz")).stem
        save = self.config.edits or first.parent / f"{stem}.edits.toml"
        self._check(save)
        try:
            drawing, again = self._drawing(EditsFile(save).read())
            with opened_server(self.bind, self.port) as server:
                viewer = Viewer(server, drawing, save, again)
                shown = ", ".join(map(str, self.motion))
                out.print(f"{viewer.address} shows {shown}; Ctrl-C ends")
                if self.open:
                    webbrowser.open(viewer.address)
                viewer.run()
        except KeyboardInterrupt:
            pass  # that is how it ends
        return 0

    def _check(self, save: Path) -> None:
        """Raise what is wrong before any work is done."""
        from kinefilter.pipeline.look.viewer_server import check_address

        check_address(self.bind, self.port)
        check_output(save)
        config, takes = replace(self.config, edits=None), self.take or self.motion
        files = (config.database, config.model, config.contacts)
        used = (*files, self.calibration)
        keep(save, *self.motion, *self.take, *used)
        if self._is_clip and config != CleanConfig():
            raise InputError(
                f"{self.motion[0]}: a clip is shown as it is; options of cleaning are "
                "for takes"
            )
        if self.take and not self._is_clip:
            raise InputError(
                f"--take {self.take[0]} is for a clip; {self.motion[0]} is taken for a "
                "take itself"
            )
        if self._is_clip and len(self.motion) > 1:
            raise InputError(
                f"{self.motion[0]}: a clip is shown alone; give the takes that it was "
                "made of with --take"
            )
        check_calibration(self.calibration, takes)

    @property
    def _is_clip(self) -> bool:
        """Whether the motion is shown as it is; .bvh and .csv may be either."""
        suffixes = {
            Path(path.name.removesuffix(".gz")).suffix.lower() for path in self.motion
        }
        with_take = bool(self.take) and self.take != self.motion
        kinds = (*WHOLE_CLIPS, ".bvh", ".csv") if with_take else WHOLE_CLIPS
        return not suffixes.isdisjoint(kinds)

    def _drawing(self, edits: Sequence[Edit]) -> tuple[Drawing, CleanAgain | None]:
        """Return what is looked at, and how it is cleaned again."""
        from kinefilter.pipeline.cleaner import Cleaner
        from kinefilter.pipeline.look.comparison import read_comparison
        from kinefilter.pipeline.merge import clean_session, read_calibration

        if self._is_clip:
            if not self.take:
                return Drawing(read_finite_clip(self.motion[0])), None
            with progress_bars() as progress:
                return read_comparison(
                    self.motion[0],
                    *self.take,
                    body=self.body,
                    calibration=self.calibration,
                    progress=progress,
                ), None
        known = read_calibration(self.calibration)
        recordings = [
            read_recording(path, format=self.format, fps=self.take_fps)
            for path in self.motion
        ]
        for note in recordings[0].notes:
            out.print(note)

        config = replace(self.config, edits=None)
        cleaner, take = Cleaner(config), recordings[0].take(self.body)
        before: list[Unedited] = []

        def made(edits: Sequence[Edit], progress: Progress) -> Drawing:
            if len(recordings) == 1:
                if not before:
                    before.append(cleaner.unedited(take, progress))
                found = cleaner.clean(
                    take, edits=edits, before=before[0], progress=progress
                )
                return Drawing.of(found, take)
            result, merged = clean_session(
                recordings,
                config,
                body=self.body,
                calibration=known,
                edits=edits,
                progress=progress,
            )
            for note in merged.told():
                out.print(note)
            return Drawing.of(result, merged.take, merged)

        with progress_bars() as progress:
            return made(edits, progress), made


@dataclass(frozen=True)
class Render:
    """Draw clips as videos, animations or pictures.

    Needs no screen: EGL draws or, where no GPU is, OSMesa (Debian's libosmesa6).
    """

    clips: Positional[tuple[Path, ...]]
    """Clips: .npz, USD, GLB, .bvh or .csv; the last two hold no props and
    reliability."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """What to write: out.mp4, out.gif or frames/%05d.png; {clip} stands for a clip's
    name. Pictures that are there already are kept."""
    look: OmitArgPrefixes[Look] = field(default_factory=Look)
    jobs: int | None = None
    """Processes that draw; default: one a core."""

    def run(self) -> int:
        """Draw, write, report."""
        from kinefilter.pipeline.look.video import render_clips

        if not self.clips:
            raise InputError("no clips given; name one or more to draw")
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}: expected 1 or more")
        keep(self.out, *self.clips, self.look.compare)
        try:
            with progress_bars() as progress:
                done = render_clips(
                    self.clips, self.out, self.look, jobs=self.jobs, progress=progress
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "the same command again goes on with numbered pictures, a video begins "
                "anew"
            ) from None
        out.print(str(done.backend))
        for path in done.written:
            out.print(f"wrote {path}")
        for failure in done.failures:
            err.print(f"kinefilter: {failure}; left out")
        return 1 if done.failures else 0


@dataclass(frozen=True)
class Report:
    """Show a clip beside its take in one web page, which needs no network.

    Raw and clean play side by side over reliability and origin of every joint,
    contacts, distances moved, and the metrics, passed or failed; where there were
    several sensors, also over where each stands, what it saw, how far that is from the
    merged take, and how much of each joint is of it. clean --report writes it too.
    """

    clip: Positional[Path]
    """Clip: .npz, USD, GLB, .bvh or .csv."""
    take: UseAppendAction[tuple[Path, ...]]
    """The take that the clip was made of; of several sensors each, in the order of
    clean."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Page to write, .html."""
    body: int | None = None
    """Which person of the take, counted from 1; default: who is seen in most
    frames."""
    calibration: Path | None = None
    """Where and when several sensors are, as of 'merge --save-calibration'."""
    thresholds: Path | None = None
    """TOML file of limits, as fail_on = ["skate > 0.003"]; default: those that ship
    with kinefilter. They color the table of metrics."""
    fail_on: UseAppendAction[tuple[str, ...]] = ()
    """A limit, as skate>0.003 (quoted, for the shell); beyond it, exit code 1. May be
    given several times."""

    def run(self) -> int:
        """Compare, write, say what failed."""
        from kinefilter.pipeline.look import page
        from kinefilter.pipeline.look.comparison import read_comparison

        if not self.take:
            raise InputError("no --take given; give the take that the clip was made of")
        check_calibration(self.calibration, self.take)
        page.check_report(self.out)
        check_output(self.out, self.clip, *self.take, self.calibration, self.thresholds)
        gates = [page.parse_limit(text) for text in self.fail_on]
        limits = page.read_limits(self.thresholds)
        with progress_bars() as progress:
            comparison = read_comparison(
                self.clip,
                *self.take,
                body=self.body,
                calibration=self.calibration,
                progress=progress,
            )
        # A gate that is a threshold too stands once in the table.
        limits = tuple(dict.fromkeys((*limits, *gates)))
        page.write_report(comparison, self.out, limits)
        out.print(f"wrote {self.out}")
        failed = [gate for gate in gates if gate.fails(comparison.after)]
        for gate in failed:
            value = comparison.after[gate.metric]
            err.print(f"kinefilter: failed {gate}: it is {value:.4g}")
        return 1 if failed else 0
