"""``kinefilter info``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from kinefilter.pipeline.config import TakeFormat

from .terminal import out


@dataclass(frozen=True)
class Info:
    """Say what is in a take, a clip, or another file that kinefilter reads."""

    file: Positional[Path]
    """The file."""
    format: TakeFormat | None = None
    """Layout of a take; default: detected from its content."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Read and print."""
        import json

        from kinefilter.pipeline.contents import as_tables, contents_of

        contents = contents_of(self.file, format=self.format)
        if self.json:
            sys.stdout.write(json.dumps(contents, indent=2) + "\n")
        else:
            out.print(as_tables(contents))
        return 0
