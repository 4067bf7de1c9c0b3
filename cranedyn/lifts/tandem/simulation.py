"""A load on two ropes, moved by the drives of two cranes: a plain loop around Pinocchio's ABA.

The drives follow their motions exactly, as with ``drive="motion"`` of
`cranedyn.simulation.simulate.simulate`. So the pivots of both ropes move as prescribed, and the
load is the only body whose motion is computed: a free body under its weight, the pulls of two
ropes and the wind. What the cranes feel of it are the forces of the ropes, which the run records.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from cranedyn.checks import finite, number
from cranedyn.clocks import clocks
from cranedyn.data.time_series import ColumnSeries
from cranedyn.errors import OutOfRange, RunError
from cranedyn.lifts.sites.crane_site import Station
from cranedyn.lifts.tandem.drives import TandemDrives
from cranedyn.lifts.tandem.load import RopeForce
from cranedyn.lifts.tandem.load_wind import LoadWind, WindOnLoad
from cranedyn.lifts.tandem.plan import TandemLift, TandemPlan

_TIME_AFTER = 10.0
"""Time that a run goes on after all drives stand [s]."""

_DIVERGED = 1e6
"""Speed of the load beyond which a run has diverged [m/s or rad/s]."""


class LoadPose(NamedTuple):
    """Where the load is.

    Attributes:
        position: Place of its centre of mass in the frame of the site [m], shape (3,).
        rotation: Rotation from its axes to those of the site.
    """

    position: np.ndarray
    rotation: Rotation


@dataclass(frozen=True, eq=False, repr=False)
class TandemRun(ColumnSeries):
    """A simulated tandem lift, one row for each period.

    Columns: `load_x_m`, `load_y_m`, `load_z_m` of the centre of mass in the frame of the site;
    `yaw_rad`, `pitch_rad`, `roll_rad`, rotations about the vertical and then about Y and X of the
    load; for each crane `NAME_tension_N`, `NAME_inclination_rad` of its rope from plumb,
    `NAME_pivot_x_m` and so on, and `NAME_DRIVE` with the unit of the drive; `energy_J`, kinetic, of
    gravity and of the stretch, `input_J`, what the cranes have put in, `wind_J`, what the wind has
    put in, and `loss_J`, what damping has dissipated; `wind_m_s`, the wind; `travel_m`, an upper
    bound of the path of any point of the load and of its lugs since the start, which tells how far
    they may have been from where they are in the rows.

    Attributes:
        t: Time [s], shape (rows,).
        values: Columns by name, shape (rows,) each.
        lift: The lift.
        start: Where the load was at the start.
        drives: How the drives moved.
        wind: The wind; None for calm air.
        parameters: Numbers of the run.
        record: What else belongs to it.
    """

    t: np.ndarray
    values: Mapping[str, np.ndarray]
    lift: TandemLift
    start: LoadPose
    drives: TandemDrives
    wind: LoadWind | None = None
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    record: Mapping[str, Any] = field(default_factory=dict)

    @property
    def principal_keys(self) -> list[str]:
        """Names of the columns that a figure shows by default: tensions and rotations."""
        tensions = [f"{name}_tension_N" for name in self.lift.names]
        return [*tensions, "roll_rad", "pitch_rad", "yaw_rad"]

    @property
    def tensions(self) -> np.ndarray:
        """Tensions of both ropes [N], shape (rows, 2)."""
        return np.stack([self[f"{name}_tension_N"] for name in self.lift.names], axis=1)

    @property
    def centres(self) -> np.ndarray:
        """Places of the centre of mass in the frame of the site [m], shape (rows, 3)."""
        return self._points("load")

    @cached_property
    def rotations(self) -> Rotation:
        """Rotations from the axes of the load to those of the site, one for each row."""
        angles = np.stack([self["roll_rad"], self["pitch_rad"], self["yaw_rad"]], axis=1)
        return Rotation.from_euler("xyz", angles)

    def pivots(self, crane: int) -> np.ndarray:
        """Return the places of the pivot of a crane in the frame of the site [m], shape
        (rows, 3).
        """
        return self._points(f"{self.lift.names[crane]}_pivot")

    def drive_positions(self, crane: int) -> np.ndarray:
        """Return the positions of the drives of a crane, shape (rows, m)."""
        station = self.lift.stations[crane]
        columns = [f"{joint.symbol}_{joint.unit}" for joint in station.crane.layout.driven]
        return np.stack([self[f"{station.name}_{column}"] for column in columns], axis=1)

    def rows(self, rows: slice) -> TandemRun:
        """Return some successive rows."""
        values = {name: column[rows] for name, column in self.values.items()}
        return replace(self, t=self.t[rows], values=values)

    def _points(self, name: str) -> np.ndarray:
        """Return the points whose three columns begin with a name [m], shape (rows, 3)."""
        return np.stack([self[f"{name}_{axis}_m"] for axis in "xyz"], axis=1)

    @property
    def largest_shares(self) -> np.ndarray:
        """Largest tension of each rope over the weight of the load, shape (2,)."""
        return self.tensions.max(axis=0) / (self.lift.load.mass * self.lift.gravity)

    @property
    def largest_inclination(self) -> float:
        """Largest angle of a rope from plumb [rad]."""
        columns = [self[f"{name}_inclination_rad"] for name in self.lift.names]
        return float(np.max(columns))


def simulate_tandem(
    lift: TandemLift,
    drives: TandemDrives | TandemPlan,
    *,
    start: LoadPose | None = None,
    duration: float | None = None,
    dt: float = 5e-4,
    period: float = 0.02,
    wind: LoadWind | None = None,
) -> TandemRun:
    """Simulate the load of a tandem lift.

    The step is semi-implicit Euler, as in the plain loop of one crane.

    Args:
        lift: The lift.
        drives: Motions of the drives, or the plan that has them.
        start: Where the load is at the start, at rest; None for where the plan begins. It is needed
            with motions that are no plan.
        duration: Duration [s]; None for until all drives stand, and 10 s more.
        dt: Physics step [s].
        period: Time between recorded rows [s].
        wind: Wind on the load; None for calm air without resistance.

    Raises:
        OutOfRange: If a number is out of range.
        RunError: If the load moves without bounds; it has the rows so far.
    """
    motions = drives.drives if isinstance(drives, TandemPlan) else drives
    if start is None:
        if not isinstance(drives, TandemPlan):
            raise OutOfRange("start of the load", None, "a LoadPose where there is no plan")
        start = LoadPose(drives.start, Rotation.from_euler("z", drives.yaw))
    position = finite("place of the load at the start", start.position, (3,), unit="m")
    if duration is None:
        duration = period * math.ceil((motions.end + _TIME_AFTER) / period)
    clock = clocks(number("duration", duration, "s", "> 0"), dt, period)

    # The plain loop.
    model = lift.load.model(lift.gravity)
    data = model.createData()
    q = np.concatenate([position, start.rotation.as_quat()])
    v = np.zeros(model.nv)
    ropes = _Ropes(lift, motions, dt * np.arange(clock.periods * clock.steps + 1))
    damping = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * lift.load.damping
    extent = _extent(lift)
    rows: list[_Row] = []
    energy = _EnergyFlow(0.0, 0.0, 0.0)
    travel = 0.0
    for k in range(clock.periods * clock.steps + 1):
        rotation = pin.Quaternion(q[3:]).toRotationMatrix()
        pulls = ropes.pulls(k, q[:3], rotation, v)
        if k % clock.steps == 0:
            rows.append(_Row(k, q, v, pulls, energy, travel))
            if not np.abs(v).max() < _DIVERGED:  # also where it is no number
                raise RunError(
                    f"The load of the tandem lift moves without bounds at {k * dt:.3f} s.",
                    t=k * dt,
                    trajectory=_run(lift, rows, ropes, dt, wind),
                )
        blown = None if wind is None else wind.on(lift.load, k * dt, rotation, v)
        on_load = ropes.force_on_load(rotation, pulls, blown)
        a = pin.aba(model, data, q, v, -damping * v, on_load)
        energy = _EnergyFlow(
            input=energy.input + dt * sum(pull.input for pull in pulls),
            wind=energy.wind + (0.0 if blown is None else dt * blown.power),
            loss=energy.loss + dt * (sum(pull.loss for pull in pulls) + float(v @ (damping * v))),
        )
        v = v + dt * a
        # The step moves the load with constant rates, so that no point goes farther than this.
        travel += dt * (math.hypot(*v[:3]) + extent * math.hypot(*v[3:]))
        q = pin.integrate(model, q, dt * v)
    return _run(lift, rows, ropes, dt, wind)


def _extent(lift: TandemLift) -> float:
    """Return the largest distance of a point of load or lugs from the centre of mass [m]."""
    corner = np.array(lift.load.size, dtype=float) / 2.0
    lugs = np.array(lift.load.lugs, dtype=float)
    return float(max(np.linalg.norm(corner), np.linalg.norm(lugs, axis=1).max()))


def planned_run(plan: TandemPlan) -> TandemRun:
    """Return a plan as a run whose load is where the plan has it, at the instants of the plan.

    It has the columns of places, attitudes and drives, and neither tensions nor energies. Its
    bound of the path is that of a load that moves along its line and turns at constant rates
    between two instants.
    """
    lift = plan.lift
    poses = plan.poses
    values = _load_columns(poses.centres, poses.rotations)
    for station, motion in zip(lift.stations, plan.drives, strict=True):
        position = motion.at(poses.t).position
        q, _ = station.plumb(position)
        values |= _crane_columns(station, station.rope(q).pivot, position)
    moved = np.linalg.norm(np.diff(poses.centres, axis=0), axis=1)
    turned = (poses.rotations[:-1].inv() * poses.rotations[1:]).magnitude()
    values["travel_m"] = np.concatenate([[0.0], np.cumsum(moved + _extent(lift) * turned)])
    start = LoadPose(poses.centres[0], poses.rotations[0])
    return TandemRun(poses.t, values, lift, start, plan.drives)


def _load_columns(centres: np.ndarray, rotations: Rotation) -> dict[str, np.ndarray]:
    """Return the columns of places of the centre of mass [m], shape (rows, 3), and of rotations of
    the load; `TandemRun.centres` and `TandemRun.rotations` take them back.
    """
    angles = rotations.as_euler("xyz")
    columns = {f"load_{axis}_m": centres[:, i] for i, axis in enumerate("xyz")}
    columns |= {name: angles[:, i] for i, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad"))}
    return columns


def _crane_columns(
    station: Station, pivots: np.ndarray, positions: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the columns of the pivot of a crane [m], shape (rows, 3), and of the positions of its
    drives, shape (rows, m).
    """
    columns = {f"{station.name}_pivot_{axis}_m": pivots[:, j] for j, axis in enumerate("xyz")}
    for j, joint in enumerate(station.crane.layout.driven):
        columns[f"{station.name}_{joint.symbol}_{joint.unit}"] = positions[:, j]
    return columns


class _EnergyFlow(NamedTuple):
    """Energies since the start [J].

    Attributes:
        input: What the cranes have put in.
        wind: What the wind has put in.
        loss: What damping has dissipated.
    """

    input: float
    wind: float
    loss: float


class _Row(NamedTuple):
    """State of a run at an instant that is recorded.

    Attributes:
        step: Number of physics steps so far.
        q: Place of the load and its rotation as a quaternion x, y, z, w, shape (7,).
        v: Its velocity and its angular velocity, along its axes, shape (6,).
        pulls: What both ropes do.
        energy: Energies that went in and out so far.
        travel: Upper bound of the path of any point of the load so far [m].
    """

    step: int
    q: np.ndarray
    v: np.ndarray
    pulls: list[RopeForce]
    energy: _EnergyFlow
    travel: float


class _Ropes:
    """Both ropes during a run, whose pivots and lengths the drives prescribe.

    Attributes:
        motions: Motions of the drives of both cranes.
        positions: Positions of the drives of both cranes at each physics step, shape (steps, m).
        pivots: Places of both pivots [m], shape (steps, 3).
    """

    def __init__(self, lift: TandemLift, motions: TandemDrives, t: np.ndarray) -> None:
        """Compute where pivots and winches are at the times of all physics steps [s]."""
        self.motions = motions
        self._rope = lift.rope
        self._lugs = np.array(lift.load.lugs, dtype=float)
        # Matrices of the product lug ×, which takes less time than a cross product of NumPy.
        self._lug_crosses = [pin.skew(lug) for lug in self._lugs]
        self.positions: list[np.ndarray] = []
        self.pivots: list[np.ndarray] = []
        self._pivot_velocities: list[np.ndarray] = []
        self._lengths: list[np.ndarray] = []
        self._length_rates: list[np.ndarray] = []
        for station, motion in zip(lift.stations, motions, strict=True):
            position, rate = motion.at(t)
            winch = station.crane.winch
            q, _ = station.plumb(position)
            poses = station.rope(q)
            self.positions.append(position)
            self.pivots.append(poses.pivot)
            self._pivot_velocities.append(np.einsum("kmi,km->ki", poses.motion, rate))
            self._lengths.append(position[:, winch])
            self._length_rates.append(rate[:, winch])

    def pulls(
        self, step: int, position: np.ndarray, rotation: np.ndarray, v: np.ndarray
    ) -> list[RopeForce]:
        """Return what both ropes do at a step.

        Args:
            step: The step.
            position: Place of the load [m], shape (3,).
            rotation: Rotation from the axes of the load to those of the site, shape (3, 3).
            v: Velocity and angular velocity of the load along its own axes, shape (6,).
        """
        pulls = []
        for i, (lug, cross) in enumerate(zip(self._lugs, self._lug_crosses, strict=True)):
            place = position + rotation @ lug
            velocity = rotation @ (v[:3] - cross @ v[3:])
            pulls.append(
                self._rope.force(
                    self.pivots[i][step],
                    self._pivot_velocities[i][step],
                    place,
                    velocity,
                    float(self._lengths[i][step]),
                    float(self._length_rates[i][step]),
                )
            )
        return pulls

    def force_on_load(
        self, rotation: np.ndarray, pulls: Sequence[RopeForce], blown: WindOnLoad | None
    ) -> pin.StdVec_Force:
        """Return what acts on the load as forces on the bodies of the model, along the axes of the
        load.

        Args:
            rotation: Rotation from the axes of the load to those of the site, shape (3, 3).
            pulls: What both ropes do.
            blown: What the wind does; None for calm air.
        """
        force = np.zeros(3)
        torque = np.zeros(3)
        for cross, pull in zip(self._lug_crosses, pulls, strict=True):
            local = rotation.T @ pull.force
            force += local
            torque += cross @ local
        if blown is not None:
            force += blown.force
            torque += blown.torque
        on_bodies = pin.StdVec_Force()
        on_bodies.append(pin.Force.Zero())  # on the world
        on_bodies.append(pin.Force(force, torque))
        return on_bodies


def _run(
    lift: TandemLift, rows: Sequence[_Row], ropes: _Ropes, dt: float, wind: LoadWind | None
) -> TandemRun:
    """Return the recorded rows as a run."""
    steps = np.array([row.step for row in rows])
    q = np.array([row.q for row in rows])
    values = _load_columns(q[:, :3], Rotation.from_quat(q[:, 3:]))
    for i, (name, station) in enumerate(zip(lift.names, lift.stations, strict=True)):
        pulls = [row.pulls[i] for row in rows]
        upwards = np.array([pull.direction[2] for pull in pulls])
        values[f"{name}_tension_N"] = np.array([pull.tension for pull in pulls])
        values[f"{name}_inclination_rad"] = np.arccos(np.clip(upwards, -1.0, 1.0))
        values |= _crane_columns(station, ropes.pivots[i][steps], ropes.positions[i][steps])
    values["energy_J"] = np.array([_energy(lift, row) for row in rows])
    for name in _EnergyFlow._fields:
        values[f"{name}_J"] = np.array([getattr(row.energy, name) for row in rows])
    t = dt * steps
    speeds = [0.0 if wind is None else wind.speed(time) for time in t.tolist()]
    values["wind_m_s"] = np.array(speeds)
    values["travel_m"] = np.array([row.travel for row in rows])
    parameters = {"dt_s": dt, "mass_kg": lift.load.mass, "gravity_m_s2": lift.gravity}
    start = LoadPose(rows[0].q[:3], Rotation.from_quat(rows[0].q[3:]))
    return TandemRun(t, values, lift, start, ropes.motions, wind, parameters)


def _energy(lift: TandemLift, row: _Row) -> float:
    """Return the energy of load and ropes [J]: kinetic, of gravity above the ground of the site,
    and of the stretch.
    """
    inertia = np.concatenate([np.full(3, lift.load.mass), lift.load.moments])
    kinetic = 0.5 * float(inertia @ row.v**2)
    height = float(row.q[2]) - lift.site.ground
    elastic = sum(pull.elastic_energy for pull in row.pulls)
    return kinetic + lift.load.mass * lift.gravity * height + elastic
