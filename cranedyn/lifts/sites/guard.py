"""Guard of one crane: it keeps each drive in an interval and the rope inside its largest swing.

The supervisor of a site reserves a *box* for each crane: an interval of positions for each of its
drives. The guard runs on the crane, between the operator and the drives, and needs no message to
keep the crane safe. Once a cycle (`CYCLE`) it does the following, see `_step`:

1. It takes over from the last grant what the crane can use at its present rates.
2. It replaces the command where the supervisor wants the crane to withdraw.
3. Where braking now would swing the rope too far, it lets no command speed a drive up, and adds
   changes of rate that damp the swing; these may speed a drive up.
4. It limits each rate so that the drive can stop inside its interval.
5. It works out which box to ask for next, and which part of the present one to give back.

That ropes stay inside their largest swing is tried for drives that react within half a second. Of
slower ones nothing is promised, see `cranedyn.lifts.sites.promise.reacts_late`.

Where a measurement or a command is not a plausible number, or the wind is above what the site
states, it brakes all drives instead.

Conventions of this module:

* m drives, n coordinates (the drives and two swing joints), N copies of a site in lockstep.
* Positions are in rad or m, rates in rad/s or m/s. The position of the winch is the cable length:
  a positive rate lowers the load, a negative one hoists it.
* A box has shape (2, m): the lower ends, then the upper ends.
* The *pivot* is the point from which the rope hangs. The *chain* is the drives between the foot of
  the crane and the pivot, such as slew and trolley: all drives but the winch.
* An *inclination* is the horizontal part of the unit vector along the rope, from the pivot to the
  load, in the frame of the site, shape (2,). Its length is the sine of the angle from plumb, which
  is taken for the angle [rad]: swings are at most some tenths of a radian.

The functions below the class `Guard` work on numbers of any kind, see `cranedyn.dynamics.scalars`:
`gentle` calls them with floats, and `_compile_step` traces them once on symbolic numbers to get
machine code. That is why they choose by `_minimum`, `_maximum` and `_select`, and not by `if`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array, number, whole
from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.scalars import (
    array,
    indicator,
    larger,
    magnitude,
    smaller,
    square_root,
    where,
)
from cranedyn.errors import OutOfRange, quoted
from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import CYCLE, Brakes, largest_rate, stopping_distance
from cranedyn.lifts.sites.capsules import (
    FOOT_SIZE,
    JOINT_SIZE,
    ROPE_DIRECTION_SIZE,
    pivot_motions,
    rope_pose,
)
from cranedyn.lifts.sites.crane_site import Station
from cranedyn.lifts.sites.working_wind import CALM, GUST_RESPONSE, WorkingWind

PATIENCE = 0.5
"""Time for which a guard waits for the answer to a request before it asks again [s]. After a sound
answer it asks again in the next cycle."""

MAX_PATIENCE = 16.0
"""Longest such time [s]. A guard doubles its patience whenever an answer comes too late."""

# Two answers may be lost or late, which takes 2 `PATIENCE` = 1.0 s; a request and its answer may
# take two cycles each way, 4 `CYCLE` = 0.4 s; and the guard sees the answer in the cycle after, in
# 0.1 s more.
HORIZON = 1.5
"""Time for which a guard asks in advance [s], so that a drive need not slow down for an answer."""

# Chosen: a guard looks once a cycle, in which the swing goes on, and its bound of the swing
# neglects terms that vanish for small angles. The remaining 5 % are for both. What adversaries of
# `cranedyn run site` reach is printed there.
SWING_LIMIT_RATIO = 0.95
"""Share of the largest swing at which a guard intervenes.

It compares with the swing that the rope would reach if all drives braked now.
"""

# Chosen: a swing is halved in 0.7 periods, while the pivot follows within its brakes.
DAMPING_RATIO = 0.15
"""Damping ratio of the swing that a guard adds while it intervenes."""

# Chosen: a two hundredth of 2 s, the period of a rope of 1 m, and far above rounding errors.
EXTRAPOLATION_STEP = 0.01
"""Time step over which the motion of rope and pivot is differentiated numerically [s]."""

RIGHT_ANGLE_TOLERANCE = 1e-9
"""Largest cosine of the angle between motions of the pivot that count as at right angles."""

POSITIONS_TRIED = 64
"""Positions at which the motions of the pivot by two drives are compared."""

MIN_WORKING_RATIO = 0.1
"""Share of the largest swing that the wind must leave to the drives. With less they would creep."""

MAX_REQUEST_NUMBER = 1 << 53
"""Largest number of a request: up to there a double holds every whole number."""

ROUNDING = 1e-9
"""Rounding error of decelerations and rates [rad/s² or m/s², rad/s or m/s]."""

MAX_RANGE_TRIED = 100.0
"""Largest magnitude of a position at which the motions of the pivot are compared [rad or m]."""

MAX_TARGET_DISTANCE = 1e9
"""Distance beyond the range of any drive [rad or m]; a target farther away means there is none."""

MAX_INPUT = 1e12
"""Largest magnitude of a measurement or command that counts as a number [SI units].

It exceeds every quantity of a crane, and no product of such numbers overflows in a step.
"""

MIN_PIVOT_MOTION = 1e-6
"""Motion of the pivot that is assumed of a drive that does not move it [m/rad or m/m].

It keeps the winch out of a division by zero, and is too small to limit its deceleration.
"""

SINGULARITY_MARGIN = 1e-9
"""Share of the trace added to the diagonal of the matrix that `_damping_rate_changes` inverts."""

NO_REQUEST = -math.inf
"""Time of the last request where none is open [s]: so long ago that the next is due at once."""

NO_TARGET = math.inf
"""Target of a drive of a crane that does not withdraw [rad or m]."""


class BoxRequest(NamedTuple):
    """Requests of the guards of one crane to the supervisors, on k copies of a site.

    A guard and a supervisor check each message that they receive, see `Guard.receive` and
    `Supervisor.receive`: what is not sound counts as lost.

    Attributes:
        copies: Indices of the copies, shape (k,).
        number: Number of each request, counted from 1 on each copy, shape (k,).
        held: Boxes that the cranes keep to from now on; the rest of their reservations is given
            back; shape (k, 2, m).
        wanted: Boxes that they ask for; each contains the box that is held; shape (k, 2, m).
    """

    copies: np.ndarray
    number: np.ndarray
    held: np.ndarray
    wanted: np.ndarray


class BoxGrant(NamedTuple):
    """Answers of the supervisors to the guards of one crane, on k copies of a site.

    Attributes:
        copies: Indices of the copies, shape (k,).
        number: Number of the request that each grant answers, shape (k,).
        box: Boxes that the cranes may keep to, shape (k, 2, m).
        blocked_by: Whether each crane of the site keeps this one from all that it asked for, shape
            (k, cranes). Guards do not use it.
        target: Positions of the drives to which the cranes withdraw so that others can pass, shape
            (k, m); `NO_TARGET` in all drives of a crane that need not withdraw.
    """

    copies: np.ndarray
    number: np.ndarray
    box: np.ndarray
    blocked_by: np.ndarray
    target: np.ndarray


class Guard:
    """The part of the supervision that runs on a crane, on N copies of a site in lockstep.

    Attributes:
        station: The crane at its place.
        box: Box to which each crane keeps, shape (N, 2, m).
        rates: Rates that were last passed on to the drives [rad/s or m/s], shape (N, m).
        fault: Whether the last measurement or command was implausible, so that all drives brake,
            shape (N,).
        stopped_by_wind: Whether the last reading of the anemometer was above the wind up to which
            the crane works, or no number, so that all drives brake, shape (N,).
        target: Positions to which each crane withdraws, whatever is commanded, shape (N, m);
            `NO_TARGET` where it does not.
    """

    def __init__(
        self, station: Station, swing: float, count: int = 1, wind: WorkingWind = CALM
    ) -> None:
        """Start at rest at the start of the crane, with a box just around it.

        Args:
            station: The crane at its place.
            swing: Largest angle of the rope from plumb [rad].
            count: Number of copies, N.
            wind: Wind up to which the crane works; its gusts take their share of the swing.

        Raises:
            OutOfRange: If the swing is not a positive number, or the number of copies not a whole
                number from 1; or if the wind leaves too little of the swing to the drives.
        """
        max_swing = number("largest swing of the rope", swing, "rad", "> 0")
        copies = whole("number of copies", count, 1)
        layout = station.crane.layout
        at_rest = np.zeros(layout.m)
        first_box = station.brakes.tube(station.crane.start.q[layout.drives], at_rest, at_rest)

        self.station = station
        self.rates = np.zeros((copies, layout.m))
        self.box = np.tile(first_box, (copies, 1, 1))
        self.fault = np.zeros(copies, dtype=bool)
        self.target = np.full((copies, layout.m), NO_TARGET)
        self.stopped_by_wind = np.zeros(copies, dtype=bool)
        self._wind = wind

        # Box of the last grant. It equals `box` once the grant has been used.
        self._granted = self.box.copy()
        self._number = np.zeros(copies, dtype=int)
        self._asked_at = np.full(copies, NO_REQUEST)
        self._patience = np.full(copies, PATIENCE)

        # Box of the last request. No grant may be larger.
        self._wanted = self.box.copy()

        self._layout = _StepLayout.of(station)
        self._crane = self._layout.pack_crane(_crane_constants(station, max_swing, wind))
        self._compiled_step = _compile_step(self._layout)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the compiled step, whose addresses hold in this process only.

        The arrays are copied, since a guard writes into them: a copy of it must not be granted what
        another one has asked for.
        """
        state = {}
        for name, value in vars(self).items():
            if name != "_compiled_step":
                state[name] = value.copy() if isinstance(value, np.ndarray) else value
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a guard, and compile its step again where that has not been done yet."""
        vars(self).update(state)
        self._compiled_step = _compile_step(self._layout)

    def step(
        self,
        t: float,
        state: State,
        command: np.ndarray,
        wind_speed: np.ndarray | float | None = None,
    ) -> tuple[np.ndarray, BoxRequest]:
        """Return the rates for the drives [rad/s or m/s], shape (N, m), and the requests due.

        A rate follows the command as far as the drive can still stop inside the box, and changes by
        no more in a cycle than the planned decelerations. Where braking now would swing the rope by
        more than `SWING_LIMIT_RATIO` of what is allowed, no drive speeds up and the drives damp the
        swing. Where a measurement or a command is implausible, see `_is_plausible`, or the wind is
        above what the crane works in, all drives of that copy brake, its box stays, and nothing is
        requested.

        Args:
            t: Time of the crane's own clock [s]. Nothing is requested while it is not finite.
            state: Measured coordinates and their rates, shape (N, n) each.
            command: Rates that operators or plans command, shape (N, m).
            wind_speed: Reading of an anemometer at the height of the load [m/s], a number or shape
                (N,); None where there is none, so that others must stop the work in the wind.

        Raises:
            Misshapen: If the state, the command or the reading has another shape.
        """
        copies = len(self.rates)
        coordinates = (copies, self._layout.coordinate_count)
        q = as_array("measured coordinates", state.q, coordinates)
        v = as_array("measured rates", state.v, coordinates)
        command = as_array("command", command, self.rates.shape)

        plausible = self._is_plausible(q, v, command)
        self.fault = ~plausible
        if wind_speed is not None:
            speed = as_array("wind speed", wind_speed, (), (copies,))
            # True also for NaN.
            too_windy = ~(np.abs(speed) <= self._wind.gust)
            self.stopped_by_wind = np.broadcast_to(too_windy, (copies,)).copy()
        works = plausible & ~self.stopped_by_wind

        inputs = _StepInput(q, v, command, self.rates, self.box, self._granted, self.target)
        rows = self._compiled_step(self._layout.pack_rows(inputs), self._crane)
        output = self._layout.unpack_output(rows)

        self.rates = np.where(works[:, None], output.rates, output.braking_rates)

        # A comparison with NaN is false: without a valid time nothing is asked.
        waited = (t if abs(t) < math.inf else math.nan) - self._asked_at
        asks = works & (waited >= self._patience)
        self._number = self._number + asks
        self._asked_at = np.where(asks, t, self._asked_at)

        # With a request the crane gives back what it no longer needs. What it could not use of the
        # last grant it drops, and asks for it again if it still wants it: the supervisor reserves
        # no more than what is held and what it grants next.
        box = np.where(asks[:, None, None], output.retained_box, output.box)
        self.box = np.where(works[:, None, None], box, self.box)
        self._granted = np.where(works[:, None, None], box, self._granted)

        due = np.flatnonzero(asks)
        self._wanted[due] = output.wanted_box[due]
        request = BoxRequest(due, self._number[due], box[due], self._wanted[due])
        return self.rates.copy(), request

    def receive(self, grant: BoxGrant) -> None:
        """Take the grants that answer the last request and are sound; ignore all others.

        A guard does not trust the supervisor. A grant that is not sound, see `_is_sound`, counts as
        lost: the crane keeps to its box, brakes before its ends, and asks again. A grant that
        answers an older request came too late: the guard then waits longer for the next ones.

        Args:
            grant: The grants.

        Raises:
            Misshapen: If a field has another shape.
        """
        count = len(np.atleast_1d(grant.copies))
        drive_count = self.rates.shape[1]
        given_copies = as_array("copies of a grant", grant.copies, (count,))
        given_numbers = as_array("numbers of a grant", grant.number, (count,))
        boxes = as_array("box of a grant", grant.box, (count, 2, drive_count))
        targets = as_array("target of a grant", grant.target, (count, drive_count))

        # An index is checked before it is used as one.
        known = is_index(given_copies, len(self.rates)) & is_request_number(given_numbers)
        copies = given_copies[known].astype(int)
        number = given_numbers[known]
        box = boxes[known]
        target = targets[known]

        last_number = self._number[copies]
        request_is_open = self._asked_at[copies] > NO_REQUEST
        answers_last = (number == last_number) & request_is_open
        taken = answers_last & self._is_sound(copies, box, target)

        self._granted[copies[taken]] = box[taken]
        self.target[copies[taken]] = target[taken]
        self._asked_at[copies[taken]] = NO_REQUEST

        late = copies[number < last_number]
        self._patience[late] = np.minimum(2.0 * self._patience[late], MAX_PATIENCE)

    def _is_plausible(self, q: np.ndarray, v: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return whether all inputs of a step are numbers up to `MAX_INPUT`, and the drives stand
        in their ranges up to the tolerances of their sensors, shape (N,).
        """
        position = q[:, self.station.crane.layout.drives]
        lowest, highest = self.station.ranges
        nearest_in_range = np.minimum(np.maximum(position, lowest), highest)
        beyond_range = np.abs(position - nearest_in_range)
        in_range = (beyond_range <= self.station.brakes.tolerances).all(axis=1)

        # True only where the comparison holds: NaN and infinity fail it.
        are_numbers = np.abs(np.concatenate([q, v, command], axis=1)) <= MAX_INPUT
        return in_range & are_numbers.all(axis=1)

    def _is_sound(self, copies: np.ndarray, box: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return whether each grant is one that a supervisor may give, shape (k,).

        Its box contains the box that is held and lies in the one that was asked for; so its ends
        are finite and ordered. Its target lies in the ranges of the drives, up to the tolerances of
        their sensors, or is `NO_TARGET` in all drives.

        Args:
            copies: Indices of the copies, shape (k,).
            box: Boxes that are granted, shape (k, 2, m).
            target: Positions to which the cranes are to withdraw, shape (k, m).
        """
        held = self.box[copies]
        wanted = self._wanted[copies]
        lowest, highest = self.station.ranges
        tolerances = self.station.brakes.tolerances

        # Each comparison is false for NaN. Ends pass the supervisor unchanged: no tolerance.
        below = (wanted[:, 0] <= box[:, 0]) & (box[:, 0] <= held[:, 0])
        above = (held[:, 1] <= box[:, 1]) & (box[:, 1] <= wanted[:, 1])
        in_range = (lowest - tolerances <= target) & (target <= highest + tolerances)
        stays = target == NO_TARGET
        return (below & above).all(axis=1) & (in_range.all(axis=1) | stays.all(axis=1))


def is_index(values: np.ndarray, count: int) -> np.ndarray:
    """Return whether each of some doubles is a whole number from 0 to below a count."""
    # Each comparison is false for NaN.
    return (values >= 0.0) & (values < count) & (np.floor(values) == values)


def is_request_number(values: np.ndarray) -> np.ndarray:
    """Return whether each of some doubles is a whole number from 1 to `MAX_REQUEST_NUMBER`."""
    return (values >= 1.0) & (values <= MAX_REQUEST_NUMBER) & (np.floor(values) == values)


def working_swing(station: Station, max_swing: float, wind: WorkingWind) -> float:
    """Return what the wind leaves of the largest swing to the drives [rad].

    A guard lets drives swing the rope to `SWING_LIMIT_RATIO` of this: of the largest swing, less
    the swing by a gust.
    """
    return max_swing - wind.swing(station.crane) / SWING_LIMIT_RATIO


def gentle(station: Station, swing: float, wind: WorkingWind = CALM) -> Brakes:
    """Return the brakes of a crane, with the decelerations that its guard plans with.

    Each drive inclines the rope by no more than a share of the largest swing, see
    `_planned_inclination`, counted per drive and not summed, wherever in their ranges the drives
    stand.

    Args:
        station: The crane at its place.
        swing: Largest angle of the rope from plumb [rad].
        wind: Wind up to which the crane works.

    Raises:
        OutOfRange: If the wind leaves too little of the swing to the drives.
    """
    crane = _crane_constants(station, swing, wind)
    decelerations = _planned_decelerations(crane, station.ranges)
    return replace(station.brakes, decelerations=decelerations.astype(float))


# --- data of a step -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _CraneConstants:
    """What a step knows about the crane.

    Attributes:
        rope: Numbers of the joints from the foot to the rope, as `capsules.rope_pose` reads them.
        reaction: Time from a measurement to full deceleration [s].
        gravity: Gravity [m/s²].
        max_swing: Largest angle of the rope from plumb [rad].
        planned_inclination: Largest inclination of the rope by the planned acceleration of a drive
            [rad].
        gust: Largest wind speed [m/s].
        drag_ratio: Drag of the wind on the load over its weight, for a speed of 1 m/s [s²/m²].
        tolerances: Largest errors of the measured positions [rad or m], shape (m,).
        decelerations: Decelerations of the brakes at their weakest [rad/s² or m/s²], shape (m,).
        ranges: Lower and upper ends of the ranges of the drives [rad or m], shape (2, m).
        chain: Indices of the drives from the foot to the pivot, among the drives.
        winch: Index of the winch among the drives.
    """

    rope: np.ndarray
    reaction: Any
    gravity: Any
    max_swing: Any
    planned_inclination: Any
    gust: Any
    drag_ratio: Any
    tolerances: np.ndarray
    decelerations: np.ndarray
    ranges: np.ndarray
    chain: list[int]
    winch: int


@dataclass(frozen=True, eq=False)
class _StepInput:
    """What a step reads, for one copy while it is traced, else for N copies with N first.

    Attributes:
        q: Measured coordinates [rad or m], shape (n,).
        v: Measured rates of the coordinates [rad/s or m/s], shape (n,).
        command: Commanded rates of the drives [rad/s or m/s], shape (m,).
        rates: Rates that were last passed on to the drives [rad/s or m/s], shape (m,).
        box: Box to which the crane keeps [rad or m], shape (2, m).
        granted: Box of the last grant [rad or m], shape (2, m).
        target: Positions to which the crane withdraws [rad or m], shape (m,), or `NO_TARGET`.
    """

    q: np.ndarray
    v: np.ndarray
    command: np.ndarray
    rates: np.ndarray
    box: np.ndarray
    granted: np.ndarray
    target: np.ndarray


@dataclass(frozen=True, eq=False)
class _StepOutput:
    """What a step returns, for one copy while it is traced, else for N copies with N first.

    Attributes:
        rates: Rates for the drives [rad/s or m/s], shape (m,).
        box: Box to which the crane keeps, with what it could use of the last grant, shape (2, m).
        retained_box: Part of the box that it keeps once it asks for another, shape (2, m).
        wanted_box: Box that it then asks for; it contains the retained one; shape (2, m).
        braking_rates: Rates for the drives if the inputs are implausible, shape (m,). They depend
            on no measurement and no command.
    """

    rates: np.ndarray
    box: np.ndarray
    retained_box: np.ndarray
    wanted_box: np.ndarray
    braking_rates: np.ndarray


@dataclass(frozen=True)
class _StepLayout:
    """Order in which the vectors of a compiled step hold their numbers.

    A compiled step maps vectors to vectors. It reads the constants of the crane once, and for each
    copy of the site a row of inputs; it writes a row of outputs. Only this class knows where in
    these vectors a quantity stands: in the order of the fields of `_CraneConstants` (without the
    indices), `_StepInput` and `_StepOutput`, a box with its lower ends before its upper ends.

    Attributes:
        drives: Index of each drive among the coordinates, m of them.
        chain: Indices of the drives from the foot to the pivot, among the drives.
        winch: Index of the winch among the drives.
        swings: Indices of the two swing joints among the coordinates.
        at_right_angles: Whether the horizontal motions of the pivot by any two drives are
            perpendicular, see `_move_at_right_angles`.
    """

    drives: tuple[int, ...]
    chain: tuple[int, ...]
    winch: int
    swings: tuple[int, ...]
    at_right_angles: bool

    @classmethod
    def of(cls, station: Station) -> _StepLayout:
        """Return the layout for a crane."""
        columns = station.bodies.columns.tolist()
        return cls(
            drives=tuple(station.crane.layout.drives.tolist()),
            chain=tuple(columns[:-1]),
            winch=columns[-1],
            swings=tuple(station.crane.swings.tolist()),
            at_right_angles=_move_at_right_angles(station),
        )

    @property
    def drive_count(self) -> int:
        """Number of drives, m."""
        return len(self.drives)

    @property
    def coordinate_count(self) -> int:
        """Number of coordinates, n."""
        return len(self.drives) + len(self.swings)

    @cached_property
    def crane_slices(self) -> dict[str, slice]:
        """Where each quantity stands in the vector of the constants."""
        m = self.drive_count
        joint_count = len(self.chain) + len(self.swings)
        lengths = {
            "rope": FOOT_SIZE + JOINT_SIZE * joint_count + ROPE_DIRECTION_SIZE,
            "reaction": 1,
            "gravity": 1,
            "max_swing": 1,
            "planned_inclination": 1,
            "gust": 1,
            "drag_ratio": 1,
            "tolerances": m,
            "decelerations": m,
            "ranges": 2 * m,
        }
        return _consecutive_slices(lengths)

    @cached_property
    def input_slices(self) -> dict[str, slice]:
        """Where each quantity stands in a row of inputs."""
        m = self.drive_count
        n = self.coordinate_count
        lengths = {
            "q": n,
            "v": n,
            "command": m,
            "rates": m,
            "box": 2 * m,
            "granted": 2 * m,
            "target": m,
        }
        return _consecutive_slices(lengths)

    @cached_property
    def output_slices(self) -> dict[str, slice]:
        """Where each quantity stands in a row of outputs."""
        m = self.drive_count
        lengths = {
            "rates": m,
            "box": 2 * m,
            "retained_box": 2 * m,
            "wanted_box": 2 * m,
            "braking_rates": m,
        }
        return _consecutive_slices(lengths)

    @property
    def crane_length(self) -> int:
        """Length of the vector of the constants."""
        return self.crane_slices["ranges"].stop

    @property
    def input_length(self) -> int:
        """Length of a row of inputs."""
        return self.input_slices["target"].stop

    @property
    def output_length(self) -> int:
        """Length of a row of outputs."""
        return self.output_slices["braking_rates"].stop

    def pack_crane(self, crane: _CraneConstants) -> np.ndarray:
        """Return the vector of the constants."""
        scalars = [
            crane.reaction,
            crane.gravity,
            crane.max_swing,
            crane.planned_inclination,
            crane.gust,
            crane.drag_ratio,
        ]
        ranges = crane.ranges.ravel()
        return np.concatenate([crane.rope, scalars, crane.tolerances, crane.decelerations, ranges])

    def unpack_crane(self, numbers: np.ndarray) -> _CraneConstants:
        """Return the constants from their vector."""
        slices = self.crane_slices
        return _CraneConstants(
            rope=numbers[slices["rope"]],
            reaction=numbers[slices["reaction"]][0],
            gravity=numbers[slices["gravity"]][0],
            max_swing=numbers[slices["max_swing"]][0],
            planned_inclination=numbers[slices["planned_inclination"]][0],
            gust=numbers[slices["gust"]][0],
            drag_ratio=numbers[slices["drag_ratio"]][0],
            tolerances=numbers[slices["tolerances"]],
            decelerations=numbers[slices["decelerations"]],
            ranges=numbers[slices["ranges"]].reshape(2, -1),
            chain=list(self.chain),
            winch=self.winch,
        )

    def pack_rows(self, inputs: _StepInput) -> np.ndarray:
        """Return the rows of inputs of N copies, shape (N, sum of the input sizes)."""
        copies = len(inputs.q)
        box = inputs.box.reshape(copies, -1)
        granted = inputs.granted.reshape(copies, -1)
        blocks = [inputs.q, inputs.v, inputs.command, inputs.rates, box, granted, inputs.target]
        return np.concatenate(blocks, axis=1)

    def unpack_input(self, row: np.ndarray) -> _StepInput:
        """Return the inputs of one copy from their row."""
        slices = self.input_slices
        return _StepInput(
            q=row[slices["q"]],
            v=row[slices["v"]],
            command=row[slices["command"]],
            rates=row[slices["rates"]],
            box=row[slices["box"]].reshape(2, -1),
            granted=row[slices["granted"]].reshape(2, -1),
            target=row[slices["target"]],
        )

    def pack_output(self, output: _StepOutput) -> np.ndarray:
        """Return the row of outputs of one copy."""
        blocks = [
            output.rates,
            output.box.ravel(),
            output.retained_box.ravel(),
            output.wanted_box.ravel(),
            output.braking_rates,
        ]
        return np.concatenate(blocks)

    def unpack_output(self, rows: np.ndarray) -> _StepOutput:
        """Return the outputs of N copies from their rows."""
        slices = self.output_slices
        boxes = len(rows), 2, self.drive_count
        return _StepOutput(
            rates=rows[:, slices["rates"]],
            box=rows[:, slices["box"]].reshape(boxes),
            retained_box=rows[:, slices["retained_box"]].reshape(boxes),
            wanted_box=rows[:, slices["wanted_box"]].reshape(boxes),
            braking_rates=rows[:, slices["braking_rates"]],
        )


def _consecutive_slices(lengths: dict[str, int]) -> dict[str, slice]:
    """Return where blocks of given lengths stand in a vector that holds them one after another."""
    slices = {}
    start = 0
    for name, length in lengths.items():
        slices[name] = slice(start, start + length)
        start += length
    return slices


def _move_at_right_angles(station: Station) -> bool:
    """Return whether the drives of the chain move the pivot at right angles to each other, seen
    from above, at each of `POSITIONS_TRIED` random positions in their ranges.

    Slew and trolley do, and slew and luff. A travelling gear below a slew does not.
    """
    lowest, highest = station.ranges
    # A description may state a range of any size. Positions several turns apart will do.
    lowest = np.maximum(lowest, -MAX_RANGE_TRIED)
    highest = np.minimum(highest, MAX_RANGE_TRIED)
    rng = np.random.default_rng(0)
    positions = rng.uniform(lowest, highest, (POSITIONS_TRIED, len(lowest)))
    coordinates, _ = station.plumb(positions)
    horizontal = station.rope(coordinates).motion[:, :, :2]
    lengths = np.linalg.norm(horizontal, axis=2)
    products = np.abs(horizontal @ horizontal.transpose(0, 2, 1))
    largest = lengths[:, :, None] * lengths[:, None, :]
    between_two = ~np.eye(len(lowest), dtype=bool)
    # Products of drives that do not move the pivot, such as the winch, are zero up to 1e-12.
    return bool((products <= RIGHT_ANGLE_TOLERANCE * largest + 1e-12)[:, between_two].all())


def _planned_inclination(layout: _StepLayout, max_swing: float) -> float:
    """Return the largest inclination of the rope by the planned acceleration of a drive [rad], for
    the swing that the wind leaves to the drives [rad].
    """
    # A drive that accelerates the pivot by a changes the amplitude by up to 2 a/g, see
    # `_swing_added_by_braking`. It does so once while it speeds up and once while it brakes: 4 a/g.
    # Two drives at right angles, such as slew and trolley, add up to √2 times that; any c drives to
    # c times that.
    summation_factor = math.sqrt(2.0) if layout.at_right_angles else float(len(layout.chain))
    return SWING_LIMIT_RATIO / (4.0 * summation_factor) * max_swing


def _crane_constants(station: Station, max_swing: float, wind: WorkingWind) -> _CraneConstants:
    """Return the constants of a crane in floats, for a largest swing [rad] and wind.

    Raises:
        OutOfRange: If the wind leaves less than `MIN_WORKING_RATIO` of the swing to the drives.
    """
    layout = _StepLayout.of(station)
    for_drives = working_swing(station, max_swing, wind)
    if not for_drives >= MIN_WORKING_RATIO * max_swing:
        for_wind = SWING_LIMIT_RATIO * (1.0 - MIN_WORKING_RATIO) * max_swing
        raise OutOfRange(
            f"swing of the load of {quoted(station.name)} in gusts of {wind.gust:g} m/s",
            f"{math.degrees(wind.swing(station.crane)):.3g}",
            f"up to {math.degrees(for_wind):.3g} degrees, as ropes swing by no more than "
            f"{math.degrees(max_swing):.3g} degrees and the drives need a share of that; enter a "
            "larger swing or less wind",
            "degrees",
        )
    return _CraneConstants(
        rope=station.ropes[0],
        reaction=station.brakes.reaction,
        gravity=station.crane.gravity,
        max_swing=max_swing,
        planned_inclination=_planned_inclination(layout, for_drives),
        gust=wind.gust,
        drag_ratio=wind.drag_ratio(station.crane),
        tolerances=station.brakes.tolerances,
        decelerations=station.brakes.decelerations,
        ranges=station.ranges,
        chain=list(layout.chain),
        winch=layout.winch,
    )


# --- arithmetic on arrays of numbers of any kind --------------------------------------------------

# NumPy's own minimum, maximum and where ask each comparison for its truth, which a symbolic number
# does not know while code is traced. These make the choice a part of the code.
_minimum = np.frompyfunc(smaller, 2, 1)
_maximum = np.frompyfunc(larger, 2, 1)
_select = np.frompyfunc(where, 3, 1)


def _number_or_zero(value: Any) -> Any:
    """Return a number, or 0 where it is NaN or beyond `MAX_INPUT`."""
    return where(magnitude(value) <= MAX_INPUT, value, 0.0)


_numbers_or_zeros = np.frompyfunc(_number_or_zero, 1, 1)


def _clip(value: Any, low: Any, high: Any) -> Any:
    """Clip values to the range [low, high] element by element; `low` wins for NaN."""
    return _minimum(_maximum(value, low), high)


def _norm(vector: np.ndarray) -> Any:
    """Return the Euclidean length of a vector."""
    return square_root(vector @ vector)


def _hull(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest box that contains two boxes, shape (2, m)."""
    return np.array([_minimum(a[0], b[0]), _maximum(a[1], b[1])])


def _intersection(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the box that two boxes have in common, shape (2, m)."""
    return np.array([_maximum(a[0], b[0]), _minimum(a[1], b[1])])


# --- physics of stopping --------------------------------------------------------------------------

# A drive at speed v goes on at v for the reaction time τ, then decelerates by a to standstill:
#
#     d(v) = v τ + v²/(2 a).
_stopping_distances = np.frompyfunc(stopping_distance, 3, 1)

# Solved for v, the largest speed from which a drive stops within d:
#
#     v(d) = √((a τ)² + 2 a d) - a τ.
_largest_speeds = np.frompyfunc(largest_rate, 3, 1)


def _stopping_box(
    crane: _CraneConstants,
    decelerations: np.ndarray,
    position: np.ndarray,
    lowest_rates: np.ndarray,
    highest_rates: np.ndarray,
) -> np.ndarray:
    """Return the box of all positions that drives may pass before they stand [rad or m], shape
    (2, m), if they brake now at unknown rates from the lowest to the highest.

    A measured position may be wrong by its tolerance, by which the box is larger on both sides.
    """
    backward = _minimum(lowest_rates, 0.0)
    forward = _maximum(highest_rates, 0.0)
    behind = _stopping_distances(backward, crane.reaction, decelerations) + crane.tolerances
    ahead = _stopping_distances(forward, crane.reaction, decelerations) + crane.tolerances
    return np.array([position - behind, position + ahead])


def _rate_limits(
    crane: _CraneConstants,
    decelerations: np.ndarray,
    box: np.ndarray,
    position: np.ndarray,
    rates: np.ndarray,
    velocity: np.ndarray,
) -> np.ndarray:
    """Return the lowest (at most 0) and the highest (at least 0) rates [rad/s or m/s], shape
    (2, m), from which drives stop inside a box.

    Args:
        crane: The crane.
        decelerations: Decelerations after the reaction time [rad/s² or m/s²], shape (m,).
        box: Ends of the intervals [rad or m], shape (2, m).
        position: Measured positions [rad or m], shape (m,).
        rates: Last rates that were passed on to the drives [rad/s or m/s], shape (m,).
        velocity: Measured rates of the drives [rad/s or m/s], shape (m,).
    """
    distance_behind = position - box[0] - crane.tolerances
    distance_ahead = box[1] - position - crane.tolerances
    speed_backward = -_minimum(rates, velocity)
    speed_forward = _maximum(rates, velocity)
    backward = _largest_speed_towards(crane, decelerations, distance_behind, speed_backward)
    forward = _largest_speed_towards(crane, decelerations, distance_ahead, speed_forward)
    return np.array([-backward, forward])


def _largest_speed_towards(
    crane: _CraneConstants,
    decelerations: np.ndarray,
    distance: np.ndarray,
    present_speed: np.ndarray,
) -> np.ndarray:
    """Return the largest speeds to command towards the ends of intervals [rad/s or m/s], shape
    (m,), at least 0.

    Args:
        crane: The crane.
        decelerations: Decelerations after the reaction time [rad/s² or m/s²], shape (m,).
        distance: Distances from the ends [rad or m], shape (m,); below 0 beyond them.
        present_speed: The larger one of the measured and the last commanded speed towards the end
            [rad/s or m/s], shape (m,); below 0 away from it.
    """
    distance = _maximum(distance, 0.0)
    steady = _largest_speeds(distance, crane.reaction, decelerations)

    # A drive lags behind its commands by up to the reaction time. Whatever is commanded now, it
    # still goes on at what it has or had been commanded, and starts to follow from there: for what
    # remains of the distance then there is no reaction time any more. So a drive that is faster
    # than its new command ends inside the box all the same.
    distance_on_the_way = _maximum(present_speed, 0.0) * crane.reaction
    remaining = _maximum(distance - distance_on_the_way, 0.0)
    lagging = _largest_speeds(remaining, 0.0, decelerations)
    return _minimum(steady, lagging)


# --- physics of the swing -------------------------------------------------------------------------
#
# A rope of length l under a pivot that accelerates by b swings about the inclination -b/g, at the
# angular frequency ω = √(g/l). The deviation θ from there and its rate θ' over ω are coordinates of
# a point that goes round a circle; the radius of the circle is the amplitude.


@dataclass(frozen=True, eq=False)
class _RopeMotion:
    """How the pivot and the rope move now.

    Attributes:
        pivot_motion: Horizontal motion of the pivot by each drive of the chain [m/rad or m/m],
            shape (drives of the chain, 2).
        equilibrium: Inclination about which the rope swings at constant rates, shape (2,).
        deviation: Inclination of the rope less the equilibrium, shape (2,).
        deviation_rate: Rate of change of the deviation [1/s], shape (2,).
    """

    pivot_motion: np.ndarray
    equilibrium: np.ndarray
    deviation: np.ndarray
    deviation_rate: np.ndarray


def _rope_motion(
    crane: _CraneConstants, layout: _StepLayout, q: np.ndarray, v: np.ndarray
) -> _RopeMotion:
    """Return the motion of the pivot and the rope at measured coordinates, shape (n,), and their
    rates, shape (n,), by differences over `EXTRAPOLATION_STEP`.
    """
    chain_coordinates = [layout.drives[drive] for drive in layout.chain]
    chain_rates = v[chain_coordinates]
    pivot_motions_over_time = []
    inclinations = []
    for steps_ahead in range(3):
        coordinates = q + steps_ahead * EXTRAPOLATION_STEP * v
        chain_position = coordinates[chain_coordinates]
        swing_angles = coordinates[[*layout.swings]]
        pose = rope_pose(crane.rope, chain_position, swing_angles)
        pivot_motions_over_time.append(pose.motion[:, :2])
        inclinations.append(pose.direction[:2])

    # At constant rates the pivot still accelerates if a drive turns it: b = dJ/dt · rates, with the
    # motions J of the pivot by each drive. The rope then swings about -b/g. Two such equilibria, a
    # step apart, take three poses.
    equilibria = []
    for steps_ahead in range(2):
        earlier = pivot_motions_over_time[steps_ahead]
        later = pivot_motions_over_time[steps_ahead + 1]
        equilibria.append((earlier - later).T @ chain_rates / (EXTRAPOLATION_STEP * crane.gravity))
    deviation = inclinations[0] - equilibria[0]
    next_deviation = inclinations[1] - equilibria[1]
    return _RopeMotion(
        pivot_motion=pivot_motions_over_time[0],
        equilibrium=equilibria[0],
        deviation=deviation,
        deviation_rate=(next_deviation - deviation) * (1.0 / EXTRAPOLATION_STEP),
    )


def _swing_amplitude(crane: _CraneConstants, rope: _RopeMotion, cable: Any) -> Any:
    """Return the amplitude about the equilibrium [rad] that a rope of a length [m] has now."""
    # √(θ² + (θ'/ω)²) with 1/ω² = l/g.
    squared_rate = rope.deviation_rate @ rope.deviation_rate
    return square_root(rope.deviation @ rope.deviation + squared_rate * (cable / crane.gravity))


def _swing_added_by_braking(
    crane: _CraneConstants,
    decelerations: np.ndarray,
    box: np.ndarray,
    rates: np.ndarray,
    velocity: np.ndarray,
    cable: Any,
    *,
    at_right_angles: bool,
) -> Any:
    """Return the largest amplitude [rad] that is added if all drives brake to standstill, wherever
    in a box they do so, from rates that were passed on or those that are measured, whichever are
    larger: drives lag behind their commands.
    """
    # A drive that brakes accelerates the pivot by a = deceleration × motion of the pivot. That
    # moves the equilibrium by a/g, and back at standstill: at the worst moments each adds a/g to
    # the amplitude, 2 a/g together. If the drive stops much faster than the rope swings, a lasts
    # too briefly for that: θ' changes by no more than the speed of the pivot over l, which adds
    # (v/l)/ω = v/√(g l).
    pivot_motion = _largest_pivot_motions(crane, box)
    by_acceleration = 2.0 * decelerations / crane.gravity

    # `by_speed` takes the present cable length l. If the winch first hoists to l', it is √(l/l')
    # larger, but grows by (l'/s)^1.5 only from then on; the product is below the (l/s)^1.5 by which
    # the sum is multiplied, see `_growth_by_hoisting`.
    speed = _maximum(abs(rates), abs(velocity))
    by_speed = speed / square_root(crane.gravity * cable)
    added = pivot_motion * _minimum(by_acceleration, by_speed)

    # Amplitudes at right angles to each other, as by slew and trolley, add as such vectors do.
    # Those of drives that may move the pivot in one direction add up.
    if at_right_angles:
        return _norm(added)
    return sum(added[1:], added[0])


def _swing_added_by_wind(
    crane: _CraneConstants, box: np.ndarray, rates: np.ndarray, velocity: np.ndarray
) -> Any:
    """Return the largest amplitude [rad] that a gust from now on adds, see `WorkingWind.swing`. The
    speed of the pivot adds to that of the gust, since it may carry the load against it.
    """
    pivot_motion = _largest_pivot_motions(crane, box)
    pivot_speeds = pivot_motion * _maximum(abs(rates), abs(velocity))
    air_speed = crane.gust + sum(pivot_speeds[1:], pivot_speeds[0])
    return GUST_RESPONSE * crane.drag_ratio * air_speed * air_speed


def _growth_by_hoisting(
    crane: _CraneConstants, decelerations: np.ndarray, cable: Any, winch_rate: Any
) -> Any:
    """Return the factor, at least 1, by which an amplitude can grow while the winch brakes from a
    rate [m/s], negative while it hoists.
    """
    # A rope of changing length l follows θ'' + 2 (l'/l) θ' + (g/l) θ = 0. The square of the
    # amplitude, A² = θ² + (l/g) θ'², then changes by (A²)' = -3 (l'/g) θ'². While the rope is
    # shortened, this is at most 3 |l'|/l A², as (l/g) θ'² is at most A²; integrated from l to s:
    #
    #     A(s) ≤ A(l) (l/s)^1.5.
    hoisting_rate = _minimum(winch_rate, 0.0)
    hoisted = stopping_distance(hoisting_rate, crane.reaction, decelerations[crane.winch])
    shortest = crane.ranges[0, crane.winch]
    cable_at_standstill = _maximum(cable - hoisted, shortest)
    ratio = _maximum(cable / cable_at_standstill, 1.0)
    return ratio * square_root(ratio)


def _largest_swing_if_braked(
    crane: _CraneConstants,
    layout: _StepLayout,
    decelerations: np.ndarray,
    rope: _RopeMotion,
    box: np.ndarray,
    cable: Any,
    rates: np.ndarray,
    velocity: np.ndarray,
) -> Any:
    """Return the largest angle of the rope from plumb [rad] if all drives brake now.

    Args:
        crane: The crane.
        layout: Layout of the step.
        decelerations: Planned decelerations in the box [rad/s² or m/s²], shape (m,).
        rope: Motion of the pivot and the rope.
        box: Box in which the drives stop, shape (2, m).
        cable: Cable length [m].
        rates: Last rates that were passed on to the drives [rad/s or m/s], shape (m,).
        velocity: Measured rates of the drives [rad/s or m/s], shape (m,).
    """
    # At standstill the equilibrium is plumb. It moves there by |b|/g while the drives brake, which
    # adds as much to the amplitude.
    amplitude = _swing_amplitude(crane, rope, cable)
    by_turning = _norm(rope.equilibrium)
    by_braking = _swing_added_by_braking(
        crane,
        decelerations,
        box,
        rates,
        velocity,
        cable,
        at_right_angles=layout.at_right_angles,
    )
    by_wind = _swing_added_by_wind(crane, box, rates, velocity)
    swing = amplitude + by_turning + by_braking + by_wind

    # The winch lags behind its commands: the faster one of both rates counts.
    winch_rate = _minimum(rates[crane.winch], velocity[crane.winch])
    growth = _growth_by_hoisting(crane, decelerations, cable, winch_rate)
    return swing * growth


def _damping_rate_changes(crane: _CraneConstants, rope: _RopeMotion, cable: Any) -> np.ndarray:
    """Return the changes of rates in a cycle that damp the swing [rad/s or m/s], shape (m,); 0 for
    the winch.
    """
    # The load at x = l θ from the pivot follows x'' = -ω² x - (acceleration of the pivot). For a
    # damping ratio ζ the pivot accelerates by 2 ζ ω x' = 2 ζ √(g l) θ', in the direction in which
    # the load moves. Over a cycle this changes the velocity of the pivot by `factor` times θ'.
    factor = 2.0 * DAMPING_RATIO * CYCLE * square_root(crane.gravity * cable)

    # Of all changes of rates r with Jᵀ r = change of the pivot's velocity, r = J (Jᵀ J)⁻¹ change is
    # the smallest. Where drives move the pivot in one direction only, Jᵀ J has no inverse; a small
    # multiple of the identity is added to it.
    motion = rope.pivot_motion
    gram = motion.T @ motion
    gram = gram + np.eye(2) * SINGULARITY_MARGIN * (gram[0, 0] + gram[1, 1])
    determinant = gram[0, 0] * gram[1, 1] - gram[0, 1] * gram[0, 1]
    x, y = rope.deviation_rate * (factor / determinant)
    solution = array([gram[1, 1] * x - gram[0, 1] * y, gram[0, 0] * y - gram[0, 1] * x])

    changes = 0.0 * crane.decelerations
    changes[crane.chain] = motion @ solution
    return changes


def _largest_pivot_motions(crane: _CraneConstants, box: np.ndarray) -> np.ndarray:
    """Return upper bounds of the motion of the pivot by each drive [m/rad or m/m], wherever in a
    box the drives stand, shape (m,).
    """
    motions = 0.0 * crane.decelerations + MIN_PIVOT_MOTION
    chain_box = box[:, crane.chain]
    motions[crane.chain] = pivot_motions(crane.rope, chain_box[0], chain_box[1])
    return motions


def _planned_decelerations(crane: _CraneConstants, box: np.ndarray) -> np.ndarray:
    """Return the decelerations that the guard plans with [rad/s² or m/s²], shape (m,), wherever in
    a box the drives stand.

    They are those of the brakes, or less where these would incline the rope by more than
    `_planned_inclination`: the farther from the mast the rope can hang in the box, the gentler.
    """
    max_pivot_acceleration = crane.planned_inclination * crane.gravity
    inclining = 1.0 / _largest_pivot_motions(crane, box) * max_pivot_acceleration
    return _minimum(crane.decelerations, inclining)


# --- the step -------------------------------------------------------------------------------------


@cache
def _compile_step(layout: _StepLayout) -> RowFunction:
    """Return `_step` as machine code, for rows of a layout."""

    def traced(numbers: np.ndarray) -> np.ndarray:
        # `compile_rows` puts the numbers that all rows share before those of a row.
        crane = layout.unpack_crane(numbers[: layout.crane_length])
        inputs = layout.unpack_input(numbers[layout.crane_length :])
        return layout.pack_output(_step(crane, layout, inputs))

    return compile_rows(
        traced,
        width_in=layout.input_length,
        width_out=layout.output_length,
        shared=layout.crane_length,
    )


def _step(crane: _CraneConstants, layout: _StepLayout, inputs: _StepInput) -> _StepOutput:
    """Return what the guard does in a cycle, see the list at the top of this module."""
    position = inputs.q[[*layout.drives]]
    velocity = inputs.v[[*layout.drives]]

    # For the case that the inputs are implausible: brake by what the present box was planned for,
    # which takes no measurement.
    held_change = _planned_decelerations(crane, inputs.box) * CYCLE
    braking_rates = _clip(0.0, inputs.rates - held_change, inputs.rates + held_change)

    box, decelerations = _box_with_grant(crane, layout, inputs, position, velocity)
    command = _withdrawing_command(crane, decelerations, position, inputs)
    command = _swing_limited_command(crane, layout, decelerations, inputs, box, command)

    change = decelerations * CYCLE
    limits = _rate_limits(crane, decelerations, box, position, inputs.rates, velocity)
    reachable = _clip(command, inputs.rates - change, inputs.rates + change)
    rates = _clip(reachable, limits[0], limits[1])

    # Drives that lag may still have their measured rates.
    lowest_rates = _minimum(rates, velocity)
    highest_rates = _maximum(rates, velocity)
    stopping_box = _stopping_box(crane, decelerations, position, lowest_rates, highest_rates)
    wanted = _wanted_box(crane, decelerations, position, rates, command, stopping_box)

    # What lies behind is given back. What may be passed before standstill never is.
    retained = _intersection(box, _hull(wanted, stopping_box))
    return _StepOutput(
        rates=rates,
        box=box,
        retained_box=retained,
        wanted_box=_hull(wanted, retained),
        braking_rates=braking_rates,
    )


def _box_with_grant(
    crane: _CraneConstants,
    layout: _StepLayout,
    inputs: _StepInput,
    position: np.ndarray,
    velocity: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the box with those intervals of the grant that the crane can use now, shape (2, m),
    and the planned decelerations in it [rad/s² or m/s²], shape (m,).

    In a larger box the rope can hang farther out, so that planned decelerations are gentler, and
    drives stop later. An interval of the grant is taken where each drive either keeps its planned
    deceleration, or can stop in the box from its present rate with the gentler one.
    """
    box = inputs.box
    decelerations = _planned_decelerations(crane, box)
    for drive in (*layout.chain, layout.winch):
        candidate = box.copy()
        candidate[:, drive] = inputs.granted[:, drive]
        gentler = _planned_decelerations(crane, candidate)
        limits = _rate_limits(crane, gentler, candidate, position, inputs.rates, velocity)

        # Flags are 1 or 0, as a symbolic condition knows no `and` and `or`: their product means
        # "and", the larger one "or". They are 0 for NaN: one NaN refuses the interval.
        all_can_stop = 1.0
        for i in range(layout.drive_count):
            brakes_as_before = _is_at_least(gentler[i], decelerations[i])
            above_lowest = _is_at_least(inputs.rates[i], limits[0, i])
            below_highest = _is_at_least(limits[1, i], inputs.rates[i])
            all_can_stop = all_can_stop * larger(brakes_as_before, above_lowest * below_highest)
        is_taken = all_can_stop > 0.5
        box = _select(is_taken, candidate, box)
        decelerations = _select(is_taken, gentler, decelerations)
    return box, decelerations


def _is_at_least(a: Any, b: Any) -> Any:
    """Return 1 if a number is at least another, up to `ROUNDING`, else 0; 0 for NaN."""
    difference = a - b
    return indicator(difference > -ROUNDING, difference)


def _withdrawing_command(
    crane: _CraneConstants, decelerations: np.ndarray, position: np.ndarray, inputs: _StepInput
) -> np.ndarray:
    """Return the commanded rates, or those towards the target where the crane withdraws [rad/s or
    m/s], shape (m,).
    """
    offset = inputs.target - position
    distance = _maximum(abs(offset) - crane.tolerances, 0.0)
    speed = _largest_speeds(distance, crane.reaction, decelerations)
    approach = []
    for drive_offset, drive_speed in zip(offset, speed, strict=True):
        approach.append(where(drive_offset > 0.0, drive_speed, -drive_speed))

    # The target of a crane that does not withdraw is infinite in all drives.
    withdraws = abs(offset[0]) < MAX_TARGET_DISTANCE
    return _select(withdraws, array(approach), inputs.command)


def _swing_limited_command(
    crane: _CraneConstants,
    layout: _StepLayout,
    decelerations: np.ndarray,
    inputs: _StepInput,
    box: np.ndarray,
    command: np.ndarray,
) -> np.ndarray:
    """Return a command, or a slower one that damps the swing where braking now would swing the rope
    by more than `SWING_LIMIT_RATIO` of the largest swing [rad/s or m/s], shape (m,).
    """
    rates = inputs.rates
    velocity = inputs.v[[*layout.drives]]
    cable = abs(inputs.q[layout.drives[crane.winch]])
    rope = _rope_motion(crane, layout, inputs.q, inputs.v)
    swing = _largest_swing_if_braked(
        crane, layout, decelerations, rope, box, cable, rates, velocity
    )

    # No drive speeds up or reverses, and the load is not hoisted, which would let the swing grow.
    slower = _clip(command, _minimum(rates, 0.0), _maximum(rates, 0.0))
    slower[crane.winch] = _maximum(slower[crane.winch], 0.0)
    change = decelerations * CYCLE
    slower = _clip(slower, rates - change, rates + change)

    # A measured swing rate of, say, 1e8 rad/s is a number, but the sine of the angle that follows
    # from it is NaN. No drive speeds up then, and none damps.
    slower = slower + _numbers_or_zeros(_damping_rate_changes(crane, rope, cable))

    # Written so that the command passes only where the swing is known to be small: not for NaN.
    is_small = swing <= SWING_LIMIT_RATIO * crane.max_swing
    return _select(is_small, command, slower)


def _wanted_box(
    crane: _CraneConstants,
    decelerations: np.ndarray,
    position: np.ndarray,
    rates: np.ndarray,
    command: np.ndarray,
    stopping_box: np.ndarray,
) -> np.ndarray:
    """Return the box that the crane needs to follow its command for the time `HORIZON`, and to stop
    from there, inside the ranges of its drives, shape (2, m).

    Args:
        crane: The crane.
        decelerations: Planned decelerations in the present box [rad/s² or m/s²], shape (m,).
        position: Measured positions [rad or m], shape (m,).
        rates: Rates for the drives [rad/s or m/s], shape (m,).
        command: Rates that they are to reach [rad/s or m/s], shape (m,).
        stopping_box: Box in which they stop if they brake now [rad or m], shape (2, m).
    """
    # Planned decelerations depend on the box, and the box on them. It is worked out with those of
    # the present box first, then with those of the result.
    for _ in range(2):
        change = HORIZON * decelerations
        later_rates = _clip(command, rates - change, rates + change)
        lowest_rates = _minimum(later_rates, rates)
        highest_rates = _maximum(later_rates, rates)
        stopping = _stopping_box(crane, decelerations, position, lowest_rates, highest_rates)
        low = _minimum(stopping[0] + HORIZON * _minimum(lowest_rates, 0.0), stopping_box[0])
        high = _maximum(stopping[1] + HORIZON * _maximum(highest_rates, 0.0), stopping_box[1])
        lowest = crane.ranges[0] - crane.tolerances
        highest = crane.ranges[1] + crane.tolerances
        wanted = np.array([_maximum(low, lowest), _minimum(high, highest)])
        decelerations = _planned_decelerations(crane, _hull(wanted, stopping_box))
    return wanted
