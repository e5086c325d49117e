"""Live streams: frames in, poses out to engines (VMC) and browsers (WebSocket).

``tests/live_figures.py`` measures latency and memory with one or more people, slow
readers, and senders of malformed messages.
"""
