"""The command line: finds the command and turns errors into exit codes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import tyro
from tyro.conf import subcommand

from kinefilter.characters import InputError

from .commands import (
    Batch,
    Bench,
    Character,
    Clean,
    Database,
    Evaluate,
    Info,
    Live,
    Render,
    Replay,
    Report,
    Reproduce,
    Simulate,
    Train,
    View,
)
from .commands.given import given_options
from .commands.terminal import err
from .workers import one_thread

__all__ = ["main"]

Command = (
    Annotated[Clean, subcommand("clean")]
    | Annotated[Batch, subcommand("batch")]
    | Annotated[Info, subcommand("info")]
    | Annotated[Live, subcommand("live")]
    | Annotated[Replay, subcommand("replay")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Report, subcommand("report")]
    | Annotated[View, subcommand("view")]
    | Annotated[Database, subcommand("database")]
    | Annotated[Train, subcommand("train")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[Simulate, subcommand("simulate")]
    | Annotated[Reproduce, subcommand("reproduce")]
    | Annotated[Character, subcommand("character")]
    | Annotated[Bench, subcommand("bench")]
)

_DESCRIPTION = """Turn noisy Kinect takes into clips that animators ship.

Exit codes: 0 done; 1 done, but of several takes or clips some were left out, a metric
is beyond --fail-on, or a figure of README did not hold; 2 the input or the command was
wrong, and nothing was written; 130 a batch was interrupted, and goes on with the same
command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    ``--help`` says which there are.
    """
    try:
        command = tyro.cli(
            Command,
            prog="kinefilter",
            description=_DESCRIPTION,
            args=arguments,
        )
        if isinstance(command, Batch | Clean):
            named = sys.argv[1:] if arguments is None else arguments
            command = replace(command, given=given_options(named))
        with one_thread():
            return command.run()
    except InputError as error:
        err.print(f"kinefilter: {error}")
        return 2


if __name__ == "__main__":
    sys.exit(main())
