"""The task of moving a load to a goal and leaving no swing, for reinforcement learning.

`SwingTask` holds many cranes at once, of any kind whose load hangs from driven joints. It draws the
starts and goals of episodes (`begin`), turns actions into commands of the drives and steps the
cranes (`act`), and observes and rewards them. `cranedyn.interop.tower_task` is the same task with
the observations of a tower crane, and `cranedyn.interop.gymnasium` makes environments of both.

The cranes may stand on bases that move, such as ships (`Rules.base`). Coordinates, goals and
distances are then those relative to the base, and the load shall come to rest there.

Arrays have a column for each of n cranes. Angles are in rad, lengths in m, times in s. A state z is
the coordinates and then their rates, shape (2 coordinates, n).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.checks import finite, number, short_repr, whole, within
from cranedyn.compiled.fleet import Fleet
from cranedyn.compiled.kernel import Precision
from cranedyn.disturbances.base_motion import COORDINATES, BaseMotion
from cranedyn.disturbances.wind import drag_force
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.cylinders import Pump
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.linearisation import linear
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.interfaces import DirectDrive, State
from cranedyn.interop.drive_commands import DriveLimits, acceleration_code, rate_code
from cranedyn.interop.hanging_loads import check_hangs, hanging_coordinates, range_corners
from cranedyn.interop.load_view import DriveRanges, LoadView, View, pivot_joint
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits

INTEGRATOR = rk4
"""Stepping rule: of order 4, since commands and wind are constant during a control period."""

DT = 1e-2
"""Physics step [s]."""

ACTIONS = ("velocity", "acceleration", "effort")
"""Kinds of actions, see `Rules`."""

PENALTY = -50.0
"""Reward of a step that ends an episode, see `SwingTask.act`.

A policy must not gain by ending an episode early. A step costs at most about 0.4 at distances of
100 m, so at a discount of 0.99 all steps to come cost less than 0.4/(1 - 0.99) = 40.
"""

OVERHEAD = XACRO.with_name("overhead_crane.urdf.xacro")
"""The overhead crane of this project."""

_MAX_UNDIVIDED_COUNT = 4096
"""Largest number of cranes for which the threads share only the physics steps.

The rest of the work on so few cranes is so short that the threads would wait for the lock of the
interpreter. With more cranes each thread does all the work on some of them, since the arrays of all
cranes would not stay in the cache.
"""

_MAX_WIND = 1e3
"""Largest speed of the wind that may be asked for [m/s]."""

_MAX_AREA = 1e6
"""Largest drag area of the payload that may be asked for [m²]."""

_MAX_TOLERANCE = 1e3
"""Largest tolerance that may be asked for [m]."""

_REWARD_SCALE = 0.01
"""Distance to the goal below which coming closer is hardly rewarded any more [m]."""

_REACH_TIME = 10.0
"""Time in which a drive gets to the farthest goal at its largest rate, where no reach is given [s]:
a quarter of an episode of usual length."""

_WORKING_RANGE = {"revolute": np.pi, "prismatic": 50.0}
"""Farthest that a drive is drawn from where the crane starts, by kind of joint [rad or m]. Drives
without ends in their descriptions have ranges of several turns, or of kilometres."""

_RANGE_SHARE = 0.01
"""Share of its range that a drive keeps from either end."""

_MAX_RANGE_MARGIN = 0.05
"""Largest distance that a drive keeps from the ends of its range [rad or m]."""

_RATE_ROUND_OFF = 1e-9
"""Relative round-off of a rate at its limit."""

_DEFAULT_EFFORT_SHARE = 0.5
"""Effort of an action of 1, where none is given, over that which takes a drive in one control
period from rest to its rate limit. The effort limits of many descriptions are mere placeholders."""

_MAX_MODE_STEP = 2.5
"""Largest product of the frequency of a mode and the physics step: RK4 is stable up to 2.8 (Hairer
& Wanner, Solving Ordinary Differential Equations II, IV.2)."""


BaseDraw = Callable[[np.random.Generator], BaseMotion]
"""Function that draws the motion of a base, see `Rules`."""

BASE_OBSERVED = (
    *(f"base_{name}" for name in COORDINATES),
    *(f"base_{name}_dot" for name in COORDINATES),
)
"""Names of the observations of a base: its coordinates [m or rad] and their rates."""

MAX_BASE_OBSERVED = 100.0
"""Bound of these observations [SI units]; what is beyond is observed at the bound."""


@dataclass(frozen=True, eq=False)
class Rules:
    """Rules of the task.

    Attributes:
        action: What an action from -1 to 1 is:

            * "velocity": a share of the rate limit of each drive, which the drive approaches as
              fast as its acceleration limit allows.
            * "acceleration": a share of the acceleration limit of each drive.
            * "effort": a share of the `efforts` of each drive, added to the effort that holds the
              crane at rest at its start, which carries the load.

            With the first two the drives keep their rate limits and brake before the ends of their
            ranges. With "effort" nothing holds them: a drive that leaves its range or exceeds its
            rate limit ends the episode.
        limits: Limits of rates and accelerations of the drives; None for those of typical frequency
            converters of the crane, see `cranedyn.dynamics.converters.converters`.
        reach: Farthest goal from the start of each drive [rad or m]; None for the distance that it
            covers in 10 s at its largest rate.
        swing: Largest amplitude of the swing at the start [rad].
        swing_limit: Swing that ends an episode [rad], at most 45°: up to there the rope stays taut
            under accelerations of less than half of gravity.
        wind: Strongest wind [m/s]; each episode has a steady wind from a random direction.
        payload_area: Drag coefficient times area of the payload [m²].
        converters: Frequency converters that follow the rates of action = "velocity" with their
            lag, ramps, and delay, which is rounded up to control periods. Their limits then hold.
            None for drives that follow exactly.
        tolerance: Distance to the goal up to which the task counts as solved [m].
        efforts: Efforts of the drives that actions of 1 add with action = "effort" [N m or N]; None
            for what the effort limits of the crane leave beside the effort that holds it, but at
            most half of what takes a drive in one control period from rest to its rate limit.
        pump: Pump that the drives share, for action = "velocity": where the rates that the actions
            ask for take more oil than it gives, all drives on it are slowed down alike. None for
            drives that share none.
        base: What draws the motion of the base for an episode from a random generator, such as
            `cranedyn.disturbances.waves.RandomSea` or a function of your own; or one motion for all
            episodes. An episode begins at the time 0 of its motion. None for a base at rest.
        base_measured: Whether the motion of the base is observed, too, as a motion reference unit
            measures it: behind all else its six coordinates [m or rad] and their rates.
    """

    action: str = "velocity"
    limits: Limits | None = None
    reach: Sequence[float] | None = None
    swing: float = 0.1
    swing_limit: float = np.pi / 4
    wind: float = 0.0
    payload_area: float = 4.0
    converters: Converters | None = None
    tolerance: float = 0.05
    efforts: Sequence[float] | None = None
    pump: Pump | None = None
    base: BaseMotion | BaseDraw | None = None
    base_measured: bool = False

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise OutOfRange("action", self.action, "velocity, acceleration or effort")
        within("swing_limit", self.swing_limit, 1e-3, np.pi / 4, "rad")
        within("swing at the start", self.swing, 0.0, self.swing_limit, "rad")
        within("wind", self.wind, 0.0, _MAX_WIND, "m/s")
        within("drag area of the payload", self.payload_area, 0.0, _MAX_AREA, "m²")
        within("tolerance", self.tolerance, 0.0, _MAX_TOLERANCE, "m")
        if self.efforts is not None and self.action != "effort":
            raise OutOfRange("efforts", "given", f"None where action = {self.action}")
        if not (self.base is None or isinstance(self.base, BaseMotion) or callable(self.base)):
            allowed = "a BaseMotion, or a function that draws one from a random generator"
            raise OutOfRange("base", short_repr(self.base), allowed)
        if self.pump is not None and self.action != "velocity":
            raise OutOfRange("pump", "given", f"None where action = {self.action}")
        if self.base_measured and self.base is None:
            raise OutOfRange("base_measured", True, "False where there is no base")
        if self.converters is None:
            return
        if self.action != "velocity":
            raise OutOfRange("converters", "given", f"None where action = {self.action}")
        if self.limits is not None:
            raise OutOfRange("limits", "given beside converters", "None: converters have their own")


def cranes_between(
    count: int,
    seed: int = 0,
    *,
    urdf: str | Path | None = None,
    machine: str | None = None,
    **ranges: tuple[float, float],
) -> list[Crane]:
    """Return cranes with some of their numbers drawn at random.

    Loading takes a tenth of a second for each crane.

    Args:
        count: Number of cranes.
        seed: Seed of the random numbers.
        urdf: Description of the crane, as `load_crane` takes it; None for the tower crane of this
            project.
        machine: Name of a real crane whose numbers are those that are not drawn, as `load_crane`
            takes it; None for none.
        ranges: Bounds between which an argument of `load_crane` is drawn uniformly, by its name,
            such as ``payload_mass=(500, 3000)``.

    Raises:
        UnknownName: If there is no such argument.
        OutOfRange: If a range is not two numbers, or a crane cannot have a number of it.
    """
    bounds = {}
    for name, values in ranges.items():
        try:
            low, high = values
        except (TypeError, ValueError):
            raise OutOfRange(f"range of {name}", short_repr(values), "two numbers") from None
        bounds[name] = (number(f"range of {name}", low), number(f"range of {name}", high))
    rng = np.random.default_rng(whole("seed", seed, 0))
    cranes = []
    for _ in range(whole("number of cranes", count, 1)):
        arguments: dict[str, Any] = {}
        for name, (low, high) in bounds.items():
            arguments[name] = float(rng.uniform(low, high))
        cranes.append(load_crane(urdf, machine=machine, **arguments))
    return cranes


@dataclass(frozen=True, eq=False)
class EpisodeStart:
    """How an episode begins; what is None is drawn at random.

    Attributes:
        start: State of the crane.
        goal: Goals of the drives [rad or m], m numbers.
    """

    start: State | None = None
    goal: Sequence[float] | None = None


@dataclass(frozen=True, eq=False)
class ActResult:
    """Result of a period of all n cranes.

    Attributes:
        reward: Rewards, shape (n,).
        terminated: Whether the episode has ended badly, see `SwingTask.act`, shape (n,).
        observations: Observations in single precision, shape (n, observed).
    """

    reward: np.ndarray
    terminated: np.ndarray
    observations: np.ndarray


@dataclass(frozen=True, eq=False)
class SwingDraw:
    """Random swings of k cranes as amplitudes times cosine and sine of a phase.

    Attributes:
        angle: Angles of the swings [rad], shape (swings, k).
        rate: Their rates over the frequency of the pendulum [rad], shape (swings, k).
    """

    angle: np.ndarray
    rate: np.ndarray


class SwingTask:
    """Many cranes, each with its goal.

    The goal of an episode is a position of each drive. Where the load hangs at rest with its drives
    there, there it must come and hang still.

    Attributes:
        rules: The rules.
        goal: Goals of the drives [rad or m], shape (m, n).
        goal_distance: Distance of each crane to its goal, see `distance` [m], shape (n,).
        drive_limits: Limits of each drive, those of the narrowest crane.
        efforts: Efforts that actions of 1 add [N m or N], shape (m,); only with action = "effort".
        fleet: The cranes.
        crane_index: Which of `fleet.cranes` the present episode of each column has, shape (n,).
        layout: Layout of all cranes.
        view: What is observed of the cranes.
    """

    def __init__(
        self,
        cranes: Crane | Sequence[Crane],
        count: int,
        rules: Rules,
        period: float,
        dt: float,
        threads: int | None,
        precision: Precision = "double",
    ) -> None:
        """Create the cranes, see `Fleet`.

        Args:
            cranes: The crane, or several, one of which is drawn for each episode.
            count: Number of cranes at once, n.
            rules: The rules.
            period: Time from one action to the next [s].
            dt: Physics step [s].
            threads: Number of threads; None for one on each processor.
            precision: "double", or "single" for steps that take about half the time.

        Raises:
            ModelError: If the load of a crane does not hang from driven joints, or not at rest with
                its drives anywhere in the ranges of starts and goals.
            OutOfRange: If something else than a crane is given, a rule has not one number for each
                drive, the cranes stand in different gravities or have no range of a drive in
                common, a crane oscillates too fast for the physics step, or as `Fleet`.
        """
        self.rules = rules
        choice = [cranes] if isinstance(cranes, Crane | str | Path) else list(cranes)
        for crane in choice:
            if not isinstance(crane, Crane):
                allowed = "a crane, or several, as cranedyn.load_crane returns them"
                raise OutOfRange("crane", short_repr(crane), allowed)
            self._check_crane(crane, dt)
        self.fleet = Fleet(
            choice,
            count,
            drive=self.drive,
            forces=rules.wind > 0.0,
            integrator=INTEGRATOR,
            dt=dt,
            control_period=period,
            threads=threads,
            precision=precision,
            base=rules.base is not None,
        )
        self.layout = self.fleet.layout
        if rules.pump is not None and rules.pump.crane.layout != self.layout:
            raise OutOfRange("pump", "one of another crane", "a pump of the crane of the task")
        self._gravity = _common_gravity(self.fleet.cranes)
        self._set_limits()
        if rules.action == "effort":
            self._set_efforts(period)
        self._set_ranges()
        self._set_commands(period)
        self.view = self._make_view()
        self._place_all()

    # --- what `cranedyn.interop.tower_task` does in another way -----------------------------------

    @staticmethod
    def default_crane() -> Crane:
        """Return the crane where none is given: the overhead crane of this project."""
        return load_crane(OVERHEAD)

    def _check_crane(self, crane: Crane, dt: float) -> None:
        """Check that the task is made for a crane, and physics steps of `dt` [s] are short enough
        for it.

        Raises:
            ModelError: If its load does not hang from driven joints.
            OutOfRange: If it oscillates too fast.
        """
        pivot_joint(crane)
        _check_step(crane, "effort" if self.rules.action == "effort" else "motion", dt)

    def _default_limits(self, crane: Crane) -> Limits:
        """Return the limits of the drives where the rules state none."""
        typical = converters(crane)
        return Limits(typical.rates.tolist(), typical.accelerations.tolist())

    def _default_reach(self) -> Sequence[float]:
        """Return the farthest goals where the rules state none [rad or m], m numbers."""
        return np.minimum(_REACH_TIME * self._rates, self._highest - self._lowest).tolist()

    def _range_margins(self, widths: np.ndarray) -> np.ndarray:
        """Return how far drives keep from the ends of ranges of some widths [rad or m], shape (m,)
        each.
        """
        return np.minimum(_RANGE_SHARE * widths, _MAX_RANGE_MARGIN)

    def _working_range(self) -> np.ndarray:
        """Return how far from the start of the crane its drives are drawn [rad or m], shape
        (m,).
        """
        return np.array([_WORKING_RANGE[joint.kind] for joint in self.layout.driven])

    def _make_view(self) -> View:
        """Return what is observed of the cranes.

        Raises:
            ModelError: If a load does not hang at rest everywhere in the ranges of the drives.
        """
        check_hangs(self.fleet.cranes, self._drawn_lower[:, 0], self._drawn_upper[:, 0])
        ranges = DriveRanges(
            lowest=self._lowest,
            highest=self._highest,
            drawn_lower=self._drawn_lower[:, 0],
            drawn_upper=self._drawn_upper[:, 0],
            reach=self._reach[:, 0],
            rates=self._rates,
        )
        return LoadView(self.fleet.cranes, ranges, self.rules.swing_limit, self._gravity)

    def _rest_coordinates(self, drives: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return coordinates about which loads swing at the start, shape (coordinates, k).

        Args:
            drives: Positions of the drives [rad or m], shape (m, k).
            kinds: Which of the cranes each column is, shape (k,).
        """
        return hanging_coordinates(self.fleet.cranes, kinds, drives)

    # --- the drives -------------------------------------------------------------------------------

    @property
    def drive(self) -> DirectDrive | Converters:
        """How the drives take their commands, see `cranedyn.simulation.simulate.simulate`."""
        if self.rules.converters is not None:
            return self.rules.converters
        return "effort" if self.rules.action == "effort" else "motion"

    def _set_limits(self) -> None:
        """Set the limits of the drives: the smallest of all cranes, since one compiled function
        serves them all.
        """
        limits = []
        for crane in self.fleet.cranes:
            given = self.rules.limits
            if self.rules.converters is not None:
                own = self.rules.converters.checked_for(crane)
                given = Limits(own.rates.tolist(), own.accelerations.tolist())
            limits.append((given or self._default_limits(crane)).for_crane(crane))
        self._rates = np.min([limit.rates for limit in limits], axis=0)
        self._accelerations = np.min([limit.accelerations for limit in limits], axis=0)

    def _set_efforts(self, period: float) -> None:
        """Set what actions of efforts mean in a control period [s]: the efforts that hold each
        crane at its start, shape (cranes, m), and those that an action of 1 adds, shape (m,).

        Raises:
            ModelError: If a drive cannot hold its crane.
            OutOfRange: If the efforts that the rules state are beyond what a drive has left, or
                accelerate it within a period from rest to its rate limit: then an episode could not
                but end at once.
        """
        holding = []
        left_by_limits = []
        to_rate_limit = []
        for crane in self.fleet.cranes:
            own = holding_effort(crane, crane.start.q)
            by_effort = linear(crane, _rest_state(crane)).b[self.layout.n + self.layout.drives]
            holding.append(own)
            left_by_limits.append(crane.effort_limit - np.abs(own))
            to_rate_limit.append(self._rates / (np.abs(np.diag(by_effort)) * period))
        self._holding = np.array(holding)
        # One number for each drive must do for all cranes.
        spare = np.min(left_by_limits, axis=0)
        fastest = np.min(to_rate_limit, axis=0)
        for joint, effort in zip(self.layout.driven, spare.tolist(), strict=True):
            if effort <= 0.0:
                raise ModelError(
                    f"The drive of {joint.name} cannot hold this crane at its start, where "
                    f"{-effort:.3g} {joint.effort_unit} more than its effort limit are needed; "
                    "give it a larger limit, or the crane a smaller load."
                )
        if self.rules.efforts is None:
            self.efforts = np.minimum(spare, _DEFAULT_EFFORT_SHARE * fastest)
            return
        self.efforts = self.layout.for_drives("effort", self.rules.efforts, None, "> 0")
        for i, joint in enumerate(self.layout.driven):
            largest = min(spare[i], fastest[i])
            if self.efforts[i] > largest:
                raise OutOfRange(
                    f"effort of {joint.symbol}",
                    self.efforts[i],
                    f"at most {largest:.3g}, which is within the effort limit beside the effort "
                    "that holds the crane, and does not take the drive from rest to its rate "
                    "limit in one control period",
                    joint.effort_unit,
                )

    def _set_ranges(self) -> None:
        """Set the ranges of the drives to those that all cranes have.

        Raises:
            OutOfRange: If there is none.
        """
        drives = self.layout.drives
        lower = np.array([crane.lower[drives] for crane in self.fleet.cranes])
        upper = np.array([crane.upper[drives] for crane in self.fleet.cranes])
        self._lowest = lower.max(axis=0)
        self._highest = upper.min(axis=0)
        margins = self._range_margins(self._highest - self._lowest)
        self._lower = (self._lowest + margins)[:, None]
        self._upper = (self._highest - margins)[:, None]
        if not (self._lower < self._upper).all():
            raise OutOfRange(
                "ranges of the drives that all cranes have",
                [self._lowest.tolist(), self._highest.tolist()],
                f"wider than {2.0 * max(margins.max(), 0.0):g} rad or m",
            )
        reach = self.rules.reach
        if reach is None:
            reach = self._default_reach()
        self._reach = self.layout.for_drives("reach", reach, "", ">= 0")[:, None]
        start = self.fleet.cranes[0].start.q[drives]
        working_range = self._working_range()
        # Starts and goals lie between these.
        self._drawn_lower = np.maximum(self._lower, (start - working_range)[:, None])
        self._drawn_upper = np.minimum(self._upper, (start + working_range)[:, None])

    def _set_commands(self, period: float) -> None:
        """Set what `commands` needs.

        Args:
            period: Time from one action to the next [s].
        """
        limits = []
        for i in range(self.layout.m):
            rate = self._rates[i]
            acceleration = self._accelerations[i]
            limits.append(DriveLimits(rate, acceleration, self._lower[i, 0], self._upper[i, 0]))
        # The arguments of the compiled functions are kept instead of the functions, which cannot be
        # copied, so that a task can be; the functions are cached.
        self.drive_limits = tuple(limits)
        self._acceleration_key = (
            self.layout,
            period,
            self.rules.action == "velocity",
            self.drive_limits,
        )
        self._reaction_times: tuple[float, ...] = ()
        own = self.rules.converters
        if own is not None:
            # A command waits for its delay, and then holds for a period. The ramp takes A/J until
            # it brakes with its acceleration A, and the drive lags behind it.
            waiting = (own.delay_steps(0.0, period) + 1) * period
            times = waiting + own.accelerations / own.jerks + own.lags
            self._reaction_times = tuple(times.tolist())

    def commands(
        self, action: np.ndarray, z: np.ndarray, kinds: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the commands of the drives, shape (m, n): accelerations [rad/s² or m/s²]; efforts
        [N m or N] where the action is an effort; rates [rad/s or m/s] where the drives have
        frequency converters.

        Args:
            action: Actions from -1 to 1, shape (m, n).
            z: Coordinates and rates, a column for each crane.
            kinds: Which of the cranes each column is, shape (n,); None for the first.
        """
        if self.rules.action == "effort":
            if kinds is None:
                kinds = np.zeros(action.shape[1], dtype=int)
            return self._holding[kinds].T + action * self.efforts[:, None]
        if self.rules.pump is not None:
            rates = action * self._rates[:, None]
            fed = self.rules.pump.limited(z[: self.layout.n].T, rates.T).T
            action = fed / self._rates[:, None]
        if self.rules.converters is not None:
            return rate_code(self.layout, self._reaction_times, self.drive_limits)(action, z)
        return acceleration_code(*self._acceleration_key)(action, z)

    # --- episodes ---------------------------------------------------------------------------------

    def _place_all(self) -> None:
        """Let all cranes stand at their starts, which are their goals, before the first episode."""
        count = self.fleet.count
        self.goal = np.tile(self.fleet.cranes[0].start.q[self.layout.drives][:, None], count)
        self.crane_index = np.zeros(count, dtype=int)
        # Forces of the wind on the points of each crane, of which the payload is the first [N].
        self._force = np.zeros((count, 3 * len(self.layout.points)))
        # Places of the loads at their goals [m].
        self._target = np.tile(self.view.targets(self.goal[:, :1], np.zeros(1, dtype=int)), count)
        self.goal_distance = self.distance(self.fleet.z, self.goal)

    def check_reset(
        self, start: State | None = None, goal: Sequence[float] | None = None
    ) -> EpisodeStart:
        """Check how an episode shall begin, and return that for `begin`.

        Args:
            start: State of the crane; None for a random one.
            goal: Goals of the drives [rad or m], m numbers; None for random ones.

        Raises:
            OutOfRange: If a goal is not in the ranges of the drives, or the start is no state of
                the crane.
        """
        if start is not None:
            start = self.layout.as_state("start", start)
        if goal is not None:
            goals = self.layout.for_drives("goal", goal)
            goal = []
            for value, low, high in zip(goals, self._lowest, self._highest, strict=True):
                goal.append(within("goal", value, low, high))
        return EpisodeStart(start, goal)

    def begin(
        self,
        rng: np.random.Generator,
        indices: np.ndarray,
        initial: EpisodeStart | None = None,
    ) -> None:
        """Begin an episode of some cranes.

        Start and goal are drawn even where they are given, so that the random numbers of later
        episodes depend on the seed alone.

        Args:
            rng: Source of the random numbers.
            indices: Indices of the cranes, shape (k,).
            initial: Start and goal, as `check_reset` returns them; None for random ones.

        Raises:
            ModelError: If a crane does not hang at rest with its drives at a start or a goal.
        """
        if initial is None:
            initial = EpisodeStart()
        rows = indices.astype(int)
        n = len(indices)
        drives = rng.uniform(self._drawn_lower, self._drawn_upper, (self.layout.m, n))
        nearest = np.maximum(self._drawn_lower, drives - self._reach)
        farthest = np.minimum(self._drawn_upper, drives + self._reach)
        goal = rng.uniform(nearest, farthest)
        swing = self._draw_swing(rng, n)
        kinds = rng.integers(len(self.fleet.cranes), size=n)

        if initial.start is None:
            state = self._swinging(drives, swing, kinds)
        else:
            q, v = initial.start
            state = State(np.repeat(q[:, None], n, axis=1), np.repeat(v[:, None], n, axis=1))
        if initial.goal is not None:
            goal = np.repeat(np.array(initial.goal)[:, None], n, axis=1)
        target = self.view.targets(goal, kinds)
        self.fleet.place(rows, State(state.q.T, state.v.T), kinds)
        self.goal[:, rows] = goal
        self._target[:, rows] = target
        self.crane_index[rows] = kinds
        if self.rules.wind:
            self._draw_wind(rng, rows)
        if self.rules.base is not None:
            self._draw_bases(rng, rows)
        # A new array, since the infos of earlier steps hold the old one.
        self.goal_distance = self.goal_distance.copy()
        unused = np.empty((n, len(self.view.names)), dtype=np.float32)
        measured = self.view.measure(self.fleet.z[:, rows], goal, target, kinds, unused)
        self.goal_distance[rows] = measured.distance

    def _draw_swing(self, rng: np.random.Generator, n: int) -> SwingDraw:
        """Draw swings of n cranes, with an amplitude A in a random direction and phase.

        The swing of a pendulum is A cos(ω t), so that its rate has the amplitude ω A.
        """
        # Adding 0.0 makes 0.0 of -0.0, which NumPy refuses as an upper end below the lower one.
        amplitude = rng.uniform(0.0, self.rules.swing + 0.0, n)
        direction = _random_directions(rng, len(self.view.swings), n)
        phase = rng.uniform(0.0, 2.0 * np.pi, n)
        swing = direction * amplitude
        return SwingDraw(swing * np.cos(phase), swing * np.sin(phase))

    def _swinging(self, drives: np.ndarray, swing: SwingDraw, kinds: np.ndarray) -> State:
        """Return states with drives at rest at some positions, shape (m, k), and swings about where
        the load hangs, shape (coordinates, k) each.
        """
        q = self._rest_coordinates(drives, kinds)
        v = np.zeros_like(q)
        frequency = np.sqrt(self._gravity / self.view.pendulum_lengths(q, kinds))
        q[self.view.swings] += swing.angle
        v[self.view.swings] = swing.rate * frequency
        return State(q, v)

    def _draw_wind(self, rng: np.random.Generator, rows: np.ndarray) -> None:
        """Draw a steady wind for the episodes of some cranes, and let it push their payloads."""
        speed = rng.uniform(0.0, self.rules.wind, len(rows))
        direction = rng.uniform(-np.pi, np.pi, len(rows))
        wind = speed[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
        # The force is that on a load at rest: its own velocity is neglected.
        self._force[rows, :2] = drag_force(self.rules.payload_area, wind)
        self.fleet.push(rows, self._force[rows])

    def _draw_bases(self, rng: np.random.Generator, rows: np.ndarray) -> None:
        """Draw the bases for the episodes of some cranes, each with random numbers of its own."""
        base = self.rules.base
        if base is None or isinstance(base, BaseMotion):
            self.fleet.stand_on(rows, base)
        else:
            # A generator for each crane: how many numbers a motion draws does not matter to others.
            self.fleet.stand_on(rows, [base(generator) for generator in rng.spawn(len(rows))])

    def base_of(self, index: int) -> BaseMotion | None:
        """Return on which base the crane of a column stands in the present episode; None for one at
        rest.
        """
        return None if self.fleet.bases is None else self.fleet.bases.motion(index)

    def crane_of(self, index: int) -> Crane:
        """Return which crane the present episode of a column has."""
        return self.fleet.cranes[self.crane_index[index]]

    def farthest_coordinates(self, index: int) -> np.ndarray:
        """Return coordinates of the crane of a column that hangs at rest with its drives at the
        corners of the ranges of starts and goals, shape (coordinates, corners).
        """
        corners = range_corners(self._drawn_lower[:, 0], self._drawn_upper[:, 0])
        kinds = np.full(corners.shape[1], self.crane_index[index])
        return hanging_coordinates(self.fleet.cranes, kinds, corners)

    def force_on(self, index: int) -> list[float]:
        """Return the force of the wind on the payload of a column in the present episode [N]: three
        numbers, in the axes of the world.
        """
        return self._force[index, :3].tolist()

    # --- steps ------------------------------------------------------------------------------------

    def act(self, action: np.ndarray) -> ActResult:
        """Apply actions for a control period.

        An episode ends badly, with the reward `PENALTY`, where the swing goes beyond its limit; and
        where a drive leaves its range or exceeds its rate limit, which only drives do that take
        efforts or have frequency converters.

        Args:
            action: Actions from -1 to 1, shape (m, n).

        Raises:
            OutOfRange: If an action is no number from -1 to 1.
        """
        action = finite("action", action, self.goal.shape)
        n = self.fleet.count
        too_large = np.abs(action) > 1.0
        if too_large.any():
            raise OutOfRange("action", float(action[too_large][0]), "-1 to 1")
        observations = np.empty((n, len(self.observed)), dtype=np.float32)
        result = ActResult(np.empty(n), np.empty(n, dtype=bool), observations)
        self.goal_distance = np.empty(n)

        def step(columns: slice, advance: Callable[[np.ndarray], np.ndarray]) -> None:
            """Move the cranes of some columns by `advance`, which takes the commands of their
            drives and returns their states, and judge these.
            """
            commands = self.commands(
                action[:, columns], self.fleet.z[:, columns], self.crane_index[columns]
            )
            self._judge(columns, advance(commands), result)

        def step_chunk(i: int) -> None:
            step(self.fleet.chunks[i], partial(self.fleet.advance, i))

        if n <= _MAX_UNDIVIDED_COUNT:
            step(slice(n), self.fleet.step)
        else:
            self.fleet.spread(step_chunk)
        if self.rules.base_measured:
            self._observe_bases(slice(None), observations)
        return result

    def _judge(self, columns: slice, z: np.ndarray, result: ActResult) -> None:
        """Fill in rewards, ends and observations of the cranes of some columns at states z."""
        distance, swing_squared = self.view.measure(
            z,
            self.goal[:, columns],
            self._target[:, columns],
            self.crane_index[columns],
            result.observations[columns, : len(self.view.names)],
        )
        # Written with "not smaller", a swing that is not a number is beyond the limit, too.
        has_failed = ~(swing_squared < self.rules.swing_limit**2)
        if self.fleet.drive != "motion":
            has_failed |= self._overrun(z)
            # The distance of a crane that has diverged is no number, but beyond all bounds.
            distance = np.where(np.isnan(distance), np.inf, distance)
        # The logarithm rewards the last centimetres as much as the first metres.
        reward = -self.fleet.control_period * np.log10(1.0 + distance / _REWARD_SCALE)
        result.terminated[columns] = has_failed
        result.reward[columns] = np.where(has_failed, PENALTY, reward)
        self.goal_distance[columns] = distance

    def _overrun(self, z: np.ndarray) -> np.ndarray:
        """Return whether a drive of each crane is outside of its range or beyond its rate limit,
        shape (k,).
        """
        positions = z[self.layout.drives]
        rates = z[self.layout.n + self.layout.drives]
        outside = (positions < self._lowest[:, None]) | (positions > self._highest[:, None])
        too_fast = np.abs(rates) > (1.0 + _RATE_ROUND_OFF) * self._rates[:, None]
        return (outside | too_fast).any(axis=0)

    # --- what is observed -------------------------------------------------------------------------

    @property
    def observed(self) -> tuple[str, ...]:
        """Names of the observations in their order, such as x_to_go, x, x_dot, phi, phi_dot."""
        return (*self.view.names, *(BASE_OBSERVED if self.rules.base_measured else ()))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest possible observations, in single precision, shape
        (observed,) each.
        """
        low, high = self.view.bounds()
        if not self.rules.base_measured:
            return low, high
        of_base = np.full(len(BASE_OBSERVED), MAX_BASE_OBSERVED, dtype=np.float32)
        return np.append(low, -of_base), np.append(high, of_base)

    @property
    def is_solved(self) -> np.ndarray:
        """Whether each crane is within the tolerance of its goal, shape (n,)."""
        return self.goal_distance < self.rules.tolerance

    def distance(self, z: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return the distance of cranes of the first kind to their goals [m], shape (n,); see
        `view`.

        Args:
            z: Coordinates and rates, a column for each crane.
            goal: Goals of the drives, a column for each crane.
        """
        kinds = np.zeros(z.shape[1], dtype=int)
        unused = np.empty((z.shape[1], len(self.view.names)), dtype=np.float32)
        return self.view.measure(z, goal, self.view.targets(goal, kinds), kinds, unused).distance

    def observe(self, which: Any = slice(None)) -> np.ndarray:
        """Return the present observations, see `observed`, in single precision.

        Args:
            which: Index, mask or slice of the cranes; by default all.
        """
        kinds = self.crane_index[which]
        of_crane = self._observations(self.fleet.z[:, which], self.goal[:, which], kinds)
        if not self.rules.base_measured:
            return of_crane
        observations = np.empty((len(of_crane), len(self.observed)), dtype=np.float32)
        observations[:, : of_crane.shape[1]] = of_crane
        self._observe_bases(which, observations)
        return observations

    def _observe_bases(self, which: Any, observations: np.ndarray) -> None:
        """Fill in the observations of the bases of some cranes, the last columns."""
        assert self.fleet.bases is not None
        rows = np.arange(self.fleet.count)[which]
        position, velocity, _ = self.fleet.bases.coordinates(rows)
        clipped = np.clip(np.hstack([position, velocity]), -MAX_BASE_OBSERVED, MAX_BASE_OBSERVED)
        observations[:, len(self.view.names) :] = clipped

    def observation(self, z: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return the observations of cranes of the first kind, without those of bases, shape (n,
        observed), in single precision.

        Args:
            z: Coordinates and rates, a column for each crane.
            goal: Goals of the drives, a column for each crane.
        """
        return self._observations(z, goal, np.zeros(z.shape[1], dtype=int))

    def _observations(self, z: np.ndarray, goal: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return observations of cranes of some kinds, shape (k,)."""
        observations = np.empty((z.shape[1], len(self.view.names)), dtype=np.float32)
        # Observations do not depend on where the load shall be.
        no_target = np.zeros((3, z.shape[1]))
        self.view.measure(z, goal, no_target, kinds, observations)
        return observations


def _random_directions(rng: np.random.Generator, size: int, n: int) -> np.ndarray:
    """Return n random unit vectors, shape (size, n), uniform over all directions."""
    if size == 2:
        angle = rng.uniform(0.0, 2.0 * np.pi, n)
        return np.stack([np.cos(angle), np.sin(angle)])
    vectors = rng.standard_normal((size, n))
    return vectors / np.linalg.norm(vectors, axis=0)


def _common_gravity(cranes: Sequence[Crane]) -> float:
    """Return the gravity in which all cranes stand [m/s²]: distances and starts take it for that of
    every crane.

    Raises:
        OutOfRange: If they stand in different gravities.
    """
    gravities = sorted({crane.gravity for crane in cranes})
    if len(gravities) > 1:
        raise OutOfRange("gravity of the cranes", gravities, "the same for all", "m/s²")
    return gravities[0]


def _rest_state(crane: Crane) -> State:
    """Return the state in which a crane hangs at rest with its drives at their starts."""
    return State(crane.rest.q, np.zeros(crane.layout.n))


def _check_step(crane: Crane, drive: DirectDrive, dt: float) -> None:
    """Check that a physics step [s] is short enough for a crane, such as one with an elastic rope.

    Raises:
        OutOfRange: If it is not.
    """
    rates = np.linalg.eigvals(linear(crane, _rest_state(crane), drive=drive).a)
    fastest = float(np.abs(rates).max())
    if fastest * dt > _MAX_MODE_STEP:
        allowed = f"{_MAX_MODE_STEP / fastest:.3g} or less: a mode has {fastest:.3g} rad/s"
        raise OutOfRange("dt", dt, allowed, "s")
