"""The commands of the command line: they parse and print, nothing else.

``cli`` loads a file when one of its commands is asked for.
"""

__all__: list[str] = []
