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
from .commands.signals import ended_gently
from .commands.terminal import err
from .workers import one_thread

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

Exit codes: 0 done, for live, replay and view also if Ctrl-C or SIGTERM ended them; 1
done, but of several takes or clips some were left out, the recording of live ended
early, a metric is beyond --fail-on, or a figure of README did not hold; 2 the input or
the command was wrong, or a file could not be written; 130 interrupted: batch, render
and reproduce --all go on with the same command. Files are there whole or not at all."""

_INTERRUPTED = 130  # what shells say of a program that Ctrl-C ended


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
        with ended_gently(), one_thread():
            return command.run()
    except InputError as error:
        err.print(f"kinefilter: {error}")
        return 2
    except KeyboardInterrupt as ended:  # its words are what the user should know
        err.print("; ".join(["kinefilter: interrupted", *map(str, ended.args)]))
        return _INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
