"""The target that the character is pulled through: the corrected motion on its floor.

``smooth`` removes trembling, ``floor`` finds the floor, the sensor's tilt and the
placement in a scene, ``feet`` finds planted feet and holds them in place.
"""
