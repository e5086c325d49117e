"""Exceptions that kinefilter raises on purpose."""


class KinefilterError(Exception):
    """Base class of every error that kinefilter raises on purpose."""


class InputError(KinefilterError):
    """Invalid input or an invalid command; the message says what, where, what to try.

    The command line prints it as one line and exits with code 2. Settings are named as
    its options: in Python, ``--rotation-order zyx`` is ``rotation_order="zyx"``, and
    ``--no-physics`` is ``physics=False``.
    """
