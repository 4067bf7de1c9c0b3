"""Environments of Gymnasium for the task of moving a load without swing.

`CraneVectorEnv` steps many cranes at once by compiled code, `CraneEnv` one crane, which can also be
drawn. Both take any crane whose load hangs from driven joints, by default the overhead crane of
this project, and are registered under one name:

``gymnasium.make_vec("cranedyn.interop.gymnasium:cranedyn/Crane-v0", num_envs=4096)``

``cranedyn/TowerCrane-v0`` is the same task with the observations and the distance to the goal of
`cranedyn.interop.tower_task`, for a tower crane of five joints.

What is observed, commanded and rewarded is in `cranedyn.interop.task`. The classes here add what
Gymnasium asks for: spaces, seeds, the end of an episode and the beginning of the next one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.checks import as_array, short_repr, whole
from cranedyn.compiled.kernel import Precision
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.disturbances.wind import constant_force
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.cylinders import Pump
from cranedyn.errors import CraneError, OutOfRange, UnknownName
from cranedyn.interfaces import Setpoint, State
from cranedyn.interop.task import DT, INTEGRATOR, BaseDraw, EpisodeStart, Rules, SwingTask
from cranedyn.interop.tower_task import TowerSwingTask
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate

try:
    import gymnasium as gym
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise CraneError(
        "This bridge needs Gymnasium, which is not installed: pip install 'cranedyn[gymnasium]'."
    ) from error

ID = "cranedyn/Crane-v0"
"""Name under which Gymnasium finds the environments of any crane."""

TOWER_ID = "cranedyn/TowerCrane-v0"
"""Name under which Gymnasium finds those of the tower crane."""

STEPS = 400
"""Number of steps after which an episode is truncated, unless another is asked for."""

_FRAME_PERIOD = 0.02
"""Time between rows of a recording [s]."""

_PICTURE_MARGIN = 0.05
"""Distance of a crane from the edges of a picture, as a share of its larger side."""

_ROUND_OFF = 1e-6
"""Round-off of a time divided by the control period."""

Interval = tuple[float, float]
"""Lower and upper end of an axis."""

VectorStep = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]
"""What a step of many environments returns by the rules of Gymnasium: observations, rewards,
terminated, truncated, infos."""


class CraneVectorEnv(gym.vector.VectorEnv):
    """Many cranes at once, stepped by compiled code on all processors.

    Attributes:
        task: The cranes and their goals.
    """

    task_type: type[SwingTask] = SwingTask
    """The task; that of a subclass differs."""

    def __init__(
        self,
        num_envs: int = 1,
        *,
        crane: Crane | Sequence[Crane] | None = None,
        control_period: float = 0.1,
        dt: float = DT,
        max_episode_steps: int = STEPS,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        precision: Precision = "double",
        render_mode: None = None,
        action: str = Rules.action,
        limits: Limits | None = Rules.limits,
        reach: Sequence[float] | None = Rules.reach,
        swing: float = Rules.swing,
        swing_limit: float = Rules.swing_limit,
        wind: float = Rules.wind,
        payload_area: float = Rules.payload_area,
        converters: Converters | None = Rules.converters,
        tolerance: float = Rules.tolerance,
        efforts: Sequence[float] | None = Rules.efforts,
        pump: Pump | None = Rules.pump,
        base: BaseMotion | BaseDraw | None = Rules.base,
        base_measured: bool = Rules.base_measured,
    ) -> None:
        """Create the cranes; no episode begins before `reset`.

        Args:
            num_envs: Number of cranes.
            crane: The crane, or several of one layout, one of which is drawn for each episode, see
                `cranes_between`; None for the overhead crane of this project.
            control_period: Duration of a step [s].
            dt: Physics step [s].
            max_episode_steps: Number of steps after which an episode is truncated.
            autoreset_mode: When the next episode follows one that has ended.
            threads: Number of threads; None for one on each processor.
            precision: "double", or "single", with which cranes move to six digits in about half the
                time; not for ropes that may go slack.
            render_mode: None, since only one crane alone can be drawn.
            action: Kind of the actions, see `Rules`.
            limits: Limits of rates and accelerations of the drives; None for those of typical
                frequency converters.
            reach: Farthest goal from the start of each drive [rad or m]; None for the distance that
                it covers in 10 s.
            swing: Largest amplitude of the swing at the start [rad].
            swing_limit: Swing that ends an episode [rad].
            wind: Strongest wind [m/s].
            payload_area: Drag coefficient times area of the payload [m²].
            converters: Frequency converters with their lag, ramps, and delay, which is rounded up
                to control periods; None for drives that follow their commands exactly.
            tolerance: Distance to the goal up to which ``is_success`` is true [m].
            efforts: Efforts that actions of 1 add with action = "effort" [N m or N], see `Rules`.
            pump: Pump that the drives share, see `Rules`; None for none.
            base: What draws the motion of the base for each episode from a random generator, such
                as `cranedyn.disturbances.waves.RandomSea`, or one motion for all; None for a base
                at rest.
            base_measured: Whether the motion of the base is observed, too, see `Rules`.

        Raises:
            ModelError: If the load of a crane does not hang from driven joints.
            OutOfRange: If a number is out of range.
        """
        if render_mode is not None:
            allowed = "None for many cranes; one crane alone takes rrd"
            raise OutOfRange("render_mode", short_repr(render_mode), allowed)
        try:
            mode = AutoresetMode(autoreset_mode)
        except ValueError:
            allowed = "one of " + ", ".join(m.value for m in AutoresetMode)
            raise OutOfRange("autoreset_mode", short_repr(autoreset_mode), allowed) from None
        self.num_envs = whole("num_envs", num_envs, 1)
        self.render_mode = None
        self._mode = mode
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self._max_steps = whole("max_episode_steps", max_episode_steps, 1)
        rules = Rules(
            action=action,
            limits=limits,
            reach=reach,
            swing=swing,
            swing_limit=swing_limit,
            wind=wind,
            payload_area=payload_area,
            converters=converters,
            tolerance=tolerance,
            efforts=efforts,
            pump=pump,
            base=base,
            base_measured=base_measured,
        )
        cranes = self.task_type.default_crane() if crane is None else crane
        self.task = self.task_type(
            cranes, self.num_envs, rules, control_period, dt, threads, precision
        )
        self.single_observation_space, self.single_action_space = _spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        # Steps of each episode so far, and whether it has ended, or has not begun yet.
        self._steps = np.zeros(self.num_envs, dtype=np.int64)
        self._ended = np.ones(self.num_envs, dtype=bool)
        self._was_reset = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes, and return observations and infos, see `step`.

        Args:
            seed: Seed of the random numbers of all cranes; None goes on with the last ones.
            options: What is not drawn at random: ``start``, a `State` of the crane, and ``goal``,
                the positions of the drives [rad or m], the same for all cranes;
                and ``reset_mask``, whether each crane begins an episode, shape (num_envs,), by
                default all.

        Raises:
            UnknownName: If there is no such option.
            OutOfRange: If the seed or an option is not valid.
        """
        whole_seed = _check_seed(seed)
        checked = _check_options(options, "start", "goal", "reset_mask")
        all_cranes = np.ones(self.num_envs, dtype=bool)
        mask = np.asarray(checked.get("reset_mask", all_cranes))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise OutOfRange("reset_mask", short_repr(mask), f"{self.num_envs} of True or False")
        initial = self.task.check_reset(checked.get("start"), checked.get("goal"))
        super().reset(seed=whole_seed)
        self._begin(mask, initial)
        self._was_reset = True
        return self.task.observe(), self._infos(mask)

    def step(self, actions: np.ndarray) -> VectorStep:
        """Apply actions for a control period.

        Args:
            actions: Actions from -1 to 1, shape (num_envs, drives).

        Returns:
            Observations, rewards, whether each episode is terminated, whether it is truncated, and
            infos with the ``distance`` of each crane to its goal [m], and ``is_success``, whether
            that is within the tolerance.

        Raises:
            OutOfRange: If an action is no number from -1 to 1, or an episode has not begun.
        """
        begins_by_itself = self._was_reset and self._mode is AutoresetMode.NEXT_STEP
        if self._ended.any() and not begins_by_itself:
            raise OutOfRange(
                "crane", int(np.argmax(self._ended)), "one whose episode has begun: call reset"
            )
        checked = as_array("actions", actions, (self.num_envs, self.task.layout.m))
        result = self.task.act(checked.T)
        observations = result.observations
        reward = result.reward
        terminated = result.terminated
        self._steps += 1
        truncated = ~terminated & (self._steps >= self._max_steps)
        if self._mode is AutoresetMode.NEXT_STEP and self._ended.any():
            # The step after the end of an episode begins the next one, whatever the action was.
            begun = self._ended.copy()
            self._begin(begun)
            reward[begun] = 0.0
            terminated[begun] = False
            truncated[begun] = False
            observations[begun] = self.task.observe(begun)
        infos = self._infos()
        self._ended = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            # The step that ends an episode begins the next one: observations and infos are those
            # of its beginning, and those of the end come beside.
            ended = self._ended.copy()
            final_observations = observations.copy()
            self._begin(ended)
            observations[ended] = self.task.observe(ended)
            infos = {
                **self._infos(),
                "final_info": infos,
                "_final_info": ended,
                "final_obs": final_observations,
                "_final_obs": ended,
            }
        return observations, reward, terminated, truncated, infos

    def _infos(self, mask: np.ndarray | None = None) -> dict[str, Any]:
        """Return infos of all cranes as they are now; of those of a mask if there is one, shape
        (num_envs,).
        """
        applies = np.ones(self.num_envs, dtype=bool) if mask is None else mask
        # Gymnasium marks in an entry with "_" to which environments another one applies.
        return {
            "distance": self.task.goal_distance,
            "_distance": applies.copy(),
            "is_success": self.task.is_solved,
            "_is_success": applies.copy(),
        }

    def _begin(self, mask: np.ndarray, initial: EpisodeStart | None = None) -> None:
        """Begin episodes of the cranes of a mask, shape (num_envs,)."""
        self.task.begin(self.np_random, np.flatnonzero(mask), initial)
        self._steps[mask] = 0
        self._ended[mask] = False


class CraneEnv(gym.Env):
    """One crane with the same task.

    Attributes:
        task: The crane and its goal.
    """

    task_type: type[SwingTask] = SwingTask
    """The task; that of a subclass differs."""

    metadata = {"render_modes": ["rrd", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        *,
        crane: Crane | Sequence[Crane] | None = None,
        control_period: float = 0.1,
        dt: float = DT,
        render_mode: str | None = None,
        folder: str | Path = "out/episodes",
        action: str = Rules.action,
        limits: Limits | None = Rules.limits,
        reach: Sequence[float] | None = Rules.reach,
        swing: float = Rules.swing,
        swing_limit: float = Rules.swing_limit,
        wind: float = Rules.wind,
        payload_area: float = Rules.payload_area,
        converters: Converters | None = Rules.converters,
        tolerance: float = Rules.tolerance,
        efforts: Sequence[float] | None = Rules.efforts,
        pump: Pump | None = Rules.pump,
        base: BaseMotion | BaseDraw | None = Rules.base,
        base_measured: bool = Rules.base_measured,
    ) -> None:
        """Create the crane; an episode begins with `reset`.

        Args:
            crane: As for `CraneVectorEnv`.
            control_period: Duration of a step [s].
            dt: Physics step [s].
            render_mode: What `render` does: with None nothing, with "rrd" it writes the episode so
                far as a recording, with "rgb_array" it returns a picture from the side, shape
                (height, width, 3).
            folder: Folder of the recordings.
            action: Kind of the actions, see `Rules`.
            limits: Limits of rates and accelerations of the drives; None for those of typical
                frequency converters.
            reach: Farthest goal from the start of each drive [rad or m]; None for the distance that
                it covers in 10 s.
            swing: Largest amplitude of the swing at the start [rad].
            swing_limit: Swing that ends an episode [rad].
            wind: Strongest wind [m/s].
            payload_area: Drag coefficient times area of the payload [m²].
            converters: Frequency converters with their lag, ramps, and delay, which is rounded up
                to control periods; None for drives that follow their commands exactly.
            tolerance: Distance to the goal up to which ``is_success`` is true [m].
            efforts: Efforts that actions of 1 add with action = "effort" [N m or N], see `Rules`.
            pump: Pump that the drives share, see `Rules`; None for none.
            base: What draws the motion of the base for each episode from a random generator, such
                as `cranedyn.disturbances.waves.RandomSea`, or one motion for all; None for a base
                at rest.
            base_measured: Whether the motion of the base is observed, too, see `Rules`.

        Raises:
            ModelError: If the load of a crane does not hang from driven joints.
            OutOfRange: If a number is out of range.
        """
        if render_mode not in (None, "rrd", "rgb_array"):
            raise OutOfRange("render_mode", short_repr(render_mode), "None, rrd or rgb_array")
        self._folder = Path(folder)
        self.render_mode = render_mode
        self._dt = dt
        rules = Rules(
            action=action,
            limits=limits,
            reach=reach,
            swing=swing,
            swing_limit=swing_limit,
            wind=wind,
            payload_area=payload_area,
            converters=converters,
            tolerance=tolerance,
            efforts=efforts,
            pump=pump,
            base=base,
            base_measured=base_measured,
        )
        cranes = self.task_type.default_crane() if crane is None else crane
        self.task = self.task_type(cranes, 1, rules, control_period, dt, threads=1)
        self.observation_space, self.action_space = _spaces(self.task)
        # A picture after each step: a film of this rate shows the crane in real time.
        rate = 1.0 / self.task.fleet.control_period
        self.metadata = {**self.metadata, "render_fps": rate}
        self._episode = 0
        self._start = self.task.fleet.cranes[0].start
        # Commands of the drives in each step of the episode, shape (m,) each.
        self._commands = list[np.ndarray]()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode, and return its first observation and info.

        Args:
            seed: Seed of the random numbers; None goes on with the last ones.
            options: What is not drawn at random: ``start``, a `State` of the crane, and ``goal``,
                the positions of the drives [rad or m].

        Raises:
            UnknownName: If there is no such option.
            OutOfRange: If the seed or an option is not valid.
        """
        whole_seed = _check_seed(seed)
        checked = _check_options(options, "start", "goal")
        initial = self.task.check_reset(checked.get("start"), checked.get("goal"))
        super().reset(seed=whole_seed)
        only_crane = np.array([0])
        self.task.begin(self.np_random, only_crane, initial)
        self._start = self._state()
        self._episode += 1
        self._commands = []
        return self.task.observe()[0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply an action for a control period.

        Args:
            action: Action from -1 to 1, shape (drives,).

        Returns:
            Observation, reward, whether the episode is terminated, whether it is truncated, and an
            info with the ``distance`` of the crane to its goal [m], and ``is_success``, whether
            that is within the tolerance.

        Raises:
            OutOfRange: If the action is not a number from -1 to 1 for each drive, or no episode has
                begun.
        """
        if not self._episode:
            raise OutOfRange("episode", "none", "one that has begun: call reset")
        checked = as_array("action", action, (self.task.layout.m,))
        task = self.task
        commands = task.commands(checked[:, None], task.fleet.z, task.crane_index)[:, 0]
        result = self.task.act(checked[:, None])
        self._commands.append(commands)
        reward = float(result.reward[0])
        terminated = bool(result.terminated[0])
        # The wrapper that `register` asks Gymnasium for truncates episodes.
        truncated = False
        return result.observations[0], reward, terminated, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        """Return the info of the crane as it is now."""
        return {
            "distance": float(self.task.goal_distance[0]),
            "is_success": bool(self.task.is_solved[0]),
        }

    def _state(self) -> State:
        """Return a copy of the state of the crane."""
        q, v = self.task.fleet.z[:, 0].reshape(2, -1).copy()
        return State(q, v)

    def render(self) -> str | np.ndarray | None:
        """Draw what the `render_mode` says: the crane as it is now, or the episode so far.

        Returns:
            With "rgb_array" a picture, shape (height, width, 3); with "rrd" the file of a recording
            for the Rerun viewer, None before the first step.

        Raises:
            DataError: If it cannot be written.
            CraneError: If the environment was made without a `render_mode`.
        """
        if self.render_mode is None:
            raise CraneError(
                "Nothing is drawn by this environment: make it with render_mode = rrd or rgb_array."
            )
        if self.render_mode == "rgb_array":
            return self._picture()
        if not self._commands:
            return None
        from cranedyn.recording import Run, record

        self._folder.mkdir(parents=True, exist_ok=True)
        title = f"Episode {self._episode}"
        run = Run("learned", self.task.crane_of(0), self._simulated())
        return str(record(self._folder / f"episode_{self._episode:04}.rrd", [run], title=title))

    def _picture(self) -> np.ndarray:
        """Return a picture of the crane now from the side, shape (height, width, 3)."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from cranedyn.recording.sketch import sketch

        crane = self.task.crane_of(0)
        figure = sketch(crane, self._state())
        # All pictures have one scale, so that they can be shown one after the other.
        across, up = self._picture_limits(crane)
        figure.axes[0].set(xlim=across, ylim=up)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return np.array(canvas.buffer_rgba())[..., :3]

    def _picture_limits(self, crane: Crane) -> tuple[Interval, Interval]:
        """Return the ends of both axes of a picture [m]: the crane is seen wherever its drives move
        in the episodes.
        """
        from cranedyn.recording.sketch import Projection

        projection = Projection(crane)
        points = []
        for q in (crane.start.q, *self.task.farthest_coordinates(0).T):
            points += [outline.corners for outline in projection.outlines(q)]
            points.append(projection.rope(q))
        seen = np.concatenate(points)
        margin = _PICTURE_MARGIN * np.ptp(seen, axis=0).max()
        low = (seen.min(axis=0) - margin).tolist()
        high = (seen.max(axis=0) + margin).tolist()
        return (low[0], high[0]), (low[1], high[1])

    def _simulated(self) -> Any:
        """Return the episode up to now as a trajectory.

        `simulate` repeats it with the commands of each step: its rows are closer than the
        steps, and it also computes efforts and energies.
        """
        period = self.task.fleet.control_period
        commands = self._commands
        position = self.task.goal[:, 0].copy()
        goal = Setpoint(position, np.zeros_like(position), np.zeros_like(position))

        def repeat(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
            step = int(t / period + _ROUND_OFF)
            return commands[min(step, len(commands) - 1)]

        # Rows are a frame apart where a control period is a whole number of frames, and a frame a
        # whole number of physics steps; otherwise a control period. The delay of converters is
        # rounded up to control periods, so that theirs must be that of the episode.
        ratios = np.array([period / _FRAME_PERIOD, _FRAME_PERIOD / self._dt])
        frames_fit = (np.abs(ratios - np.round(ratios)) < 1e-9).all()
        frames_fit &= self.task.rules.converters is None
        crane = self.task.crane_of(0)
        force = self.task.force_on(0)
        base = self.task.base_of(0)
        # From one control instant to the next, a force turns with the base.
        frames_fit &= base is None or not any(force)
        return simulate(
            crane,
            repeat,
            lambda t: goal,
            start=self._start,
            duration=len(commands) * period,
            dt=self._dt,
            control_period=_FRAME_PERIOD if frames_fit else period,
            drive=self.task.drive,
            integrator=INTEGRATOR,
            disturbance=constant_force(crane, payload=force) if any(force) else None,
            validity="mark",
            engine="compiled",
            base=base,
        )


def _spaces(task: SwingTask) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Return the spaces of observations and actions."""
    low, high = task.bounds()
    actions = gym.spaces.Box(-1.0, 1.0, (task.layout.m,), np.float32)
    return gym.spaces.Box(low, high, dtype=np.float32), actions


def _check_seed(seed: object) -> int | None:
    """Return a seed as an integer, or None.

    Raises:
        OutOfRange: If it is no whole number, such as a list with a seed for each crane.
    """
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise OutOfRange("seed", short_repr(seed), "None or one whole number >= 0 for all cranes")
    return int(seed)


def _check_options(options: Any, *names: str) -> dict[str, Any]:
    """Return a copy of the options of `reset`, which may have these names; None has none.

    Raises:
        OutOfRange: If they are no dictionary.
        UnknownName: If there is an option of another name.
    """
    if not isinstance(options, Mapping | None):
        raise OutOfRange("options", short_repr(options), "a dictionary or None")
    for name in options or {}:
        if name not in names:
            raise UnknownName("option of reset", str(name), names)
    return dict(options or {})


class TowerCraneVectorEnv(CraneVectorEnv):
    """Many tower cranes at once, see `cranedyn.interop.tower_task`; the arguments are those of
    `CraneVectorEnv`, with the tower crane of this project by default.
    """

    task_type = TowerSwingTask


class TowerCraneEnv(CraneEnv):
    """One tower crane, see `cranedyn.interop.tower_task`; the arguments are those of `CraneEnv`,
    with the tower crane of this project by default.
    """

    task_type = TowerSwingTask

    def _picture_limits(self, crane: Crane) -> tuple[Interval, Interval]:
        """Return the ends of both axes of a picture [m]: those of the start, where the jib is seen
        in its whole length, as wide on the other side.
        """
        from cranedyn.recording.sketch import sketch

        side = sketch(crane).axes[0]
        reach = max(abs(end) for end in side.get_xlim())
        return (-reach, reach), side.get_ylim()


def register() -> None:
    """Register the environments with Gymnasium; importing this module does so."""
    module = "cranedyn.interop.gymnasium"
    for name, one, many in (
        (ID, "CraneEnv", "CraneVectorEnv"),
        (TOWER_ID, "TowerCraneEnv", "TowerCraneVectorEnv"),
    ):
        if name not in gym.registry:
            gym.register(
                name,
                f"{module}:{one}",
                max_episode_steps=STEPS,
                vector_entry_point=f"{module}:{many}",
            )


register()
