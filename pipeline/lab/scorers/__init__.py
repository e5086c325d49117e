"""Reliability scorers for comparison with the default one."""

__all__: list[str] = []
