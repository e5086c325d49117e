"""Reliability scorers beside the default one."""

__all__: list[str] = []
