"""Live streams: frames in, poses out to engines (VMC) and browsers (WebSocket)."""
