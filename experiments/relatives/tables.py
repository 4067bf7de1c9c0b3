"""The tables of the experiment cranes."""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from experiments.harness import ResultTable, tabulate
from experiments.relatives import modes, pendulum, rope
from experiments.relatives.agreement import DURATION, EngineAgreement
from experiments.relatives.catalogue import HOOK, relative_crane, rest_at
from experiments.relatives.control import AREA, GUST, SWING, WAY, ControlResult
from experiments.relatives.robots import STEP, Robot


def frequency_table(results: Sequence[modes.Frequency]) -> ResultTable:
    """Return frequencies by closed form, linearisation and small swings."""
    return tabulate(
        "Frequencies",
        results,
        [
            ("crane", "", lambda f: f.crane),
            ("mode", "", lambda f: f.mode),
            ("closed form [rad/s]", ".8f", lambda f: f.closed),
            ("linearised", ".8f", lambda f: f.linear),
            ("off", "+.0e>1e-11", lambda f: f.linear - f.closed),
            ("small swing", ".8f", lambda f: f.simulated),
            ("of the step", "+.0e", lambda f: f.stepped - f.linear),
            ("rest", "+.0e>1e-11", lambda f: f.simulated - f.stepped),
        ],
        "Drives locked but where they roll. The tower that twists is that of a hand-derived 2 × 2 "
        "model without the trolley, 0.79786094 and 4.53213150 rad/s: the multibody agrees when the "
        "trolley's m x² is counted within the 1e6 kg m², and is slower by what the trolley adds "
        "when it is not. A structure that leans at rest is held to the square of that angle.",
    )


def jump_table(results: Sequence[rope.Jump]) -> ResultTable:
    """Return the tensions of a rope that stretches."""
    return tabulate(
        "Rope that stretches: tension over the weight that hangs",
        results,
        [
            ("what happens", "", lambda j: j.name),
            ("closed form", ".4f", lambda j: j.closed),
            ("run", ".4f", lambda j: j.simulated),
            ("off", "+.1e", lambda j: j.simulated - j.closed),
            ("allowed", ".1e", lambda j: j.allowed),
            ("because of", "", lambda j: j.why),
        ],
    )


def agreement_table(results: Sequence[EngineAgreement]) -> ResultTable:
    """Return the agreement of three engines and the ledger."""
    return tabulate(
        f"Three engines, {DURATION:g} s with all drives moving and the load swinging",
        results,
        [
            ("crane", "", lambda a: a.relative.name),
            ("joints", "d", lambda a: relative_crane(a.relative).layout.n),
            ("Pinocchio - code", ".0e>1e-12", lambda a: a.engines),
            ("Pinocchio - MuJoCo", ".0e>1e-12", lambda a: a.mujoco),
            ("energy [J]", ".0f", lambda a: a.energy),
            ("open [J]", ".0e", lambda a: a.left_open),
        ],
        "Largest difference of any coordinate or rate [rad, m, per second]. "
        "Ledger by RK4: what the energy changes by, and what is left open.",
    )


def control_table(results: Sequence[ControlResult]) -> ResultTable:
    """Return the control of each crane."""
    return tabulate(
        "Control",
        results,
        [
            ("crane", "", lambda c: c.relative.name),
            ("gives way [mm]", ".2f", lambda c: 1e3 * c.deflection),
            ("hold [mrad]", ".2f", lambda c: 1e3 * c.left_by_hold),
            ("LQR", ".2f", lambda c: 1e3 * c.left_by_lqr),
            ("observer", ".2f", lambda c: 1e3 * c.left_by_observer),
            ("MPC", ".2f", lambda c: 1e3 * c.left_by_mpc),
            ("least time [s]", ".2f", lambda c: c.arrival),
            ("left [mrad]", ".3f", lambda c: 1e3 * c.residual),
            ("limits [%]", ".1f", lambda c: 100.0 * c.limits),
            ("wind [m]", ".2f", lambda c: c.blown),
            ("batch", ".0e>1e-12", lambda c: c.lanes),
        ],
        f"From {1e3 * SWING:g} mrad in each swing joint: how far the trolley gives way under the "
        "hold controller, and the swing left after 10 s by each controller. Then the trolley's "
        f"move of {WAY:g} m in least time: how long, swing left, largest share of a limit. Wind of "
        f"{GUST:g} m/s on {AREA:g} m² for 4 s: where the load goes. Batch: eight cranes at once "
        "beside runs one by one [rad, m, per second].",
    )


def residual_table(title: str, results: Sequence[pendulum.ModeResidual], note: str) -> ResultTable:
    """Return the swing that moves of the double pendulum leave in each mode."""

    def mrad(value: float | None) -> float | None:
        return None if value is None else 1e3 * value

    return tabulate(
        title,
        results,
        [
            ("strategy", "", lambda r: r.strategy),
            ("arrives [s]", ".2f", lambda r: r.arrival),
            ("slow [mrad]", ".4f", lambda r: 1e3 * r.slow),
            ("closed", ".4f", lambda r: mrad(r.closed_slow)),
            ("fast [mrad]", ".4f", lambda r: 1e3 * r.fast),
            ("closed ", ".4f", lambda r: mrad(r.closed_fast)),
            ("later: slow", ".4f", lambda r: 1e3 * _later(r)[0]),
            ("fast", ".4f", lambda r: 1e3 * _later(r)[1]),
        ],
        note,
    )


def _later(result: pendulum.ModeResidual) -> tuple[float, float]:
    """Return the amplitudes at the end of the run [rad]."""
    crane = relative_crane(HOOK)
    goal = rest_at(crane, x=float(result.run["x_setpoint_m"][-1]))
    return pendulum.mode_amplitudes(crane, goal, result.run, float(result.run.t[-1]))


def unaware_note(growth: tuple[float, float]) -> str:
    """Return a note on designs that do not know of the hook, with the growth rates of the closed
    loops [1/s].
    """
    return (
        f"At the arrival, and {pendulum.LASTS + 1:g} s later. The five-joint designs take hook and "
        "load for one load of 2300 kg at the hoist's end, and see slew, trolley, cable and its two "
        f"swings. At rest every motion under the LQR of the whole model goes with {growth[0]:+.4f} "
        f"1/s or faster; under that of five joints one has {growth[1]:+.4f} 1/s"
        + (
            ": through the slew it stirs up the fast mode across the jib, which it does not see."
            if growth[1] > 0.0
            else "."
        )
    )


def robot_table(results: Sequence[Robot]) -> ResultTable:
    """Return integrators and engines on robots that are no cranes."""
    euler, runge = semi_implicit_euler, rk4
    return tabulate(
        "Robots of example-robot-data, loaded as cranes",
        results,
        [
            ("robot", "", lambda r: r.name),
            ("joints", "d", lambda r: r.joints),
            ("driven", "d", lambda r: r.driven),
            ("Pinocchio - code", ".0e>1e-12", lambda r: max(r.engines.values())),
            ("open, Euler [J]", ".1e", lambda r: r.open[euler.name][0]),
            ("order", ".3f", lambda r: r.order(euler)),
            ("open, RK4 [J]", ".1e", lambda r: r.open[runge.name][0]),
            ("order ", ".3f", lambda r: r.order(runge)),
        ],
        f"Half a second under hold in steps of {1e3 * STEP:g} ms; what the ledger leaves open, and "
        "the power of the step with which that falls.",
    )
