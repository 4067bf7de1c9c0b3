"""What the experiment cranes prints: its tables."""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from experiments.harness import Table
from experiments.relatives import modes, pendulum, rope
from experiments.relatives.agreement import DURATION, Agreement
from experiments.relatives.catalogue import HOOK, crane_of, rest_at
from experiments.relatives.control import AREA, GUST, SWING, WAY, Control
from experiments.relatives.robots import STEP, Robot


def frequencies(found: Sequence[modes.Frequency]) -> Table:
    """Frequencies by closed form, linearisation and small swings."""
    columns = [
        ("crane", ""),
        ("mode", ""),
        ("closed form [rad/s]", ".8f"),
        ("linearised", ".8f"),
        ("off", "+.0e>1e-11"),
        ("small swing", ".8f"),
        ("of the step", "+.0e"),
        ("rest", "+.0e>1e-11"),
    ]
    rows = [
        (
            f.crane,
            f.mode,
            f.closed,
            f.linear,
            f.linear - f.closed,
            f.simulated,
            f.stepped - f.linear,
            f.simulated - f.stepped,
        )
        for f in found
    ]
    note = (
        "Drives locked but where they roll. The tower that twists is that of a hand-derived 2 × 2 "
        "model without the trolley, 0.79786094 and 4.53213150 rad/s: the multibody agrees when the "
        "trolley's m x² is counted within the 1e6 kg m², and is slower by what the trolley adds "
        "when it is not. A structure that leans at rest is held to the square of that angle."
    )
    return Table("Frequencies", columns, rows, note)


def jumps(found: Sequence[rope.Jump]) -> Table:
    """A rope that stretches."""
    columns = [
        ("what happens", ""),
        ("closed form", ".4f"),
        ("run", ".4f"),
        ("off", "+.1e"),
        ("allowed", ".1e"),
        ("because of", ""),
    ]
    rows = [(j.what, j.closed, j.found, j.found - j.closed, j.allowed, j.why) for j in found]
    return Table("Rope that stretches: tension over the weight that hangs", columns, rows)


def agreement(found: Sequence[Agreement]) -> Table:
    """Three engines and the ledger."""
    columns = [
        ("crane", ""),
        ("joints", "d"),
        ("Pinocchio - code", ".0e>1e-12"),
        ("Pinocchio - MuJoCo", ".0e>1e-12"),
        ("energy [J]", ".0f"),
        ("open [J]", ".0e"),
    ]
    rows = [
        (a.relative.name, crane_of(a.relative).layout.n, a.engines, a.mujoco, a.energy, a.left_open)
        for a in found
    ]
    note = (
        "Largest difference of any coordinate or rate [rad, m, per second]. "
        "Ledger by RK4: what the energy changes by, and what is left open."
    )
    return Table(
        f"Three engines, {DURATION:g} s with all drives moving and the load swinging",
        columns,
        rows,
        note,
    )


def control(found: Sequence[Control]) -> Table:
    """What is made for any crane, on each."""
    columns = [
        ("crane", ""),
        ("gives way [mm]", ".2f"),
        ("hold [mrad]", ".2f"),
        ("LQR", ".2f"),
        ("observer", ".2f"),
        ("MPC", ".2f"),
        ("least time [s]", ".2f"),
        ("left [mrad]", ".3f"),
        ("limits [%]", ".1f"),
        ("wind [m]", ".2f"),
        ("batch", ".0e>1e-12"),
    ]
    rows: list[tuple[float | str | None, ...]] = [
        (
            c.relative.name,
            1e3 * c.held,
            *(
                1e3 * swing
                for swing in (c.left_by_hold, c.left_by_lqr, c.left_by_observer, c.left_by_mpc)
            ),
            c.arrival,
            1e3 * c.rest,
            100.0 * c.limits,
            c.blown,
            c.lanes,
        )
        for c in found
    ]
    note = (
        f"From {1e3 * SWING:g} mrad in each swing joint: how far the trolley gives way under the "
        "hold controller, and the swing left after 10 s by each controller. Then the trolley's "
        f"move of {WAY:g} m in least time: how long, swing left, largest share of a limit. Wind of "
        f"{GUST:g} m/s on {AREA:g} m² for 4 s: where the load goes. Batch: eight cranes at once "
        "beside runs one by one [rad, m, per second]."
    )
    return Table("Control", columns, rows, note)


def left(title: str, found: Sequence[pendulum.Left], note: str) -> Table:
    """What moves of the double pendulum leave in each mode."""
    columns = [
        ("strategy", ""),
        ("arrives [s]", ".2f"),
        ("slow [mrad]", ".4f"),
        ("closed", ".4f"),
        ("fast [mrad]", ".4f"),
        ("closed ", ".4f"),
        ("later: slow", ".4f"),
        ("fast", ".4f"),
    ]
    rows: list[tuple[float | str | None, ...]] = []
    for each in found:
        later = _later(each)
        closed = [
            None if form is None else 1e3 * form for form in (each.closed_slow, each.closed_fast)
        ]
        rows.append(
            (
                each.strategy,
                each.arrival,
                1e3 * each.slow,
                closed[0],
                1e3 * each.fast,
                closed[1],
                1e3 * later[0],
                1e3 * later[1],
            )
        )
    return Table(title, columns, rows, note)


def _later(found: pendulum.Left) -> tuple[float, float]:
    """Amplitudes at the end of the run [rad]."""
    crane = crane_of(HOOK)
    goal = rest_at(crane, x=float(found.run["x_setpoint_m"][-1]))
    return pendulum.left(crane, goal, found.run, float(found.run.t[-1]))


def unaware(growth: tuple[float, float]) -> str:
    """What to know of designs that do not know of the hook, with the growth rates of the closed
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


def robots(found: Sequence[Robot]) -> Table:
    """Robots that are no cranes."""
    columns = [
        ("robot", ""),
        ("joints", "d"),
        ("driven", "d"),
        ("Pinocchio - code", ".0e>1e-12"),
        ("open, Euler [J]", ".1e"),
        ("order", ".3f"),
        ("open, RK4 [J]", ".1e"),
        ("order ", ".3f"),
    ]
    rules = (semi_implicit_euler, rk4)
    rows: list[tuple[float | str | None, ...]] = [
        (
            r.name,
            r.joints,
            r.driven,
            max(r.engines.values()),
            *(part for rule in rules for part in (r.open[rule.name][0], r.order(rule))),
        )
        for r in found
    ]
    note = (
        f"Half a second under hold in steps of {1e3 * STEP:g} ms; what the ledger leaves open, and "
        "the power of the step with which that falls."
    )
    return Table("Robots of example-robot-data, loaded as cranes", columns, rows, note)
