"""Reliability scorers for comparison with the default one."""
