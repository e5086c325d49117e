"""What is drawn of takes and clips: videos, the viewer in the browser, report pages.

``drawing`` describes what is drawn; ``video``, ``viewer`` and ``page`` each turn that
description into their medium.
"""

__all__: list[str] = []
