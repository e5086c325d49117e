"""The commands of the lab: they parse and print, as those of ``pipeline.commands``."""

__all__: list[str] = []
