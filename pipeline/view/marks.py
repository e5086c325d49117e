"""What is drawn of a clip that no one could film: contacts and external force."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY
from kinefilter.pipeline.target.feet import ankles_and_toes

from .solids import upright_cylinder

_RADIUS, _THICK = 0.055, 0.006  # m, of what marks a part of a foot that stands
_STANDS = np.array([0, 100, 36], dtype=np.uint8)
_BAR = 0.025  # m, radius of the bar
_METERS = 1.0  # that the bar is high for a force of one body weight
_ASIDE = 0.55  # m from the pelvis
_LEAST = 0.01  # body weights: below, there is no bar to see


class FootMarks:
    """A disk on the floor under every heel and toe that stands.

    Args:
        scene: Where they are drawn.
        clip: The motion.
        contacts: Which parts stand (CONTACTS), shape (T, 4).
    """

    def __init__(
        self, scene: viser.SceneApi, clip: Clip, contacts: NDArray[np.bool_]
    ) -> None:
        self.contacts = contacts
        ankles, toes = ankles_and_toes(clip.skeleton)
        parts = [j for pair in zip(ankles, toes, strict=True) for j in pair]
        self._places = clip.positions[:, parts] * [1.0, 0.0, 1.0]
        self._places[..., 1] = 0.5 * _THICK
        disk = upright_cylinder(_RADIUS, _THICK, sections=32)
        self._disks = scene.add_batched_meshes_simple(
            "/contacts",
            disk.vertices,
            disk.faces,
            batched_wxyzs=np.tile(IDENTITY, (len(parts), 1)),
            batched_positions=np.zeros((len(parts), 3)),
            batched_scales=np.zeros((len(parts), 3)),
            batched_colors=np.tile(_STANDS, (len(parts), 1)),
            cast_shadow=False,
            lod="off",
        )

    def show(self, frame: int) -> None:
        """Mark what stands in a frame."""
        stands = self.contacts[frame].astype(np.float32)
        self._disks.batched_positions = self._places[frame].astype(np.float32)
        self._disks.batched_scales = np.repeat(stands[:, None], 3, axis=1)

    def set_visible(self, visible: bool) -> None:
        """Show or hide them."""
        self._disks.visible = visible


class ForceBar:
    """A bar beside the character, as high as the external force is large.

    Args:
        scene: Where it is drawn.
        clip: The motion.
        side: Unit vector from the character to the bar, world frame, shape (3,).
    """

    def __init__(self, scene: viser.SceneApi, clip: Clip, side: Array) -> None:
        roots = clip.positions[:, clip.skeleton.root] * [1.0, 0.0, 1.0]
        self._places = roots + _ASIDE * side
        self._force = clip.external_force
        bar = upright_cylinder(_BAR, 1.0, sections=24)
        bar.apply_translation([0.0, 0.5, 0.0])
        self._frame = scene.add_frame("/force", show_axes=False)
        self._bar = scene.add_mesh_simple(
            "/force/bar", bar.vertices, bar.faces, color=(214, 92, 60)
        )
        self._label = scene.add_label("/force/label", "", anchor="bottom-center")

    def show(self, frame: int) -> None:
        """Make the bar as high as the force of a frame, and say how large it is."""
        force = float(np.nan_to_num(self._force[frame]))
        height = max(force, _LEAST) * _METERS
        self._frame.position = self._places[frame]
        self._bar.scale = (1.0, height, 1.0)
        self._label.position = (0.0, height, 0.0)
        self._label.text = f"{force:.2f} body weights"

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        self._frame.visible = visible
