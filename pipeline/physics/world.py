"""The simulated world: one MuJoCo model of a scene with every character in it.

All characters take a step together, so that they share the props and push each other.
Only one that diverges or is stuck is put back: the others take the step again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn
from weakref import ref

import mujoco
import numpy as np

from kinefilter.characters import Body, Tracking
from kinefilter.characters.arrays import Flags
from kinefilter.characters.humanoid import build_humanoids
from kinefilter.scenes import load_scene

from .holdable import add_ties
from .moves import Move

_UPDATE = 1.0 / 60.0  # s at most between two updates of the actuators' targets
_SUBSTEP = 1.0 / 240.0
"""Longest simulation step [s]: omega * dt = 0.25 at the default tracking. At 1/120 one
in six recorded takes of punches and kicks diverged somewhere."""
_TOP_SPEED = 1e3  # rad/s or m/s: no part of a body is ever that fast
# What a frame begins with, but not the time, which shows when the engine restarts.
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION) & ~(
    int(mujoco.mjtState.mjSTATE_TIME) | int(mujoco.mjtState.mjSTATE_WARMSTART)
)
_PROP = -1  # owner of a degree of freedom that is no character's


def steps_in(dt: float) -> tuple[int, int]:
    """Return how many updates are in a frame of ``dt`` [s], and steps in an update."""
    updates = max(1, int(np.ceil(dt / _UPDATE - 1e-3)))
    return updates, max(1, int(np.ceil(dt / (updates * _SUBSTEP) - 1e-3)))


class World:
    """A scene, one of SCENES or an MJCF file, by default a floor, with characters.

    ``extend`` is called to add to the scene before it is compiled. Each body needs a
    ``PulledCharacter``, made in the order of the bodies. It is to be kept elsewhere:
    they keep the world, and if it kept them, too, only garbage collection, which does
    not see the engine's memory, would free both. Raises InputError as ``load_scene``
    and ``build_humanoids``.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        tracking: Tracking | None = None,
        *,
        scene: str | Path | None = None,
        extend: Callable[[mujoco.MjSpec], object] = lambda _: None,
    ) -> None:
        if scene is None:
            spec = build_humanoids(bodies, tracking)
            if len(bodies) == 1:
                # Finding the parts that do not touch costs 3 % and finds one.
                spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        else:
            spec = load_scene(scene, bodies, tracking=tracking)
        extend(spec)
        if scene is not None:
            add_ties(spec, len(bodies))
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._characters: list[ref[Any]] = []
        self._owner = np.full(self.model.nv, _PROP)
        self._props = np.ones(self.model.nq, dtype=bool)
        self._before = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        self._disabled = self.model.opt.disableactuator
        if mujoco.get_mju_user_warning() is None:
            # The engine's own handler writes a log file into the working directory;
            # the trace reports diverging steps anyway.
            mujoco.set_mju_user_warning(lambda _: None)

    @property
    def characters(self) -> list[Any]:
        """The characters: each a PulledCharacter, whose file imports this one."""
        return [character() for character in self._characters]

    def __reduce__(self) -> NoReturn:
        """Refuse copies and pickles, whose views of the engine's memory lead nowhere.

        Characters and avatars refer to their world, so that this holds for them, too.
        """
        raise TypeError(
            "a simulated world, and whatever is in it, cannot be copied or pickled; "
            "make another one, such as a new Avatar"
        )

    def add(self, character: Any, places: slice, speeds: slice) -> int:
        """Add the character of the next body; return its number, from 0.

        ``places`` and ``speeds`` are where its state is in ``qpos`` and ``qvel``.
        """
        number = len(self._characters)
        self._characters.append(ref(character))
        self._owner[speeds] = number
        self._props[places] = False
        return number

    def reset(self, *, props: bool) -> None:
        """Prepare for a character that starts, and return props to where they were.

        Without ``props``, those stop where they are if nobody else is there.
        """
        data, there = self.data, self.data.qpos.copy()
        if len(self._characters) == 1:
            mujoco.mj_resetData(self.model, data)
            if not props:
                data.qpos[:] = there
        elif props:
            data.qpos[self._props] = self.model.qpos0[self._props]
            data.qvel[self._owner == _PROP] = 0.0

    def take_props(self, other: World) -> None:
        """Put the props where they are, moving as they do, in the same scene."""
        mine, theirs = self._owner == _PROP, other._owner == _PROP
        self.data.qpos[self._props] = other.data.qpos[other._props]
        self.data.qvel[mine] = other.data.qvel[theirs]
        mujoco.mj_kinematics(self.model, self.data)

    def follow(self, moves: Sequence[Move], stands: Sequence[Flags | None]) -> Flags:
        """Pull each character through its move, all of which take the same time.

        ``stands`` says of each which feet bear weight. Returns, shape (characters,),
        which were pulled through; the others were put onto their targets.
        """
        model, data, characters = self.model, self.data, self.characters
        dt, began = moves[0].duration, data.time
        for character, move, feet in zip(characters, moves, stands, strict=True):
            character.begin(move, feet)
        mujoco.mj_getState(model, data, self._before, _STATE)
        self._advance(dt)
        good = ~self._diverged(began)
        for k, character in enumerate(characters):
            good[k] = good[k] and not character.is_stuck(dt)
        while not good.all():
            mujoco.mj_resetData(model, data)
            mujoco.mj_setState(model, data, self._before, _STATE)
            bad = [one for one, fine in zip(characters, good, strict=True) if not fine]
            for character in bad:
                character.put_back()
            if not good.any():
                break
            for character in characters:
                character.begin_again()
            self._advance(dt)
            again = good & ~self._diverged(0.0)
            for character in bad:
                character.put_back()
            if (again == good).all():
                break
            good = again
        for character, fine in zip(characters, good, strict=True):
            if fine:
                character.rise_from_floor()
        return good

    def _advance(self, dt: float) -> None:
        model, data, characters = self.model, self.data, self.characters
        updates, substeps = steps_in(dt)
        model.opt.timestep = step = dt / (updates * substeps)
        limp = sum(character.limp << character.group for character in characters)
        model.opt.disableactuator = self._disabled | limp
        for k in range(updates):
            # Midway between the first and the last step of this update, as the engine
            # compares the target with the state at the beginning of a step.
            share = (k + 0.5 - 0.5 / substeps) / updates
            for character in characters:
                character.aim(share)
            for _ in range(substeps):
                for character in characters:
                    character.press(step)
                mujoco.mj_step(model, data)
                for character in characters:
                    character.feel()
        for character in characters:
            character.momentum.note()
        mujoco.mj_kinematics(model, data)
        for character in characters:
            character.end()

    def _diverged(self, began: float) -> Flags:
        """Return which characters spin or lost their targets; all if a prop does."""
        data, count = self.data, len(self._characters)
        wild = np.flatnonzero(~(np.abs(data.qvel) < _TOP_SPEED)).tolist()
        if not data.time > began:
            # The engine restarts at time 0 when its numbers overflow, and notes where.
            wild = [warning.lastinfo for warning in data.warning if warning.number]
        elif not wild:
            return np.array([character.is_lost for character in self.characters])
        owners = self._owner[wild]
        everyone = _PROP in owners or not wild
        return np.isin(np.arange(count), owners) | everyone
