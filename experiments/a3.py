"""A3, slewing: the tangential swing against the paper's Eq. (10), its sign, and what the rest of
the difference is made of.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

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
from cranedyn.plotting.figures import COLOURS, panels
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

SMOOTHING = 11
"""Samples in the Savitzky-Golay window (cubic) that turns the slew rate into a slew acceleration;
ours, none is published."""

STRONGEST = 1000.0
"""Largest x γ̈ that a model of the swing is integrated with [m/s²], a hundred times gravity; there
is no such crane."""

DIGITS = Agreement(measured=1e-4, modelled=1e-4, correlation=1e-4, rms=1e-5)
"""The last digits of the article's result: half of each is its rounding, half is left for our slew
gains, which are round numbers."""

PUBLISHED = Agreement(measured=0.0504, modelled=0.0504, correlation=0.9994, rms=0.00047)
"""The article's result."""

STIFF_SLEW = (1.0e7, 5.0e6)
"""k_p [N m/rad] and k_d [N m s/rad] of a slew drive that follows the pulse."""

EQUATION = "Eq. (10), γ̈ filtered"
"""Name of the paper's model, driven as in the article."""

COLUMNS = ("t_s", "gamma_dot_rad_s", "x_m", "theta_rad", "theta_dot_rad_s", "l_m")


def filtered(t: np.ndarray, slew_rate: np.ndarray) -> np.ndarray:
    """Return the slew acceleration as from a measurement: the derivative of a Savitzky-Golay fit.

    Raises:
        DataError: If the samples are too few or not evenly spaced within 1 %.
    """
    if len(t) < SMOOTHING or np.ptp(np.diff(t)) > 0.01 * (t[1] - t[0]):
        raise DataError(
            f"The slew acceleration needs {SMOOTHING} rows or more, evenly spaced in time."
        )
    return savgol_filter(slew_rate, SMOOTHING, 3, deriv=1, delta=float(t[1] - t[0]))


def exact_acceleration(t: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the acceleration as the simulation has it: the change of rate over each control period
    is exact; here at the instants between them.
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
    """Integrate Eq. (10) from the first measured state, driven by measured x(t) γ̈(t); shapes
    (n,).
    """

    def rates(s: float, y: np.ndarray) -> tuple[float, float]:
        push = float(np.interp(s, t, excitation))
        angle = float(y[0])
        return y[1], theory.tangential_paper(angle, length=length, gravity=gravity, excitation=push)

    return _integrate(rates, t, [theta[0], theta_rate[0]])[0]


def full_model(trajectory: Trajectory, gravity: float, extra_length: float = 0.0) -> np.ndarray:
    """Return θ by the equations with all rates (`theory.small_swing`), driven by the motion of the
    drives as simulated; shape (n,).

    Args:
        trajectory: The run, already cut to the comparison.
        gravity: Gravity of the world [m/s²].
        extra_length: Length that rotational inertia adds to the restoring pendulum, I/(m l) [m].
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
    drives = make_interp_spline(t, np.stack(list(columns.values()), axis=1), k=1)

    def derivative(s: float, y: np.ndarray) -> np.ndarray:
        motion = dict(zip(columns, drives(s).tolist(), strict=True))
        swing = theory.small_swing(y[:2], y[2:], gravity=gravity, **motion)
        return np.concatenate([y[2:], swing * motion["length"] / (motion["length"] + extra_length)])

    start = np.hstack([trajectory.coordinates("phi", "theta"), trajectory.rates("phi", "theta")])[0]
    return _integrate(derivative, t, start)[1]


def _integrate(derivative: Callable, t: np.ndarray, start: Sequence[float]) -> np.ndarray:
    exact: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-10, "max_step": 0.05}
    solution = solve_ivp(derivative, (t[0], t[-1]), start, method="DOP853", t_eval=t, **exact)
    if not solution.success:
        end = solution.t[-1] if len(solution.t) else t[0]
        raise DataError(
            f"A model of the swing cannot be integrated beyond t = {end:g} s: {solution.message}"
        )
    return solution.y


def run(
    setup: Setup,
    slew: Sequence[float] = (STIFFNESS["slew"], DAMPING["slew"]),
    *,
    crane: Crane | None = None,
    radius: float = RADIUS,
    length: float = LENGTH,
) -> Trajectory:
    """Swing the load by moving the jib aside and back.

    Args:
        setup: The world.
        slew: k_p [N m/rad] and k_d [N m s/rad] of the slew drive.
        crane: A crane other than that of the world.
        radius: Trolley radius [m].
        length: Cable length [m].
    """
    return setup.make(planned_slewing(crane or setup.crane, slew, radius=radius, length=length))


def planned_slewing(
    crane: Crane,
    slew: Sequence[float] = (STIFFNESS["slew"], DAMPING["slew"]),
    *,
    radius: float = RADIUS,
    length: float = LENGTH,
) -> PlannedRun:
    """Return the run in which the jib moves aside and back.

    Args:
        crane: The crane.
        slew: k_p [N m/rad] and k_d [N m s/rad] of the slew drive.
        radius: Trolley radius [m].
        length: Cable length [m].
    """
    start = crane.state(x=radius, l=length)
    controller = hold_controller(
        crane,
        stiffness={"gamma": slew[0]},
        damping={"gamma": slew[1]},
        gravity=STANDARD_GRAVITY,
    )
    half_period = math.pi * math.sqrt(length / STANDARD_GRAVITY)
    reference = pulse(crane, hold(crane, start), "gamma", PULSE, at=PULSE_AT, width=half_period)
    label = f"slew k_p = {slew[0]:.0e}"
    return PlannedRun(crane, controller, reference, start, DURATION, label)


def by_paper(
    data: Trajectory | dict[str, np.ndarray],
    acceleration: Callable[[np.ndarray, np.ndarray], np.ndarray] = filtered,
    gravity: float = STANDARD_GRAVITY,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return times, measured θ, θ by Eq. (10) and its push x γ̈ from the start of the comparison,
    of a run or of recorded columns.

    Raises:
        DataError: If the record is too short or too coarse, or x γ̈ is beyond `STRONGEST`.
    """
    late = data["t_s"] >= ANALYSED_FROM
    if np.count_nonzero(late) < 2:
        raise DataError(
            f"The record ends at {data['t_s'][-1]:g} s; the comparison starts at {ANALYSED_FROM:g} "
            "s."
        )
    t, x, theta, theta_rate, length = (
        data[name][late] for name in COLUMNS if name != "gamma_dot_rad_s"
    )
    excitation = x * acceleration(data["t_s"], data["gamma_dot_rad_s"])[late]
    if (strongest := float(np.abs(excitation).max())) > STRONGEST:
        raise DataError(
            f"The jib accelerates the trolley sideways by up to {strongest:.3g} m/s²; allowed is "
            f"up to {STRONGEST:g} m/s²."
        )
    model = paper_model(t, theta, theta_rate, excitation, float(length.mean()), gravity)
    return t, theta, model, excitation


def stages(crane: Crane, trajectory: Trajectory) -> list[tuple[str, Agreement]]:
    """Return the agreement of one model after the other, each with one cause of error less."""
    late = trajectory.since(ANALYSED_FROM)
    theta = late["theta_rad"]
    g = crane.gravity
    length = float(late["l_m"].mean())
    inertia = (crane.payload_inertia[1, 1] + crane.dummy_inertia[1]) / (crane.payload_mass * length)
    amplitude = math.sqrt(2.0) * float(np.std(trajectory.since(DURATION / 2.0)["theta_rad"]))
    slower = float(theory.amplitude_factor(amplitude)) ** 2
    finite = inertia + (slower - 1.0) * (length + inertia)
    models = {
        "Eq. (10), γ̈ filtered as measured": by_paper(trajectory)[2],
        "Eq. (10), γ̈ exact": by_paper(trajectory, exact_acceleration)[2],
        "and the gravity of the world": by_paper(trajectory, exact_acceleration, g)[2],
        "and all rates kept": full_model(late, g),
        "and rotational inertia": full_model(late, g, inertia),
        "and the period of a finite swing": full_model(late, g, finite),
    }
    return [(name, agreement(theta, model)) for name, model in models.items()]


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Run the slew pulse with a soft and a stiff drive, or analyse recorded files."""
    if options.files:
        files = harness.analyse_files(
            options, COLUMNS, lambda _, data: agreement(*by_paper(data)[1:3])
        )
        rows = [(file, EQUATION, result) for file, result in files.results]
        return Outcome([files.noted(_table([*rows, ("article", "", PUBLISHED)]))])
    position = {"radius": options.radius, "length": options.length}
    soft = run(setup, **position)
    stiff = run(setup, STIFF_SLEW, **position)
    results = {"soft": stages(setup.crane, soft), "stiff": stages(setup.crane, stiff)}
    rows = [(drive, name, a) for drive, models in results.items() for name, a in models]
    return Outcome(
        tables=[_table([*rows, ("article", EQUATION, PUBLISHED)])],
        claims=list(_claims(setup, results, position == {"radius": RADIUS, "length": LENGTH})),
        parameters={
            **position,
            "slew_soft": [STIFFNESS["slew"], DAMPING["slew"]],
            "slew_stiff": STIFF_SLEW,
            "smoothing_samples": SMOOTHING,
            "pulse_at_s": PULSE_AT,
        },
        trajectories={"a3": soft, "a3_stiff": stiff},
        figures={"slewing": _slewing_figure(*by_paper(soft)), "stages": _stages_figure(results)},
        recording=harness.side_by_side({"soft slew drive": (setup.crane, soft)}),
    )


def _claims(
    setup: Setup, results: Mapping[str, Sequence[tuple[str, Agreement]]], as_published: bool
) -> Iterator[Claim]:
    soft, stiff = ([result for _, result in models] for models in results.values())
    ours = soft[0]
    hard = stiff[0]
    last = (soft[-1].relative, stiff[-1].relative)
    yield Claim(
        f"θ has the sign of Eq. (10): correlation {ours.correlation:+.4f} with a soft slew "
        f"drive, {hard.correlation:+.4f} with a stiff one.",
        min(ours.correlation, hard.correlation) > 0.99,
    )
    met = all(
        abs(getattr(ours, name) - getattr(PUBLISHED, name)) < getattr(DIGITS, name)
        for name in ("measured", "correlation", "rms")
    )
    yield Claim(
        f"Amplitude, correlation and RMS are the published within {DIGITS.measured:g} rad, "
        f"{DIGITS.correlation:g} and {DIGITS.rms:.0e} rad, one of their last digits "
        f"({ours.measured:.5f}, {ours.correlation:+.5f}, {ours.rms:.6f}).",
        setup.judged(met) if as_published else None,
    )
    yield Claim(
        "With every cause gone the rest is below 0.5 % of the amplitude "
        f"({100 * last[0]:.2f} % soft, {100 * last[1]:.2f} % stiff).",
        max(last) < 0.005,
    )


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


def _slewing_figure(
    t: np.ndarray, measured: np.ndarray, modelled: np.ndarray, excitation: np.ndarray
) -> Figure:
    """Draw the push x γ̈ above, measured and modelled swing below."""
    figure, (above, below) = panels(2, height=2.6, sharex=True)
    above.plot(t, excitation, color=COLOURS["gamma"])
    above.set_ylabel("x γ̈ [m/s²]")
    below.plot(t, np.degrees(measured), color=COLOURS["theta"], label="θ simulated")
    style: Any = {"color": COLOURS["unexplained"], "linewidth": 1.0}
    below.plot(t, np.degrees(modelled), "--", label="θ by Eq. (10)", **style)
    below.set(ylabel="θ [°]", xlabel="time [s]")
    below.legend(loc="upper right", ncols=2)
    return figure


def _stages_figure(results: Mapping[str, Sequence[tuple[str, Agreement]]]) -> Figure:
    """Draw the difference that is left as one cause after the other is removed."""
    figure, (ax,) = panels(1, height=3.0)
    for (drive, models), colour, shift in zip(
        results.items(), (COLOURS["theta"], COLOURS["gamma"]), (-0.18, 0.18), strict=True
    ):
        shares = [100 * result.relative for _, result in models]
        positions = np.arange(len(models))
        name = f"{drive} slew drive"
        bars = ax.barh(positions + shift, shares, 0.34, color=colour, label=name)
        ax.bar_label(bars, fmt="%.2f %%", padding=3)
    ax.set_yticks(range(len(models)), [name for name, _ in models])
    ax.invert_yaxis()
    ax.margins(x=0.12)
    ax.set_xlabel("RMS difference in θ [% of its amplitude]")
    ax.legend()
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
