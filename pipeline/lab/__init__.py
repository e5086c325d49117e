"""What measures kinefilter and reproduces the papers; cleaning needs none of it."""

__all__: list[str] = []
