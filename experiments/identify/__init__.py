"""A crane identified from its records, how sure that is, and a twin of it to try controllers on."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from cranedyn.data.external import parse_sources
from cranedyn.errors import DataError, OutOfRange, quoted
from cranedyn.identification import Estimate, Model, Prior, load_record
from cranedyn.identification.assumed import inertia_effects
from cranedyn.identification.estimate import EXPLAINED_SHARE
from cranedyn.identification.parameters import Drives
from cranedyn.model.machines import read_machine
from cranedyn.model.options import add_crane_options, add_values, load_options, parse_pairs
from experiments import gazebo, harness
from experiments.harness import Claim, Outcome, ResultTable, Setup
from experiments.identify.coverage import PLANTS, covered
from experiments.identify.figures import beside, correlations
from experiments.identify.tables import (
    Identification,
    doubts,
    identify_records,
    inertia_tables,
    of_trials,
    record_tables,
    values_table,
)
from experiments.identify.trial import NOISE, TRIED, TRUTH, Trial, trial_record, try_strategies

FREE = ("a1_l5", "a1_l10", "a1_l15", "a1_l20")
"""Recordings of Gazebo Classic in which the load swings freely from 12 s on."""

HELD = ("a1_l5", "a1_l15")
"""Recordings from which the gains of the brake are estimated, too."""

UNTIL = 42.0
"""End of the part of these recordings from which the gains are estimated [s]."""

WORLD = ("gravity", "dummy_inertia", "damp_swing")
"""Parameters of the world that are estimated from a free swing."""

GAINS = ("x_stiffness", "x_damping", "l_stiffness", "l_damping")
"""Gains of the brake."""

MADE_WITH = {
    "gravity": gazebo.GRAVITY,
    "dummy_inertia": 50.0,
    "damp_swing": 1.0,
    "x_stiffness": 3e5,
    "x_damping": 5e4,
    "l_stiffness": 3e4,
    "l_damping": 2e4,
}
"""True values of these parameters in the recordings [SI units]."""

CLOSE = {"gravity": 1e-6, **dict.fromkeys(("dummy_inertia", "damp_swing", *GAINS), 5e-3)}
"""Largest relative error of each estimate.

Gazebo steps by 0.5 ms with the velocity at the end of the step, as if each k_d were k_p dt/2 larger
(0.15 % of the trolley's), and moves centres along chords.
"""

MAX_FIGURES = 4
"""Largest number of records of which a figure is drawn."""


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Identify what the command line asks for."""
    if options.coverage is not None:
        return covered(options, setup)
    loading = load_options(options)
    urdf = loading.pop("urdf")
    values = loading.pop("values")
    if (name := loading.pop("machine")) is not None:
        machine = read_machine(name)
        urdf = machine.urdf
        values = machine.values | values
    # Gravity is a parameter to estimate: its prior value is an option of its own.
    del loading["gravity"]
    prior = Prior(urdf, values, options.believed, loading)
    return files(options, setup, prior) if options.files else examples(setup)


def files(options: argparse.Namespace, setup: Setup, prior: Prior) -> Outcome:
    """Identify a crane from files."""
    sources = parse_sources(options.columns)
    records = [
        load_record(
            file,
            prior.crane,
            sources=sources,
            joints=parse_pairs("joints", options.joints),
            since=options.since,
            until=options.until,
        )
        for file in options.files
    ]
    names = [record.name for record in records]
    if len(set(names)) < len(names):
        raise DataError(f"Two records have one name: {', '.join(map(quoted, names))}.")
    model = Model.of(
        prior, records, options.estimate, drives=options.drives, signs=_signs(options.sign)
    )
    result = identify_records(model, setup, "records")
    progress = setup.reporter.message("assumed inertias", "changes tried")
    effects = inertia_effects(result.estimate, progress)
    tables = [
        *record_tables(result, "", {}),
        *inertia_tables(result.estimate, effects),
        *of_trials(_trials(result.estimate)),
    ]
    claims = [*_believed("The records", result), _white("The records", result)]
    return _outcome(result, tables, claims)


def _signs(arguments: Sequence[str]) -> dict[str, int]:
    """Return the signs of swings from arguments such as ``phi=-1``, by their symbols."""
    signs: dict[str, int] = {}
    for symbol, text in parse_pairs("sign", arguments).items():
        if text not in ("1", "+1", "-1"):
            raise OutOfRange(f"sign of {symbol}", quoted(text), "1 or -1")
        signs[symbol] = int(text)
    return signs


def _believed(subject: str, result: Identification) -> list[Claim]:
    """Return the claims that the twin explains the records, and that none of its numbers is at an
    end of its range.
    """
    share, column = result.estimate.least_explained
    bounds = result.estimate.at_bound
    return [
        Claim(
            f"{subject}: the twin explains {100 * EXPLAINED_SHARE:g} % of the variance of each "
            f"swing at least ({100 * share:.1f} % of {column}).",
            share >= EXPLAINED_SHARE,
        ),
        Claim(
            f"{subject}: no parameter ended at a bound ({', '.join(bounds) or 'none did'}).",
            not bounds,
        ),
    ]


def _white(subject: str, result: Identification) -> Claim:
    """Return the claim that residuals are white noise, on which all intervals rest."""
    coloured = ", ".join(result.estimate.not_white)
    verdict = "all"
    if coloured:
        verdict = f"not {coloured}: the model lacks something, and intervals may not hold the truth"
    return Claim(
        f"{subject}: what the twin leaves of each column is white noise ({verdict}).", not coloured
    )


def examples(setup: Setup) -> Outcome:
    """Identify Gazebo's world from its recordings, and the crane of the trial from its record."""
    world = Prior()
    free = identify_records(
        _recordings(world, FREE, WORLD, "motion"), setup, "free swing in Gazebo"
    )
    brake = identify_records(
        _recordings(world, HELD, (*WORLD, *GAINS), "hold", UNTIL), setup, "brake in Gazebo"
    )
    alone = identify_records(
        Model.of(world, [trial_record(world, positions=False)]), setup, "trial, setpoints"
    )
    both = identify_records(
        Model.of(world, [trial_record(world, positions=True)]), setup, "trial, positions"
    )
    trials = _trials(both.estimate)
    worlds = {"free swing": free, "brake": brake}
    subject = "The trial, setpoints of the drives alone"
    tables = []
    claims: list[Claim] = []
    for name, result in worlds.items():
        tables.append(values_table(result, f"Gazebo Classic 11.1, {name}", MADE_WITH))
        claims += _worlds_claims(name, result)
    tables += [
        values_table(alone, subject, TRUTH),
        *doubts(alone, subject),
        *record_tables(both, "The trial, positions of the drives recorded, too", TRUTH),
        *of_trials(trials),
    ]
    claims += _trials_claims(alone, both, trials)
    outcome = _outcome(both, tables, claims)
    figures = {
        "gazebo": beside(free.estimate, FREE.index("a1_l15")),
        "correlation": correlations(list(alone.judged.margins), alone.judged.correlation),
    }
    return replace(
        outcome,
        parameters={"noise_rad": NOISE, **outcome.parameters},
        figures={**outcome.figures, **figures},
    )


def _recordings(
    prior: Prior,
    names: Sequence[str],
    parameters: Sequence[str],
    drives: Drives,
    until: float = math.inf,
) -> Model:
    """Return the model of some parameters with recordings of Gazebo, from the free swing on."""
    records = [
        load_record(gazebo.RECORDINGS / f"{name}.parquet", prior.crane, since=12.0, until=until)
        for name in names
    ]
    return Model.of(prior, records, parameters, drives=drives)


def _worlds_claims(name: str, result: Identification) -> Iterator[Claim]:
    """Yield the claims that the numbers of Gazebo's world are found in its recordings."""
    for parameter, (value, _) in result.estimate.intervals.items():
        error = abs(value / MADE_WITH[parameter] - 1.0)
        allowed = CLOSE[parameter]
        yield Claim(
            f"Gazebo, {name}: {parameter} is found within {allowed:.1g} of what the recordings "
            f"were made with ({value:.8g}, {error:.1e} off), from files alone.",
            error <= allowed,
        )


def _trials_claims(
    alone: Identification, both: Identification, trials: Sequence[Trial]
) -> Iterator[Claim]:
    """Yield the claims on the trial.

    Args:
        alone: Identification from setpoints of the drives alone.
        both: Identification from setpoints and positions.
        trials: Strategies that were tried.
    """
    for columns, result in (("setpoints alone", alone), ("positions, too", both)):
        # Error over half the interval.
        errors = {}
        for name, (value, margin) in result.estimate.intervals.items():
            errors[name] = abs(value - TRUTH[name]) / margin
        worst = max(errors, key=lambda name: errors[name])
        yield Claim(
            f"The trial, {columns}: everything is found within twice its interval (at most "
            f"{errors[worst]:.2f} times, {worst}).",
            errors[worst] <= 2.0,
        )
        yield _white(f"The trial, {columns}", result)
    pairs = [p for p in alone.judged.inseparable if {p.first, p.second} == {"delay", "x_lag"}]
    rho = abs(pairs[0].correlation) if pairs else 0.0
    yield Claim(
        f"Setpoints alone do not tell delay and lag apart (correlation {rho:.3f}), and the "
        "preflight says so.",
        bool(pairs),
    )
    best = alone.judged.advice[0]
    promised = best.margins["delay"] / alone.judged.margins["delay"]
    yield Claim(
        f"It knows a record that would: {best.move} ({promised:.2f} times the interval of the "
        "delay).",
        promised < 0.5,
    )
    for strategy in TRIED[1:]:
        worst_of = {t.designed: float(t.swing.max()) for t in trials if t.strategy == strategy}
        yield Claim(
            f"{strategy} designed for the twin leaves less swing on it than designed for "
            f"the crane that was believed in ({1e3 * worst_of['twin']:.3g} and "
            f"{1e3 * worst_of['believed']:.3g} mrad at worst).",
            worst_of["twin"] < worst_of["believed"],
        )


def _trials(estimate: Estimate) -> list[Trial]:
    """Try strategies on the twin of this project's crane; none if a move cannot be planned."""
    prior = estimate.model.prior
    return try_strategies(estimate) if prior.urdf is None else []


def _outcome(
    result: Identification, tables: Sequence[ResultTable], claims: Sequence[Claim]
) -> Outcome:
    """Return the outcome with the twin, its runs of the records, and their figures."""
    estimate = result.estimate
    twin = result.twin
    model = estimate.model
    prior_is_ours = model.prior.urdf is None
    names = [record.name for record in model.records]
    runs = [model.run(i, estimate.values, twin.crane) for i in range(len(names))]
    return Outcome(
        tables,
        claims,
        parameters={
            "drives": model.drives,
            "records": names,
            "evaluations": estimate.evaluations,
            "twin": twin.options,
        },
        trajectories={f"twin_{i + 1}": run for i, run in enumerate(runs)},
        figures={f"twin_{i + 1}": beside(estimate, i) for i in range(min(len(names), MAX_FIGURES))},
        recording=harness.side_by_side(
            {name: (twin.crane, run) for name, run in zip(names, runs, strict=True)}, apart=60.0
        ),
        texts={"twin.json": twin.text},
        # Only this project's crane takes a twin as its arguments.
        next_commands=["cranedyn drive --set {folder}/twin.json"] if prior_is_ours else [],
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("identify", __doc__, engines=("compiled",))
    parser.example = f"{parser.prog} run.csv --drives motion"
    add = parser.add_argument
    text = (
        "records of one crane, such as .csv, .mat, .xlsx or .mcap; without any the examples are "
        "identified"
    )
    add("files", nargs="*", metavar="FILE", default=[], help=text)
    text = (
        "parameters to estimate: delay, l_offset, x_lag, x_friction, phi_bias, x_stiffness, "
        "x_damping, gravity or an argument of the crane; by default all that the columns determine"
    )
    add("--estimate", nargs="+", metavar="NAME", help=text)
    text = (
        "simulation of the drives: by their recorded motion, by their recorded efforts, or by a "
        "controller that holds them at their setpoints"
    )
    add("--drives", choices=("motion", "effort", "hold"), help=text)
    text = "leave out what was recorded before this time [s]"
    add("--since", type=float, default=-math.inf, metavar="T", help=text)
    text = "leave out what was recorded after this time [s]"
    add("--until", type=float, default=math.inf, metavar="T", help=text)
    text = "sign of a swing, 1 as recorded; by default both are tried if that does not explain it"
    add("--sign", nargs="+", default=[], metavar="S", help=text)
    harness.add_sources(parser, "{} FILE")
    add_crane_options(parser.common)
    text = "prior value of gravity [m/s²]; by default the crane's"
    add("--gravity", dest="believed", type=float, metavar="G", help=text)
    add_values(parser.common, "prior values of numbers of the crane")
    text = "identify N synthetic cranes instead; count how often intervals contain the true value"
    add("--coverage", type=int, metavar="N", help=text)
    text = "simulator of their records: simulate (default) or mujoco (extra mujoco)"
    add("--plant", choices=tuple(PLANTS), help=text)
    text = "number of processes, by default one for each processor"
    add("--workers", type=int, metavar="N", help=text)
    of_files = (
        "estimate",
        "drives",
        "sign",
        "since",
        "until",
        "urdf",
        "machine",
        "believed",
        "values",
    )
    harness.add_condition(parser, "a FILE", lambda options: bool(options.files), *of_files)
    text = "steps in which synthetic positions are recorded [m and degrees], 0 for exact ones"
    add("--resolution", type=float, metavar="STEP", help=text)
    of_coverage = ("plant", "workers", "resolution")
    harness.add_condition(
        parser, "--coverage", lambda options: options.coverage is not None, *of_coverage
    )
    harness.add_mode(parser, "coverage", *of_coverage)
    return harness.run_experiment(parser, experiment, argv)
