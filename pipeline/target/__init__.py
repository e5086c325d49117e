"""What the character is pulled through: the corrected motion, smooth, on its floor.

``smooth`` takes the tremble out, ``floor`` finds the floor and the sensor's tilt,
``contacts`` says which feet stand, ``planting`` keeps them there; ``placement`` says
where the motion is in a scene.
"""

__all__: list[str] = []
