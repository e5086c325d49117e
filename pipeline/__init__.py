"""The stages that a take or a frame passes, and everything around them.

``cleaner`` has the stages in their order; ``import kinefilter`` gives what most need.
"""

__all__: list[str] = []
