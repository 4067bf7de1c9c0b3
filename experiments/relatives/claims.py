"""What the experiment cranes claims, and by how much each claim holds."""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from experiments.harness import Claim
from experiments.relatives import modes, pendulum, robots, rope
from experiments.relatives.agreement import OPEN, ROUNDING, EngineAgreement
from experiments.relatives.control import ControlResult

HALF = 0.5
"""A controller that damps leaves at most this share of what the hold controller leaves in the same
time."""

ALIKE = 0.05
"""Of the swing left: how far MPC and LQR may differ, whose periods are 50 ms and 5 ms, and the run
from the linear loop, at 0.05 rad."""

LEDGER = 1e-10
"""Share of the wind's work: energies of 1e6 J are known to 1e-10 J, the work is 100 J, and there
are 800 rows."""


def of_frequencies(frequencies: Sequence[modes.Frequency]) -> list[Claim]:
    """Claim that closed form, linearisation and small swings agree, for each crane."""
    names = dict.fromkeys(f.crane for f in frequencies)
    claims = []
    for name in names:
        of_crane = [f for f in frequencies if f.crane == name]
        off, simulated_off = (
            max(abs(f.linear - f.closed) for f in of_crane),
            max(abs(f.simulated - f.stepped) for f in of_crane),
        )
        claims.append(
            Claim(
                f"{name}: {', '.join(f'{f.closed:.8f}' for f in of_crane)} rad/s by closed form, "
                f"off by {off:.0e} in the linearisation (allowed "
                f"{max(f.allowed for f in of_crane):.0e}), by {simulated_off:.0e} in small swings "
                f"beyond the step's own error ({modes.EXACT:.0e}).",
                all(f.holds for f in of_crane),
            )
        )
    return claims


def of_jumps(jumps: Sequence[rope.Jump]) -> list[Claim]:
    """Claim the tensions of the rope that stretches."""
    return [
        Claim(
            "A load picked up at a speed v loads the rope by 1 + v ω/g, a part dropped by 1 ± its "
            f"share of the load left: {len(jumps)} cases, each within what is allowed.",
            all(j.holds for j in jumps),
        )
    ]


def of_agreement(agreements: Sequence[EngineAgreement]) -> list[Claim]:
    """Claim that three engines and the ledger agree."""
    engines, deviations = (
        max(a.engines for a in agreements),
        [a.mujoco for a in agreements if a.mujoco is not None],
    )
    share = max(a.left_open / a.energy for a in agreements)
    theirs = f"{max(deviations):.0e}" if deviations else "MuJoCo is not installed"
    return [
        Claim(
            f"Pinocchio and compiled code agree on each crane to {engines:.0e} (allowed "
            f"{ROUNDING:.0e}).",
            engines < ROUNDING,
        ),
        Claim(
            f"MuJoCo, on the exported URDF under the same efforts, makes the same move: {theirs} "
            f"(allowed {ROUNDING:.0e}).",
            max(deviations) < ROUNDING if deviations else None,
        ),
        Claim(
            f"The ledger of each closes to {share:.0e} of what the energy changes by (allowed "
            f"{OPEN:.0e}).",
            share < OPEN,
        ),
    ]


def of_control(controls: Sequence[ControlResult]) -> list[Claim]:
    """Claim how controllers do on the worst of the cranes."""
    damped = max(
        max(c.left_by_lqr, c.left_by_observer, c.left_by_mpc) / c.left_by_hold for c in controls
    )
    predicted = max(abs(c.left_by_lqr / c.predicted - 1.0) for c in controls)
    alike = max(abs(c.left_by_mpc / c.left_by_lqr - 1.0) for c in controls)
    gives, late = (
        max(c.deflection / c.pull for c in controls),
        max(c.residual / c.sampling for c in controls),
    )
    return [
        Claim(
            f"Hold: the trolley gives way by {100 * gives:.0f} % at most of what a pull at once, 2 "
            "m g φ, allows.",
            all(c.deflection < c.pull for c in controls),
        ),
        Claim(
            "LQR, LQR with an observer that sees the drives alone, and MPC leave "
            f"{100 * damped:.0f} % at most of what the hold leaves (allowed {100 * HALF:g} %).",
            damped < HALF,
        ),
        Claim(
            f"LQR: {100 * predicted:.1f} % off the linear loop at most (allowed {100 * ALIKE:g} "
            "%).",
            predicted < ALIKE,
        ),
        Claim(
            f"MPC is the LQR where no limit binds: {100 * alike:.1f} % apart (allowed "
            f"{100 * ALIKE:g} %), efforts up to "
            f"{100 * max(c.efforts for c in controls):.0f} % of their limits.",
            alike < ALIKE and all(c.efforts <= 1.0 for c in controls),
        ),
        Claim(
            "Moves of least time keep all limits and end at rest in all modes: "
            f"{1e3 * max(c.residual for c in controls):.3f} mrad, "
            f"{100 * late:.0f} % at most of what efforts held for 5 ms may leave.",
            late < 1.0 and all(c.limits < 1.0 + 1e-6 for c in controls),
        ),
        Claim(
            f"Wind: its work is in the ledger to {max(c.open for c in controls):.0e} (allowed "
            f"{LEDGER:.0e}), and it moves every load.",
            all(c.open < LEDGER and c.blown > 0.01 for c in controls),
        ),
        Claim(
            f"Cranes of a batch move as alone: {max(c.lanes for c in controls):.0e} (allowed "
            f"{ROUNDING:.0e}).",
            all(c.lanes < ROUNDING for c in controls),
        ),
    ]


def of_pendulum(
    shaped: Sequence[pendulum.ModeResidual],
    moved: Sequence[pendulum.ModeResidual],
    growth: tuple[float, float],
    stirred: float,
) -> list[Claim]:
    """Claim the residual swing in the double pendulum's two modes."""
    size = max(shaped[0].slow, shaped[0].fast)
    off = max(
        abs(simulated - closed)
        for s in shaped[1:]
        for simulated, closed in ((s.slow, s.closed_slow), (s.fast, s.closed_fast))
        if closed is not None
    )
    least_time, unaware = moved[1], moved[3]
    sampling = pendulum.sampling(least_time.run)
    return [
        Claim(
            "Shapers on the double pendulum leave their closed form, Π |cos(π ω/(2 ω_i))|, to "
            f"{off:.0e} rad (allowed {size**3:.0e}, the cube of the swing); that for both modes "
            f"leaves {1e3 * max(shaped[-1].slow, shaped[-1].fast):.0e} mrad.",
            off < size**3,
        ),
        Claim(
            "A move of least time on the whole model ends at rest in both modes: "
            f"{1e3 * least_time.slow:.4f} and {1e3 * least_time.fast:.4f} mrad, "
            f"where efforts held for 5 ms may leave {1e3 * sampling:.4f}.",
            max(least_time.slow, least_time.fast) < sampling,
        ),
        Claim(
            f"The LQR of the whole model damps every motion ({growth[0]:+.3f} 1/s); planned and "
            "tracked with five joints, the move of "
            f"least time leaves {unaware.slow / least_time.slow:.0f} and "
            f"{unaware.fast / least_time.fast:.0f} times as much in the two modes.",
            growth[0] < 0.0 and unaware.slow > least_time.slow and unaware.fast > least_time.fast,
        ),
        Claim(
            "On the crane with the hook the LQR of five joints stirs up the fast mode across the "
            f"jib: {stirred:+.4f} 1/s in a run, "
            f"{growth[1]:+.4f} 1/s by the linear loop (allowed {100 * ALIKE:g} %).",
            stirred > 0.0 and abs(stirred / growth[1] - 1.0) < ALIKE,
        ),
    ]


def of_robots(robots_run: Sequence[robots.Robot]) -> list[Claim]:
    """Claim that integrators and compiled engine are general."""
    engines = max(max(r.engines.values()) for r in robots_run)
    orders = {rule.name: [r.order(rule) for r in robots_run] for rule in (semi_implicit_euler, rk4)}
    orders_text = ", ".join(
        f"{name} {min(values):.3f} to {max(values):.3f}" for name, values in orders.items()
    )
    off = max(
        abs(order - power)
        for values, power in zip(orders.values(), (1.0, 4.0), strict=True)
        for order in values
    )
    return [
        Claim(
            f"{len(robots_run)} robots move as well: both engines agree to {engines:.0e} (allowed "
            f"{robots.ROUNDING:.0e}), and what the ledger leaves open falls with the order of the "
            f"rule: {orders_text} (within {robots.ORDER:g} of 1 and 4).",
            engines < robots.ROUNDING and off < robots.ORDER,
        )
    ]
