"""The commands of the lab; like ``pipeline.commands``, they only parse and print."""

__all__: list[str] = []
