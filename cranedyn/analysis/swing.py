"""Analysis of swings: periods, damping, amplitudes, agreement of two signals.

Functions take plain arrays, so that they work on any data.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy

from cranedyn.checks import as_array, finite, number
from cranedyn.errors import DataError


@dataclass(frozen=True)
class SwingFit:
    """φ(t) = A exp(-ζ ω_n t) cos(ω_d t + ψ) + c, with ω_d = ω_n √(1 - ζ²) and t counted from the
    start of the record.

    Attributes:
        period: 2π/ω_d [s].
        damping_ratio: Damping ratio ζ.
        amplitude: A, extrapolated back to t = 0 [rad].
        phase: ψ [rad].
        offset: c [rad].
        rms: Root mean square of the residual of the fit [rad].
    """

    period: float
    damping_ratio: float
    amplitude: float
    phase: float
    offset: float
    rms: float

    def amplitude_at(self, t: np.ndarray | float) -> np.ndarray:
        """Return the amplitude at a time [rad]."""
        return self.amplitude * np.exp(-self.decay_rate * np.asarray(t, dtype=float))

    @property
    def decay_rate(self) -> float:
        """ζ ω_n [1/s]."""
        ratio = self.damping_ratio / math.sqrt(1.0 - self.damping_ratio**2)
        return ratio * 2.0 * math.pi / self.period

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the fitted swing at times [rad]."""
        phase = 2.0 * math.pi / self.period * t + self.phase
        return self.amplitude_at(t) * np.cos(phase) + self.offset


def fit_swing(t: np.ndarray, swing: np.ndarray) -> SwingFit:
    """Fit a decaying cosine by least squares.

    Args:
        t: Times [s], increasing, shape (n,).
        swing: Swing angle [rad], shape (n,).

    Raises:
        DataError: If time does not increase, the record holds fewer than two swings, or the fit
            does not converge.
    """
    t = finite("t", t, ("n",), unit="s")
    swing = finite("swing", swing, t.shape, unit="rad")
    if len(t) == 0:
        raise DataError("The record holds no row where a swing is to be fitted.")
    if not (t[1:] > t[:-1]).all():
        raise DataError(
            "The times of a record must increase from row to row where a swing is to be fitted."
        )
    # Samples near zero are left out: noise there would make crossings of its own.
    centred = swing - swing.mean()
    clear = np.abs(centred) > 0.25 * centred.std()
    crossings = zero_crossings(t[clear], centred[clear])
    if len(crossings) < 5:
        raise DataError(
            f"The record from {t[0]:g} to {t[-1]:g} s holds {max(len(crossings) - 1, 0)} half "
            "swings; at least four are needed for a fit."
        )
    half_period = (crossings[-1] - crossings[0]) / (len(crossings) - 1)
    # Time counts from the middle of the record: there a change of the decay or of the frequency
    # changes amplitude and phase least, so that the parameters are hardly correlated.
    middle = 0.5 * (t[0] + t[-1])

    def misfit(parameters: np.ndarray) -> np.ndarray:
        """Return exp(-decay s) (a cos(ω s) + b sin(ω s)) + c less the swing."""
        a, b, decay, omega, c = parameters
        s = t - middle
        return np.exp(-decay * s) * (a * np.cos(omega * s) + b * np.sin(omega * s)) + c - swing

    # With a known frequency and no decay the fit is linear: that is where the search begins.
    phase = math.pi / half_period * (t - middle)
    basis = np.stack([np.cos(phase), np.sin(phase), np.ones_like(t)], axis=1)
    a, b, c = np.linalg.lstsq(basis, swing, rcond=None)[0]
    with np.errstate(all="ignore"):
        fit = scipy.optimize.least_squares(
            misfit, (a, b, 0.0, math.pi / half_period, c), method="lm", x_scale="jac"
        )
        a, b, decay, omega, c = fit.x.tolist()
        amplitude = float(math.hypot(a, b) * np.exp(decay * middle))
    if not (fit.success and math.isfinite(amplitude) and omega > 0.0 and abs(decay) < omega):
        if fit.success:
            reason = f"its best decay is {decay:g} 1/s at {omega:g} rad/s."
        else:
            reason = fit.message
        raise DataError(
            f"The record from {t[0]:g} to {t[-1]:g} s does not fit a decaying cosine: {reason}"
        )
    # a cos(ω s) + b sin(ω s) = A cos(ω s + ψ) with A = √(a² + b²) and tan ψ = -b/a.
    return SwingFit(
        period=2.0 * math.pi / omega,
        damping_ratio=decay / math.hypot(decay, omega),
        amplitude=amplitude,
        phase=(math.atan2(-b, a) - omega * middle) % (2.0 * math.pi),
        offset=c,
        rms=float(np.sqrt(np.mean(fit.fun**2))),
    )


def zero_crossings(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the times at which a signal changes sign, by linear interpolation between samples;
    error O(dt²) of the period.
    """
    t = as_array("t", t, ("n",))
    y = as_array("y", y, t.shape)
    i = np.flatnonzero((np.signbit(y[:-1]) != np.signbit(y[1:])) & (y[:-1] != y[1:]))
    return t[i] - y[i] * (t[i + 1] - t[i]) / (y[i + 1] - y[i])


def peaks(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and heights of the largest |y| between neighbouring zero crossings, by a
    parabola through the three samples at the top.
    """
    t = as_array("t", t, ("n",))
    y = as_array("y", y, t.shape)
    size = np.abs(y)
    edges = np.flatnonzero(np.signbit(y[:-1]) != np.signbit(y[1:])) + 1
    tops = []
    for first, end in itertools.pairwise(edges):
        tops.append(first + int(np.argmax(size[first:end])))
    i = np.array(tops, dtype=int)
    before = size[i - 1]
    top = size[i]
    after = size[i + 1]

    # The parabola through three samples has its top at (before - after) / (2 bend) samples from the
    # middle one. Where all three are alike there is none, and the sample itself counts.
    bend = before - 2.0 * top + after
    shift = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend != 0.0)
    return t[i] + shift * (t[i + 1] - t[i]), top - 0.25 * (before - after) * shift


@dataclass(frozen=True)
class PowerLaw:
    """y ∝ x^exponent, fitted on logarithms.

    Attributes:
        exponent: The exponent.
        factor: y at x = 1.
        r2: Coefficient of determination; 0 where all x are alike.
        points: Number of fitted points.
    """

    exponent: float
    factor: float
    r2: float
    points: int

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the fitted law at x."""
        return self.factor * np.asarray(x, dtype=float) ** self.exponent


def fit_power_law(x: np.ndarray, y: np.ndarray) -> PowerLaw:
    """Fit a power law by least squares on logarithms.

    Raises:
        DataError: If fewer than three points are given, all x are alike, or a number is not
            positive.
    """
    x = finite("x", x, ("n",))
    y = finite("y", y, x.shape)
    if len(x) < 3 or np.ptp(x) == 0.0:
        raise DataError(f"A power law needs three points of different abscissa, here are {len(x)}.")
    least = min(np.min(x), np.min(y))
    if not least > 0.0:
        raise DataError(f"A power law needs positive numbers, the least here is {least:g}.")
    line = scipy.stats.linregress(np.log(x), np.log(y))
    return PowerLaw(float(line.slope), math.exp(line.intercept), float(line.rvalue**2), len(x))


@dataclass(frozen=True)
class Agreement:
    """Agreement of a model with a measured signal.

    Attributes:
        measured: Largest magnitude of the measured signal.
        modelled: Largest magnitude of the modelled signal.
        correlation: Pearson's correlation.
        rms: Root mean square of the difference.
    """

    measured: float
    modelled: float
    correlation: float
    rms: float

    @property
    def relative(self) -> float:
        """RMS as a fraction of the measured amplitude."""
        return self.rms / self.measured


def agreement(measured: np.ndarray, modelled: np.ndarray) -> Agreement:
    """Compare two signals of the same times, shape (n,) each.

    Raises:
        DataError: If a signal is constant.
    """
    measured = finite("measured", measured, ("n",))
    modelled = finite("modelled", modelled, measured.shape)
    for name, signal in (("measured", measured), ("modelled", modelled)):
        if len(signal) == 0 or np.ptp(signal) == 0.0 or np.var(signal) == 0.0:
            raise DataError(f"The {name} signal does not move, so there is nothing to compare.")
    return Agreement(
        measured=float(np.abs(measured).max()),
        modelled=float(np.abs(modelled).max()),
        correlation=float(np.corrcoef(measured, modelled)[0, 1]),
        rms=float(np.sqrt(np.mean((measured - modelled) ** 2))),
    )


def swing_amplitude(
    swing: np.ndarray, rates: np.ndarray, length: np.ndarray | float, gravity: float
) -> np.ndarray:
    """Return the amplitude that a small swing would keep if the drives stopped at once [rad], shape
    (n,).

    Args:
        swing: φ and θ [rad], shape (n, 2).
        rates: Their rates [rad/s], shape (n, 2).
        length: Cable length [m].
        gravity: Gravity [m/s²].
    """
    swing = as_array("swing", swing, ("n", 2))
    rates = as_array("rates", rates, swing.shape)
    length = as_array("length", length, (), (len(swing),))
    number("gravity", gravity, "m/s²", "> 0")
    # A free swing at ω² = g / l keeps φ² + (φ̇ / ω)².
    return np.sqrt(np.sum(swing**2, axis=1) + np.sum(rates**2, axis=1) * length / gravity)


def settling_time(t: np.ndarray, distance: np.ndarray, within: float) -> float:
    """Return when a distance has come within a bound for good [s]; inf if it has not by the end.

    Args:
        t: Times [s], shape (n,).
        distance: Distances, not negative, shape (n,).
        within: Bound.
    """
    t = as_array("t", t, ("n",))
    distance = as_array("distance", distance, t.shape)
    if not len(t):
        raise DataError("The record holds no row where a time of settling is looked for.")
    # A distance that is no number counts as outside.
    outside = np.flatnonzero(~(distance <= within))
    if not len(outside):
        return float(t[0])
    first_settled = outside[-1] + 1
    return float(t[first_settled]) if first_settled < len(t) else math.inf
