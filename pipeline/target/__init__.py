"""What the character is pulled through: the corrected motion, smooth, on its floor.

``smooth`` removes trembling, ``floor`` finds the floor, the sensor's tilt and where the
motion begins in a scene, ``feet`` finds out which feet stand and keeps them there.
"""

__all__: list[str] = []
