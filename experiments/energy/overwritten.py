"""The article's broken crane: what a plugin that overwrites the passive velocities at every step
does to the swing, in closed form.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from cranedyn.data.trajectory import Trajectory, read_columns
from cranedyn.dynamics.equations_of_motion import energy
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from experiments.energy.swing import (
    AUDIT,
    DAMPINGS,
    PUBLISHED,
    Oscillation,
    oscillation,
    resting_energy,
    run,
    swing_energy,
)
from experiments.gazebo import RECORDINGS
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table

PUBLISHED_RATIO = 0.55
"""Damping ratio that the article saw, about."""

MAX_DIFFERENCE = 1e-6
"""Largest difference from the swing in Gazebo over 6 s [rad].

Gazebo's step moves centres of mass along chords, which makes the cable longer by h l ω²/2.
"""


def closed_form(crane: Crane, length: float, dt: float) -> Oscillation:
    """Return the swing under the plugin.

    At every step the two dummy links lose their rates, I φ̇, which the joints to the load give back
    to them from its swing: the torque (ΣI/dt) φ̇. The joints' own dampers see a rate of zero and
    exert nothing.

    Args:
        crane: The crane.
        length: Of the cable [m].
        dt: Physics step [s].
    """
    return oscillation(crane, length, crane.dummy_inertia[0] / dt)


def fitted(t: np.ndarray, phi: np.ndarray) -> Oscillation:
    """Fit an oscillation to a swing from rest."""

    def misfit(parameters: np.ndarray) -> np.ndarray:
        return Oscillation(*parameters)(t)[0] - phi / phi[0]

    fit = least_squares(misfit, (0.8, 0.5), bounds=((0.01, 0.0), (100.0, 0.999)))
    return Oscillation(*fit.x.tolist())


def recorded(crane: Crane) -> dict[str, np.ndarray]:
    """Read the swing recorded in Gazebo, with coordinates and rates."""
    columns = [column for joint in crane.layout.joints for column in joint.columns]
    return read_columns(RECORDINGS / "swing_overwritten.parquet", ["t_s", *columns])


def final_swing_energy(crane: Crane, data: dict[str, np.ndarray]) -> float:
    """Return the swing energy at the end of a recording [J].

    It is counted from the load hanging at rest where the drives started.

    Args:
        crane: The crane.
        data: Coordinates and rates of the recording.
    """
    first = []
    last = []
    last_rates = []
    for joint in crane.layout.joints:
        position, rate = joint.columns
        first.append(data[position][0])
        last.append(data[position][-1])
        last_rates.append(data[rate][-1])
    end = State(np.array(last), np.array(last_rates))
    return energy(crane, end) - resting_energy(crane, np.array(first))


def experiment(setup: Setup, swing: float, length: float) -> Outcome:
    """Run the swing as it should be and under the plugin, and compare it with Gazebo.

    Args:
        setup: The world.
        swing: Swing at the start [rad].
        length: Cable length [m].
    """
    cranes = {damping: setup.variant(damp_swing=damping) for damping in DAMPINGS}
    crane = cranes[1.0]
    expected = closed_form(crane, length, setup.dt)
    if not expected.ratio < 1.0:
        raise OutOfRange(
            "damping ratio under the plugin",
            f"{expected.ratio:.3g}",
            "below 1: a longer dt, lighter links, a longer cable",
        )
    plugin_damping = crane.dummy_inertia[0] / setup.dt
    broken = setup.variant(damp_swing=plugin_damping)
    runs = {}
    energies = {}
    for damping, variant in cranes.items():
        runs[damping] = run(setup, variant, swing, length, AUDIT)
        energies[damping] = float(swing_energy(variant, runs[damping])[-1])
    stopped = run(setup, broken, swing, length, AUDIT)
    kept_energy = float(swing_energy(broken, stopped)[-1])

    gazebo_run = recorded(crane)
    gazebo_energy = final_swing_energy(broken, gazebo_run)
    fit_here = fitted(stopped.t, stopped["phi_rad"])
    fit_in_gazebo = fitted(gazebo_run["t_s"], gazebo_run["phi_rad"])
    # The recording says something of this run only if both begin alike in the article's world.
    recorded_start = (gazebo_run["phi_rad"][0], gazebo_run["l_m"][0])
    is_same = bool(setup.judged(True)) and np.allclose((swing, length), recorded_start, rtol=1e-12)
    deviation = math.inf
    if is_same:
        deviation = float(np.abs(stopped["phi_rad"] - gazebo_run["phi_rad"]).max())

    lift_energy = crane.payload_mass * crane.gravity * float(stopped["l_m"][0] - stopped["l_m"][-1])
    claims = [
        _damper_claim(plugin_damping, expected.ratio, fit_here.ratio, swing),
        Claim(
            f"Gazebo with such a plugin swings as this crane with that damper within "
            f"{MAX_DIFFERENCE:g} rad ({deviation:.1e} rad), and keeps {gazebo_energy:.2f} J where "
            f"this one keeps {kept_energy:.2f} J.",
            deviation < MAX_DIFFERENCE and abs(gazebo_energy - kept_energy) < 0.01
            if is_same
            else None,
        ),
        Claim(
            f"That is the article's loss: ζ = {fit_here.ratio:.3f} where it saw about "
            f"{PUBLISHED_RATIO:g}, half a unit of its last digit allowed.",
            abs(fit_here.ratio - PUBLISHED_RATIO) < 0.005 if is_same else None,
        ),
    ]
    rows = [
        ("closed form", expected.ratio, expected.frequency, None),
        ("here, damper ΣI/dt", fit_here.ratio, fit_here.frequency, kept_energy),
        (
            "Gazebo 11.1, rates overwritten",
            fit_in_gazebo.ratio,
            fit_in_gazebo.frequency,
            gazebo_energy,
        ),
        ("article", PUBLISHED_RATIO, None, PUBLISHED.last),
    ]
    name = "swing with its passive rates overwritten"
    loss_table = ResultTable(
        f"The article's loss, after {AUDIT:g} s",
        [(name, ""), ("ζ", ".4f"), ("ω [rad/s]", ".4f"), ("energy left [J]", ".2f")],
        rows,
        f"Of the energy left {lift_energy:.2f} J are the load's height: the hoist's feed-forward "
        "believes in standard gravity and lifts it.",
    )
    return Outcome(
        tables=[loss_table, _dampings(energies, kept_energy)],
        claims=claims,
        parameters={"swing_rad": swing, "length_m": length, "overwritten": True},
        trajectories={"energy_overwritten": stopped},
        figures={"overwritten": _figure(runs[1.0], stopped, gazebo_run if is_same else None)},
    )


def _damper_claim(damping: float, expected: float, simulated: float, swing: float) -> Claim:
    """Return the claim that the plugin damps as its damper does on paper.

    Args:
        damping: Damping constant of the plugin, ΣI/dt [N m s/rad].
        expected: Damping ratio by the closed form.
        simulated: Damping ratio of the simulated run.
        swing: Swing at the start [rad].
    """
    error = abs(simulated / expected - 1.0)
    # A swing A weakens gravity's spring by that share.
    tolerance = swing**2 / 8
    return Claim(
        f"The plugin is a damper of ΣI/dt = {damping:.3g} N m s/rad: "
        f"ζ = (ΣI/dt)/(2 J ω) = {expected:.4f}, simulated {simulated:.4f}, off by {error:.1e}, "
        f"within A²/8 = {tolerance:.1e}, by which a swing A weakens gravity's spring.",
        error < tolerance,
    )


def _dampings(kept_energy: dict[float, float], overwritten: float) -> ResultTable:
    return make_table(
        "Damping of the swing joints does not reach the swing",
        kept_energy,
        ("damp_swing [N m s/rad]", "g", lambda damping: damping),
        ("left as it should be [J]", ".2f", lambda damping: kept_energy[damping]),
        ("left under the plugin [J]", ".2f", lambda damping: overwritten),
        note="Under the plugin a joint's damper sees a rate of zero. In Gazebo the three runs are "
        "then the same to the byte, as in the article.",
    )


def _figure(
    free: Trajectory, stopped: Trajectory, gazebo_run: dict[str, np.ndarray] | None
) -> Figure:
    figure, (ax,) = panels(1, height=3.0)
    ax.plot(free.t, free["phi_rad"], color=COLOURS["energy"], label="as it should be")
    ax.plot(stopped.t, stopped["phi_rad"], color=COLOURS["unexplained"], label="damper ΣI/dt, here")
    if gazebo_run is not None:
        t = gazebo_run["t_s"][::40]
        phi = gazebo_run["phi_rad"][::40]
        ax.plot(t, phi, "x", color=COLOURS["x"], label="rates overwritten, Gazebo")
    ax.set(xlabel="time [s]", ylabel="φ [rad]")
    legend_above(ax)
    return figure
