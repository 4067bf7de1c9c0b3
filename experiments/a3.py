"""A3, slewing: the tangential swing against the paper's Eq. (10), its sign, and what the rest of
the difference is made of.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.signal import savgol_filter

from cranedyn import theory
from cranedyn.analysis.swing import Agreement, agreement
from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import DAMPING, STIFFNESS
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.references import hold, pulse
from experiments import harness
from experiments.harness import Claim, Outcome, PlannedRun, ResultTable, Setup, make_table

RADIUS = 20.0
"""Trolley radius [m]."""

LENGTH = 15.0
"""Cable length [m]."""

PULSE = 0.05
"""Angle of the slew pulse [rad]."""

PULSE_AT = 5.0
"""Start of the pulse [s], chosen here."""

DURATION = 70.0
"""Duration of the run [s]."""

ANALYSED_FROM = 4.0
"""Start of the comparison [s]."""

SMOOTHING_SAMPLES = 11
"""Samples in the window of the cubic Savitzky-Golay filter that turns the slew rate into a slew
acceleration. The number is our choice, none is published."""

MAX_EXCITATION = 1000.0
"""Largest x γ̈ with which a model of the swing is integrated [m/s²].

It is a hundred times gravity; no crane reaches it.
"""

DIGITS = Agreement(measured=1e-4, modelled=1e-4, correlation=1e-4, rms=1e-5)
"""One in the last digit of each number of the article's result.

Half of it is the rounding of the article; half is left for our slew gains, which are round numbers.
"""

PUBLISHED = Agreement(measured=0.0504, modelled=0.0504, correlation=0.9994, rms=0.00047)
"""The article's result."""


class SlewGains(NamedTuple):
    """Gains of the slew drive.

    Attributes:
        stiffness: k_p [N m/rad].
        damping: k_d [N m s/rad].
    """

    stiffness: float
    damping: float


USUAL_SLEW = SlewGains(STIFFNESS["slew"], DAMPING["slew"])
"""Gains of the hold controller, with which the slew drive is soft."""

STIFF_SLEW = SlewGains(1.0e7, 5.0e6)
"""Gains with which the slew drive follows the pulse."""

EQUATION = "Eq. (10), γ̈ filtered"
"""Name of the paper's model, driven as in the article."""

COLUMNS = ("t_s", "gamma_dot_rad_s", "x_m", "theta_rad", "theta_dot_rad_s", "l_m")
"""Columns that a recorded file must have."""


def filtered(t: np.ndarray, slew_rate: np.ndarray) -> np.ndarray:
    """Return the slew acceleration as one would measure it: the derivative of a Savitzky-Golay fit.

    Args:
        t: Times [s], shape (rows,).
        slew_rate: Slew rate [rad/s], shape (rows,).

    Raises:
        DataError: If there are too few samples, or they are not evenly spaced to within 1 %.
    """
    if len(t) < SMOOTHING_SAMPLES or np.ptp(np.diff(t)) > 0.01 * (t[1] - t[0]):
        raise DataError(
            f"The slew acceleration needs {SMOOTHING_SAMPLES} rows or more, evenly spaced in time."
        )
    return savgol_filter(slew_rate, SMOOTHING_SAMPLES, 3, deriv=1, delta=float(t[1] - t[0]))


def exact_acceleration(t: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the acceleration of a drive as the simulation has it, shape (rows,).

    Between two control instants it is the change of the rate over the time. At an instant it is the
    mean of the two accelerations beside it.
    """
    change = np.diff(rate) / np.diff(t)
    return np.concatenate([[change[0]], (change[1:] + change[:-1]) / 2.0, [change[-1]]])


def paper_model(
    t: np.ndarray,
    theta: np.ndarray,
    theta_rate: np.ndarray,
    excitation: np.ndarray,
    length: float,
    gravity: float,
) -> np.ndarray:
    """Return θ by Eq. (10), integrated from the first measured state [rad], shape (rows,).

    Args:
        t: Times [s], shape (rows,).
        theta: Measured θ [rad]; the first is the start.
        theta_rate: Measured rate of θ [rad/s]; the first is the start.
        excitation: Measured x γ̈ [m/s²], shape (rows,).
        length: Cable length [m].
        gravity: Gravity [m/s²].
    """

    def rates(s: float, y: np.ndarray) -> tuple[float, float]:
        push = float(np.interp(s, t, excitation))
        acceleration = theory.tangential_paper(
            float(y[0]), length=length, gravity=gravity, excitation=push
        )
        return y[1], acceleration

    return _integrated(rates, t, [theta[0], theta_rate[0]])[0]


def full_model(trajectory: Trajectory, gravity: float, extra_length: float = 0.0) -> np.ndarray:
    """Return θ by the equations with all rates, `theory.small_swing`, under the simulated motion of
    the drives [rad], shape (rows,).

    Args:
        trajectory: The run from the start of the comparison on.
        gravity: Gravity of the world [m/s²].
        extra_length: Length that rotational inertia adds to the pendulum, I/(m l) [m].
    """
    t = trajectory.t
    gamma_rate, x_rate, length_rate = trajectory.rates("gamma", "x", "l").T
    columns = {
        "length": trajectory["l_m"],
        "length_rate": length_rate,
        "x": trajectory["x_m"],
        "x_rate": x_rate,
        "x_acceleration": exact_acceleration(t, x_rate),
        "slew_rate": gamma_rate,
        "slew_acceleration": exact_acceleration(t, gamma_rate),
    }
    motion_at = make_interp_spline(t, np.stack(list(columns.values()), axis=1), k=1)

    def derivative(s: float, y: np.ndarray) -> np.ndarray:
        """Return the derivative of φ, θ and their rates."""
        motion = dict(zip(columns, motion_at(s).tolist(), strict=True))
        accelerations = theory.small_swing(y[:2], y[2:], gravity=gravity, **motion)
        # Inertia makes the pendulum longer, and with it every acceleration smaller.
        longer = motion["length"] + extra_length
        return np.concatenate([y[2:], accelerations * motion["length"] / longer])

    start = np.hstack([trajectory.coordinates("phi", "theta"), trajectory.rates("phi", "theta")])[0]
    return _integrated(derivative, t, start)[1]


def _integrated(derivative: Callable, t: np.ndarray, start: Sequence[float]) -> np.ndarray:
    """Return the solution of a differential equation at given times, shape (states, times).

    Raises:
        DataError: If it cannot be integrated up to the last time.
    """
    solution = solve_ivp(
        derivative,
        (t[0], t[-1]),
        start,
        method="DOP853",
        t_eval=t,
        rtol=1e-8,
        atol=1e-10,
        max_step=0.05,
    )
    if not solution.success:
        end = solution.t[-1] if len(solution.t) else t[0]
        raise DataError(
            f"A model of the swing cannot be integrated beyond t = {end:g} s: {solution.message}"
        )
    return solution.y


def run(
    setup: Setup,
    slew: SlewGains = USUAL_SLEW,
    *,
    crane: Crane | None = None,
    radius: float = RADIUS,
    length: float = LENGTH,
) -> Trajectory:
    """Swing the load by moving the jib aside and back.

    Args:
        setup: The world.
        slew: Gains of the slew drive.
        crane: A crane other than that of the world.
        radius: Trolley radius [m].
        length: Cable length [m].
    """
    return setup.make(planned_slewing(crane or setup.crane, slew, radius=radius, length=length))


def planned_slewing(
    crane: Crane,
    slew: SlewGains = USUAL_SLEW,
    *,
    radius: float = RADIUS,
    length: float = LENGTH,
) -> PlannedRun:
    """Return the run in which the jib moves aside and back.

    Args:
        crane: The crane.
        slew: Gains of the slew drive.
        radius: Trolley radius [m].
        length: Cable length [m].
    """
    start = crane.state(x=radius, l=length)
    controller = hold_controller(
        crane,
        stiffness={"gamma": slew.stiffness},
        damping={"gamma": slew.damping},
        gravity=STANDARD_GRAVITY,
    )
    half_period = math.pi * math.sqrt(length / STANDARD_GRAVITY)
    reference = pulse(crane, hold(crane, start), "gamma", PULSE, at=PULSE_AT, width=half_period)
    label = f"slew k_p = {slew.stiffness:.0e}"
    return PlannedRun(crane, controller, reference, start, DURATION, label)


class PaperSwing(NamedTuple):
    """Measured swing beside that by the paper's Eq. (10), from the start of the comparison on.

    Attributes:
        t: Times [s], shape (rows,).
        measured: Measured θ [rad], shape (rows,).
        modelled: θ by Eq. (10) [rad], shape (rows,).
        excitation: x γ̈, by which it is driven [m/s²], shape (rows,).
    """

    t: np.ndarray
    measured: np.ndarray
    modelled: np.ndarray
    excitation: np.ndarray

    @property
    def agreement(self) -> Agreement:
        """How well the two agree."""
        return agreement(self.measured, self.modelled)


def by_paper(
    data: Trajectory | Mapping[str, np.ndarray],
    acceleration: Callable[[np.ndarray, np.ndarray], np.ndarray] = filtered,
    gravity: float = STANDARD_GRAVITY,
) -> PaperSwing:
    """Return the swing of a run, or of recorded columns, beside that by the paper's Eq. (10).

    Args:
        data: The run or the columns.
        acceleration: Function that takes times and slew rates and returns slew accelerations.
        gravity: Gravity of the model [m/s²].

    Raises:
        DataError: If the record is too short or too coarse, or x γ̈ is beyond `MAX_EXCITATION`.
    """
    late = data["t_s"] >= ANALYSED_FROM
    if np.count_nonzero(late) < 2:
        raise DataError(
            f"The record ends at {data['t_s'][-1]:g} s; the comparison starts at {ANALYSED_FROM:g} "
            "s."
        )
    # All rows are filtered, so that the first ones of the comparison are not at an end.
    slew_acceleration = acceleration(data["t_s"], data["gamma_dot_rad_s"])
    excitation = (data["x_m"] * slew_acceleration)[late]
    strongest = float(np.abs(excitation).max())
    if strongest > MAX_EXCITATION:
        raise DataError(
            f"The jib accelerates the trolley sideways by up to {strongest:.3g} m/s²; allowed is "
            f"up to {MAX_EXCITATION:g} m/s²."
        )
    t = data["t_s"][late]
    theta = data["theta_rad"][late]
    theta_rate = data["theta_dot_rad_s"][late]
    length = float(data["l_m"][late].mean())
    modelled = paper_model(t, theta, theta_rate, excitation, length, gravity)
    return PaperSwing(t, theta, modelled, excitation)


def stages(crane: Crane, trajectory: Trajectory) -> list[tuple[str, Agreement]]:
    """Return the agreement of one model after the other with a run.

    Each model has one cause of error less than the one before; its name says which.
    """
    late = trajectory.since(ANALYSED_FROM)
    theta = late["theta_rad"]
    gravity = crane.gravity
    length = float(late["l_m"].mean())

    # Rotational inertia acts as a longer pendulum, and so does a finite swing, whose period is
    # longer: the length goes with the square of the period.
    inertia = crane.payload_inertia[1, 1] + crane.dummy_inertia[1]
    inertia_length = inertia / (crane.payload_mass * length)
    amplitude = math.sqrt(2.0) * float(np.std(trajectory.since(DURATION / 2.0)["theta_rad"]))
    longer = float(theory.amplitude_factor(amplitude)) ** 2 - 1.0
    finite_swing_length = inertia_length + longer * (length + inertia_length)

    models = {
        "Eq. (10), γ̈ filtered as measured": by_paper(trajectory).modelled,
        "Eq. (10), γ̈ exact": by_paper(trajectory, exact_acceleration).modelled,
        "and the gravity of the world": by_paper(trajectory, exact_acceleration, gravity).modelled,
        "and all rates kept": full_model(late, gravity),
        "and rotational inertia": full_model(late, gravity, inertia_length),
        "and the period of a finite swing": full_model(late, gravity, finite_swing_length),
    }
    return [(name, agreement(theta, modelled)) for name, modelled in models.items()]


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run the slew pulse with a soft and a stiff drive, or analyse recorded files."""
    if options.files:
        files = harness.analyse_files(options, COLUMNS, lambda _, data: by_paper(data).agreement)
        rows = [(file, EQUATION, result) for file, result in files.results]
        return Outcome([files.noted(_table([*rows, ("article", "", PUBLISHED)]))])
    position = {"radius": options.radius, "length": options.length}
    soft = run(setup, **position)
    stiff = run(setup, STIFF_SLEW, **position)
    results = {"soft": stages(setup.crane, soft), "stiff": stages(setup.crane, stiff)}
    rows = []
    for drive, models in results.items():
        rows += [(drive, name, result) for name, result in models]
    as_published = options.radius == RADIUS and options.length == LENGTH
    return Outcome(
        tables=[_table([*rows, ("article", EQUATION, PUBLISHED)])],
        claims=_claims(setup, results, as_published),
        parameters={
            **position,
            "slew_soft": list(USUAL_SLEW),
            "slew_stiff": STIFF_SLEW,
            "smoothing_samples": SMOOTHING_SAMPLES,
            "pulse_at_s": PULSE_AT,
        },
        trajectories={"a3": soft, "a3_stiff": stiff},
        figures={"slewing": _slewing_figure(by_paper(soft)), "stages": _stages_figure(results)},
        recording=harness.side_by_side({"soft slew drive": (setup.crane, soft)}),
    )


def _claims(
    setup: Setup, results: Mapping[str, Sequence[tuple[str, Agreement]]], as_published: bool
) -> list[Claim]:
    """Return the claims.

    Args:
        setup: The world.
        results: Name and agreement of each stage, by drive.
        as_published: Whether the trolley and the cable are where the article has them.
    """
    soft = [result for _, result in results["soft"]]
    stiff = [result for _, result in results["stiff"]]
    ours = soft[0]
    of_stiff = stiff[0]
    are_met = all(
        abs(getattr(ours, name) - getattr(PUBLISHED, name)) < getattr(DIGITS, name)
        for name in ("measured", "correlation", "rms")
    )
    return [
        Claim(
            f"θ has the sign of Eq. (10): correlation {ours.correlation:+.4f} with a soft slew "
            f"drive, {of_stiff.correlation:+.4f} with a stiff one.",
            min(ours.correlation, of_stiff.correlation) > 0.99,
        ),
        Claim(
            f"Amplitude, correlation and RMS are the published within {DIGITS.measured:g} rad, "
            f"{DIGITS.correlation:g} and {DIGITS.rms:.0e} rad, one of their last digits "
            f"({ours.measured:.5f}, {ours.correlation:+.5f}, {ours.rms:.6f}).",
            setup.judged(are_met) if as_published else None,
        ),
        Claim(
            "With every cause gone the rest is below 0.5 % of the amplitude "
            f"({100 * soft[-1].relative:.2f} % soft, {100 * stiff[-1].relative:.2f} % stiff).",
            max(soft[-1].relative, stiff[-1].relative) < 0.005,
        ),
    ]


def _table(rows: Sequence[tuple[str, str, Agreement]]) -> ResultTable:
    return make_table(
        "Tangential swing after a slew pulse",
        rows,
        ("slew drive", "", lambda row: row[0]),
        ("model", "", lambda row: row[1]),
        ("θ measured [rad]", ".4f", lambda row: row[2].measured),
        ("θ model [rad]", ".4f", lambda row: row[2].modelled),
        ("correlation", "+.5f", lambda row: row[2].correlation),
        ("RMS [rad]", ".6f", lambda row: row[2].rms),
        ("of amplitude [%]", ".2f", lambda row: 100 * row[2].relative),
        note="Amplitudes are the largest |θ|. From one row to the next one cause of difference "
        "goes: the filter, the constant of gravity, the dropped rates, the inertia, the small "
        "angle.",
    )


def _slewing_figure(swing: PaperSwing) -> Figure:
    """Draw the push x γ̈ above, measured and modelled swing below."""
    figure, (above, below) = panels(2, height=2.6, sharex=True)
    above.plot(swing.t, swing.excitation, color=COLOURS["gamma"])
    above.set_ylabel("x γ̈ [m/s²]")
    below.plot(swing.t, np.degrees(swing.measured), color=COLOURS["theta"], label="θ simulated")
    below.plot(
        swing.t,
        np.degrees(swing.modelled),
        "--",
        color=COLOURS["unexplained"],
        linewidth=1.0,
        label="θ by Eq. (10)",
    )
    below.set(ylabel="θ [°]", xlabel="time [s]")
    legend_above(below, columns=2)
    return figure


def _stages_figure(results: Mapping[str, Sequence[tuple[str, Agreement]]]) -> Figure:
    """Draw the difference that is left as one cause after the other is removed."""
    figure, (ax,) = panels(1, height=3.0)
    names = [name for name, _ in results["soft"]]
    positions = np.arange(len(names))
    for drive, colour, shift in (
        ("soft", COLOURS["theta"], -0.18),
        ("stiff", COLOURS["gamma"], 0.18),
    ):
        shares = [100 * result.relative for _, result in results[drive]]
        label = f"{drive} slew drive"
        bars = ax.barh(positions + shift, shares, 0.34, color=colour, label=label)
        ax.bar_label(bars, fmt="%.2f %%", padding=3)
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.margins(x=0.12)
    ax.set_xlabel("RMS difference in θ [% of its amplitude]")
    legend_above(ax)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("a3", __doc__)
    harness.add_setup(parser, "trolley_init", "hoist_init")
    add = parser.add_argument
    add("--radius", type=float, default=RADIUS, metavar="X", help="trolley radius [m]")
    add("--length", type=float, default=LENGTH, metavar="L", help="cable length [m]")
    harness.add_files(parser, COLUMNS)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
