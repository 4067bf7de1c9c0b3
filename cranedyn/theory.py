"""Closed forms to validate the simulation. SI units, radians, gravity positive.

Swing angles are positive when the load lags behind the pivot. Each function raises `OutOfRange`
where its result is not finite, or its arguments have no meaning, such as a swing beyond 180°.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, TypeVar

import numpy as np
import scipy

from cranedyn.checks import as_array, short_repr
from cranedyn.errors import OutOfRange

_Function = TypeVar("_Function", bound=Callable[..., Any])

_MIN_AMPLITUDE = 1e-9
"""Smallest amplitude that `adiabatic_amplitude` looks for [rad]."""

_MAX_AMPLITUDE = 3.1
"""Largest amplitude that `adiabatic_amplitude` looks for [rad]. At π the pendulum stands upside
down, and has no period."""


def _finite(form: _Function) -> _Function:
    """Make a closed form raise `OutOfRange` where its result is not finite.

    One check of the result stands for many of the arguments: a length of 0, a mass below 0 and NaN
    all lead to a division by zero, the root of a negative number, or a result that is not finite.
    """

    @wraps(form)
    def checked(*args: Any, **named: Any) -> Any:
        try:
            with np.errstate(all="ignore"):
                result = form(*args, **named)
            if isinstance(result, float):
                # Much faster than NumPy's.
                is_finite = math.isfinite(result)
            else:
                is_finite = bool(np.isfinite(result).all())
            if is_finite:
                return result
        except (ArithmeticError, ValueError):
            # Also np.linalg.LinAlgError, which is a ValueError.
            pass
        arguments = [short_repr(value) for value in args]
        for name, value in named.items():
            arguments.append(f"{name}={short_repr(value)}")
        call = f"{form.__name__}({', '.join(arguments)})"
        raise OutOfRange(f"the result of {call}", "not finite", "arguments with a finite result")

    return checked  # type: ignore[return-value]


def _check_amplitude(amplitude: float | np.ndarray) -> None:
    """Check that a swing of this amplitude turns back before the pendulum stands upside down.

    The closed forms take an amplitude A by sin²(A/2), which is the same for 2π - A: beyond π they
    would give the numbers of another swing.

    Raises:
        ValueError: If an amplitude is beyond π.
    """
    if (np.abs(amplitude) > math.pi).any():
        raise ValueError


@_finite
def point_period(length: float | np.ndarray, gravity: float) -> float | np.ndarray:
    """Return the period of small swings of a point load on a cable [s]: 2π√(l/g)."""
    return 2.0 * math.pi * np.sqrt(length / gravity)


@_finite
def rigid_period(length: float, gravity: float, mass: float, inertia: float) -> float:
    """Return the period of small swings of a load with rotational inertia I about its own centre
    [s]: 2π√((m l² + I)/(m g l)), the compound pendulum.
    """
    return 2.0 * math.pi * math.sqrt((mass * length**2 + inertia) / (mass * gravity * length))


@_finite
def amplitude_factor(amplitude: float | np.ndarray) -> float | np.ndarray:
    """Return the period of a swing of finite amplitude [rad] over that of a small one: (2/π)
    K(sin²(A/2)), about 1 + A²/16.

    Landau & Lifshitz, Mechanics, §11.
    """
    _check_amplitude(amplitude)
    # SciPy's complete elliptic integral takes the parameter m = k², not the modulus k.
    parameter = np.sin(np.asarray(amplitude) / 2.0) ** 2
    return 2.0 / math.pi * scipy.special.ellipk(parameter)


@_finite
def pivot_compliance(
    length: float,
    gravity: float,
    mass: float,
    stiffness: float,
    damping: float = 0.0,
    trolley_mass: float = 0.0,
) -> tuple[float, float]:
    """Return the effect of a trolley held by k_p [N/m] and k_d [N s/m] on a small swing.

    The pivot gives by the horizontal rope force times the trolley's compliance at the swing's
    frequency. Without damping and mass the gain is m g/(2 k_p l): the pendulum turns about a point
    m g/k_p higher. The damper takes ζ, about ½ (m g/l) ω k_d/k_p².

    Returns:
        Relative gain in period, and damping ratio.
    """
    omega = math.sqrt(gravity / length)
    # Displacement of the trolley over the force on it, at the frequency of the swing.
    compliance = 1.0 / (stiffness - omega**2 * trolley_mass + 1.0j * omega * damping)
    # The swing φ pulls the pivot by m g φ, and the pivot then is off by that times the compliance:
    # to first order the pendulum is longer by m g times the compliance, which is complex. Its
    # period grows by half of the share; the imaginary part is a damping.
    scale = mass * gravity / (2.0 * length)
    return scale * compliance.real, -scale * compliance.imag


@_finite
def hoist_compliance(
    amplitude: float, length: float, gravity: float, mass: float, stiffness: float, damping: float
) -> tuple[float, float]:
    """Return the effect of a hoist held by k_p [N/m] and k_d [N s/m] on a swing of an amplitude
    [rad].

    The rope force of a swing A cos ωt varies by m g A² (1/4 - 3/4 cos 2ωt). The hoist gives by that
    force times its compliance: the mean lengthens the pendulum, the component at 2ω pumps and damps
    it. Averaging the Lagrangian over a swing gives both, to order A².

    Returns:
        Relative gain in period, and damping ratio.
    """
    omega = math.sqrt(gravity / length)
    # Displacement of the hoist with the load over the force on it, at 2ω.
    compliance = 1.0 / (stiffness - 4.0 * omega**2 * mass + 2.0j * omega * damping)
    scale = mass * gravity * amplitude**2 / length
    gain = scale * (1.0 / (8.0 * stiffness) + 9.0 / 16.0 * compliance.real)
    damping_ratio = -9.0 / 16.0 * scale * compliance.imag
    return gain, damping_ratio


@_finite
def constant_hoisting(
    t: np.ndarray, length: float, rate: float, gravity: float, swing: float, swing_rate: float
) -> np.ndarray:
    """Return the small swing of a point load while the cable runs at constant speed [rad]: (l0 + v
    t) φ̈ + 2 v φ̇ + g φ = 0.

    φ = [A J1(u) + B Y1(u)]/u with u = 2√(g l)/|v| (Watson, Theory of Bessel Functions; A and B from
    the start).

    Args:
        t: Times since the start [s], shape (n,).
        length: Cable length at the start [m].
        rate: Speed v of the cable, positive downward [m/s], not zero.
        gravity: Gravity [m/s²].
        swing: φ at the start [rad].
        swing_rate: φ̇ at the start [rad/s].
    """
    a, b = _hoisting_constants(length, rate, gravity, swing, swing_rate)
    u = 2.0 * np.sqrt(gravity * (length + rate * np.asarray(t))) / abs(rate)
    return (a * scipy.special.jv(1, u) + b * scipy.special.yv(1, u)) / u


@_finite
def constant_hoisting_envelope(
    t: np.ndarray, length: float, rate: float, gravity: float, swing: float, swing_rate: float
) -> np.ndarray:
    """Return the amplitude of `constant_hoisting` [rad]: √((A² + B²)(J1² + Y1²))/u, the modulus
    within which the swing oscillates.
    """
    a, b = _hoisting_constants(length, rate, gravity, swing, swing_rate)
    u = 2.0 * np.sqrt(gravity * (length + rate * np.asarray(t))) / abs(rate)
    return math.hypot(a, b) * np.hypot(scipy.special.jv(1, u), scipy.special.yv(1, u)) / u


def _hoisting_constants(
    length: float, rate: float, gravity: float, swing: float, swing_rate: float
) -> tuple[float, float]:
    """Return A and B of `constant_hoisting`, from the swing and its rate at the start."""
    u = 2.0 * math.sqrt(gravity * length) / abs(rate)
    # du/dt at the start, where the length is l0: sign(v) √(g/l0).
    du = math.copysign(1.0, rate) * math.sqrt(gravity / length)
    # Rows: φ and φ̇ at the start for (A, B) = (1, 0) and (0, 1). For any cylinder function C it is
    # d/du (C1(u)/u) = -C2(u)/u.
    basis = np.array(
        [
            [scipy.special.jv(1, u) / u, scipy.special.yv(1, u) / u],
            [-du * scipy.special.jv(2, u) / u, -du * scipy.special.yv(2, u) / u],
        ]
    )
    a, b = np.linalg.solve(basis, [swing, swing_rate])
    return float(a), float(b)


@_finite
def radial_paper(phi: float, *, length: float, gravity: float, excitation: float) -> float:
    """Return φ̈ [rad/s²] by Eq. (8) of Muddassir et al., ISARC 2024: l φ̈ + g φ - ẍ = 0, where the
    excitation is ẍ [m/s²].
    """
    return (excitation - gravity * phi) / length


@_finite
def tangential_paper(theta: float, *, length: float, gravity: float, excitation: float) -> float:
    """Return θ̈ [rad/s²] by Eq. (10) of Muddassir et al., ISARC 2024: l θ̈ + g θ - x γ̈ = 0, where
    the excitation is x γ̈ [m/s²].
    """
    return (excitation - gravity * theta) / length


@_finite
def small_swing(
    swing: np.ndarray,
    rates: np.ndarray,
    *,
    length: float,
    length_rate: float,
    gravity: float,
    x: float,
    x_rate: float,
    x_acceleration: float,
    slew_rate: float,
    slew_acceleration: float,
) -> np.ndarray:
    """Return φ̈, θ̈ [rad/s²] of a point load for small angles and arbitrary motion of the drives,
    to first order in the swing.

    l φ̈ + 2 l̇ φ̇ + g φ = ẍ - γ̇² (x - l φ) + 2 γ̇ (lθ)˙ + γ̈ l θ
    l θ̈ + 2 l̇ θ̇ + g θ = γ̈ (x - l φ) + 2 γ̇ (ẋ - (lφ)˙) + γ̇² l θ

    Follows from the payload at radius x - l φ and tangential offset -l θ in the frame that turns
    with the jib.

    Args:
        swing: φ, θ [rad], shape (2,).
        rates: φ̇, θ̇ [rad/s], shape (2,).
        length: Cable length [m].
        length_rate: Its rate [m/s].
        gravity: Gravity [m/s²].
        x: Trolley radius [m].
        x_rate: Its rate [m/s].
        x_acceleration: Its acceleration [m/s²].
        slew_rate: Slew rate [rad/s].
        slew_acceleration: Slew acceleration [rad/s²].
    """
    swing = as_array("swing", swing, (2,))
    rates = as_array("rates", rates, (2,))
    phi, theta = swing
    phi_rate, theta_rate = rates
    # The radius of the payload is x - l φ, its offset across the jib -l θ.
    radial = x - length * phi
    radial_rate = x_rate - length_rate * phi - length * phi_rate
    offset = length * theta
    offset_rate = length_rate * theta + length * theta_rate
    phi_excitation = (
        x_acceleration
        - slew_rate**2 * radial
        + 2.0 * slew_rate * offset_rate
        + slew_acceleration * offset
    )
    theta_excitation = (
        slew_acceleration * radial + 2.0 * slew_rate * radial_rate + slew_rate**2 * offset
    )
    excitation = np.array([phi_excitation, theta_excitation])
    return (excitation - 2.0 * length_rate * rates - gravity * swing) / length


@_finite
def adiabatic_amplitude(lengths: np.ndarray, length: float, amplitude: float) -> np.ndarray:
    """Return the amplitude of a swing [rad] after the cable has run slowly from one length [m] to
    others, of any size below 180°.

    The action l^(3/2) [E(k) - (1-k²) K(k)] with k = sin(A/2) stays constant (Landau & Lifshitz,
    Mechanics, §49); for small A it is A² l^(3/2), so A goes with l^(-3/4).
    """

    def action(a: float) -> float:
        """Return the action over l^(3/2) of a swing of an amplitude [rad]."""
        # SciPy's elliptic integrals take the parameter k².
        parameter = math.sin(a / 2.0) ** 2
        first_kind = scipy.special.ellipk(parameter)
        return float(scipy.special.ellipe(parameter) - (1.0 - parameter) * first_kind)

    def change_of_action(a: float, ratio: float) -> float:
        """Return how much larger the action is at an amplitude and a length ratio than before."""
        return action(a) * ratio**1.5 - action_before

    _check_amplitude(amplitude)
    action_before = action(amplitude)
    ratios = np.atleast_1d(as_array("lengths", lengths, (), ("n",))) / length
    amplitudes = []
    for ratio in ratios:
        root = scipy.optimize.brentq(
            change_of_action, _MIN_AMPLITUDE, _MAX_AMPLITUDE, args=(ratio,)
        )
        amplitudes.append(root)
    return np.array(amplitudes)


@_finite
def apsidal_precession(length: float, far: float, near: float) -> float:
    """Return the angle by which the orbit of a spherical pendulum turns in a revolution [rad], from
    4 times the apsidal angle ψ.

    The load is let go at the distance a from the vertical [m], with a horizontal speed across of b
    √(g/l). With u the cosine of the angle from the vertical, ψ = ∫ h du / ((1-u²) √f) between two
    roots of the cubic f = 2 (ε + u) (1 - u²) - h², where ε and h are energy and angular momentum in
    units of m g l and m √(g l³) (Landau & Lifshitz, Mechanics, §14). Gravity drops out.

    Args:
        length: Cable length [m].
        far: a [m], below the cable length.
        near: b [m].
    """
    u0 = math.sqrt(1.0 - (far / length) ** 2)
    h = far * near / length**2
    energy = (near / length) ** 2 / 2.0 - u0
    # u0 is one root of f, since the start is an apse. Sum and product of the other two follow from
    # the coefficients of the cubic, f = -2 (u - u0) (u - u1) (u - u2).
    half_sum = -(energy + u0) / 2.0
    product = (energy - h**2 / 2.0) / u0
    spread = math.sqrt(half_sum**2 - product)
    u1 = half_sum + spread
    u2 = half_sum - spread

    def integrand(s: float) -> float:
        # The integrand in u is infinite at both ends, u0 and u1. In s, with
        # u = (u0 + u1)/2 + (u1 - u0)/2 sin s, du/√f becomes ds/√(2 (u - u2)), which is not.
        u = (u0 + u1) / 2.0 + (u1 - u0) / 2.0 * math.sin(s)
        return h / ((1.0 - u**2) * math.sqrt(2.0 * (u - u2)))

    # As exact as rounding allows: the precession is a small difference of large angles.
    apsidal_angle = scipy.integrate.quad(
        integrand, -math.pi / 2.0, math.pi / 2.0, epsabs=1e-13, epsrel=1e-13
    )[0]
    return float(4.0 * apsidal_angle - 2.0 * math.pi)


@_finite
def airy_precession(length: float, far: float, near: float) -> float:
    """Return `apsidal_precession` to lowest order in the half axes a and b of the orbit [rad]: 3π a
    b/(4 l²) (Airy, Memoirs of the RAS 20, 1851).
    """
    return 3.0 * math.pi * far * near / (4.0 * length**2)


@_finite
def slewing_swing(radius: float, length: float, rate: float, gravity: float) -> float:
    """Return φ [rad] at which a point load hangs while the jib turns steadily [rad/s]; negative,
    because the load swings out.

    tan|φ| = Ω² (x + l sin|φ|)/g, the balance of weight, rope and circular motion at the radius x +
    l sin|φ|.
    """

    def imbalance(angle: float) -> float:
        # The balance times cos φ: it has no pole at 90°.
        load_radius = radius + length * math.sin(angle)
        return gravity * math.sin(angle) - rate**2 * load_radius * math.cos(angle)

    return -float(scipy.optimize.brentq(imbalance, 0.0, math.pi / 2.0, xtol=1e-15))


@_finite
def slewing_tension(
    radius: float, length: float, rate: float, gravity: float, mass: float
) -> float:
    """Return the tension of the rope at `slewing_swing` [N]: m √(g² + Ω⁴ r²) with r the radius of
    the load.
    """
    # The swing is negative, so that the load is farther out than the trolley.
    swing = slewing_swing(radius, length, rate, gravity)
    load_radius = radius - length * math.sin(swing)
    return mass * math.hypot(gravity, rate**2 * load_radius)


@_finite
def rolling_period(length: float, gravity: float, mass: float, trolley: float) -> float:
    """Return the period of small swings under a trolley that rolls without drive or friction [s]:
    2π √(l M/((M + m) g)), M the trolley's mass.
    """
    return 2.0 * math.pi * math.sqrt(length * trolley / ((trolley + mass) * gravity))


@_finite
def pulse_residual(acceleration: float, pulse: float, length: float, gravity: float) -> float:
    """Return the amplitude after a trolley has accelerated for a time and runs on [rad], small
    angles: (2a/g) |sin(ω t_p/2)|.

    Each step of the acceleration starts a swing of a/g about its own lag, and the two add as
    vectors (Singhose, Int. J. of Precision Engineering and Manufacturing 10, 2009, reviews the
    method).

    Args:
        acceleration: a [m/s²].
        pulse: t_p [s].
        length: Cable length [m].
        gravity: Gravity [m/s²].
    """
    omega = math.sqrt(gravity / length)
    return 2.0 * abs(acceleration) / gravity * abs(math.sin(omega * pulse / 2.0))


@_finite
def coast_residual(
    acceleration: float, pulse: float, coast: float, length: float, gravity: float
) -> float:
    """Return the amplitude after the trolley has accelerated, coasted for t_c and braked as it
    accelerated [rad]: `pulse_residual` times 2 |sin(ω (t_p + t_c)/2)|.
    """
    # Braking is the same pulse in the other sense, t_p + t_c later: the two swings are vectors of
    # one length, and their difference is 2 |sin| of half of the angle between them.
    omega = math.sqrt(gravity / length)
    half_angle = omega * (pulse + coast) / 2.0
    return 2.0 * pulse_residual(acceleration, pulse, length, gravity) * abs(math.sin(half_angle))


@_finite
def quintic_residual(distance: float, duration: float, length: float, gravity: float) -> float:
    """Return the amplitude after a quintic spline of the trolley, rest to rest [rad], small angles.

    The Fourier transform of the trolley's acceleration at the frequency of the swing, over √(g l);
    with w = ω T it is D/(T l ω) · |120 (w² sin(w/2) + 6 w cos(w/2) - 12 sin(w/2))/w⁴|.

    Args:
        distance: D [m].
        duration: T [s].
        length: Cable length [m].
        gravity: Gravity [m/s²].
    """
    omega = math.sqrt(gravity / length)
    w = omega * duration
    shape = w**2 * math.sin(w / 2.0) + 6.0 * w * math.cos(w / 2.0) - 12.0 * math.sin(w / 2.0)
    return abs(distance) / (duration * length * omega) * abs(120.0 * shape / w**4)


@_finite
def double_pendulum(
    cable: float, sling: float, hook: float, load: float, gravity: float
) -> tuple[float, float]:
    """Return the slow and fast frequency of a point load slung below a point hook, small swings,
    trolley at rest [rad/s].

    ω² = (g/2) [(1 + R)(1/l₁ + 1/l₂) ∓ √((1 + R)² (1/l₁ + 1/l₂)² - 4 (1 + R)/(l₁ l₂))] with R the
    load's mass over the hook's (Singhose, Kim & Kenison, J. Dyn. Sys. Meas. Control 130, 2008).

    Args:
        cable: l₁, pivot to hook [m].
        sling: l₂, hook to load [m].
        hook: Its mass [kg].
        load: Its mass [kg].
        gravity: g [m/s²].
    """
    mass_ratio = 1.0 + load / hook
    half_sum = mass_ratio * (1.0 / cable + 1.0 / sling) / 2.0
    # Sum and product of both roots ω²/g. The smaller root is the product over the larger, since the
    # difference of nearly equal numbers would lose digits.
    product = mass_ratio / (cable * sling)
    fast = half_sum + math.sqrt(half_sum**2 - product)
    slow_frequency = math.sqrt(gravity * mass_ratio / (cable * sling) / fast)
    return slow_frequency, math.sqrt(gravity * fast)


@_finite
def bifilar(
    mass: float, inertia: float, half_spacing: float, length: float, gravity: float
) -> tuple[float, float]:
    """Return the frequencies of small sways and yaws of a load on two parallel falls [rad/s]:
    √(g/h) and √(m g a²/(I h)).

    Args:
        mass: m of the load [kg].
        inertia: I about the vertical through its centre [kg m²].
        half_spacing: a, half the distance of the falls [m].
        length: h of the falls [m].
        gravity: g [m/s²].
    """
    sway = math.sqrt(gravity / length)
    return sway, sway * half_spacing * math.sqrt(mass / inertia)


@_finite
def rope_bounce(stiffness: float, length: float, mass: float) -> float:
    """Return the frequency of a load that bounces on a rope whose drum stands still [rad/s]: √(k/m)
    with k = EA/l of the cable, without its own mass.

    Args:
        stiffness: EA, Young's modulus times the cross-section [N].
        length: Cable length l [m].
        mass: m of the load [kg].
    """
    return math.sqrt(stiffness / (length * mass))


@_finite
def pickup_factor(
    speed: float, frequency: float, gravity: float, damping_ratio: float = 0.0
) -> float:
    """Return the largest tension of a rope over the load's weight when the load is picked up at a
    hoisting speed: 1 + v ω/g, less where the rope is damped.

    The load leaves the ground when the rope carries its weight, while the rope still shortens at v:
    the tension then is an oscillator of one mass that starts from the weight at the rate k v.

    Args:
        speed: v [m/s].
        frequency: ω of the bounce [rad/s].
        gravity: g [m/s²].
        damping_ratio: Damping ratio ζ of the bounce, less than 1.
    """
    # With ζ the tension exceeds the weight by v ω/g e^(-ζ ω t) sin(√(1 - ζ²) ω t)/√(1 - ζ²), which
    # is largest where tan(√(1 - ζ²) ω t) = √(1 - ζ²)/ζ, that is at √(1 - ζ²) ω t = acos ζ. The sine
    # there is √(1 - ζ²), and cancels.
    root = math.sqrt(1.0 - damping_ratio**2)
    decay = math.exp(-damping_ratio * math.acos(damping_ratio) / root)
    return 1.0 + speed * frequency / gravity * decay


@_finite
def reeving_efficiency(falls: int, efficiency: float) -> float:
    """Return the efficiency of a reeving of n falls, (1 - ηⁿ)/(n (1 - η)): the load over n times
    the pull of the line. A sheave passes on the share η of its pull in hoisting, 1/η in lowering.
    """
    if efficiency == 1.0:
        # The limit of the quotient, which is 0/0 there.
        return 1.0
    # 1 - ηⁿ and 1 - η lose digits where η is near 1; expm1 does not.
    loss = math.log(efficiency)
    return math.expm1(falls * loss) / (falls * math.expm1(loss))


@_finite
def fall_factor(height: float, stiffness: float, weight: float) -> float:
    """Return the largest tension of a rope over the weight W [N] of a load that falls freely by a
    height h [m] until the rope, of stiffness k [N/m], is taut: 1 + √(1 + 2 k h/W).
    """
    return 1.0 + math.sqrt(1.0 + 2.0 * stiffness * height / weight)


@_finite
def drop_factor(dropped: float, remaining: float) -> float:
    """Return the largest deviation of the rope's tension from the weight of the remaining load,
    over that weight, when a mass is dropped at once.

    It is the dropped mass over the remaining mass: the rope is stretched for both, and the
    remaining load swings about its own stretch. The tension lies between 1 - factor and 1 + factor
    times the remaining weight.

    Args:
        dropped: Dropped mass [kg].
        remaining: Mass of the remaining load [kg].
    """
    return dropped / remaining


@_finite
def twisting_tower(
    inertia: float,
    torsion: float,
    radius: float,
    length: float,
    mass: float,
    gravity: float,
    trolley: float = 0.0,
) -> tuple[float, float]:
    """Return the slow and fast frequency of a twisting tower and the tangential swing of a point
    load below its jib, slew drive and trolley locked [rad/s].

    M = [[J + (M_t + m) x², -m x l], [-m x l, m l²]], K = diag(k, m g l), for the twist and the
    swing θ, by Lagrange: the load moves by x ψ - l θ across the jib.

    Args:
        inertia: J of the upper structure about the slew axis [kg m²].
        torsion: k of the tower [N m/rad].
        radius: Trolley radius x [m].
        length: Cable length l [m].
        mass: m of the load [kg].
        gravity: g [m/s²].
        trolley: Mass M_t of the trolley as a point [kg].
    """
    return _two_modes(
        first_inertia=inertia + (trolley + mass) * radius**2,
        coupling=mass * radius * length,
        second_inertia=mass * length**2,
        first_stiffness=torsion,
        second_stiffness=mass * gravity * length,
    )


@_finite
def bending_tower(
    inertia: float,
    stiffness: float,
    moment: float,
    height: float,
    length: float,
    mass: float,
    gravity: float,
) -> tuple[float, float]:
    """Return the slow and fast frequency of a tower that bends at its foot across the jib and the
    tangential swing of a point load, drives locked [rad/s].

    M = [[I + m h², -m h l], [-m h l, m l²]], K = diag(k - (S + m h) g, m g l), for the bend and the
    load's angle from the vertical, by Lagrange: the load moves by h ψ - l α, and the weight above
    the foot increases the bend.

    Args:
        inertia: I of all but the load about the foot [kg m²].
        stiffness: k of the foot [N m/rad].
        moment: S, masses of all but the load times their heights above the foot [kg m].
        height: h of the pivot above the foot [m].
        length: Cable length l [m].
        mass: m of the load [kg].
        gravity: g [m/s²].
    """
    return _two_modes(
        first_inertia=inertia + mass * height**2,
        coupling=mass * height * length,
        second_inertia=mass * length**2,
        first_stiffness=stiffness - (moment + mass * height) * gravity,
        second_stiffness=mass * gravity * length,
    )


def _two_modes(
    *,
    first_inertia: float,
    coupling: float,
    second_inertia: float,
    first_stiffness: float,
    second_stiffness: float,
) -> tuple[float, float]:
    """Return the slow and fast frequency [rad/s] of two coupled oscillators.

    They are the roots of det(K - ω² M) = a ω⁴ - b ω² + c with M = [[first inertia, -coupling],
    [-coupling, second inertia]] and K = diag(first stiffness, second stiffness).
    """
    a = first_inertia * second_inertia - coupling**2
    b = first_inertia * second_stiffness + second_inertia * first_stiffness
    c = first_stiffness * second_stiffness
    fast = (b + math.sqrt(b**2 - 4.0 * a * c)) / (2.0 * a)
    # The product of both roots is c/a: as in `double_pendulum`, no digits are lost.
    return math.sqrt(c / a / fast), math.sqrt(fast)


@_finite
def bending_jib(stiffness: float, inertia: float, radius: float, mass: float) -> float:
    """Return the frequency at which a jib that bends down at its root bounces with its load
    [rad/s]: √(k/(I + m x²)), for a small droop.

    The load follows the pivot's height; its sideways motion is of second order in the droop at
    rest.

    Args:
        stiffness: k of the root [N m/rad].
        inertia: I of the jib about its root [kg m²].
        radius: Trolley radius x [m].
        mass: m of trolley and load together [kg].
    """
    return math.sqrt(stiffness / (inertia + mass * radius**2))


@_finite
def convolved_zv(frequency: float, modes: Sequence[float]) -> float:
    """Return the share of an undamped swing that convolved zero-vibration shapers for several modes
    leave: Π |cos(π ω/(2 ω_i))|.

    Each shaper is two halves, half a period of its mode apart, and the transfer functions of
    convolved shapers multiply (Singer & Seering, J. Dyn. Sys. Meas. Control 112, 1990; Singhose,
    Kim & Kenison 2008 for double pendulums).

    Args:
        frequency: ω of the swing [rad/s].
        modes: ω_i of the shapers [rad/s].
    """
    shares = [abs(math.cos(math.pi * frequency / (2.0 * mode))) for mode in modes]
    return float(np.prod(shares))


@_finite
def heavy_rope(
    length: float, mass_per_metre: float, load: float, gravity: float, modes: int = 1
) -> np.ndarray:
    """Return the lowest frequencies of small swings of a point load on a rope with mass [rad/s],
    shape (modes,): the first is that of the load's swing, in the others the rope vibrates.

    At the height s above the load the tension is T = g (M + μ s), and a swing w(s) e^{iωt} follows
    from (T w')' + μ ω² w = 0. With z = 2 ω √((s + M/μ)/g) this is Bessel's equation of order 0. The
    pivot is at rest, w = 0, and at the load M ω² w + T w' = 0. With J₀(z) - (2/z) J₁(z) = -J₂(z),
    and likewise for Y, the frequencies are the roots ω of

        J₂(z₀) Y₀(z₁) - Y₂(z₀) J₀(z₁),   z₀ = 2 ω √(M/(μ g)),   z₁ = 2 ω √((l + M/μ)/g).

    As M goes to zero they become j₀ₖ/2 √(g/l) with the zeros of J₀ (Daniel Bernoulli 1732).

    Args:
        length: Cable length l [m].
        mass_per_metre: Mass of a metre of the rope, of all its falls together, μ [kg/m].
        load: Mass of the load M, more than zero [kg].
        gravity: g [m/s²].
        modes: Number of frequencies.
    """
    below = load / mass_per_metre
    # A wave takes this time from the pivot to the load.
    travel = 2.0 * (math.sqrt((length + below) / gravity) - math.sqrt(below / gravity))

    def boundary(omega: float) -> float:
        lower = 2.0 * omega * math.sqrt(below / gravity)
        upper = 2.0 * omega * math.sqrt((length + below) / gravity)
        jv = scipy.special.jv
        yv = scipy.special.yv
        return float(jv(2, lower) * yv(0, upper) - yv(2, lower) * jv(0, upper))

    # The swing lies between that of a load on a rope without mass and that of a rope without load.
    swing = math.sqrt(gravity / length)
    brackets = [(0.999 * swing, 1.203 * swing)]
    # The phases of the Bessel functions place ω times the travel time of vibration k between k π,
    # of a rope whose load stands still, and about (k + 3/4) π, of a rope without load.
    for k in range(1, modes):
        phase = k * math.pi
        brackets.append(((phase - 0.1) / travel, (phase + 0.75 * math.pi + 0.1) / travel))
    roots = [scipy.optimize.brentq(boundary, low, high, rtol=1e-14) for low, high in brackets]
    return np.array(roots[:modes])


@_finite
def capstan(friction: float, wrap: float) -> float:
    """Return the tension on the tight side of a rope over that on its slack side where it slips on
    a drum, T₂/T₁ = e^{μα} (Euler 1769, Eytelwein 1808).

    Args:
        friction: Coefficient of friction μ.
        wrap: Angle α of the rope on it [rad].
    """
    return math.exp(friction * wrap)
