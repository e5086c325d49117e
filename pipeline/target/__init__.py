"""The target that the character is pulled through: the corrected motion on its floor.

``tilt`` finds the sensor's tilt, ``smooth`` removes trembling, ``floor`` finds the
floor and the placement in a scene, ``feet`` finds planted feet, ``planting`` holds
them in place.
"""
