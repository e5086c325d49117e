"""The errors a user of kinefilter can meet."""

from __future__ import annotations


class KinefilterError(Exception):
    """Base of every error that kinefilter raises on purpose."""


class InputError(KinefilterError):
    """The input or the command is wrong; the message says what, where, what to try.

    The command line prints it as one line and exits with code 2.
    """
