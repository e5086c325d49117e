"""The command line: finds the command, and turns errors into exit codes."""

import errno
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from io import TextIOWrapper
from typing import Annotated, Any, Union

import tyro
from tyro.conf import subcommand

from kinefilter.characters import InputError

from .commands.terminal import ended_gently, err, out
from .formats.files import local_path
from .formats.plain import printable
from .workers import one_thread, set_variables

_GROUPS = {
    "daily": "clean, batch, merge, info, render, report, view, character, blender",
    "live": "live, replay, play",
    "learning": "pair, train, database",
    "lab": "evaluate, simulate, rate, ratings, reproduce, bench",
}
_FILES = {
    "commands.clean": "clean, batch",
    "commands.info": "info, character, blender",
    "commands.merge": "merge",
    "commands.view": "render, report, view",
    "commands.play": "play",
    "commands.live": "live, replay",
    "lab.commands.learn": "pair, train, database",
    "lab.commands.measure": "evaluate, reproduce, bench",
    "lab.commands.simulate": "simulate",
    "lab.commands.rate": "rate, ratings",
}
"""Modules in ``pipeline``, with the commands in each."""
COMMANDS = ", ".join(_GROUPS.values()).split(", ")  # names of the commands, by group

_ABOUT = f"""Turn noisy Kinect takes into clips that animators ship.

{chr(10).join(f"- {group}: {names}" for group, names in _GROUPS.items())}

'kinefilter COMMAND --help' describes a command. Its group may come before it, as in
'kinefilter lab rate'. 'kinefilter --version' prints the version.

Exit codes: 0, done, also when Ctrl-C or SIGTERM ended live, replay, play or view; 1,
done, but some takes or clips were left out, the recording of live ended early, a metric
exceeds --fail-on, --fail-on-damage found damage, or a figure of README did not hold; 2,
the input or the command was wrong, or a file could not be written; 130, interrupted:
the same batch or reproduce --all command resumes where it ended. Files are
written whole or not at all."""

_CONFIG = (tyro.conf.HelptextFromCommentsOff,)  # whose search takes long
_INTERRUPTED = 130  # as shells report a program ended by Ctrl-C
_UNREAD = 141  # and one whose output is no longer read


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; see ``kinefilter --help``."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    for stream in (sys.stdout, sys.stderr):  # for characters the terminal cannot show
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        if arguments is None and words[:1] == ["clean"]:
            # It draws nothing, and looking for OpenGL takes a tenth of a second.
            with set_variables({"MUJOCO_GL": "disable"}):
                import_module("mujoco")
        return _run(words)
    except InputError as error:
        err.print(f"kinefilter: {printable(str(error))}")
        return 2
    except MemoryError:
        err.print("kinefilter: not enough memory; cut long takes into parts")
        return 2
    except KeyboardInterrupt as ended:  # its arguments are notes for the user
        err.print("; ".join(["kinefilter: interrupted", *map(str, ended.args)]))
        return _INTERRUPTED
    except PermissionError as error:
        where = error.filename or error
        err.print(f"kinefilter: {where}: cannot be accessed; check permissions")
        return 2
    except OSError as error:
        windows = sys.platform == "win32" and error.errno == errno.EINVAL
        if not (windows or isinstance(error, BrokenPipeError)):
            raise
        # The reader has closed the pipe; the final flush must not fail either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _UNREAD


def _run(words: Sequence[str]) -> int:
    if words == ["--version"]:
        out.print(f"kinefilter {version('kinefilter')}")
        return 0
    if words and words[0] not in COMMANDS:  # 'lab rate' means 'rate'
        group = _GROUPS.get(words[0], "").split(", ")
        words = words[1:] if words[1:2] and words[1] in group else words
    words = [*map(local_path, words)]
    if "" in words:  # as a path it would mean the current folder
        raise InputError("an argument is empty; name a file, or set the variable")
    try:
        command = _read(words)
        if hasattr(command, "given"):
            command = replace(command, given=given_options(words))
        with ended_gently(), one_thread():
            return int(command.run())
    finally:
        sys.stdout.flush()


def _read(words: Sequence[str]) -> Any:
    """Return the command with its options."""
    with _paragraphs_joined():
        if words and words[0] in COMMANDS:
            name, *rest = words
            prog = f"kinefilter {name}"
            return tyro.cli(_command(name), prog=prog, args=rest, config=_CONFIG)
        listed = []
        for name in COMMANDS:
            kind = _command(name)
            summary = (kind.__doc__ or "").split("\n")[0]
            listed.append(Annotated[kind, subcommand(name, description=summary)])
        union: Any = Union[tuple(listed)]  # noqa: UP007 - made at run time
        return tyro.cli(
            union, prog="kinefilter", description=_ABOUT, args=words, config=_CONFIG
        )


@contextmanager
def _paragraphs_joined() -> Iterator[None]:
    """Join the lines of each field's docstring, so that help is wrapped only once.

    tyro joins lines before it removes their indentation, which has no effect on the
    docstrings of fields. It reads them through docstring_parser, which it depends on.
    """
    import docstring_parser

    parse = docstring_parser.parse_from_object

    def parse_joined(kind: Any) -> Any:
        parsed = parse(kind)
        for field in parsed.params:
            field.description = " ".join((field.description or "").split())
        return parsed

    vars(docstring_parser)["parse_from_object"] = parse_joined
    try:
        yield
    finally:
        vars(docstring_parser)["parse_from_object"] = parse


def _command(name: str) -> Any:
    (file,) = (file for file, names in _FILES.items() if name in names.split(", "))
    return getattr(import_module(f"kinefilter.pipeline.{file}"), name.capitalize())


def given_options(words: Sequence[str]) -> frozenset[str]:
    """Return the fields of the given options, which files must not change."""
    names = set()
    for word in words:
        if word == "--":
            break
        if word.startswith("--"):
            name = word[2:].partition("=")[0].replace("-", "_")
            names |= {name, name.removeprefix("no_")}
    return frozenset(names)


if __name__ == "__main__":
    sys.exit(main())
