"""Floor, light and camera of the page."""

from __future__ import annotations

import numpy as np
import viser

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.render.cameras import camera_path

_ASPECT = 1.0  # of the page beside its panel, or more: there is room for a label
_FRAMES = 1000  # at least, of a long motion, that the first view is to hold
_ROOM = 0.15  # m between a joint and the skin's farthest point
_SKY = ((0.80, 0.86, 0.92), (0.97, 0.98, 0.99))  # overhead, at the horizon
_SKY_ROWS = 64
_SKY_LIGHT, _GROUND_LIGHT = (255, 255, 255), (190, 186, 180)
_FLOOR = 12.0  # m, the side of what catches shadows


def set_stage(
    server: viser.ViserServer, clip: Clip, beside: Array
) -> viser.DirectionalLightHandle:
    """Set the floor, the light, and where one looks from at first.

    Args:
        server: The page.
        clip: What is looked at.
        beside: How far [m] from the clip its take stands, shape (3,).

    Returns:
        The light that casts shadows.
    """
    scene = server.scene
    scene.set_up_direction("+y")
    top, bottom = (np.array(color) for color in _SKY)
    share = np.linspace(0.0, 1.0, _SKY_ROWS)[:, None, None]
    sky = (top + share * (bottom - top)) * 255.0
    # No picture of surroundings for light: a processor draws for seconds to filter it.
    scene.configure_environment_map(None)
    scene.set_background_image(np.rint(sky).astype(np.uint8).repeat(2, axis=1), "png")
    scene.add_grid(
        "/floor",
        _FLOOR,
        _FLOOR,
        plane="xz",
        cell_size=0.5,
        section_size=1.0,
        cell_color=(205, 207, 211),
        section_color=(170, 173, 180),
        infinite_grid=True,
        fade_distance=25.0,
        shadow_opacity=0.2,
    )
    some = clip.positions[:: max(1, len(clip) // _FRAMES)]
    joints = np.concatenate([some, some + beside], axis=1)
    around = _ROOM * np.array([[1, 1, 1], [-1, -1, -1]])
    points = (joints[:, :, None] + around).reshape(len(some), -1, 3)
    scene.configure_default_lights(False)
    scene.add_light_hemisphere(
        "/sky", sky_color=_SKY_LIGHT, ground_color=_GROUND_LIGHT, intensity=1.7
    )
    camera = camera_path("front", clip, points, aspect=_ASPECT, rate=clip.fps)
    position, target = camera.at(0)
    front = (position - target) * [1.0, 0.0, 1.0]
    front /= np.linalg.norm(front)
    left = np.array([-front[2], 0.0, front[0]])  # in the picture
    server.initial_camera.position = position
    server.initial_camera.look_at = target
    server.initial_camera.fov = np.radians(camera.fov)
    return scene.add_light_directional(
        "/sun",
        intensity=2.0,
        cast_shadow=True,
        position=tuple(0.5 * front + 0.45 * left + [0.0, 1.0, 0.0]),
    )
