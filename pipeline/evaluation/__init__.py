"""How good a motion is, by itself (``metrics``) and beside the truth (``accuracy``)."""

__all__: list[str] = []
