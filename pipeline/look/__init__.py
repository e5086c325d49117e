"""Drawing takes and clips: videos, pages to view and play in the browser, reports.

``drawing`` describes what is drawn; ``video``, ``viewer`` and ``page`` each render that
description in their medium.
"""
