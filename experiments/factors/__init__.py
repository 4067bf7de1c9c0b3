"""Factors of the standards: formulas, the mechanics under them, and what control needs."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

from matplotlib.figure import Figure

from cranedyn.lifts.judging import factors
from cranedyn.plotting.figures import COLOURS, panels
from experiments import harness
from experiments.factors.derived import AGREES, RATIOS, simulate_factors
from experiments.factors.formulas import DIGITS, FORMULAS, Compared
from experiments.factors.needed import Need, across, upwards
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Compare formulas, derive them by simulation, and measure what moves need of them."""
    moves = across(setup)
    hoists = upwards(setup)
    factors_derived = simulate_factors(setup.gravity)
    return Outcome(
        tables=[_formulas(), _derived(factors_derived), _moves(moves), _hoists(hoists)],
        claims=[*_claims(factors_derived), *_gains(moves, hoists)],
        trajectories={f"{need.move}_{i}": need.run for i, need in enumerate(moves)},
        figures={"factors": _figure(factors_derived), "needed": _needed(moves)},
        recording=harness.side_by_side(
            {n.strategy: (setup.crane, n.run) for n in moves if n.move == "trolley"}, apart=0.0
        ),
    )


def _formulas() -> ResultTable:
    return make_table(
        "Formulas of the standards",
        FORMULAS,
        ("formula", "", lambda f: f.name),
        ("source", "", lambda f: f.origin),
        ("ours", ".6g", lambda f: f.formula),
        ("printed", ".6g", lambda f: f.other),
        note="Sources were read second hand: none of the standards was before us.",
    )


def _derived(factors: Sequence[Compared]) -> ResultTable:
    return make_table(
        "The same by mechanics alone",
        factors,
        ("factor", "", lambda d: d.name),
        ("simulated", "", lambda d: d.origin),
        ("formula", ".6f", lambda d: d.formula),
        ("result", ".6f", lambda d: d.other),
        ("relative difference", "+.1e", lambda d: d.difference),
        note="Pick-up: by an elastic hoist at 0.5 m/s. Release: of a part of the load, slowly in "
        "0.6034 periods. Braking: of a trolley by a constant force, of the worst duration, and of "
        "a slew. Pushes: at constant acceleration. Gust: sudden and lasting.",
    )


def _moves(needs: Sequence[Need]) -> ResultTable:
    return make_table(
        "What a move needs of ψ_h",
        needs,
        ("move", "", lambda n: n.move),
        ("strategy", "", lambda n: n.strategy),
        ("arrives [s]", ".1f", lambda n: n.arrives),
        ("ψ_h allowed", ".2f", lambda n: n.allowed),
        ("needed", ".3f", lambda n: n.needed),
        ("unused [%]", ".0f", lambda n: 100.0 * n.unused),
        note="Largest pull of the rope along the drive, over mass times limit of acceleration. "
        "Allowed: 2, one acceleration from rest. An operator who brakes a swinging load adds a "
        "second.",
    )


def _hoists(needs: Sequence[Need]) -> ResultTable:
    return make_table(
        "What taking up a load needs of φ2",
        needs,
        ("taken up", "", lambda n: n.strategy),
        ("φ2 at 1 m/s", ".3f", lambda n: n.allowed),
        ("needed", ".3f", lambda n: n.needed),
        ("unused [%]", ".0f", lambda n: 100.0 * n.unused),
        note="On the elastic rope of experiment cranes. φ2 at full speed: 1 + v ω/g, without the "
        "part φ2,min - 1 that does not depend on the speed.",
    )


def _claims(factors_derived: Sequence[Compared]) -> list[Claim]:
    holding = sum(factor.holds for factor in FORMULAS)
    worst = max(factors_derived, key=lambda factor: abs(factor.difference))
    return [
        Claim(
            f"{holding} of {len(FORMULAS)} numbers of the standards come out as printed, to "
            f"{DIGITS:g}.",
            holding == len(FORMULAS),
        ),
        Claim(
            f"{len(factors_derived)} of them follow from the crane's mechanics alone to {AGREES:g} "
            f"(worst: {worst.name}, {worst.difference:+.1e}).",
            all(factor.holds for factor in factors_derived),
        ),
    ]


def _gains(moves: Sequence[Need], hoists: Sequence[Need]) -> list[Claim]:
    claims = []
    for name in dict.fromkeys(need.move for need in moves):
        needs = {need.strategy: need.needed for need in moves if need.move == name}
        joystick = needs.pop("operator")
        one_push = moves[0].allowed
        claims += [
            Claim(
                f"{name}: a joystick that brakes while the load swings needs ψ_h = {joystick:.3f}, "
                f"more than the {one_push:g} of one acceleration from rest, less than the "
                f"{2.0 * one_push:g} of two.",
                one_push < joystick < 2.0 * one_push,
            ),
            Claim(
                f"{name}: under control the standard's {one_push:g} is enough: "
                f"{', '.join(f'{strategy} {needed:.3f}' for strategy, needed in needs.items())}.",
                max(needs.values()) <= one_push,
            ),
        ]
    rough, *gentler = (need.needed for need in hoists)
    claims.append(
        Claim(
            f"hoist: taken up at full speed a load needs φ2 = {rough:.3f}, {hoists[0].allowed:.3f} "
            f"in closed form; creeping, from a taut rope, and shaped "
            f"{', '.join(f'{need:.3f}' for need in gentler)}, each less than the one before.",
            all(one > next_one for one, next_one in itertools.pairwise([rough, *gentler])),
        )
    )
    return claims


def _figure(factors_derived: Sequence[Compared]) -> Figure:
    """Draw ψ_h over the mass ratio, and β2 over the class."""
    figure, (ratio, slope) = panels(1, 2, height=3.4, width=10.0)
    mus = [0.2 + 0.1 * i for i in range(110)]
    ratio.plot(mus, [factors.psi_h(mu) for mu in mus], color=COLOURS["setpoint"], label="formula")
    derived_at = [f.other for f in factors_derived if f.name.startswith("ψ_h at μ")]
    ratio.plot(RATIOS, derived_at, "o", color=COLOURS["phi"], label="worst braking, simulated")
    ratio.set(xlabel="load over carriage", ylabel="ψ_h")
    slopes = [f for f in factors_derived if f.name.startswith("β2")]
    at = range(len(slopes))
    slope.bar(at, [f.formula for f in slopes], color=COLOURS["setpoint"], label="EN 1991-3")
    slope.plot(at, [f.other for f in slopes], "o", color=COLOURS["phi"], label="pick-up")
    slope.set(xlabel="hoisting class", ylabel="β2 [s/m]", xticks=at)
    slope.set_xticklabels(list(factors.HOISTING))
    for ax in (ratio, slope):
        ax.legend()
    return figure


def _needed(moves: Sequence[Need]) -> Figure:
    figure, axes = panels(1, 2, height=3.0, width=10.0)
    for ax, name in zip(axes, dict.fromkeys(need.move for need in moves), strict=True):
        of_move = [need for need in moves if need.move == name]
        strategies = [n.strategy for n in of_move]
        needs = [n.needed for n in of_move]
        ax.barh(strategies, needs, color=COLOURS["phi"])
        ax.axvline(of_move[0].allowed, color=COLOURS["limit"], linestyle="--")
        ax.set(title=name, xlabel="ψ_h needed; dashed: allowed for")
        ax.invert_yaxis()
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("factors", __doc__, engines=("compiled", "pinocchio"))
    harness.add_setup(parser)
    return harness.run_experiment(parser, experiment, argv)
