"""Stepping rules in code, those of `cranedyn.dynamics.integrators`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.plant import Plant
from cranedyn.dynamics.integrators import Integrator, rk4, semi_implicit_euler
from cranedyn.dynamics.rigid_body import array
from cranedyn.errors import OutOfRange
from cranedyn.model.crane import DRIVES

Step = Callable[[Plant, np.ndarray, np.ndarray, np.ndarray, Any, Value, Any, Any], tuple[np.ndarray, np.ndarray, Any]]
"""From plant, q, v, command, forces from outside, step [s], work of the buffers so far [J] and number of
small steps to take where the motion is not smooth to q, v and that work."""


def _semi_implicit_euler(
    plant: Plant, q: np.ndarray, v: np.ndarray, command: np.ndarray, forces: Any, dt: Value, work: Any, small: Any
) -> tuple[np.ndarray, np.ndarray, Any]:
    faster = v + plant.answer(q, v, command, forces)[0] * dt
    if plant.buffers:
        work = work + 0.5 * dt * (plant.stop_effort(q, v) @ (v + faster)[DRIVES])
    return q + faster * dt, faster, work


def _rk4(
    plant: Plant, q: np.ndarray, v: np.ndarray, command: np.ndarray, forces: Any, dt: Value, work: Any, small: Any
) -> tuple[np.ndarray, np.ndarray, Any]:
    smooth = replace(plant, buffers=False)
    half = 0.5 * dt
    a1 = smooth.answer(q, v, command, forces)[0]
    v2 = v + a1 * half
    a2 = smooth.answer(q + v * half, v2, command, forces)[0]
    v3 = v + a2 * half
    a3 = smooth.answer(q + v2 * half, v3, command, forces)[0]
    v4 = v + a3 * dt
    a4 = smooth.answer(q + v3 * dt, v4, command, forces)[0]
    sixth = dt * (1.0 / 6.0)
    there = q + (v + 2.0 * (v2 + v3) + v4) * sixth
    faster = v + (a1 + 2.0 * (a2 + a3) + a4) * sixth
    if not plant.buffers:
        return there, faster, work
    return _where_buffers_act(plant, q, v, command, forces, dt, work, small, there, faster)


def _where_buffers_act(
    plant: Plant,
    q: np.ndarray,
    v: np.ndarray,
    command: np.ndarray,
    forces: Any,
    dt: Value,
    work: Any,
    small: Any,
    there: np.ndarray,
    faster: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, Any]:
    """The outcome of a smooth step, replaced by that of small semi-implicit ones where a drive is beyond its range before or after it."""
    code: Code = dt.code
    outcome = code.variables([*there, *faster, work])
    rough = code.either(plant.beyond(q), plant.beyond(there))
    with code.when(code.anywhere(rough)):
        fine = dt / code.from_integer(small)
        here = code.variables([*q, *v, work])
        with code.loop(0, small):
            now = array([place.get() for place in here])
            q_next, v_next, done = _semi_implicit_euler(plant, now[:5], now[5:10], command, forces, fine, now[10], small)
            for place, value in zip(here, [*q_next, *v_next, done], strict=True):
                place.set(value)
        for place, value in zip(outcome, here, strict=True):
            place.set(code.chosen(rough, value.get(), place.get()))
    ended = array([place.get() for place in outcome])
    return ended[:5], ended[5:10], ended[10]


_STEPS: dict[Integrator, Step] = {semi_implicit_euler: _semi_implicit_euler, rk4: _rk4}


def in_code(integrator: Integrator) -> Step:
    """A stepping rule in code.

    Raises:
        OutOfRange: If there is none for it.
    """
    if integrator not in _STEPS:
        known = " or ".join(rule.name for rule in _STEPS)
        raise OutOfRange(
            "integrator of compiled code", integrator.name, f"{known} of cranedyn.dynamics.integrators; engine = pinocchio takes any"
        )
    return _STEPS[integrator]
