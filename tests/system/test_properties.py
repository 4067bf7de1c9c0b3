"""What holds for every crane, state and command: symmetries, scaling laws, energy, finite numbers,
bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from cranedyn.data.trajectory import QUANTITIES, Trajectory
from cranedyn.disturbances import wind
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.errors import CraneError, RunError
from cranedyn.interfaces import Disturbance, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.description import arguments
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.helpers import G, constant, crane

pytestmark = pytest.mark.slow

COLUMNS = crane().layout.columns()
DRIVES = crane().layout.drives
PASSIVE = crane().layout.passive

# --- any crane, any state, any command ------------------------------------------------------------

POINT = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}
LAB = dict(
    mast_height=0.9, pivot_height=1.0, total_height=1.2, trolley_min=0.1, trolley_max=0.8,
    trolley_init=0.4, hoist_min=0.2, hoist_max=0.9, hoist_init=0.5, payload_mass=0.5,
    payload_inertia=1e-4, trolley_mass=0.3, dummy_mass=1e-3, dummy_inertia=1e-6,
    upper_mass=5.0, slewing_inertia=1.0, trolley_inertia=1e-3, damp_swing=1e-3,
)  # fmt: skip

_ORDERS = dict(
    payload_mass=(0, 5), payload_inertia=(-1, 4), upper_mass=(2, 5), slewing_inertia=(4, 8),
    trolley_mass=(2, 4), trolley_inertia=(0, 3), dummy_mass=(-2, 2), dummy_inertia=(-2, 2),
    damp_slew=(0, 5), damp_trolley=(0, 3), damp_swing=(-2, 2), damp_hoist=(0, 3),
    trolley_min=(-1, 0.5), trolley_max=(1.2, 2), hoist_min=(0, 1), hoist_max=(1.2, 1.8),
    slew_effort=(5, 8), trolley_effort=(4, 7), hoist_effort=(5, 7),
)  # fmt: skip
"""Powers of ten between which numbers of cranes are, from a workshop to a harbour."""


def _random(rng: np.random.Generator) -> dict[str, float]:
    """Return numbers of a crane, each uniform in its logarithm."""
    values = {name: float(10.0 ** rng.uniform(*ends)) for name, ends in _ORDERS.items()}
    return values | {"mast_height": values["hoist_max"], "pivot_height": values["hoist_max"] + 2.0}


VARIANTS: tuple[dict[str, float], ...] = (
    {},
    {"payload_mass": 1.0},
    {"payload_mass": 1e5, "hoist_effort": 2e6},
    POINT,
    POINT | {"payload_mass": 1e5, "trolley_mass": 100.0, "hoist_effort": 2e6},
    {"damp_slew": 1e9, "damp_trolley": 1e8, "damp_swing": 1e9, "damp_hoist": 1e8},
    {"slew_limit": 0.5, "swing_limit": 0.3, "slew_effort": 1.0, "hoist_effort": 1.0},
    LAB,
    *(_random(rng) for rng in [np.random.default_rng(7)] for _ in range(6)),
)
"""Arguments of the cranes that are drawn from: the one of this project, extremes, and random
ones."""

CALM = [values for values in VARIANTS if values.get("damp_swing", 0.0) < 1e9]
"""Without the one whose damping no explicit step can follow."""


class Case(NamedTuple):
    """A crane, and numbers between -1 and 1: where it starts, shape (10,), what is commanded, (4,
    3), how it is pushed, (2, 3).
    """

    values: dict[str, float]
    where: np.ndarray
    what: np.ndarray
    push: np.ndarray

    @property
    def crane(self) -> Crane:
        """Loaded once a session."""
        return crane(**self.values)

    @property
    def start_q(self) -> np.ndarray:
        """Anywhere in the ranges, slews and swings up to 69°."""
        ends = np.stack([self.crane.lower, self.crane.upper])
        ends[:, [0, *PASSIVE]] = ends[:, [0, *PASSIVE]].clip(-1.2, 1.2)
        return ends.sum(axis=0) / 2.0 + np.diff(ends, axis=0)[0] / 2.0 * self.where[:5]

    @property
    def start(self) -> State:
        """With rates as of a load that passes the bottom of a swing of 0.3 rad."""
        length = self.start_q[4]
        rates = 0.3 * np.sqrt(G / length) * np.array([1.0, length, 1.0, 1.0, length])
        return State(self.start_q, rates * self.where[5:])

    @property
    def accelerations(self) -> np.ndarray:
        """Of the drives, in four equal parts of a run, up to a fifth of gravity at the load; shape
        (4, 3).
        """
        radius = max(self.crane.upper[1], self.start_q[4])
        return 0.2 * G * np.array([1.0 / radius, 1.0, 1.0]) * self.what

    @property
    def efforts(self) -> np.ndarray:
        """What holds the load and accelerates each drive about as much, shape (4, 3)."""
        c = self.crane
        inertia = np.diag(pin.crba(c.model, c.data, self.start_q))[DRIVES]
        return dynamics.holding_effort(c, self.start_q) + inertia * self.accelerations

    @property
    def forces(self) -> np.ndarray:
        """From outside, up to a third of the load's weight, shape (2, 3)."""
        return 0.3 * self.crane.payload_mass * G * self.push


def quarters(
    commands: np.ndarray, duration: float
) -> Callable[[float, State, Setpoint], np.ndarray]:
    """A controller that holds each of four commands for a quarter of the run."""
    return lambda t, state, setpoint: commands[min(int(4.0 * t / duration + 1e-9), 3)]


def _force(forces: np.ndarray, at: float = 0.0) -> Disturbance:
    """On payload and trolley [N], shape (2, 3)."""
    return wind.constant_force(crane(), payload=forces[0], trolley=forces[1], at=at)


def run(case: Case, drive: str, *, duration: float = 0.4, **changes: Any) -> Trajectory:
    """Return a run of a case, pushed and never stopped; anything may be changed by name."""
    commands = case.efforts if drive == "effort" else case.accelerations
    usual: dict[str, Any] = dict(dt=1e-3, control_period=1e-2, validity="mark", drive=drive)
    usual |= dict(start=case.start, disturbance=_force(case.forces), duration=duration)
    return simulate(case.crane, quarters(commands, duration), **(usual | changes))


def cases(variants: list[dict[str, float]]) -> st.SearchStrategy[Case]:
    """Any case of some cranes."""
    # Products of what remains are above the subnormal numbers.
    ones = st.floats(-1.0, 1.0).map(lambda x: round(x, 12))
    return st.builds(
        Case,
        st.sampled_from(variants),
        arrays(float, 10, elements=ones),
        arrays(float, (4, 3), elements=ones),
        arrays(float, (2, 3), elements=ones),
    )


kinds = st.sampled_from(["effort", "motion"])


# --- finite, or a sentence ------------------------------------------------------------------------


def _columns(trajectory: Trajectory) -> np.ndarray:
    """All numbers of a trajectory, shape (n, 29)."""
    return np.column_stack([getattr(trajectory, name) for name in QUANTITIES])


WINDS: dict[str, Callable[[Case], Disturbance | None]] = {
    "none": lambda case: None,
    "push": lambda case: _force(case.forces, at=0.1),
    "gust": lambda case: wind.wind(
        case.crane,
        wind.cosine_gust(wind.step_gust(wind.steady(5.0), 8.0, at=0.1), -30.0, at=0.15, lasts=0.1),
        direction=0.3,
        payload_area=9.0,
        trolley_area=1.0,
    ),
    "turbulence": lambda case: wind.wind(
        case.crane,
        wind.turbulence(wind.steady(9.0), 0.3, np.random.default_rng(1), duration=0.3),
        direction=-1.0,
        payload_area=4.0,
    ),
}
WILD = st.one_of(*(st.floats(-most, most) for most in (1.0, 100.0, 1e300)))


@settings(max_examples=60)
@given(
    cases(list(VARIANTS)),
    arrays(float, (4, 3), elements=WILD),
    kinds,
    st.sampled_from(["stop", "buffers", "mark"]),
    st.sampled_from(list(WINDS)),
    st.sampled_from([5e-4, 1e-3, 1e-2]),
)
def test_a_run_ends_with_finite_numbers_or_with_a_sentence(
    case: Case, what: np.ndarray, drive: Any, validity: Any, blows: str, dt: float
) -> None:
    wild = case._replace(what=what)
    with np.errstate(over="ignore"):
        commands = wild.efforts if drive == "effort" else wild.accelerations
    how = dict(start=case.start, duration=0.2, dt=dt, control_period=1e-2)
    how |= dict(drive=drive, validity=validity, disturbance=WINDS[blows](case))
    try:
        found = simulate(case.crane, quarters(commands, 0.2), **how)
        assert len(found) == 21
        # Drives that take efforts may be too fast, which marks rows but stops no run.
        drives = case.crane.layout.drives
        fast = (np.abs(found.v[:, drives]) > case.crane.rate_limit).any(axis=1)
        assert validity == "mark" or (found.valid + (fast & (drive == "effort")) > 0).all()
    except CraneError as error:
        assert str(error).endswith(".") and "\n" not in str(error)
        found = error.trajectory if isinstance(error, RunError) else None
    assert found is None or np.isfinite(_columns(found)).all()


# --- energy ---------------------------------------------------------------------------------------


def _passive(case: Case, drive: str, step: float) -> Trajectory:
    """Without damping nor work of the drives: all drives locked, or slew and trolley free and the
    hoist held; a step per natural time.
    """
    c = replace(case.crane, damping=np.zeros(5), effort_limit=np.full(3, np.inf))
    free = [0, 0, 1, 1, 0] if drive == "motion" else [1, 1, 1, 1, 0]
    start = State(case.start.q, case.start.v * free)
    weight = c.payload_mass * G
    compliance = np.linalg.inv(_mass_matrix(c, start.q))[PASSIVE, PASSIVE].max()
    dt = step / np.sqrt(weight * start.q[4] * compliance)

    def hoist_held(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        free, carried = (
            dynamics.acceleration(c, state, np.array([0.0, 0.0, force]))[4]
            for force in (0.0, weight)
        )
        return np.array([0.0, 0.0, -free / (carried - free) * weight])

    controller = constant(0.0, 0.0, 0.0) if drive == "motion" else hoist_held
    clock = dict(dt=dt, control_period=dt, duration=round(0.8 / step) * dt)
    return simulate(c, controller, start=start, drive=drive, validity="mark", **clock)


def _mass_matrix(c: Crane, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(c.model, c.data, q))
    return upper + np.triu(upper, 1).T


def _ripple(c: Crane, run: Trajectory) -> np.ndarray:
    """What each step adds to a constant energy E(q, v) to order dt² [J]: dt²/2 (∂E/∂q · a - M v ·
    da/dt).

    From v' = v + dt a, q' = q + dt v' and d²E/dt² = 0. For a constant mass matrix it is dt/2 times
    the change of the power of gravity.
    """
    dt = run.t[1]
    a = np.diff(run.v, axis=0) / dt
    h = 1e-4 / (np.abs(a).max() + 1e-6)
    there, back = (
        np.array([dynamics.energy(c, State(q, v)) for q, v in zip(moved, run.v[:-1], strict=True)])
        for moved in (run.q[:-1] + h * a, run.q[:-1] - h * a)
    )
    momentum = np.array([_mass_matrix(c, q) @ v for q, v in zip(run.q, run.v, strict=True)])[:-1]
    slope = (there - back) / (2.0 * h)
    return dt**2 / 2.0 * (slope - (momentum * np.gradient(a, dt, axis=0)).sum(axis=1))


@given(cases(list(VARIANTS)), kinds)
def test_without_damping_and_work_energy_changes_by_the_ripple_of_the_step_which_halves_with_it(
    case: Case, drive: str
) -> None:
    coarse, fine = (_passive(case, drive, step) for step in (4e-3, 2e-3))
    steps = _ripple(case.crane, coarse)
    rounding = 1e-12 * np.abs(coarse.energy).max()
    # what is left is of order dt² in natural units, as much as is the difference quotient of a: a
    # few times 4e-3
    allowed = 0.03 * np.abs(steps).sum() + rounding
    assert_allclose(np.diff(coarse.q[:, 4]), 0.0, atol=1e-9)
    assert_allclose(coarse.energy[1:] - coarse.energy[0], np.cumsum(steps), rtol=0.0, atol=allowed)
    halved = 2.0 * (fine.energy[::2] - fine.energy[0])
    assert_allclose(coarse.energy - coarse.energy[0], halved, rtol=0.0, atol=allowed)


# --- symmetries -----------------------------------------------------------------------------------


@given(cases(CALM), kinds, st.floats(-3.0, 3.0))
def test_a_crane_that_starts_turned_makes_the_same_move_turned(
    case: Case, drive: str, angle: float
) -> None:
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    offset = np.array([angle, 0.0, 0.0, 0.0, 0.0])
    straight = run(case, drive)
    turned = run(
        case,
        drive,
        start=State(case.start.q + offset, case.start.v),
        disturbance=_force(case.forces @ turn.T),
    )
    nudged = run(case, drive, start=State(case.start.q + 1e-9, case.start.v - 1e-9))
    # rounding: 1e-13 of what there is and what becomes of a nudge of 1e-13, times what
    # accelerations lose where a heavy load moves a light trolley: M_ii (M⁻¹)_ii
    inertia = _mass_matrix(case.crane, case.start.q)
    lost = float((np.diag(inertia) * np.diag(np.linalg.inv(inertia))).max())
    rounding = lost * (
        1e-13 * np.abs(_motion(straight)).max()
        + 1e-4 * np.abs(_motion(nudged) - _motion(straight)).max()
    )
    assert_allclose(turned.q - offset, straight.q, rtol=0.0, atol=rounding)
    assert_allclose(turned.v, straight.v, rtol=0.0, atol=rounding)
    places, turned_places = (
        np.array([dynamics.payload_position(case.crane, q) for q in one.q])
        for one in (straight, turned)
    )
    # A radius of 100 m.
    assert_allclose(turned_places, places @ turn.T, rtol=0.0, atol=1e2 * rounding)


def _motion(run: Trajectory) -> np.ndarray:
    return np.hstack([run.q, run.v])


@given(cases(list(VARIANTS)), kinds, st.sampled_from(["mark", "buffers"]))
def test_the_mirror_image_of_a_move_is_a_move_to_the_bit(
    case: Case, drive: str, validity: str
) -> None:
    validity = validity if drive == "effort" else "mark"
    q = np.array([-1.0, 1.0, 1.0, -1.0, 1.0])
    drives = np.array([-1.0, 1.0, 1.0])
    mirrored = case._replace(
        where=case.where * np.tile(q, 2), what=case.what * drives, push=case.push * drives
    )
    one, other = (_answer(lambda c=c: run(c, drive, validity=validity)) for c in (case, mirrored))
    if isinstance(one, str) or isinstance(other, str):
        assert isinstance(one, str) and isinstance(other, str)
        return
    # x, φ, l keep their sign; γ, θ and the slew torque change it; so does the force across the jib.
    # Signs do not round
    for name, sign in {
        "q": q,
        "v": q,
        "command": drives,
        "effort": drives,
        "force": np.tile(drives, 2),
    }.items():
        assert (getattr(other, name) == sign * getattr(one, name)).all(), name
    for name in ("energy", "work", "dissipated", "outside", "valid"):
        assert (getattr(other, name) == getattr(one, name)).all(), name


def _answer(what: Callable[[], Trajectory]) -> Trajectory | str:
    try:
        return what()
    except CraneError as error:
        return str(error)


# --- scaling --------------------------------------------------------------------------------------

POWERS = {
    "": (0, 0, 0), "rad": (0, 0, 0), "kg": (1, 0, 0), "kg m^2": (1, 2, 0), "m": (0, 1, 0),
    "N": (1, 1, -2),
    "N m s/rad": (1, 2, -1), "N s/m": (1, 0, -1), "N m": (1, 2, -2), "rad/s": (0, 0, -1),
    "m/s": (0, 1, -1), "N m/rad": (1, 2, -2), "N/m": (1, 0, -2), "kg/m": (1, -1, 0),
}  # fmt: skip
"""Of mass, length and time in the units of the crane's arguments."""

ENDINGS = {
    "_rad_s": (0, 0, -1), "_m_s": (0, 1, -1), "_Nm": (1, 2, -2), "_N": (1, 1, -2),
    "_J": (1, 2, -2), "_rad": (0, 0, 0), "_m": (0, 1, 0), "_s": (0, 0, 1), "valid": (0, 0, 0),
}  # fmt: skip
"""Of mass, length and time in the units at the ends of column names, the longer ending first."""

Units = tuple[float, float, float]
"""How many of another unit one kilogram, metre and second are."""


def _factor(powers: tuple[int, int, int], units: Units) -> float:
    return units[0] ** powers[0] * units[1] ** powers[1] * units[2] ** powers[2]


def _factors(columns: tuple[str, ...], units: Units) -> np.ndarray:
    """Return what turns columns to other units, shape (n,)."""
    powers = (next(p for end, p in ENDINGS.items() if name.endswith(end)) for name in columns)
    return np.array([_factor(power, units) for power in powers])


@cache
def _rescaled(variant: int, units: Units) -> Crane:
    """A crane with its numbers in other units."""
    values = {
        name: _factor(POWERS[known.unit], units)
        * float(VARIANTS[variant].get(name, float(known.default)))
        for name, known in arguments().items()
        # What follows from other arguments follows them.
        if name in VARIANTS[variant] or "$(" not in known.default
    }
    return load_crane(gravity=_factor((0, 1, -2), units) * G, **values)


@pytest.mark.parametrize(
    ("units", "variants"),
    [((1024.0, 1.0, 1.0), CALM[::5]), ((4.0, 0.5, 0.125), CALM)],
    ids=["mass", "mass, length and time"],
)
def test_counted_in_other_units_every_crane_moves_the_same_to_the_bit(
    units: Units, variants: list[dict[str, float]]
) -> None:
    @settings(max_examples=4 * len(variants))
    @given(cases(variants), kinds)
    def same(case: Case, drive: str) -> None:
        one = run(case, drive)
        factors = {name: _factors(COLUMNS[name], units) for name in ("q", "v", "effort", "force")}
        accelerations = case.accelerations * factors["v"][DRIVES] / units[2]
        commands = case.efforts * factors["effort"] if drive == "effort" else accelerations
        dt, period, duration = (units[2] * time for time in (1e-3, 1e-2, 0.4))
        other = simulate(
            _rescaled(VARIANTS.index(case.values), units),
            quarters(commands, duration),
            start=State(case.start.q * factors["q"], case.start.v * factors["v"]),
            dt=dt,
            control_period=period,
            duration=duration,
            drive=drive,  # type: ignore[arg-type]
            disturbance=_force(case.forces * factors["force"][:3]),
            validity="mark",
        )
        # A law of physics has no units, and powers of two do not round.
        for columns in COLUMNS.values():
            for column, factor in zip(columns, _factors(columns, units), strict=True):
                assert (other[column] == factor * one[column]).all(), column

    same()


# --- bits -----------------------------------------------------------------------------------------


def test_every_column_says_its_unit() -> None:
    for columns in COLUMNS.values():
        assert all(column.endswith(tuple(ENDINGS)) for column in columns)
