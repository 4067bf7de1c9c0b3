"""Planned lifts of one crane, one after the other: the empty hook comes, takes a load, sets it down
on what is below, is released from it, and goes to the next one.

Each move, with a load or without, begins or ends standing on something: on the ground, on a roof,
or on another load. It is planned, controlled and proven as a lift from the ground
(`cranedyn.lifts.planning.ground_lift`). The load of a move of the empty hook is the hook block
itself, with its own size and mass, which stands on a load while it is hooked on or released. All
loads that are not carried stand still, and are obstacles: before their lift where they are picked
up, and after it where they were planned to stand, wider by the tolerance of a set-down on each
side.

`certify_chain` simulates all moves in one run, by `cranedyn.simulation.stages.simulate_stages`, and
checks them: a load is attached to the hook where the hook stands on it, and released where it
stands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import finite, number
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import box_corners
from cranedyn.errors import DataError, quoted
from cranedyn.interfaces import Controller, Reference, Setpoint, State
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.clearance_of import clearance_of, tower_clearance
from cranedyn.lifts.planning.ground_lift import (
    GOAL_TOLERANCE,
    GroundLift,
    HookBlock,
    drum_inertia_of,
    from_ground,
    ground_lift_checks,
    ground_lift_start,
    load_corners,
    standing_corners,
)
from cranedyn.lifts.planning.lift import Lift, NoWay, crane_of, plan_lift
from cranedyn.lifts.planning.plan_details import Slings
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import read_fields
from cranedyn.lifts.planning.site_table import SiteTable
from cranedyn.lifts.planning.solids import Solid, box, rotation_z
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.simulation.stages import LoadStage, StagedRun, simulate_stages
from cranedyn.verdict import Check

_LEVEL_TOLERANCE = 0.01
"""Largest difference of height between a load that is released and where it was planned to stand
[m]: some times the 2 mm by which a load sinks into what it stands on."""

ENERGY_TOLERANCE = 1e-3
"""Largest energy of a chain that nothing accounts for, over the largest energy that a load brings
as it is attached: the error of the physics step."""

_TURN = 2.0 * math.pi
"""A full turn [rad]."""


@dataclass(frozen=True, eq=False)
class ChainedLift:
    """A load that stands somewhere, and where it is brought.

    Attributes:
        name: Its name, which is that of the load, too.
        start: Where the load stands in the frame of the site [m], shape (2,).
        goal: Where it is set down [m], shape (2,).
        mass: Mass of all that hangs, hook and slings included [kg]; None for that of the site.
        size: Sides of the load across the jib, along it, and its height [m]; None for those of the
            site.
    """

    name: str
    start: np.ndarray
    goal: np.ndarray
    mass: float | None = None
    size: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If a place is not two finite numbers, or the mass or a side not positive.
        """
        finite(f"start of the lift {quoted(self.name)}", self.start, (2,), unit="m")
        finite(f"goal of the lift {quoted(self.name)}", self.goal, (2,), unit="m")
        if self.mass is not None:
            number(f"load of the lift {quoted(self.name)}", self.mass, "kg", "> 0")
        if self.size is not None:
            for side in finite(f"size of the lift {quoted(self.name)}", self.size, (3,), unit="m"):
                number(f"side of the load of {quoted(self.name)}", side, "m", "> 0")


@dataclass(frozen=True, eq=False)
class ChainList:
    """A list of lifts, as a file has it.

    Attributes:
        lifts: The lifts, in order.
        home: Where the middle of the empty hook hangs before the first lift and after the last, in
            the frame of the site [m], shape (3,); None for where the crane starts.
        hook_size: Sides of the hook with what stays with it [m]; None for the width of the block
            that the description of the crane draws, and the height of all that it draws above the
            load.
        hooking: Time for which the hook stands on a load to take it or to release it [s].
    """

    lifts: tuple[ChainedLift, ...]
    home: np.ndarray | None = None
    hook_size: tuple[float, float, float] | None = None
    hooking: float = 0.0


class StandingLoad(NamedTuple):
    """A load that stands.

    Attributes:
        box: The load as an obstacle, wider by the tolerance of a set-down on each side.
        centre: Its centre in the frame of the site [m], shape (3,).
        yaw: Angle of its X axis from that of the site [rad].
    """

    box: Solid
    centre: np.ndarray
    yaw: float


class ChainMove(NamedTuple):
    """A move of a chain.

    Attributes:
        name: What it is, in words.
        load: Name of the load that is carried; "" for the empty hook.
        lift: The move, as a lift from the ground or to it.
        duration: Its duration, with the time for which the hook stands still at the end [s].
        set_down: Where the load is planned to stand after it; None for the empty hook.
    """

    name: str
    load: str
    lift: GroundLift
    duration: float
    set_down: StandingLoad | None


@dataclass(frozen=True, eq=False)
class LiftChain:
    """A chain of planned moves.

    Attributes:
        site: The site, without the loads of the chain.
        moves: The moves, in order: to the first load, with it, to the second load, and so on.
        initial_loads: Where each load stands before its lift, by name.
        sizes: Sides of each load [m], by name.
        hook: The hook block.
    """

    site: Site
    moves: tuple[ChainMove, ...]
    initial_loads: Mapping[str, StandingLoad]
    sizes: Mapping[str, tuple[float, float, float]]
    hook: HookBlock

    @property
    def begins(self) -> list[float]:
        """Time at which each move begins [s]."""
        ends = np.cumsum([move.duration for move in self.moves])
        return [0.0, *ends[:-1].tolist()]

    @property
    def duration(self) -> float:
        """Duration of the whole chain [s]."""
        return float(sum(move.duration for move in self.moves))


@dataclass(frozen=True, eq=False)
class CertifiedChain:
    """A simulated chain and its checks.

    Attributes:
        chain: The chain.
        run: The run, one trajectory with a stage for each move.
        checks: The checks of each move.
        whole: Checks of the whole: the energy, and that loads stand where they were planned to.
    """

    chain: LiftChain
    run: StagedRun
    checks: tuple[tuple[Check, ...], ...]
    whole: tuple[Check, ...]

    @property
    def all_checks(self) -> list[Check]:
        """All checks, those of a move with its name."""
        named = []
        for move, checks in zip(self.chain.moves, self.checks, strict=True):
            for check in checks:
                named.append(Check(f"{move.name}: {check.sentence}", check.verdict))
        return [*named, *self.whole]


def read_chain(path: str | Path) -> ChainList:
    """Read a list of lifts from a TOML file with [[lift]].

    Raises:
        DataError: If it cannot be read, there is no lift, two have one name, or a field is missing,
            unknown or out of its range, with its line.
    """
    top, lines = read_fields(Path(path), ["home", "hook", "hooking", "lift"], "list of lifts")
    lifts: list[ChainedLift] = []
    for entry in top.tables("lift", ("name", "from", "to", "load", "size"), lines):
        name = entry.text("name")
        if any(lift.name == name for lift in lifts):
            entry.fail("name", f"two lifts are called {quoted(name)}; each needs its own name.")
        lifts.append(
            ChainedLift(
                name=name,
                start=_standing_place(entry, "from"),
                goal=_standing_place(entry, "to"),
                mass=entry.optional_number("load", "kg", "> 0"),
                size=_size(entry),
            )
        )
    if not lifts:
        top.fail("lift", "there is none; write each as [[lift]].")
    home = top.optional_numbers("home", 3)
    return ChainList(
        lifts=tuple(lifts),
        home=None if home is None else np.array(home),
        hook_size=_size(top.top_table("hook", ["size"], lines)),
        hooking=top.number("hooking", 0.0, "s", "0 to 3600"),
    )


def _standing_place(entry: SiteTable, field: str) -> np.ndarray:
    """Return a place where a load stands [m], shape (2,).

    Raises:
        DataError: If it has three coordinates, as a load that hangs has.
    """
    value = entry.values.get(field)
    if isinstance(value, list) and len(value) == 3:
        entry.fail(
            field,
            "a load of a chain stands on what is below, so that it can be released; give X and Y.",
        )
    return np.array(entry.numbers(field, 2))


def _size(table: SiteTable) -> tuple[float, float, float] | None:
    """Return the sides of a load or of the hook [m]; None if they are not entered."""
    size = table.optional_numbers("size", 3, "m", "> 0")
    return None if size is None else (size[0], size[1], size[2])


def plan_chain(
    site: Site,
    listed: ChainList,
    limits: Limits,
    *,
    gravity: float | None = None,
    period: float = 5e-3,
    values: Mapping[str, object] | None = None,
) -> LiftChain:
    """Plan all moves of a list of lifts.

    Args:
        site: The site; [rigging] has the masses of hook and slings, which stay with the hook.
        listed: The lifts.
        limits: Rates and accelerations of the drives.
        gravity: Gravity [m/s²]; None for that of the crane.
        period: Time between rows of the motions [s].
        values: Further values of the crane by name, such as ``hoist_max``.

    Raises:
        DataError: If the site does not say how heavy the empty hook is, or a load is not heavier
            than it; if a load has the name of an obstacle.
        NoWay: As `cranedyn.lifts.planning.lift.plan_lift`, with the move.
        CraneError: As `plan_lift` and `from_ground`, with the move.
    """
    planner = _Planner(site, listed, limits, gravity, period, dict(values or {}))
    return planner.planned()


class _Planner:
    """Plans the moves of a chain one after the other."""

    def __init__(
        self,
        site: Site,
        listed: ChainList,
        limits: Limits,
        gravity: float | None,
        period: float,
        values: dict[str, object],
    ) -> None:
        """Take what `plan_chain` is given, and find the hook and the loads."""
        self._site = site
        self._listed = listed
        self._limits = limits
        self._gravity = gravity
        self._period = period
        # Each move has a payload of its own.
        self._values = {name: value for name, value in values.items() if name != "payload_mass"}
        clearance = clearance_of(self._crane(site), site)
        # Of the crane with the load of the site, from which all others differ in their load alone.
        self._given_clearance = tower_clearance(clearance, "A chain of lifts")
        self._masses = self._load_masses()
        self.sizes = self._load_sizes()
        self.hook = self._hook_block()
        # The drum does not change with the load, so that it has one inertia in all moves.
        self._drum_inertia = drum_inertia_of(self._given_clearance, max(self._masses.values()))
        self._standing: dict[str, StandingLoad] = {}
        self._moves: list[ChainMove] = []

    def planned(self) -> LiftChain:
        """Return the chain."""
        for lift in self._listed.lifts:
            site = self._carrying(lift)
            clearance = clearance_of(self._crane(site), site)
            self._standing[lift.name] = self._load_set_down(clearance, lift, lift.start, "start")
        initial_loads = dict(self._standing)
        place = self._home()
        for lift in self._listed.lifts:
            self._plan_empty_move(f"to {lift.name}", place, lift.start)
            self._plan_loaded_move(lift)
            place = lift.goal
        self._plan_empty_move("home", place, self._home())
        return LiftChain(self._site, tuple(self._moves), initial_loads, self.sizes, self.hook)

    # --- hook and loads ---------------------------------------------------------------------------

    def _crane(self, site: Site) -> Crane:
        """Return the crane with the load of a site."""
        values: dict[str, Any] = self._values
        return crane_of(site, gravity=self._gravity, **values)

    def _load_masses(self) -> dict[str, float]:
        """Return the mass of each load with hook and slings [kg]."""
        site_crane = self._given_clearance.crane
        masses = {}
        for lift in self._listed.lifts:
            masses[lift.name] = site_crane.payload_mass if lift.mass is None else lift.mass
        return masses

    def _load_sizes(self) -> dict[str, tuple[float, float, float]]:
        """Return the sides of each load [m]."""
        load = self._given_clearance.bodies.load if self._site.load is None else self._site.load
        width, length, height = np.ptp(load, axis=0).tolist()
        sizes = {}
        for lift in self._listed.lifts:
            sizes[lift.name] = (width, length, height) if lift.size is None else lift.size
        return sizes

    def _hook_block(self) -> HookBlock:
        """Return the hook block.

        Raises:
            DataError: If its mass is unknown, or a load is not heavier or not as wide.
        """
        mass = sum(self._site.rigging.values())
        if not mass > 0.0:
            raise DataError(
                "The site does not say how heavy the empty hook is; enter hook and slings in "
                "[rigging], with the mass of the load alone in [load]."
            )
        for name, whole in self._masses.items():
            if not whole > mass:
                raise DataError(
                    f"The load of {quoted(name)} is {whole:g} kg with hook and slings, which are "
                    f"{mass:g} kg alone; enter all that hangs."
                )
        size = self._listed.hook_size
        if size is None:
            # Slings that are spread over a load hang together below the block when it is gone.
            bodies = self._given_clearance.bodies
            size = (2.0 * bodies.falls, 2.0 * bodies.falls, float(bodies.hook.size[2]))
        for name, sides in self.sizes.items():
            if size[0] > sides[0] or size[1] > sides[1]:
                raise DataError(
                    f"The hook is {size[0]:.2f} m by {size[1]:.2f} m and would not stand on the "
                    f"load of {quoted(name)}, {sides[0]:g} m by {sides[1]:g} m; enter the size of "
                    "the hook as [hook] size."
                )
        return HookBlock(mass, size)

    def _home(self) -> np.ndarray:
        """Return where the middle of the empty hook hangs at the beginning and at the end [m],
        shape (3,).
        """
        if self._listed.home is not None:
            return self._listed.home
        drives = self._given_clearance.crane.start.q[self._given_clearance.drive_joints]
        return self._site.to_site(self._given_clearance.point(drives))

    # --- sites ------------------------------------------------------------------------------------

    def _with_load(self, sides: Sequence[float], mass: float, standing: Sequence[Solid]) -> Site:
        """Return the site with a load, and with loads that stand as obstacles."""
        width, length, height = sides
        return replace(
            self._site,
            load=np.array(box_corners(width, length, height)),
            # Slings and spreader of [rigging] are those of the load of [load].
            details=replace(self._site.details, slings=Slings(), spreader=None),
            crane={**self._site.crane, "payload_mass": mass},
            solids=(*self._site.solids, *standing),
            start=None,
            goal=None,
        )

    def _carrying(self, lift: ChainedLift) -> Site:
        """Return the site with the load of a lift, and with all others that stand."""
        others = [load.box for name, load in self._standing.items() if name != lift.name]
        return self._with_load(self.sizes[lift.name], self._masses[lift.name], others)

    def _load_set_down(
        self, clearance: Clearance, lift: ChainedLift, place: np.ndarray, label: str
    ) -> StandingLoad:
        """Return the load of a lift as it stands where the crane has set it down.

        Raises:
            NoWay: If it would tip, with the name of the lift.
        """
        try:
            corners = standing_corners(clearance, place, f"{label} of {lift.name}")
        except NoWay as error:
            raise NoWay(f"{lift.name}: {error}") from None
        # The corners are in the order of `box_corners`: the first and the fifth differ along X.
        along = corners[4] - corners[0]
        middle = corners.mean(axis=0)
        width, length, height = self.sizes[lift.name]
        wider = [width + 2.0 * GOAL_TOLERANCE, length + 2.0 * GOAL_TOLERANCE, height]
        base = float(middle[2]) - height / 2.0
        yaw = math.atan2(along[1], along[0])
        solid = box(lift.name, middle[:2].tolist(), wider, base, yaw)
        return StandingLoad(solid, middle, yaw)

    # --- moves ------------------------------------------------------------------------------------

    def _plan_empty_move(self, name: str, start: np.ndarray, goal: np.ndarray) -> None:
        """Plan a move of the empty hook between places on which it stands on a load, shape (2,), or
        where it hangs, shape (3,).
        """
        standing = [load.box for load in self._standing.values()]
        site = self._with_load(self.hook.size, self.hook.mass, standing)
        # The load of this move is the hook itself, in whose mass the rigging is contained already.
        site = replace(site, rigging={})
        lift = self._ground_lift(name, site, start, goal, hook=None)
        self._moves.append(ChainMove(name, "", lift, self._duration(lift), None))

    def _plan_loaded_move(self, lift: ChainedLift) -> None:
        """Plan the move of a load, which then stands at its goal."""
        moved = self._ground_lift(lift.name, self._carrying(lift), lift.start, lift.goal, self.hook)
        set_down = self._load_set_down(moved.lift.clearance, lift, lift.goal, "goal")
        self._standing[lift.name] = set_down
        self._moves.append(ChainMove(lift.name, lift.name, moved, self._duration(moved), set_down))

    def _ground_lift(
        self,
        name: str,
        site: Site,
        start: np.ndarray,
        goal: np.ndarray,
        hook: HookBlock | None,
    ) -> GroundLift:
        """Return a planned move that begins where the move before it has ended.

        Raises:
            NoWay: If there is none, with its name.
        """
        try:
            lift = plan_lift(
                site,
                self._limits,
                start=start,
                goal=goal,
                crane=self._crane(site),
                period=self._period,
            )
            return from_ground(
                self._from_where_it_is(lift),
                stands=(len(start) == 2, len(goal) == 2),
                hook=hook,
                drum_inertia=self._drum_inertia,
            )
        except NoWay as error:
            raise NoWay(f"{name}: {error}") from None

    def _from_where_it_is(self, lift: Lift) -> Lift:
        """Return a lift with its slew moved by whole turns, so that it begins at the angle at which
        the move before it has ended: one that goes round the mast ends a turn away from where the
        next one is planned to begin.
        """
        turning = lift.clearance.turning
        if not self._moves or turning is None:
            return lift
        slew = int(lift.clearance.drive_joints[turning])
        now = float(self._moves[-1].lift.motion.q[-1, slew])
        motion = lift.timed.motion
        shift = _TURN * round((now - float(motion.q[0, slew])) / _TURN)
        if shift == 0.0:
            return lift
        q = motion.q.copy()
        q[:, slew] += shift
        ends = lift.ends.copy()
        ends[:, turning] += shift
        free = lift.slews
        slews = free._replace(low=free.low + shift, high=free.high + shift)
        timed = replace(lift.timed, motion=replace(motion, q=q))
        return replace(lift, ends=ends, slews=slews, timed=timed)

    def _duration(self, lift: GroundLift) -> float:
        """Return the duration of a move with the time for hooking on or off [s]."""
        periods = math.ceil(self._listed.hooking / self._period)
        return lift.motion.arrival + self._period * periods


def certify_chain(chain: LiftChain, *, dt: float = 5e-4) -> CertifiedChain:
    """Simulate a chain in one run, and check all moves.

    Args:
        chain: The chain.
        dt: Physics step [s].

    Raises:
        RunError: If the simulation breaks off, with the trajectory of all moves until there.
    """
    stages = []
    for move, begin in zip(chain.moves, chain.begins, strict=True):
        lift = move.lift
        stages.append(
            LoadStage(
                lift.crane,
                _later_command(lift, begin),
                move.duration,
                _later_setpoint(lift, begin),
                lift.ground,
            )
        )
    first = chain.moves[0].lift
    run = simulate_stages(
        stages, start=ground_lift_start(first), dt=dt, control_period=first.motion.period
    )
    checks = []
    for move, piece in zip(chain.moves, run.stages, strict=True):
        # The checks of a move are about the times of its own plan, which begins at 0.
        in_move_time = replace(piece, t=piece.t - piece.t[0])
        checks.append(tuple(ground_lift_checks(move.lift, in_move_time)))
    whole = [_energy_check(run)]
    for move, piece in zip(chain.moves, run.stages, strict=True):
        if move.set_down is not None:
            whole.append(_standing_check(chain, move, piece))
    return CertifiedChain(chain, run, tuple(checks), tuple(whole))


def _later_setpoint(lift: GroundLift, begin: float) -> Reference:
    """Return the setpoints of a move that begins at a time [s]."""
    return lambda t: lift.setpoint(t - begin)


def _later_command(lift: GroundLift, begin: float) -> Controller:
    """Return the controller of a move that begins at a time [s]."""

    def command(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return lift.command(t - begin, state, setpoint)

    return command


def _energy_check(run: StagedRun) -> Check:
    """Return whether the energy of the whole run adds up across all changes of the load."""
    left = float(np.abs(run.trajectory.unexplained).max())
    moved = max(abs(change.brought) for change in run.changes)
    lost = sum(change.lost for change in run.changes)
    return Check(
        f"Across {len(run.changes)} changes of the load {left:.1f} J of the energy of the whole "
        f"run are unexplained at most; allowed are {100.0 * ENERGY_TOLERANCE:g} % of the "
        f"{moved / 1e3:.1f} kJ that a load brings. Attaching loses {lost:.3f} J.",
        left <= ENERGY_TOLERANCE * moved,
    )


def _standing_check(chain: LiftChain, move: ChainMove, piece: Trajectory) -> Check:
    """Return whether a load stands in the box that stands for it in later moves."""
    assert move.set_down is not None
    corners = chain.site.to_site(load_corners(move.lift, piece.q[-1])) - move.set_down.centre
    in_box_axes = corners @ rotation_z(move.set_down.yaw)
    half_sides = np.array(chain.sizes[move.load]) / 2.0
    beyond = np.abs(in_box_axes).max(axis=0) - half_sides
    aside = float(beyond[:2].max())
    return Check(
        f"{move.load}: when it is released, its corners are {1e3 * max(aside, 0.0):.1f} mm beside "
        f"its planned place at most, {1e3 * GOAL_TOLERANCE:g} allowed, by which later moves keep "
        f"farther away, and {1e3 * max(float(beyond[2]), 0.0):.1f} mm above or below it, "
        f"{1e3 * _LEVEL_TOLERANCE:g} allowed.",
        bool(aside <= GOAL_TOLERANCE and beyond[2] <= _LEVEL_TOLERANCE),
    )
