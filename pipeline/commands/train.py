"""``kinefilter train``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.methods import LearnedName

from .terminal import Skeletons, clips_of, in_folders, keep, out, progress_bars


@dataclass(frozen=True)
class Train:
    """Teach a correction method from pairs of Kinect and mocap.

    The weights that clean has by default (pipeline/embedded/learned.npz) are what the
    six files of UI-PRMD teach, in some minutes. learned learns from simulated people
    as well, beside the recorded ones.
    """

    out: Annotated[Path, arg(aliases=["-o"])]
    """Model to write (.npz)."""
    pairs: Positional[tuple[Path, ...]] = ()
    """Pairs files (.npz), or folders of them; they may be larger than memory."""
    simulated: Skeletons | None = None
    """Learn from simulated pairs of this skeleton, in place of files."""
    furnished: bool = False
    """Simulate people with things before them and in their hands, not alone."""
    method: LearnedName = "learned"
    """What to teach."""

    def run(self) -> int:
        """Learn and write."""
        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.lab.simulate import furnished_pairs, simulated_pairs
        from kinefilter.pipeline.lab.teach import teach
        from kinefilter.pipeline.models import Model, save_model
        from kinefilter.pipeline.training import training_set

        if self.out.suffix != ".npz":
            raise InputError(f"{self.out}: a model is an .npz file; name it so")
        check_folder(self.out)
        if bool(self.pairs) == (self.simulated is not None):
            raise InputError("give pairs files or --simulated SKELETON, not both")
        if self.furnished and self.simulated is None:
            raise InputError("--furnished needs --simulated SKELETON")
        files = in_folders(self.pairs, [".npz"])
        keep(self.out, *files)
        with progress_bars() as progress:
            if self.simulated is None:
                lessons = training_set(clips_of(files, progress))
            else:
                simulated = furnished_pairs if self.furnished else simulated_pairs
                lessons = training_set(simulated(self.simulated, progress=progress))
            learner = teach(self.method, lessons, progress=progress)
        model = Model(learner, self.method, lessons.skeleton, lessons.source)
        save_model(model, self.out)
        out.print(f"wrote {self.out}: {self.method}, learned from {lessons.source}")
        return 0
