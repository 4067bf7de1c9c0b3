"""Prescribed motion of the base on which a crane stands: a ship, a barge, a floating dock, a truck.

The base has a frame that coincides with the world while the base is at rest: the frame of the root
of the crane's URDF. Six coordinates say where it is:

* surge, sway and heave [m]: displacement of its origin along the axes X, Y and Z of the world;
* roll, pitch and yaw [rad]: its attitude. It is R = Rz(yaw) Ry(pitch) Rx(roll), which turns vectors
  of the base into the world: rotations about the axes X, Y and Z of the world, which stay where
  they are, in this order; or about those of the base in the reverse order. Each is positive in the
  right-handed sense, as are the angles rpy of URDF.

`cranedyn.simulation.simulate.simulate` takes a motion as `base=`. It needs accelerations, so that a
motion is known with its first two derivatives by time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cranedyn.checks import ShortRepr, finite, number
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName, format_error

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


COORDINATES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
"""Coordinates of a base, in the order of all arrays."""

UNITS = ("m", "m", "m", "rad", "rad", "rad")
"""Unit of each of them."""

MAX_PITCH = 1.5
"""Largest pitch [rad]; at π/2 roll and yaw turn about the same axis, so that neither is determined.
"""

_LEAST_ROWS = 6
"""Rows that a table needs for a spline of degree five."""

_SPLINE_DEGREE = 5
"""Degree of the spline through a table: its second derivative is twice differentiable."""

_TIME_TOLERANCE = 1e-9
"""Round-off of a time at the ends of a table [s]."""

_MAX_OFFSETS = 32
"""Most times from one sine to the next that is computed as such, see `sums_of_sines`: more of them
would save little, and add to the round-off."""

_STARTS_TOGETHER = 256
"""Starts whose sines are summed together, so that their numbers stay in a processor's cache."""


class BaseCoordinates(NamedTuple):
    """Coordinates of a base at k times, in the order of `COORDINATES`.

    Attributes:
        position: Coordinates [m and rad], shape (k, 6).
        velocity: Their rates, shape (k, 6).
        acceleration: Their accelerations, shape (k, 6).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    def seen_at(self, point: np.ndarray) -> BaseCoordinates:
        """Return the coordinates of a point of the base, see `BaseMotion.seen_at`.

        Args:
            point: Place of the point in the frame of the base [m], shape (3,).
        """
        frames = frames_of(self)
        # In the axes of the base: velocity and acceleration of the point beyond the origin's.
        turning = _cross(frames.omega, point)
        accelerating = _cross(frames.alpha, point) + _cross(frames.omega, turning)
        position = self.position.copy()
        velocity = self.velocity.copy()
        acceleration = self.acceleration.copy()
        position[:, :3] += frames.rotation @ point - point
        velocity[:, :3] += np.einsum("kij,kj->ki", frames.rotation, turning)
        acceleration[:, :3] += np.einsum("kij,kj->ki", frames.rotation, accelerating)
        return BaseCoordinates(position, velocity, acceleration)


class BaseFrames(NamedTuple):
    """Frame of a base at k times.

    Attributes:
        rotation: Attitude, from the axes of the base to those of the world, shape (k, 3, 3).
        origin: Displacement of the origin in the world [m], shape (k, 3).
        velocity: Its velocity in the world [m/s], shape (k, 3).
        acceleration: Its acceleration in the world [m/s²], shape (k, 3).
        omega: Angular velocity in the axes of the base [rad/s], shape (k, 3).
        alpha: Angular acceleration in the axes of the base [rad/s²], shape (k, 3).
    """

    rotation: np.ndarray
    origin: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    omega: np.ndarray
    alpha: np.ndarray

    def points_in_world(self, points: np.ndarray) -> np.ndarray:
        """Return points on the base in the world [m], shape (k, points, 3).

        Args:
            points: The points in the frame of the base at each time [m], shape (k, points, 3).
        """
        return np.einsum("kij,kpj->kpi", self.rotation, points) + self.origin[:, None]

    def root_numbers(self, gravity: np.ndarray) -> np.ndarray:
        """Return what a crane on the base feels, shape (k, 9), in the order of
        `cranedyn.dynamics.root_motion.RootMotion`.

        Args:
            gravity: Gravity in the world [m/s²], shape (3,).
        """
        felt = np.einsum("kij,ki->kj", self.rotation, self.acceleration - gravity)
        return np.hstack([self.omega, self.alpha, felt])


@dataclass(frozen=True, eq=False, repr=False)
class BaseMotion(ShortRepr):
    """Motion of a base over time, see the module for its coordinates and their signs.

    Make one by `from_table`, `from_file` or `sines`, with a function of your own, or by
    `cranedyn.disturbances.waves.motion_in_waves`.

    Attributes:
        law: From times [s], shape (k,), to the coordinates with rates and accelerations, a
            `BaseCoordinates` or three arrays of shape (k, 6). It must be able to take all times
            from `first` to `last`.
        first: Earliest time for which the motion is known [s].
        last: Latest time for which it is known [s].
        source: Where it comes from, in words, for the record of a run.
    """

    law: Callable[[np.ndarray], BaseCoordinates]
    first: float = -math.inf
    last: float = math.inf
    source: str = "a function"

    @classmethod
    def from_table(
        cls, t: Sequence[float] | np.ndarray, **columns: Sequence[float] | np.ndarray
    ) -> BaseMotion:
        """Return the motion on the spline of degree five through a table.

        The spline is four times differentiable, so that accelerations are smooth; its ends take no
        condition beyond the rows ("not a knot"). Times outside of the table are refused.

        Args:
            t: Times [s], increasing, six rows or more.
            columns: Coordinates at these times by their names [m or rad], for example
                ``heave=[...]``; those that are left out stay zero.

        Raises:
            UnknownName: If there is no coordinate of a name.
            Misshapen: If an array has another length than the times.
            OutOfRange: If a number is not finite, times do not increase, or there are too few rows.
        """
        return _from_columns(t, columns, f"a table of {len(t)} rows")

    @classmethod
    def from_file(cls, path: str | Path) -> BaseMotion:
        """Return the motion of a table in a ``.csv`` or ``.parquet`` file, see `from_table`.

        The column ``t_s`` has the times. Those of the coordinates are ``surge_m``, ``sway_m``,
        ``heave_m``, ``roll_rad`` or ``roll_deg``, and so on, or, as in the record of a run,
        ``base_heave_m`` and so on. Coordinates without a column stay zero.

        Raises:
            DataError: If the file cannot be read, has no column of a coordinate, or two of one.
            OutOfRange: As `from_table`.
        """
        from cranedyn.data.tables import column_names
        from cranedyn.data.trajectory import read_columns

        found = _columns_of_coordinates(column_names(path), path)
        values = read_columns(path, ["t_s", *(name for name, _ in found.values())])
        columns = {name: values[column] * scale for name, (column, scale) in found.items()}
        return _from_columns(values["t_s"], columns, f"the file {Path(path).name}")

    @classmethod
    def sines(cls, **waves: Sequence[float]) -> BaseMotion:
        """Return harmonic motions: amplitude · sin(2π t/period + phase).

        Args:
            waves: Amplitude [m or rad], period [s] and, if it is not zero, phase [rad] of each
                coordinate by its name, for example ``heave=(1.0, 8.0), roll=(0.03, 10.0, 1.6)``.

        Raises:
            UnknownName: If there is no coordinate of a name.
            OutOfRange: If a period is not positive, or a number is not finite.
        """
        amplitude = np.zeros((1, len(COORDINATES)))
        frequency = np.ones((1, len(COORDINATES)))
        phase = np.zeros((1, len(COORDINATES)))
        for name, values in waves.items():
            column = coordinate_index(name)
            try:
                given = [*values, 0.0] if len(values) == 2 else [*values]
                given_amplitude, period, given_phase = given
            except (TypeError, ValueError):
                allowed = "an amplitude, a period and, if you like, a phase"
                raise OutOfRange(f"{name} of the base", values, allowed) from None
            unit = UNITS[column]
            amplitude[0, column] = number(f"amplitude of {name}", given_amplitude, unit)
            frequency[0, column] = 2.0 * math.pi / number(f"period of {name}", period, "s", "> 0")
            phase[0, column] = number(f"phase of {name}", given_phase, "rad")
        return cls(Harmonics(amplitude, frequency, phase), source=f"sines of {', '.join(waves)}")

    def at(self, times: np.ndarray) -> BaseCoordinates:
        """Return the coordinates with rates and accelerations at times [s], shape (k,).

        Raises:
            OutOfRange: If a time is not one for which the motion is known, a number is not finite,
                or the pitch is beyond `MAX_PITCH`.
            Misshapen: If the function returns arrays of another shape.
            CraneError: If the function raises an error, which is then its cause.
        """
        times = np.asarray(times, dtype=float)
        self._check_covers(times)
        inside = np.clip(times, self.first, self.last)
        try:
            answer = self.law(inside)
            position, velocity, acceleration = answer
        except CraneError:
            raise
        except Exception as error:
            message = f"The function of the base failed: {format_error(error)}"
            raise CraneError(message) from error
        return checked_coordinates(position, velocity, acceleration, len(times))

    def _check_covers(self, times: np.ndarray) -> None:
        """Check that the motion is known at times [s].

        Raises:
            OutOfRange: If it is not.
        """
        if not len(times):
            return
        for t in (float(times.min()), float(times.max())):
            if not self.first - _TIME_TOLERANCE <= t <= self.last + _TIME_TOLERANCE:
                allowed = f"{self.first:g} to {self.last:g}, for which {self.source} is given"
                raise OutOfRange("time at which the base is needed", t, allowed, "s")

    def frames(self, times: np.ndarray) -> BaseFrames:
        """Return the frames of the base at times [s], shape (k,).

        Raises:
            OutOfRange: As `at`.
        """
        return frames_of(self.at(times))

    def frames_at(self, t: float) -> BaseFrames:
        """Return the frames of the base at one time [s], k = 1, read-only.

        Wind and engine ask for the same control instant one after the other, so the last answer is
        kept.

        Raises:
            OutOfRange: As `at`.
        """
        return _frames_at(self, t)

    def world_velocities(self, t: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the velocities of points in the world [m/s], shape (points, 3), at a time [s].

        Args:
            t: The time.
            position: Positions of the points in the frame of the base [m], shape (points, 3).
            velocity: Their velocities relative to the base, in its axes [m/s], shape (points, 3).
        """
        frames = self.frames_at(t)
        in_base_axes = velocity + _cross(frames.omega[0], position)
        return frames.velocity[0] + in_base_axes @ frames.rotation[0].T

    def shifted(self, by: float) -> BaseMotion:
        """Return the motion that is now what this one is later.

        So a run that begins at zero, or an episode of a learning environment, begins somewhere
        within a record.

        Args:
            by: Time by which it is later [s].

        Raises:
            OutOfRange: If it is not finite.
        """
        later = number("time by which the base is shifted", by, "s")
        source = f"{self.source}, from {later:g} s on"
        if isinstance(self.law, Harmonics):
            law = self.law
            turned = Harmonics(law.amplitude, law.frequency, law.phase + later * law.frequency)
            return BaseMotion(turned, self.first - later, self.last - later, source)

        def moved(times: np.ndarray) -> BaseCoordinates:
            return self.at(times + later)

        return BaseMotion(moved, self.first - later, self.last - later, source)

    def seen_at(self, point: Sequence[float]) -> BaseMotion:
        """Return the motion of a crane that stands elsewhere on the base.

        A ship's motion is most often given for its centre of gravity, and the crane stands on the
        deck. The origin of the crane then moves by r + (R - 1) p, with the displacement r and the
        attitude R of the ship; its attitude is that of the ship.

        Args:
            point: Place p of the crane's origin in the frame of the ship [m], shape (3,).

        Raises:
            OutOfRange: If a number is not finite.
        """
        lever = finite("place of the crane on the base", point, (3,), unit="m")

        def moved(times: np.ndarray) -> BaseCoordinates:
            return self.at(times).seen_at(lever)

        return BaseMotion(moved, self.first, self.last, f"{self.source}, seen at {lever.tolist()}")


@lru_cache(maxsize=1)
def _frames_at(motion: BaseMotion, t: float) -> BaseFrames:
    """Return the frames of a base at one time, see `BaseMotion.frames_at`."""
    frames = motion.frames(np.array([t]))
    for numbers in frames:
        numbers.flags.writeable = False
    return frames


def _cross(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors, shape (..., 3): the same numbers as `np.cross`, which
    takes several times as long for the single instants of a run.
    """
    left_x = left[..., 0]
    left_y = left[..., 1]
    left_z = left[..., 2]
    right_x = right[..., 0]
    right_y = right[..., 1]
    right_z = right[..., 2]
    product = np.empty(np.broadcast_shapes(left.shape, right.shape))
    product[..., 0] = left_y * right_z - left_z * right_y
    product[..., 1] = left_z * right_x - left_x * right_z
    product[..., 2] = left_x * right_y - left_y * right_x
    return product


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Sums of k sines for each coordinate: Σ amplitude · sin(frequency · t + phase).

    Attributes:
        amplitude: Amplitudes [m or rad], shape (k, 6).
        frequency: Angular frequencies [rad/s], shape (k, 6).
        phase: Phases [rad], shape (k, 6).
    """

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def __call__(self, times: np.ndarray) -> BaseCoordinates:
        """Return the coordinates with rates and accelerations at times [s], shape (k,).

        Times that are equally spaced, as those of a run, are the sums of a start and an offset, so
        that far fewer sines are computed than there are times, see `sums_of_sines`.
        """
        starts, offsets = _starts_and_offsets(times)
        found = sums_of_sines([self], starts, offsets)
        in_order = found.reshape(len(found), -1, len(COORDINATES))
        return BaseCoordinates(*in_order[:, : len(times)])


def _starts_and_offsets(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return starts and equally spaced offsets, the first 0, of which times [s] are the sums, each
    start with all offsets, in this order; with the last start some sums may be beyond the last
    time.

    Times that are not equally spaced, but for round-off, are starts with the only offset 0.
    """
    block = min(math.isqrt(len(times)), _MAX_OFFSETS)
    if block > 1:
        starts = times[::block]
        # The mean, since a difference of two times has the round-off of their size, and each
        # further offset would have it once more.
        spacing = (times[-1] - times[0]) / (len(times) - 1)
        offsets = spacing * np.arange(block)
        sums = np.add.outer(starts, offsets).ravel()[: len(times)]
        round_off = 4.0 * np.finfo(float).eps * np.abs(times[[0, -1]]).max()
        if np.abs(sums - times).max() <= round_off:
            return starts, offsets
    return times, np.zeros(1)


def sums_of_sines(laws: Sequence[Harmonics], starts: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return coordinates, rates and accelerations on sums of as many sines each, shape (3, starts,
    offsets, 6).

    A sine is the imaginary part of a exp(i (ω t + ε)). From one offset to the next it turns by the
    constant factor exp(i ω δ), which is far cheaper than its sine. The round-off of these products
    grows with the number of offsets, some dozens.

    Args:
        laws: The sums: one for all starts, or one for each.
        starts: Times at the first offset [s], shape (starts,).
        offsets: Times from there on [s], equally spaced, the first 0.
    """
    coordinates = np.zeros((3, len(starts), len(offsets), len(COORDINATES)))
    for first in range(0, len(starts), _STARTS_TOGETHER):
        some = slice(first, first + _STARTS_TOGETHER)
        of_some = laws if len(laws) == 1 else laws[some]
        coordinates[:, some] = _sums_together(of_some, starts[some], offsets)
    return coordinates


def _sums_together(
    laws: Sequence[Harmonics], starts: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """Return the sums of `sums_of_sines` for all starts at once."""
    amplitude = np.array([law.amplitude.T for law in laws])
    # Coordinates that no base moves along cost nothing.
    moving = np.flatnonzero((amplitude != 0.0).any(axis=(0, 2)))
    amplitude = amplitude[:, moving]
    frequency = np.array([law.frequency.T[moving] for law in laws])
    phase = np.array([law.phase.T[moving] for law in laws])
    squared = frequency**2
    angle = frequency * starts[:, None, None] + phase
    real = amplitude * np.cos(angle)
    imaginary = amplitude * np.sin(angle)
    spacing = offsets[1] if len(offsets) > 1 else 0.0
    cosine = np.cos(frequency * spacing)
    sine = np.sin(frequency * spacing)
    coordinates = np.zeros((3, len(starts), len(offsets), len(COORDINATES)))
    for row in range(len(offsets)):
        coordinates[0][:, row, moving] = imaginary.sum(axis=2)
        coordinates[1][:, row, moving] = np.einsum("lck,lck->lc", real, frequency)
        coordinates[2][:, row, moving] = -np.einsum("lck,lck->lc", imaginary, squared)
        turned = real * cosine - imaginary * sine
        imaginary = real * sine + imaginary * cosine
        real = turned
    return coordinates


@dataclass(frozen=True, eq=False)
class MotionSpline:
    """Coordinates on splines of degree five through a table.

    Attributes:
        t: Times of the table [s], shape (rows,).
        values: Coordinates at these times [m or rad], shape (rows, 6).
    """

    t: np.ndarray
    values: np.ndarray

    def __call__(self, times: np.ndarray) -> BaseCoordinates:
        """Return the coordinates with rates and accelerations at times [s], shape (k,)."""
        position, velocity, acceleration = self._splines
        return BaseCoordinates(position(times), velocity(times), acceleration(times))

    @cached_property
    def _splines(self) -> tuple[BSpline, BSpline, BSpline]:
        """The spline and its first two derivatives."""
        # SciPy's splines take a while to import, and few runs need them.
        from scipy.interpolate import make_interp_spline

        position = make_interp_spline(self.t, self.values, k=_SPLINE_DEGREE)
        return position, position.derivative(1), position.derivative(2)


def checked_coordinates(
    position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray, count: int
) -> BaseCoordinates:
    """Return coordinates, rates and accelerations of bases at so many times, after checking them.

    Raises:
        OutOfRange: If a number is not finite, or the pitch is beyond `MAX_PITCH`.
        Misshapen: If an array has another shape than (count, 6).
    """
    shape = (count, len(COORDINATES))
    coordinates = BaseCoordinates(
        finite("coordinates of the base", position, shape),
        finite("rates of the base", velocity, shape),
        finite("accelerations of the base", acceleration, shape),
    )
    largest = float(np.abs(coordinates.position[:, 4]).max(initial=0.0))
    if largest > MAX_PITCH:
        raise OutOfRange("pitch of the base", largest, f"-{MAX_PITCH} to {MAX_PITCH}", "rad")
    return coordinates


def frames_of(coordinates: BaseCoordinates) -> BaseFrames:
    """Return the frames of a base at its coordinates."""
    position, velocity, acceleration = coordinates
    angles = position[:, 3:].T
    sines = np.sin(angles)
    cosines = np.cos(angles)
    omega, alpha = angular_motion(sines, cosines, velocity[:, 3:].T, acceleration[:, 3:].T)
    return BaseFrames(
        rotation=np.array(attitude(sines, cosines)).transpose(2, 0, 1),
        origin=position[:, :3],
        velocity=velocity[:, :3],
        acceleration=acceleration[:, :3],
        omega=np.stack(omega, axis=1),
        alpha=np.stack(alpha, axis=1),
    )


def rotations(angles: np.ndarray) -> np.ndarray:
    """Return the attitudes Rz(yaw) Ry(pitch) Rx(roll), shape (k, 3, 3), of roll, pitch and yaw
    [rad], shape (k, 3).
    """
    return np.array(attitude(np.sin(angles).T, np.cos(angles).T)).transpose(2, 0, 1)


def attitude(sines: Any, cosines: Any) -> list[list[Any]]:
    """Return the rows of the attitude Rz(yaw) Ry(pitch) Rx(roll), of any kind of number.

    Args:
        sines: Sines of roll, pitch and yaw.
        cosines: Their cosines.
    """
    sin_roll, sin_pitch, sin_yaw = sines
    cos_roll, cos_pitch, cos_yaw = cosines
    return [
        [
            cos_yaw * cos_pitch,
            cos_yaw * sin_pitch * sin_roll - sin_yaw * cos_roll,
            cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll,
        ],
        [
            sin_yaw * cos_pitch,
            sin_yaw * sin_pitch * sin_roll + cos_yaw * cos_roll,
            sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll,
        ],
        [-sin_pitch, cos_pitch * sin_roll, cos_pitch * cos_roll],
    ]


class Turning(NamedTuple):
    """How a base turns, in its axes.

    Attributes:
        omega: The three components of the angular velocity [rad/s].
        alpha: Those of the angular acceleration [rad/s²].
    """

    omega: list[Any]
    alpha: list[Any]


def angular_motion(sines: Any, cosines: Any, rates: Any, accelerations: Any) -> Turning:
    """Return angular velocity and acceleration of a base, of any kind of number.

    The angular velocity in the axes of the base, with roll φ, pitch θ and yaw ψ, is

        ω = (φ̇ - ψ̇ sin θ,  θ̇ cos φ + ψ̇ cos θ sin φ,  -θ̇ sin φ + ψ̇ cos θ cos φ),

    and α is its derivative by time, as the axes of the base turn with ω themselves.

    Args:
        sines: Sines of roll, pitch and yaw.
        cosines: Their cosines.
        rates: Rates of the three angles [rad/s].
        accelerations: Their accelerations [rad/s²].
    """
    sin_roll, sin_pitch, _ = sines
    cos_roll, cos_pitch, _ = cosines
    roll_rate, pitch_rate, yaw_rate = rates
    roll_acceleration, pitch_acceleration, yaw_acceleration = accelerations

    # Components of the rate of yaw along the axes of the base, and their derivatives.
    yaw_x = -sin_pitch
    yaw_y = cos_pitch * sin_roll
    yaw_z = cos_pitch * cos_roll
    yaw_x_rate = -cos_pitch * pitch_rate
    yaw_y_rate = -sin_pitch * sin_roll * pitch_rate + cos_pitch * cos_roll * roll_rate
    yaw_z_rate = -sin_pitch * cos_roll * pitch_rate - cos_pitch * sin_roll * roll_rate

    omega = [
        roll_rate + yaw_rate * yaw_x,
        pitch_rate * cos_roll + yaw_rate * yaw_y,
        -pitch_rate * sin_roll + yaw_rate * yaw_z,
    ]
    alpha = [
        roll_acceleration + yaw_acceleration * yaw_x + yaw_rate * yaw_x_rate,
        pitch_acceleration * cos_roll
        - pitch_rate * sin_roll * roll_rate
        + yaw_acceleration * yaw_y
        + yaw_rate * yaw_y_rate,
        -pitch_acceleration * sin_roll
        - pitch_rate * cos_roll * roll_rate
        + yaw_acceleration * yaw_z
        + yaw_rate * yaw_z_rate,
    ]
    return Turning(omega, alpha)


def coordinate_index(name: str) -> int:
    """Return the index of a coordinate by its name.

    Raises:
        UnknownName: If there is none.
    """
    if name not in COORDINATES:
        raise UnknownName("coordinate of the base", name, COORDINATES)
    return COORDINATES.index(name)


def _from_columns(
    t: Sequence[float] | np.ndarray,
    columns: Mapping[str, Sequence[float] | np.ndarray],
    source: str,
) -> BaseMotion:
    """Return the motion on the spline through a table, see `BaseMotion.from_table`."""
    times = finite("times of the base", t, ("n",), unit="s")
    if len(times) < _LEAST_ROWS:
        raise OutOfRange("number of rows of the base", len(times), f"{_LEAST_ROWS} or more")
    later = np.diff(times) > 0.0
    if not later.all():
        row = int(np.argmin(later)) + 1
        allowed = f"later than the row before, at {times[row - 1]:g} s (row {row + 1})"
        raise OutOfRange("time of the base", float(times[row]), allowed, "s")
    values = np.zeros((len(times), len(COORDINATES)))
    for name, column in columns.items():
        index = coordinate_index(name)
        values[:, index] = finite(f"{name} of the base", column, (len(times),), unit=UNITS[index])
    return BaseMotion(MotionSpline(times, values), float(times[0]), float(times[-1]), source)


def _columns_of_coordinates(names: Sequence[str], path: str | Path) -> dict[str, tuple[str, float]]:
    """Return for each coordinate in a file the column that holds it, and the factor to its unit.

    Raises:
        DataError: If there is none, or a coordinate has two columns.
    """
    found: dict[str, tuple[str, float]] = {}
    for name, unit in zip(COORDINATES, UNITS, strict=True):
        scales = {f"{name}_{unit}": 1.0, f"base_{name}_{unit}": 1.0}
        if unit == "rad":
            scales[f"{name}_deg"] = math.pi / 180.0
        column = only_column(name, list(scales), names, path)
        if column is not None:
            found[name] = (column, scales[column])
    if not found:
        raise DataError(
            f"{path} has no column of a motion of the base; it needs t_s and one of surge_m, "
            "sway_m, heave_m, roll_rad, roll_deg, pitch_rad, pitch_deg, yaw_rad, yaw_deg."
        )
    return found


def only_column(
    name: str, columns: Sequence[str], names: Sequence[str], path: str | Path
) -> str | None:
    """Return the one column of a file that holds a coordinate; None if there is none.

    Args:
        name: The coordinate.
        columns: The columns that may hold it.
        names: Columns of the file.
        path: The file, for the message.

    Raises:
        DataError: If there are two.
    """
    present = [column for column in columns if column in names]
    if len(present) > 1:
        both = " and ".join(present)
        raise DataError(f"{path} has two columns of {name}, {both}; leave one of them out.")
    return present[0] if present else None
