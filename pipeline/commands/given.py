"""Which options a command line names, and so no file may change."""

from __future__ import annotations

from collections.abc import Sequence


def given_options(arguments: Sequence[str]) -> frozenset[str]:
    """Return the names of the options that arguments hold, as fields are called.

    Args:
        arguments: The command line; tyro takes no option by a part of its name.
    """
    names = set()
    for word in arguments:
        if word == "--":
            break
        if word.startswith("--"):
            name = word[2:].partition("=")[0].replace("-", "_")
            names |= {name, name.removeprefix("no_")}
    return frozenset(names)
