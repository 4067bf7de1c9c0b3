"""Stability margins of a closed loop: damping of its modes, and gain, phase and delay margins of
each drive.

`loop_margins` has them for a controller of a crane. `regulator` is the controller as a linear
system, `sampled_plant` the crane with drives of any kind, and `margins` joins the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, schur
from scipy.optimize import brentq

from cranedyn.checks import finite
from cranedyn.clocks import at_begin_of_run
from cranedyn.controllers.affine import affine_form
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.linearisation import Sampled
from cranedyn.errors import CraneError
from cranedyn.export.matlab import linear_system
from cranedyn.interfaces import Controller, Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.signals import state_names

_VANISHING = 1e-9
"""Largest eigenvalue of the loop over a period that counts as zero. A mode of it would be gone to
1e-9 after one period; of a state that vanishes at once, round-off leaves less."""

_FREQUENCY_COUNT = 1200
"""Number of frequencies, from the lowest to half of the sampling rate."""

_LOWEST_FREQUENCY = 1e-3
"""Lowest of these frequencies [rad/s]."""

_RESONANCE_OFFSETS = np.concatenate(
    [-np.geomspace(0.2, 1e-5, 60), [0.0], np.geomspace(1e-5, 0.2, 60)]
)
"""Relative offsets of further frequencies around each resonance of the open loop, whose response
changes there within little."""


class Regulator(NamedTuple):
    """Linear controller about a rest: u = -(c x + d z), then x becomes a x + b z.

    Attributes:
        a: Shape (k, k), with k states of the controller.
        b: Shape (k, 2 n).
        c: Shape (m, k).
        d: Shape (m, 2 n).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


class Margin(NamedTuple):
    """Margins of a drive, the others unchanged.

    Attributes:
        upper_gain: Gain margin: the smallest factor above one on the drive's command at which the
            loop becomes unstable; inf if there is none.
        lower_gain: The largest factor below one at which it becomes unstable; 0 if there is none.
        delay: Delay margin: the delay of its commands at which the loop becomes unstable [s]; inf
            if there is none.
        phase: Phase margin: the smallest phase shift of its commands, lag or lead, at which the
            loop becomes unstable [rad]; inf if there is none.
    """

    upper_gain: float
    lower_gain: float
    delay: float
    phase: float


class Margins(NamedTuple):
    """Stability of a closed loop.

    Attributes:
        damping: Least share of critical damping of a mode, -Re s/|s|: 1 where nothing oscillates,
            negative where one grows.
        growth_rate: Largest growth rate of a mode [1/s], negative where it is stable.
        drives: Margins of each drive; empty where the loop is unstable.
    """

    damping: float
    growth_rate: float
    drives: tuple[Margin, ...]

    @property
    def least(self) -> Margin:
        """Worst margins over all drives."""
        if not self.drives:
            return Margin(1.0, 1.0, 0.0, 0.0)
        return Margin(
            min(d.upper_gain for d in self.drives),
            max(d.lower_gain for d in self.drives),
            min(d.delay for d in self.drives),
            min(d.phase for d in self.drives),
        )


def regulator(
    crane: Crane, controller: Controller, rest: State, *, t: float = 0.0, period: float
) -> Regulator:
    """Return the linear form of an affine controller about a rest at a time [s]. Its states are the
    integrals of the drives, and then those of `ControllerStates`. Limits of drives, and with them
    anti-windup, are no part of it.

    Raises:
        CraneError: If it has no affine form, see `cranedyn.controllers.affine`.
        OutOfRange: If it is for another control period [s].
    """
    layout = crane.layout
    rest = layout.as_state("rest", rest)
    controller = at_begin_of_run(controller, t, period)
    affine = affine_form(controller, np.array([t]), rest.q[layout.drives][None], 2 * layout.n)
    if affine is None:
        raise CraneError(
            f"The controller {type(controller).__name__} is not affine in the state, so it has no "
            "margins of this kind."
        )
    # States are the integrals of the drives that have one: in a period each adds the deviation of
    # its drive times the period.
    integrating = np.flatnonzero(affine.integral_gain)
    count = len(integrating)
    added = np.zeros((count, 2 * layout.n))
    added[np.arange(count), layout.drives[integrating]] = period
    integral_gain = np.zeros((layout.m, count))
    integral_gain[integrating, np.arange(count)] = affine.integral_gain[integrating]
    # The error of an instant is in the integral that the command of this instant takes.
    gain = affine.gain[-1] + integral_gain @ added
    law = Regulator(a=np.eye(count), b=added, c=integral_gain, d=gain)
    states = affine.states
    if states is None:
        return law
    return Regulator(
        a=block_diag(law.a, states.a),
        b=np.vstack([law.b, states.b]),
        c=np.hstack([law.c, -states.c]),
        d=law.d,
    )


def sampled_plant(
    crane: Crane,
    rest: State,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    control_period: float = 5e-3,
    converters: Converters | None = None,
) -> Sampled:
    """Linearise a crane with drives of any kind about a rest, and step it as `simulate` does.

    Its states are coordinates and rates, and with "velocity" the commands on their way to the
    converters. For "effort" it is `cranedyn.dynamics.linearisation.sampled`.

    Args:
        crane: The crane.
        rest: State to linearise about.
        drive: What the commands are, see `cranedyn.export.matlab.linear_system`.
        dt: Physics step [s].
        control_period: Time for which a command is held [s].
        converters: Frequency converters of "velocity"; None for typical ones.

    Raises:
        OutOfRange: If a time is out of range, or `drive` is no kind of drives.
    """
    system = linear_system(
        crane, rest, drive=drive, control_period=control_period, dt=dt, converters=converters
    )
    # A linear system leaves out states that are held; here they stay, at zero.
    names = state_names(crane)
    names += [name for name in system.states if name not in names]
    places = [names.index(name) for name in system.states]
    a = np.zeros((len(names), len(names)))
    a[np.ix_(places, places)] = system.a
    b = np.zeros((len(names), crane.layout.m))
    b[places] = system.b
    return Sampled(a, b, control_period)


def loop_margins(
    crane: Crane,
    controller: Controller,
    rest: State,
    *,
    drive: Drive = "effort",
    dt: float = 5e-4,
    control_period: float = 5e-3,
    converters: Converters | None = None,
) -> Margins:
    """Return the margins of a controller about a rest, see `margins`.

    Args:
        crane: The crane.
        controller: A controller with an affine form, see `cranedyn.controllers.affine`.
        rest: The rest.
        drive: What the commands are: efforts, accelerations or rates.
        dt: Physics step [s].
        control_period: Time between control instants [s].
        converters: Frequency converters of "velocity"; None for typical ones. Their lags and their
            delay count, their ramps do not.

    Raises:
        CraneError: If the controller has no affine form.
        OutOfRange: If a time is out of range, or the controller is for another control period.
    """
    plant = sampled_plant(
        crane, rest, drive=drive, dt=dt, control_period=control_period, converters=converters
    )
    law = regulator(crane, controller, rest, period=control_period)
    # Commands on their way are not measured; a controller that feeds them back remembers them.
    further = len(plant.a) - 2 * crane.layout.n
    law = law._replace(
        b=np.pad(law.b, ((0, 0), (0, further))), d=np.pad(law.d, ((0, 0), (0, further)))
    )
    return margins(plant, law)


def behind_observer(
    law: Regulator, plant: Sampled, gain: np.ndarray, measured: np.ndarray
) -> Regulator:
    """Return the same controller fed by the estimate of a filter that measures part of the state
    and knows the commands.

    The estimate is e = p + K (y - p_y) with the prediction p and the measurement y, that is
    e = (1 - K S) p + K S z with S selecting what is measured. The prediction follows the model with
    the command u = -(c x + d e): p ← A e + B u = (A - B d) e - B c x. The states of the result are
    (p, x).

    Args:
        law: Controller.
        plant: Crane model of the filter, over a control period.
        gain: Gain of the filter, shape (2 n, measured).
        measured: Indices of the measured coordinates and rates, shape (measured,).

    Raises:
        OutOfRange: If the gain has another shape or is not finite.
    """
    size = len(plant.a)
    indices = finite("measured", measured, ("measured",)).astype(int)
    selection = np.eye(size)[indices]
    from_state = finite("gain of the filter", gain, (size, len(indices))) @ selection
    from_prediction = np.eye(size) - from_state
    advance = plant.a - plant.b @ law.d
    return Regulator(
        a=np.block(
            [[advance @ from_prediction, -plant.b @ law.c], [law.b @ from_prediction, law.a]]
        ),
        b=np.vstack([advance @ from_state, law.b @ from_state]),
        c=np.hstack([law.d @ from_prediction, law.c]),
        d=law.d @ from_state,
    )


def margins(plant: Sampled, law: Regulator) -> Margins:
    """Return the margins of a crane under a linear controller, each drive's loop opened at its
    command while the others stay closed.

    Args:
        plant: The crane over a control period, see `sampled_plant`.
        law: Controller.

    Raises:
        OutOfRange: If a matrix of the controller has another shape or is not finite.
    """
    size, m = plant.b.shape
    k = len(law.a)
    finite("a of the controller", law.a, (k, k))
    finite("b of the controller", law.b, (k, size))
    finite("c of the controller", law.c, (m, k))
    finite("d of the controller", law.d, (m, size))

    # An eigenvalue z of the loop over a period T is the mode exp(s t) with s = ln(z)/T.
    eigenvalues = np.linalg.eigvals(_closed(plant, law, range(m)))
    # What vanishes within a period, such as a command on its way, is no mode.
    lasting = eigenvalues[np.abs(eigenvalues) > _VANISHING]
    modes = np.log(lasting.astype(complex))
    modes = modes / plant.period
    sizes = np.abs(modes)
    # A mode s = 0 has no damping ratio; it counts as 0.
    ratios = np.divide(-modes.real, sizes, out=np.zeros(len(modes)), where=sizes > 0.0)
    damping = float(ratios.min(initial=1.0))
    growth_rate = float(modes.real.max(initial=-math.inf))
    if not growth_rate < 0.0:
        return Margins(damping, growth_rate, ())
    return Margins(damping, growth_rate, tuple(_margin(plant, law, i) for i in range(m)))


def _closed(plant: Sampled, law: Regulator, drives: range | list[int]) -> np.ndarray:
    """Return the matrix of the loop closed at some of the drives, for the state (z, x)."""
    b = plant.b[:, drives]
    return np.block([[plant.a - b @ law.d[drives], -b @ law.c[drives]], [law.b, law.a]])


def _margin(plant: Sampled, law: Regulator, drive: int) -> Margin:
    """Return the margins of a drive whose loop is opened at its command.

    With the open loop L a factor k on the command is at the limit of stability where 1 + k L = 0:
    where L is real and negative, with k = -1/L. A phase shift is there where |L| = 1 and it closes
    the angle to -1, and a delay τ where ω τ does.
    """
    other_drives = [i for i in range(plant.b.shape[1]) if i != drive]
    a = _closed(plant, law, other_drives)
    b = np.concatenate([plant.b[:, drive], np.zeros(len(law.a))])[:, None]
    c = np.concatenate([law.d[drive], law.c[drive]])[None]
    transfer_function = _transfer_function(a, b, c)
    grid = _frequency_grid(a, plant.period)

    def response(frequencies: np.ndarray) -> np.ndarray:
        """Return L at frequencies [rad/s]."""
        return transfer_function(np.exp(1j * plant.period * frequencies))

    on_grid = response(grid)

    def zeros(
        quantity: Callable[[np.ndarray], np.ndarray], intervals: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the frequencies at which a quantity of L is zero, in some intervals of the
        grid.
        """
        changes_sign = np.diff(np.sign(quantity(on_grid))) != 0.0
        if intervals is not None:
            changes_sign &= intervals
        found = []
        for i in np.flatnonzero(changes_sign):
            found.append(
                brentq(
                    lambda frequency: quantity(response(np.array([frequency])))[0],
                    grid[i],
                    grid[i + 1],
                )
            )
        return np.array(found)

    # The angle of -L is zero on the negative axis. It jumps by 2π on the positive one, which would
    # look like a zero.
    negative = on_grid.real[:-1] <= 0.0
    gains = 1.0 / np.abs(response(zeros(lambda values: np.angle(-values), negative)))
    crossings = zeros(lambda values: np.abs(values) - 1.0)
    phase = np.angle(-response(crossings))
    delay = np.mod(phase, 2.0 * math.pi) / crossings
    # At both ends of the frequencies, zero (z = 1) and half of the sampling rate (z = -1), L is
    # real, so it may be on the negative axis there without a change of sign between.
    gains = np.append(gains, _gains_at_ends(a, plant.period, transfer_function))
    return Margin(
        float(min(gains[gains > 1.0], default=math.inf)),
        float(max(gains[gains < 1.0], default=0.0)),
        float(min(delay, default=math.inf)),
        float(min(np.abs(phase), default=math.inf)),
    )


def _gains_at_ends(
    a: np.ndarray, period: float, transfer_function: Callable[[np.ndarray], np.ndarray]
) -> list[float]:
    """Return the factors -1/L at frequency zero and at half of the sampling rate where L is
    negative.

    The first is what an unstable crane has: a jib that its weight would let fall is held only by
    an effort that grows faster with its angle than the moment of the weight does. A loop with an
    integrator has no finite L at zero, and no limit there: a pole that is slower than the lowest
    frequency counts as an integrator.

    Args:
        a: Matrix of the open loop over a period.
        period: Period of the loop [s].
        transfer_function: L as a function of complex numbers z, shape (k,).
    """
    ends = [-1.0]
    slowest = np.abs(np.linalg.eigvals(a) - 1.0).min()
    if slowest > _LOWEST_FREQUENCY * period:
        ends.insert(0, 1.0)
    gains = []
    for z in ends:
        value = float(transfer_function(np.array([z]))[0].real)
        if value < 0.0:
            gains.append(-1.0 / value)
    return gains


def _frequency_grid(a: np.ndarray, period: float) -> np.ndarray:
    """Return frequencies [rad/s] up to half of the sampling rate, closer at each resonance.

    Args:
        a: Matrix of the open loop over a period.
        period: Period of the loop [s].
    """
    highest = 0.999 * math.pi / period
    natural = np.abs(np.angle(np.linalg.eigvals(a))) / period
    resonances = natural[natural > _LOWEST_FREQUENCY]
    around_resonances = (resonances[:, None] * (1.0 + _RESONANCE_OFFSETS)).ravel()
    regular = np.geomspace(_LOWEST_FREQUENCY, highest, _FREQUENCY_COUNT)
    grid = np.unique(np.concatenate([regular, around_resonances]))
    return grid[grid < highest]


def _transfer_function(
    a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function c (z - a)⁻¹ b of complex numbers z, shape (k,), for a loop of one input
    and one output; a Schur form of a leaves substitutions.
    """
    # With a = Q T Q* it is (c Q) (z - T)⁻¹ (Q* b), and T is triangular.
    triangle, basis = schur(a, output="complex")
    inputs = (basis.conj().T @ b)[:, 0]
    outputs = (c @ basis)[0]

    def response(z: np.ndarray) -> np.ndarray:
        x = np.zeros((len(outputs), len(z)), dtype=complex)
        for i in reversed(range(len(outputs))):
            # Not a product of BLAS, whose threads cost more than so few numbers.
            solved = np.einsum("j,jk->k", triangle[i, i + 1 :], x[i + 1 :])
            x[i] = (inputs[i] + solved) / (z - triangle[i, i])
        return np.einsum("j,jk->k", outputs, x)

    return response
