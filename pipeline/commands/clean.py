"""``kinefilter clean``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.export import Export

from .terminal import keep, out, progress_bars, write_json

__all__ = ["Clean"]

Formats = Literal["kinefilter", "kinect-v2", "kinect-v1"]


@dataclass(frozen=True)
class Clean:
    """Clean a Kinect take and write it as an animation clip."""

    take: Positional[Path]
    """Recording: kinefilter CSV, Kinect v2 CSV or Kinect v1 text; .gz too."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Clip to write; the extension decides: .usda .usdc .usd .usdz .bvh .csv
    .npz."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    export: OmitArgPrefixes[Export] = field(default_factory=Export)
    format: Formats | None = None
    """Layout of the take; default: detected from its content."""
    save_contacts: Path | None = None
    """Write when which foot stands as a table (CSV), to edit and to use again."""
    json: Path | None = None
    """Write the printed figures to this file too."""

    def run(self) -> int:
        """Clean, write, print."""
        from kinefilter.pipeline.formats import (
            check_folder,
            check_writable,
            read_take,
            write_clip,
            write_contacts,
        )
        from kinefilter.pipeline.run import clean
        from kinefilter.pipeline.summary import as_json, as_tables

        check_writable(self.out, self.export)
        used = (
            self.take,
            self.config.database,
            self.config.model,
            self.config.contacts,
            self.export.character,
        )
        keep(self.out, *used)
        if self.json is not None:
            check_folder(self.json)
            keep(self.json, *used, self.out)
        if self.save_contacts is not None:
            check_folder(self.save_contacts)
            keep(self.save_contacts, *used, self.out, self.json)
        take = read_take(self.take, format=self.format)
        with progress_bars() as progress:
            result = clean(take, self.config, progress=progress)
        write_clip(result.clip, self.out, self.export)
        if self.save_contacts is not None:
            write_contacts(result.clip, self.save_contacts)
        if self.json is not None:
            write_json(as_json(result), self.json)
        out.print(as_tables(result))
        out.print(f"wrote {self.out}")
        return 0
