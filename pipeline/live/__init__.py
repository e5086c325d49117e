"""Streams of frames in, poses out: to engines by VMC, to browsers by WebSocket.

``tests/live_figures.py`` measures latency and memory, with one or many people, slow
readers and senders of nonsense.
"""

__all__: list[str] = []
