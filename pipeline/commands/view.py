"""``kinefilter view``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import CleanConfig, TakeFormat

from .terminal import keep, out, progress_bars

if TYPE_CHECKING:
    from kinefilter.pipeline.look import Drawing
    from kinefilter.pipeline.look.viewer import CleanAgain
    from kinefilter.pipeline.progress import Progress


_CLIPS = (".npz", ".usda", ".usdc", ".usd", ".usdz")


@dataclass(frozen=True)
class View:
    """Look at a motion in the browser, and edit when its feet stand.

    Prints the address of a page: play and scrub raw, cleaned and simulated motion,
    skin, contacts and forces, turn them with the mouse, edit when which part of a foot
    stands, save that for clean --contacts, or clean again at once. Needs pip install
    "kinefilter[view]".
    """

    motion: Annotated[Positional[Path], arg(metavar="TAKE|CLIP")]
    """A take in any of the formats of --format, which is cleaned first; or a clip,
    .npz or USD, which is shown as it is. With --take, .bvh and .csv are clips too."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    format: TakeFormat | None = None
    """Layout of the take; default: detected from its content."""
    body: int | None = None
    """Which person of the take, counted from 1; default: who is seen in most
    frames."""
    take: Path | None = None
    """The take that a clip was made of, to see beside it."""
    save_contacts: Path | None = None
    """Where the page saves contacts, for clean --contacts, and nothing else; default:
    beside what is shown, NAME.contacts.csv."""
    bind: str = "127.0.0.1"
    """Address to listen at; the default is reached from this machine alone. Whoever
    reaches it may look and save."""
    port: int = 0
    """Port to listen at; 0: any that is free."""
    open: bool = False
    """Open the page in this machine's browser."""

    def run(self) -> int:
        """Read or clean, serve, wait until it is ended."""
        from kinefilter.pipeline.extras import require

        require("viser", "viewing", "view")
        save = self.save_contacts or _beside(self.motion)
        self._check(save)
        try:
            drawing, again = self._drawing()
            self._serve(drawing, save, again)
        except KeyboardInterrupt:
            pass  # that is how it ends
        return 0

    def _check(self, save: Path) -> None:
        """Raise what is wrong before any work is done."""
        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.look.viewer_server import check_address

        check_address(self.bind, self.port)
        if self.save_contacts is not None:
            check_folder(save)
            if save.suffix.lower() != ".csv":
                raise InputError(f"{save}: contacts are saved as a table; name it .csv")
        config = self.config
        keep(
            save, self.motion, self.take, config.database, config.model, config.contacts
        )
        if self._is_clip and config != CleanConfig():
            raise InputError(
                f"{self.motion}: a clip is shown as it is; options of cleaning are for "
                "takes"
            )
        if self.take is not None and not self._is_clip:
            raise InputError(
                f"--take {self.take} is for a clip; {self.motion} is taken for a take "
                "itself"
            )

    @property
    def _is_clip(self) -> bool:
        """Whether the motion is shown as it is; .bvh and .csv may be either."""
        suffix = Path(self.motion.name.removesuffix(".gz")).suffix.lower()
        with_take = self.take is not None and self.take != self.motion
        return suffix in _CLIPS or (with_take and suffix in (".bvh", ".csv"))

    def _drawing(self) -> tuple[Drawing, CleanAgain | None]:
        """Return what is looked at, and how it is cleaned again."""
        from kinefilter.pipeline.look import cleaned, read_drawing

        if self._is_clip:
            return read_drawing(self.motion, self.take, body=self.body), None
        from kinefilter.pipeline.formats.takes import read_recording

        recording = read_recording(self.motion, format=self.format)
        take = recording.take(self.body)
        for note in recording.notes:
            out.print(note)

        def again(contacts: Path, progress: Progress) -> Drawing:
            config = replace(self.config, contacts=contacts)
            return cleaned(take, config, progress=progress)

        with progress_bars() as progress:
            return cleaned(take, self.config, progress=progress), again

    def _serve(self, drawing: Drawing, save: Path, again: CleanAgain | None) -> None:
        from kinefilter.pipeline.look import opened_viewer

        with opened_viewer(
            drawing, save, again=again, bind=self.bind, port=self.port
        ) as viewer:
            out.print(f"{viewer.address} shows {self.motion}; Ctrl-C ends")
            if self.open:
                import webbrowser

                webbrowser.open(viewer.address)
            viewer.run()


def _beside(path: Path) -> Path:
    """Return where contacts are saved by default: wave.contacts.csv for wave.csv.gz."""
    stem = Path(path.name.removesuffix(".gz")).stem
    return path.with_name(f"{stem}.contacts.csv")
