"""Factors of the standards: formulas, the mechanics under them, and what control needs."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

from matplotlib.figure import Figure

from cranedyn.lifts.judging import factors
from cranedyn.plotting.figures import COLOURS, legend_above, panels
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
    recorded = {}
    for need in moves:
        if need.move == "trolley":
            recorded[need.strategy] = (setup.crane, need.run)
    return Outcome(
        tables=[
            _formulas_table(),
            _derived_table(factors_derived),
            _moves_table(moves),
            _hoists_table(hoists),
        ],
        claims=[*_factor_claims(factors_derived), *_control_claims(moves, hoists)],
        trajectories={f"{need.move}_{i}": need.run for i, need in enumerate(moves)},
        figures={"factors": _factors_figure(factors_derived), "needed": _needed_figure(moves)},
        recording=harness.side_by_side(recorded, apart=0.0),
    )


def _formulas_table() -> ResultTable:
    return make_table(
        "Formulas of the standards",
        FORMULAS,
        ("formula", "", lambda f: f.name),
        ("source", "", lambda f: f.origin),
        ("ours", ".6g", lambda f: f.formula),
        ("printed", ".6g", lambda f: f.other),
        note="Sources were read second hand: none of the standards was before us.",
    )


def _derived_table(factors: Sequence[Compared]) -> ResultTable:
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


def _moves_table(needs: Sequence[Need]) -> ResultTable:
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


def _hoists_table(needs: Sequence[Need]) -> ResultTable:
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


def _factor_claims(factors_derived: Sequence[Compared]) -> list[Claim]:
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


def _control_claims(moves: Sequence[Need], hoists: Sequence[Need]) -> list[Claim]:
    """Return the claims on what control needs of the factors.

    Args:
        moves: Needs of moves of trolley and slew.
        hoists: Needs of loads that are taken up, from rough to gentle.
    """
    claims = []
    one_push = moves[0].allowed
    for name in dict.fromkeys(need.move for need in moves):
        needs = {need.strategy: need.needed for need in moves if need.move == name}
        joystick = needs.pop("operator")
        listed = ", ".join(f"{strategy} {needed:.3f}" for strategy, needed in needs.items())
        claims += [
            Claim(
                f"{name}: a joystick that brakes while the load swings needs ψ_h = {joystick:.3f}, "
                f"more than the {one_push:g} of one acceleration from rest, less than the "
                f"{2.0 * one_push:g} of two.",
                one_push < joystick < 2.0 * one_push,
            ),
            Claim(
                f"{name}: under control the standard's {one_push:g} is enough: {listed}.",
                max(needs.values()) <= one_push,
            ),
        ]
    needed = [need.needed for need in hoists]
    gentler = ", ".join(f"{factor:.3f}" for factor in needed[1:])
    claims.append(
        Claim(
            f"hoist: taken up at full speed a load needs φ2 = {needed[0]:.3f}, "
            f"{hoists[0].allowed:.3f} in closed form; creeping, from a taut rope, and shaped "
            f"{gentler}, each less than the one before.",
            all(rougher > gentler for rougher, gentler in itertools.pairwise(needed)),
        )
    )
    return claims


def _factors_figure(factors_derived: Sequence[Compared]) -> Figure:
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
        legend_above(ax)
    return figure


def _needed_figure(moves: Sequence[Need]) -> Figure:
    figure, axes = panels(1, 2, height=3.0, width=10.0, sharex=True)
    for ax, name in zip(axes, dict.fromkeys(need.move for need in moves), strict=True):
        of_move = [need for need in moves if need.move == name]
        strategies = [n.strategy for n in of_move]
        needs = [n.needed for n in of_move]
        ax.barh(strategies, needs, color=COLOURS["phi"])
        ax.axvline(of_move[0].allowed, color=COLOURS["limit"], linestyle="--")
        ax.set(title=f"{name} move", xlabel="ψ_h needed; dashed: allowed by the standard")
        ax.invert_yaxis()
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("factors", __doc__, engines=("compiled", "pinocchio"))
    harness.add_setup(parser)
    return harness.run_experiment(parser, experiment, argv)
