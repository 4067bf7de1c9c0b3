"""Cranes of other topology: hook and slung load, rope, tower and jib that give, overhead crane; what is made for any crane, on each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from cranedyn.model.crane import Crane
from experiments import harness
from experiments.relatives import modes, pendulum, rope
from experiments.relatives.agreement import DURATION, OPEN, ROUNDING, Agreement, agreement
from experiments.relatives.catalogue import HOOK, RELATIVES, crane_of
from experiments.relatives.control import AREA, GUST, SWING, WAY, Control, control

HALF = 0.5
"""A controller that damps leaves at most this share of what the hold controller leaves in the same time."""

ALIKE = 0.05
"""Of the swing left: how far MPC and LQR may differ, whose periods are 50 ms and 5 ms, and the run from the linear loop, at 0.05 rad."""

LEDGER = 1e-10
"""Share of the wind's work: energies of 1e6 J are known to 1e-10 J, the work is 100 J, and there are 800 rows."""

SITES = ((0.0, 0.0), (75.0, 0.0), (150.0, 0.0), (0.0, -75.0), (75.0, -75.0), (110.0, -75.0))
"""Where the cranes stand in the recording [m]."""


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """All cranes: frequencies, ropes, agreement, control, and the double pendulum."""
    from cranedyn.recording import Run

    done = setup.reporter.count("cranes", 4 + 2 * len(RELATIVES))
    frequencies, jumps = modes.frequencies(), rope.jumps()
    done(2)
    agreed = []
    for i, relative in enumerate(RELATIVES):
        agreed.append(agreement(relative))
        done(3 + i)
    controlled = []
    for i, relative in enumerate(RELATIVES):
        controlled.append(control(relative))
        done(3 + len(RELATIVES) + i)
    shaped, moved, growth = pendulum.shaping(), list(pendulum.moves()), pendulum.growth()
    return harness.Outcome(
        tables=[
            _frequencies(frequencies),
            _jumps(jumps),
            _agreement(agreed),
            _control(controlled),
            _left("Double pendulum: shaped moves of an operator", shaped, f"Trolley at {pendulum.NUDGE:g} m/s; closed: by the swing that the move leaves unshaped."),
            _left(f"Double pendulum: {pendulum.WAY:g} m of the trolley", moved, _unaware(growth)),
        ],
        claims=[
            *_of_frequencies(frequencies),
            *_of_jumps(jumps),
            *_of_agreement(agreed),
            *_of_control(controlled),
            *_of_pendulum(shaped, moved, growth),
        ],
        parameters={"swing_rad": SWING, "way_m": WAY, "wind_m_s": GUST, "drag_area_m2": AREA, "duration_s": DURATION},
        trajectories={relative.name.replace(" ", "_"): found.run for relative, found in zip(RELATIVES, agreed, strict=True)}
        | {"double_pendulum_unaware": moved[-1].run},
        recording=[
            Run(found.relative.name, crane_of(found.relative), found.run, (*site, 0.0)) for site, found in zip(SITES, agreed, strict=True)
        ],
    )


def _frequencies(found: Sequence[modes.Frequency]) -> harness.Table:
    columns = [
        ("crane", ""),
        ("mode", ""),
        ("closed form [rad/s]", ".8f"),
        ("linearised", ".8f"),
        ("off", "+.0e"),
        ("small swing", ".8f"),
        ("of the step", "+.0e"),
        ("rest", "+.0e"),
    ]
    rows = [
        (f.crane, f.mode, f.closed, f.linear, f.linear - f.closed, f.simulated, f.stepped - f.linear, f.simulated - f.stepped) for f in found
    ]
    note = (
        "Drives locked but where they roll. The tower that twists is that of a hand-derived 2 × 2 model without the trolley, "
        "0.79786094 and 4.53213150 rad/s: the multibody agrees when the trolley's m x² is counted within the 1e6 kg m², and is "
        "slower by what the trolley adds when it is not. A structure that leans at rest is held to the square of that angle."
    )
    return harness.Table("Frequencies", columns, rows, note)


def _of_frequencies(found: Sequence[modes.Frequency]) -> list[harness.Claim]:
    names = dict.fromkeys(f.crane for f in found)
    made = []
    for name in names:
        own = [f for f in found if f.crane == name]
        off, rest = max(abs(f.linear - f.closed) for f in own), max(abs(f.simulated - f.stepped) for f in own)
        made.append(
            harness.Claim(
                f"{name}: {', '.join(f'{f.closed:.8f}' for f in own)} rad/s by closed form, off by {off:.0e} in the linearisation (allowed "
                f"{max(f.allowed for f in own):.0e}), by {rest:.0e} in small swings beyond the step's own error ({modes.EXACT:.0e}).",
                all(f.holds for f in own),
            )
        )
    return made


def _jumps(found: Sequence[rope.Jump]) -> harness.Table:
    columns = [("what happens", ""), ("closed form", ".4f"), ("run", ".4f"), ("off", "+.1e"), ("allowed", ".1e"), ("because of", "")]
    rows = [(j.what, j.closed, j.found, j.found - j.closed, j.allowed, j.why) for j in found]
    return harness.Table("Rope that stretches: tension over the weight that hangs", columns, rows)


def _of_jumps(found: Sequence[rope.Jump]) -> list[harness.Claim]:
    return [
        harness.Claim(
            f"A load picked up at a speed v loads the rope by 1 + v ω/g, a part dropped by 1 ± its share of the load left: "
            f"{len(found)} cases, each within what is allowed.",
            all(j.holds for j in found),
        )
    ]


def _agreement(found: Sequence[Agreement]) -> harness.Table:
    columns = [("crane", ""), ("joints", "d"), ("Pinocchio - code", ".0e"), ("Pinocchio - MuJoCo", ".0e"), ("energy [J]", ".0f"), ("open [J]", ".0e")]
    rows = [(a.relative.name, crane_of(a.relative).layout.n, a.engines, a.mujoco, a.energy, a.left_open) for a in found]
    note = "Largest difference of any coordinate or rate [rad, m, per second]; ledger by RK4: what the energy changes by, and what is left open."
    return harness.Table(f"Three engines, {DURATION:g} s with all drives moving and the load swinging", columns, rows, note)


def _of_agreement(found: Sequence[Agreement]) -> list[harness.Claim]:
    engines, known = max(a.engines for a in found), [a.mujoco for a in found if a.mujoco is not None]
    share = max(a.left_open / a.energy for a in found)
    theirs = f"{max(known):.0e}" if known else "MuJoCo is not installed"
    return [
        harness.Claim(f"Pinocchio and compiled code agree on each crane to {engines:.0e} (allowed {ROUNDING:.0e}).", engines < ROUNDING),
        harness.Claim(
            f"MuJoCo, on the exported URDF under the same efforts, makes the same move: {theirs} (allowed {ROUNDING:.0e}).",
            max(known) < ROUNDING if known else None,
        ),
        harness.Claim(f"The ledger of each closes to {share:.0e} of what the energy changes by (allowed {OPEN:.0e}).", share < OPEN),
    ]


def _control(found: Sequence[Control]) -> harness.Table:
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
        ("batch", ".0e"),
    ]
    rows = [
        (
            c.relative.name,
            1e3 * c.held,
            *(1e3 * swing for swing in (c.left_by_hold, c.left_by_lqr, c.left_by_observer, c.left_by_mpc)),
            c.arrival,
            1e3 * c.rest,
            100.0 * c.limits,
            c.blown,
            c.lanes,
        )
        for c in found
    ]
    note = (
        f"From {1e3 * SWING:g} mrad in each swing joint: how far the trolley gives way under the hold controller, and the swing left after 10 s "
        f"by each controller. Then the trolley's move of {WAY:g} m in least time: how long, swing left, largest share of a limit. Wind of "
        f"{GUST:g} m/s on {AREA:g} m² for 4 s: where the load goes. Batch: eight cranes at once beside runs one by one [rad, m, per second]."
    )
    return harness.Table("Control", columns, rows, note)


def _of_control(found: Sequence[Control]) -> list[harness.Claim]:
    damped = max(max(c.left_by_lqr, c.left_by_observer, c.left_by_mpc) / c.left_by_hold for c in found)
    predicted = max(abs(c.left_by_lqr / c.predicted - 1.0) for c in found)
    alike = max(abs(c.left_by_mpc / c.left_by_lqr - 1.0) for c in found)
    late = max(c.rest / c.sampling for c in found)
    return [
        harness.Claim(
            f"Hold: the trolley gives way by {100 * max(c.held / c.pull for c in found):.0f} % at most of what a pull at once, 2 m g φ, allows.",
            all(c.held < c.pull for c in found),
        ),
        harness.Claim(
            f"LQR, LQR with an observer that sees the drives alone, and MPC leave {100 * damped:.0f} % at most of what the hold leaves "
            f"(allowed {100 * HALF:g} %).",
            damped < HALF,
        ),
        harness.Claim(f"LQR: {100 * predicted:.1f} % off the linear loop at most (allowed {100 * ALIKE:g} %).", predicted < ALIKE),
        harness.Claim(
            f"MPC is the LQR where no limit binds: {100 * alike:.1f} % apart (allowed {100 * ALIKE:g} %), efforts up to "
            f"{100 * max(c.efforts for c in found):.0f} % of their limits.",
            alike < ALIKE and all(c.efforts <= 1.0 for c in found),
        ),
        harness.Claim(
            f"Moves of least time keep all limits and end at rest in all modes: {1e3 * max(c.rest for c in found):.3f} mrad, "
            f"{100 * late:.0f} % at most of what efforts held for 5 ms may leave.",
            late < 1.0 and all(c.limits < 1.0 + 1e-6 for c in found),
        ),
        harness.Claim(
            f"Wind: its work is in the ledger to {max(c.open for c in found):.0e} (allowed {LEDGER:.0e}), and it moves every load.",
            all(c.open < LEDGER and c.blown > 0.01 for c in found),
        ),
        harness.Claim(
            f"Cranes of a batch move as alone: {max(c.lanes for c in found):.0e} (allowed {ROUNDING:.0e}).",
            all(c.lanes < ROUNDING for c in found),
        ),
    ]


def _left(title: str, found: Sequence[pendulum.Left], note: str) -> harness.Table:
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
    rows = []
    for each in found:
        later = _later(each)
        closed = [None if form is None else 1e3 * form for form in (each.closed_slow, each.closed_fast)]
        rows.append((each.strategy, each.arrival, 1e3 * each.slow, closed[0], 1e3 * each.fast, closed[1], 1e3 * later[0], 1e3 * later[1]))
    return harness.Table(title, columns, rows, note)


def _later(found: pendulum.Left) -> tuple[float, float]:
    """Amplitudes at the end of the run [rad]."""
    crane: Crane = crane_of(HOOK)
    goal = pendulum.rest_at(crane, x=float(found.run["x_setpoint_m"][-1]))
    return pendulum.left(crane, goal, found.run, float(found.run.t[-1]))


def _unaware(growth: tuple[float, float]) -> str:
    aware, unaware = growth
    return (
        f"At the arrival, and {pendulum.LASTS + 1:g} s later. The five-joint designs take hook and load for one load of 2300 kg at the hoist's "
        f"end, and see slew, trolley, cable and its two swings. At rest the LQR of the whole model damps the slowest motion by {aware:+.4f} 1/s; "
        f"that of five joints, on the crane with the hook, has {unaware:+.4f} 1/s"
        + (": it stirs up what it does not see." if unaware > 0.0 else ".")
    )


def _of_pendulum(shaped: Sequence[pendulum.Left], moved: Sequence[pendulum.Left], growth: tuple[float, float]) -> list[harness.Claim]:
    size = max(shaped[0].slow, shaped[0].fast)
    off = max(
        abs(found - closed) for s in shaped[1:] for found, closed in ((s.slow, s.closed_slow), (s.fast, s.closed_fast)) if closed is not None
    )
    least, unaware = moved[1], moved[3]
    sampling = pendulum.sampling(least.run)
    return [
        harness.Claim(
            f"Shapers on the double pendulum leave their closed form, Π |cos(π ω/(2 ω_i))|, to {off:.0e} rad (allowed {size**3:.0e}, the cube "
            f"of the swing); that for both modes leaves {1e3 * max(shaped[-1].slow, shaped[-1].fast):.0e} mrad.",
            off < size**3,
        ),
        harness.Claim(
            f"A move of least time on the whole model ends at rest in both modes: {1e3 * least.slow:.4f} and {1e3 * least.fast:.4f} mrad, where "
            f"efforts held for 5 ms may leave {1e3 * sampling:.4f}.",
            max(least.slow, least.fast) < sampling,
        ),
        harness.Claim(
            f"The LQR of the whole model damps every motion ({growth[0]:+.3f} 1/s); planned and tracked with five joints, the move of least "
            f"time leaves {unaware.slow / least.slow:.0f} and {unaware.fast / least.fast:.0f} times as much in the two modes.",
            growth[0] < 0.0 and unaware.slow > least.slow and unaware.fast > least.fast,
        ),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = harness.parser("cranes", "Cranes of other topology: closed forms, three engines, energy, and control on each.")
    return harness.conduct(made, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
