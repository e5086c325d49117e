"""The commands of the command line, one a file: they parse and print, nothing else.

``cli`` loads a command when it is asked for: ``Render`` of ``render.py``.
"""

__all__: list[str] = []
