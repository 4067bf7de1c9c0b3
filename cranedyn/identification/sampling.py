"""Columns as they were sampled: which rows bring a fresh value, how sure it is, and a smooth curve.

A logger often writes a row whenever any sensor reports, so that a column repeats its last value
until its own sensor reports again, and two rows may follow each other within microseconds. An
encoder reports whole steps, and a potentiometer adds noise. In each case the derivative of an
interpolation through the rows is noise: steps of 10 mm at 50 Hz are accelerations of 25 m/s².
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, diags_array

_HELD_SHARE = 0.2
"""Share of rows that repeat the value before them, above which a column is sampled and held.
Repeats that follow from a coarse resolution do not count."""

_IRREGULAR_RATIO = 0.2
"""Least step of a clock over its usual step, below which its times are irregular."""

_STANDSTILL_INTERVALS = 3.0
"""Intervals without a change after which the sensor is taken to stand still, so that the repeated
value counts as a fresh one."""

_FILE_ROUND_OFF = 1e-9
"""Share of the largest value below which a difference of two values is round-off of the file."""

_ROUND_OFF = 1e-12
"""Share of the largest value below which noise is round-off of a computation."""

_GRID_TOLERANCE = 0.1
"""Largest distance of a value from a grid of values, as a share of its step. All differences of
fifty values that lie on no grid would be as near to one once in 1e35."""

_MAX_EUCLID_STEPS = 20
"""Largest number of steps of Euclid's algorithm towards the common divisor of differences."""

_SIGN_CHANGE_SHARE = 0.65
"""Share of third differences whose sign differs from that before, above which they are noise.

Successive third differences of white noise are correlated by -15/20, so that their signs differ
with the probability 1/2 + asin(3/4) / π = 0.77. Those of a smooth motion seldom do."""

_JUMP_SHARE = 0.5
"""Share of rows of an accelerating drive in which the acceleration changes, above which values on a
grid are rounded. It is three in four for rounded values, and a few at the ends of a ramp."""

_EXACT_NOISE = 1e-4
"""Noise of an acceleration [m/s² or rad/s²] below which a column counts as exact."""

_DEGREE = 5
"""Degree of the splines, so that an acceleration is smooth."""

_PENALTY_ORDER = 3
"""Order of the differences of coefficients that are penalised: those of a jerk."""

_MIN_STIFFNESS = 1e-9
"""Least weight of the penalty over that of the values. Below it a banded Cholesky factorisation
loses its last digits."""

_MAX_STIFFNESS = 1e9
"""Largest such weight, for the same reason."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Fresh values of a column.

    Attributes:
        rows: Indices of the rows with a fresh value, and of some where the sensor stands still.
        held: Share of rows that repeat the value before them while it changes.
        interval: Usual time from one fresh value to the next [s].
        resolution: Step of the grid on which the values lie; 0 where they lie on none.
        noise: Standard deviation of white noise in the values, rounding included; 0 where none is
            seen, the times are irregular, or the column is held.
        lateness: Time [s] that a value may have waited for its row, at most.
    """

    rows: np.ndarray
    held: float
    interval: float
    resolution: float
    noise: float
    lateness: float

    @property
    def deviation(self) -> float:
        """Standard deviation of a value: that of its rounding, or of its noise if it is larger."""
        return max(self.resolution / math.sqrt(12.0), self.noise)

    def is_exact(self, order: int) -> bool:
        """Return whether differences of the values of an order are derivatives of the motion rather
        than noise: of order one for a column of rates, two for one of positions, so that either
        is an acceleration.
        """
        # A first difference of independent errors has 1 + 1 times their variance, a second one
        # 1 + 4 + 1 times.
        noise = math.sqrt(2.0 if order == 1 else 6.0) * self.deviation / self.interval**order
        return noise <= _EXACT_NOISE

    @property
    def is_held(self) -> bool:
        """Whether most rows of the column are no measurements of their own."""
        return self.held > _HELD_SHARE


def samples(t: np.ndarray, values: np.ndarray) -> Samples:
    """Return the fresh values of a column.

    Args:
        t: Times [s], increasing, shape (rows,).
        values: The column, shape (rows,).
    """
    usual = float(np.mean(np.diff(t)))
    irregular = is_irregular(t)
    resolution = grid_step(values)
    if not is_rounded(values, resolution):
        resolution = 0.0
    # The times of a regular clock are those of its values. White noise is told by differences at
    # equal intervals only; where these are irregular, lateness stands for it.
    each_row = Samples(
        rows=np.arange(len(t)),
        held=0.0,
        interval=usual,
        resolution=resolution,
        noise=0.0 if irregular else white_noise(values),
        lateness=usual if irregular else 0.0,
    )
    changed = np.flatnonzero(np.diff(values)) + 1
    if len(changed) < 2:
        return each_row
    fresh = np.concatenate([[0], changed])
    gaps = np.diff(t[fresh])
    # The usual gap: pauses, which are longer than twice the lower quartile, do not count.
    interval = float(np.median(gaps[gaps < 2.0 * np.percentile(gaps, 25)]))
    held = _held_share(values, fresh, gaps, interval, resolution)
    if held <= _HELD_SHARE:
        return replace(each_row, held=held)
    return Samples(
        rows=_fresh_rows(t, values, interval),
        held=held,
        interval=interval,
        resolution=resolution,
        noise=0.0,
        lateness=usual,
    )


def _held_share(
    values: np.ndarray, fresh: np.ndarray, gaps: np.ndarray, interval: float, resolution: float
) -> float:
    """Return the share of rows that repeat the value before them while the column changes.

    Args:
        values: The column, shape (rows,).
        fresh: Indices of the rows whose value differs from that before, shape (changes,).
        gaps: Times between these rows [s], shape (changes - 1,).
        interval: Usual one of these times [s].
        resolution: Step of the grid on which the values lie; 0 where they lie on none.
    """
    # A slow drive repeats values because they are coarse, and then changes by one step of the
    # grid. Only repeats before a larger change tell that the sensor reports more rarely.
    coarse = np.abs(np.diff(values[fresh])) < 1.5 * resolution
    moving = (gaps < _STANDSTILL_INTERVALS * interval) & ~coarse
    rows_moving = int(np.diff(fresh)[moving].sum())
    if rows_moving == 0:
        return 0.0
    return 1.0 - float(moving.sum()) / rows_moving


def _fresh_rows(t: np.ndarray, values: np.ndarray, interval: float) -> np.ndarray:
    """Return the rows in which the value changes. Where it stays for longer, the sensor is taken to
    stand still, and a row counts as fresh each `_STANDSTILL_INTERVALS` intervals [s].
    """
    rows = [0]
    last = 0
    for row in range(1, len(t)):
        is_late = t[row] - t[last] > _STANDSTILL_INTERVALS * interval
        if values[row] != values[row - 1] or is_late:
            rows.append(row)
            last = row
    return np.array(rows)


def grid_step(values: np.ndarray) -> float:
    """Return the step of the grid on which values lie, such as that of an encoder: the common
    divisor of their differences. It is 0 where they lie on no grid, or are all the same.

    Args:
        values: Values of a column, shape (rows,), each within a tenth of a step of the grid.
    """
    levels = np.unique(values)
    round_off = _FILE_ROUND_OFF * float(np.abs(levels).max(initial=0.0))
    gaps = np.diff(levels)
    gaps = gaps[gaps > round_off]
    if not len(gaps):
        return 0.0
    # The mean of many smallest gaps averages over a second rounding, such as that of an angle in
    # radians that was counted in hundredths of degrees. Of both estimates that one counts which
    # overlooks no coarser grid.
    by_smallest = _common_divisor(gaps, round_off, spread=1.0)
    by_mean = _common_divisor(gaps, round_off, spread=1.5)
    return max(by_smallest, by_mean)


def _common_divisor(gaps: np.ndarray, round_off: float, spread: float) -> float:
    """Return the common divisor of positive numbers by Euclid's algorithm, 0 if there is none.

    Args:
        gaps: The numbers, shape (n,).
        round_off: Number that counts as zero.
        spread: The mean of all numbers up to this multiple of the smallest counts as the smallest.
    """
    # The remainders of some multiples of a number by another multiple are multiples of it, too.
    smallest = gaps
    for _ in range(_MAX_EUCLID_STEPS):
        step = float(np.mean(smallest[smallest <= spread * smallest.min()]))
        if step <= round_off:
            return 0.0
        if spread > 1.0:
            step = _least_squares_step(gaps, step)
        remainders = np.abs(gaps - step * np.rint(gaps / step))
        significant = remainders[remainders > _GRID_TOLERANCE * step]
        if not len(significant):
            return _least_squares_step(gaps, step)
        smallest = significant
    return 0.0


def _least_squares_step(gaps: np.ndarray, step: float) -> float:
    """Return the step whose multiples come nearest to some gaps, from a first guess of it."""
    counts = np.maximum(np.rint(gaps / step), 1.0)
    return float(counts @ gaps / (counts @ counts))


def white_noise(values: np.ndarray) -> float:
    """Return the standard deviation of white noise in samples of a smooth motion at equal
    intervals, from the median of their third differences; 0 where these are those of a motion.

    Args:
        values: The samples, shape (rows,).
    """
    differences = np.diff(values, 3)
    moving = differences[differences != 0.0]
    if len(moving) < 4 or 2 * len(moving) < len(differences):
        return 0.0
    sign_changes = np.mean(moving[1:] * moving[:-1] < 0.0)
    if sign_changes < _SIGN_CHANGE_SHARE:
        return 0.0
    # A third difference has 1 + 9 + 9 + 1 times the variance of a value; 0.6745 is the median of
    # the magnitude of a standard normal number.
    noise = float(np.median(np.abs(differences))) / (0.6745 * math.sqrt(20.0))
    return noise if noise > _ROUND_OFF * float(np.abs(values).max()) else 0.0


def is_rounded(values: np.ndarray, step: float) -> bool:
    """Return whether values on a grid were rounded to it. A ramp that was computed from round
    numbers may lie on a grid without rounding; its acceleration is constant then, where that of
    rounded values jumps in each row.

    Args:
        values: Samples, shape (rows,).
        step: Step of the grid.
    """
    # Only rows tell in which the drive moves by more than a step of the grid and accelerates: a
    # slow or a steady motion has jumps of single steps, however it was made.
    is_fast = np.abs(np.diff(values))[1:-1] > 1.5 * step
    is_bent = np.abs(np.diff(values, 2)) > 0.5 * step
    accelerates = is_fast & (is_bent[1:] | is_bent[:-1])
    if not accelerates.any():
        return True  # too slow to tell: taken as rounded, which is the larger uncertainty
    jumps = np.abs(np.diff(values, 3))[accelerates] > 0.5 * step
    return bool(np.mean(jumps) > _JUMP_SHARE)


def is_irregular(t: np.ndarray) -> bool:
    """Return whether some times follow each other much closer than is usual."""
    steps = np.diff(t)
    return bool(steps.min() < _IRREGULAR_RATIO * np.median(steps))


@dataclass(frozen=True, eq=False)
class SmoothCurve:
    """A smooth curve through the fresh values of a column, and how it was made.

    Attributes:
        times: Times of the fresh values [s], shape (fresh rows,).
        sampled: How the column was sampled.
        deviations: Standard deviation of each fresh value, shape (fresh rows,).
        stiffness: Weight of the penalty over that of the values.
        spline: The curve, a spline of degree five.
        misfit: Mean square of the deviation of a fresh value from the curve, over its variance.
            It is about one, or less where a drive stands, if the column is a smooth motion.
    """

    times: np.ndarray
    sampled: Samples
    deviations: np.ndarray
    stiffness: float
    spline: BSpline
    misfit: float

    @property
    def deviation(self) -> float:
        """Standard deviation of a value, the root of its mean square over the column."""
        return float(np.sqrt(np.mean(self.deviations**2)))

    @property
    def cutoff(self) -> float:
        """Frequency above which the curve does not follow the column [rad/s]: it passes the share
        1 / (1 + (ω / cutoff)^6) of an oscillation.
        """
        return float(self.stiffness ** (-1.0 / (2 * _PENALTY_ORDER)) / self.sampled.interval)

    @property
    def acceleration_noise(self) -> float:
        """Standard deviation of what the noise of the column leaves in the second derivative [per
        second squared]. Its variance is the density of the noise times the integral of ω⁴ and the
        square of the gain over all ω from 0 on, which is π/18 cutoff⁵.
        """
        density = self.deviation**2 * self.sampled.interval / math.pi
        return math.sqrt(density * math.pi / 18.0 * self.cutoff**5)

    @property
    def creep(self) -> float:
        """Rate [per second] that the curve may have where a drive stands. Where an acceleration a
        begins at once, the curve moves at a / (3 cutoff) already: that is a/π times the integral
        of (1 - gain) / ω² over all frequencies ω from 0 on.
        """
        peak = float(np.abs(self.spline.derivative(2)(self.times)).max())
        return peak / (3.0 * self.cutoff)

    def measured_again(self, shift: float, rng: np.random.Generator) -> BSpline:
        """Return the curve that would have come out, had the same motion been measured once more.

        Args:
            shift: Where the grid of the sensor lies, -1/2 to 1/2 of its resolution.
            rng: Random numbers, for noise.
        """
        # Noise is added, or the motion is rounded again, whichever its deviation comes from.
        values = self.spline(self.times)
        if self.sampled.noise > self.sampled.resolution / math.sqrt(12.0):
            values = values + self.sampled.noise * rng.standard_normal(len(values))
        elif self.sampled.resolution > 0.0:
            step = self.sampled.resolution
            values = step * (np.rint(values / step - shift) + shift)
        penalised = _PenalisedSpline(self.times, values, self.deviations, self.sampled.interval)
        return penalised.solve(self.stiffness)


def smooth(t: np.ndarray, values: np.ndarray, sampled: Samples) -> SmoothCurve:
    """Return a smooth curve through the fresh values of a column.

    The variance of a value is that of its rounding, r²/12, or of its noise, and that of its time,
    (v τ)²/12 for a value that moves at v and waited up to τ. The curve is the spline with the least
    sum of squared deviations over these variances and of squared jerks, weighted by the stiffness
    that makes the values most likely.

    Source: Eilers and Marx, Statistical Science 11 (1996), 89-121 (penalised splines); Wood,
    Journal of the Royal Statistical Society B 73 (2011), 3-36 (marginal likelihood).

    Args:
        t: Times [s], shape (rows,).
        values: The column, shape (rows,).
        sampled: Its samples.
    """
    times = t[sampled.rows]
    points = values[sampled.rows]
    rate = np.gradient(points, times)
    # The mean over five values, since one difference is noisy.
    speed = np.convolve(np.abs(rate), np.full(5, 0.2), mode="same")
    variance = sampled.deviation**2 + (speed * sampled.lateness) ** 2 / 12.0
    # An exact column has a deviation of 1e-12, to divide by.
    deviations = np.sqrt(np.maximum(variance, 1e-24))
    penalised = _PenalisedSpline(times, points, deviations, sampled.interval)
    stiffness = penalised.most_likely_stiffness()
    spline = penalised.solve(stiffness)
    misfit = float(np.mean(((points - spline(times)) / deviations) ** 2))
    return SmoothCurve(times, sampled, deviations, stiffness, spline, misfit)


class _PenalisedSpline:
    """A spline with a penalty on its jerk, through values of known standard deviations.

    With B the basis at the times of the values y, W their weights, D the third differences of the
    coefficients c, and λ the stiffness, c minimises (y - B c)ᵀ W (y - B c) + λ |D c|². The normal
    equations are (BᵀWB + λ DᵀD) c = BᵀW y; both matrices have five bands beside the diagonal.
    """

    def __init__(
        self, times: np.ndarray, values: np.ndarray, deviations: np.ndarray, interval: float
    ) -> None:
        """Set up the normal equations.

        Args:
            times: Times of the values [s], increasing, shape (values,).
            values: The values, shape (values,).
            deviations: Their standard deviations, shape (values,).
            interval: Usual time between values [s], which is the distance of the knots.
        """
        pieces = max(math.ceil((times[-1] - times[0]) / interval), 2 * _DEGREE)
        spacing = (times[-1] - times[0]) / pieces
        self._knots = times[0] + spacing * np.arange(-_DEGREE, pieces + _DEGREE + 1)
        # Rounding of the last knot may leave the last time outside.
        inside = np.clip(times, self._knots[_DEGREE], self._knots[-_DEGREE - 1])
        basis = csr_array(BSpline.design_matrix(inside, self._knots, _DEGREE))
        # Values from their mean, in units of a usual deviation: sums of squares keep their digits.
        self._mean = float(np.mean(values))
        self._unit = float(np.median(deviations))
        weights = (self._unit / deviations) ** 2
        scaled = (values - self._mean) / self._unit
        self._count = basis.shape[1]
        binomials = [
            float((-1) ** k * math.comb(_PENALTY_ORDER, k)) for k in range(_PENALTY_ORDER + 1)
        ]
        differences = diags_array(
            binomials,
            offsets=list(range(_PENALTY_ORDER + 1)),
            shape=(self._count - _PENALTY_ORDER, self._count),
        )
        self._normal = _lower_bands(basis.T @ (basis * weights[:, None]))
        self._penalty = _lower_bands(differences.T @ differences)
        self._right = basis.T @ (weights * scaled)
        self._square = float(weights @ scaled**2)

    def most_likely_stiffness(self) -> float:
        """Return the stiffness at which the values are most likely."""
        low = math.log(_MIN_STIFFNESS)
        high = math.log(_MAX_STIFFNESS)
        best = minimize_scalar(
            lambda logarithm: self._cost(math.exp(logarithm)),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 0.1},
        )
        return float(math.exp(best.x))

    def _cost(self, stiffness: float) -> float:
        """Return the negative logarithm of the likelihood of the values, but for a constant.

        The penalty λ |D c|² is a normal prior of D c with the variance 1/λ. The likelihood with the
        coefficients integrated out has the logarithm
        -½ (least penalised misfit + ln det(BᵀWB + λ DᵀD) - rank(D) ln λ).
        """
        try:
            factor = cholesky_banded(self._normal + stiffness * self._penalty, lower=True)
        except LinAlgError:
            return math.inf
        coefficients = cho_solve_banded((factor, True), self._right)
        # At the minimum the penalised misfit is yᵀWy - (BᵀWy)ᵀc.
        misfit = self._square - float(self._right @ coefficients)
        log_determinant = 2.0 * float(np.sum(np.log(factor[0])))
        prior = (self._count - _PENALTY_ORDER) * math.log(stiffness)
        return 0.5 * (misfit + log_determinant - prior)

    def solve(self, stiffness: float) -> BSpline:
        """Return the spline at a stiffness."""
        factor = cholesky_banded(self._normal + stiffness * self._penalty, lower=True)
        coefficients = cho_solve_banded((factor, True), self._right)
        return BSpline(self._knots, self._mean + self._unit * coefficients, _DEGREE)


def _lower_bands(matrix: csr_array) -> np.ndarray:
    """Return the diagonal and the lower bands of a symmetric matrix, shape (6, n), in the layout of
    `scipy.linalg.cholesky_banded`.
    """
    bands = np.zeros((_DEGREE + 1, matrix.shape[0]))
    for offset in range(_DEGREE + 1):
        diagonal = matrix.diagonal(-offset)
        bands[offset, : len(diagonal)] = diagonal
    return bands
