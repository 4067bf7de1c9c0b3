"""Measured cranes: public records of other laboratories, identified blind and predicted."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cranedyn.dynamics.equations_of_motion import energy
from cranedyn.errors import DataError
from cranedyn.identification import Estimate, Model, Prior, Record, identify, twin_of
from cranedyn.identification.estimate import EXPLAINED_SHARE
from cranedyn.interfaces import State
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.model.description import XACRO
from cranedyn.theory import point_period
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, finite_or_none, make_table
from experiments.identify.figures import beside
from experiments.measured.drive import Log, drive_table
from experiments.measured.effects import CANDIDATES, Fit, effects_table, fit, offsets_table
from experiments.measured.sources import SOURCES, PublicRecords

if TYPE_CHECKING:
    from cranedyn.recording import Run

MIN_SENSOR_STEPS = 60
"""Least peak-to-peak swing of a record, in steps of its sensor.

Of a smaller swing the sensor shows its steps rather than the motion.
"""

MIN_AGREEING_SHARE = 12 / 13
"""Least share of the records whose offset agrees with the mean of all."""

MAX_FIGURES = 4
"""Largest number of records of which a figure is drawn, evenly among all."""


class Single(NamedTuple):
    """A record identified alone, and as predicted from the other records of its crane.

    Attributes:
        source: Name of the crane.
        estimate: Estimate from this record alone.
        held_out: RMS error of the swing, predicted with the means of the other records, over the
            standard deviation of the swing; None without other records.
    """

    source: str
    estimate: Estimate
    held_out: float | None

    @property
    def record(self) -> Record:
        """The record."""
        return self.estimate.model.records[0]


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Identify each record alone, and predict it from the others."""
    if options.data is None:
        clones = {source.folder: source.command for source in reversed(SOURCES)}
        commands = " ".join(f"{command};" for command in reversed(clones.values()))
        raise DataError(
            "The records have no licence and are no part of this project. Clone them into a folder "
            f"DIR: {commands} then add --data DIR."
        )
    singles = list[Single]()
    drives = list[Log]()
    count = 0
    for source in SOURCES:
        folder = Path(options.data) / source.folder
        if folder.is_dir():
            logs: list[tuple[str, Log]] = list(source.read(folder))
            drives += [columns for _, columns in logs if np.any(columns.get("x_command", 0.0))]
            singles += _identified(source, logs, setup)
            count += len(logs)
    if not singles:
        names = " nor ".join(dict.fromkeys(source.folder for source in SOURCES))
        raise DataError(f"{options.data} holds neither {names}.")
    return _outcome(singles, drives, count)


def _identified(source: PublicRecords, logs: list[tuple[str, Log]], setup: Setup) -> list[Single]:
    """Identify the records of a crane whose swing is more than its sensor's steps."""
    path = XACRO.with_name("overhead_crane.urdf.xacro")
    prior = Prior(path, source.values)
    records = [
        Record.of(prior.crane, columns, name=name)
        for name, columns in logs
        if _steps(columns["phi_rad"]) >= MIN_SENSOR_STEPS
    ]
    count = setup.reporter.count(source.name, len(records))
    estimates = []
    for done, record in enumerate(records):
        count(done)
        estimates.append(identify(Model.of(prior, [record], source.names)))
    singles = []
    for i, estimate in enumerate(estimates):
        peers = estimates[:i] + estimates[i + 1 :]
        singles.append(Single(source.name, estimate, _held_out(estimate, peers)))
    return singles


def _steps(swing: np.ndarray) -> float:
    """Return the peak-to-peak swing in steps of its sensor.

    A step is the smallest difference between two values.
    """
    values = np.unique(swing)
    return float(np.ptp(values) / np.diff(values).min()) if len(values) > 1 else 0.0


def _means(estimates: Sequence[Estimate]) -> Mapping[str, float]:
    """Return the mean of each parameter, each estimate weighted by the inverse of its variance."""
    means = {}
    for p in estimates[0].model.own:
        values, margins = np.array([e.intervals[p.name] for e in estimates]).T
        means[p.name] = float(np.average(values, weights=1.0 / margins**2))
    return means


def _held_out(estimate: Estimate, peers: Sequence[Estimate]) -> float | None:
    """Return the relative RMS error of a record that is predicted with the means of the others.

    Parameters that belong to the record itself, such as its first swing, keep their estimates.

    Args:
        estimate: Estimate from the record alone.
        peers: Estimates from the other records of the crane.

    Returns:
        The error over the standard deviation of the swing; None without other records.
    """
    if not peers:
        return None
    model = estimate.model
    means = _means(peers)
    values = []
    for p, value in zip(model.parameters, estimate.values.tolist(), strict=True):
        values.append(means[p.name] if p.record is None else value)
    measured = model.measured(0)[0]
    error = model.predicted(0, np.array(values)[None])[0, 0] - measured
    return float(np.sqrt(np.mean(error**2)) / np.std(measured))


def _outcome(singles: Sequence[Single], drives: Sequence[Log], count: int) -> Outcome:
    """Return tables, claims and figures.

    Args:
        singles: Records identified alone.
        drives: Logs whose motor has a command.
        count: Number of all records, those included that swing too little.
    """
    claims = []
    for name in dict.fromkeys(single.source for single in singles):
        of_source = [single.estimate.least_explained for single in singles if single.source == name]
        share, column = min(of_source)
        claims.append(
            Claim(
                f"{name}: each record alone explains {100 * EXPLAINED_SHARE:g} % of its swing at "
                f"least ({100 * share:.1f} % of {column}).",
                share >= EXPLAINED_SHARE,
            )
        )
    tables = [_records_table(singles, count)]
    # Effects are told apart by records of a trolley that moves.
    moved = [single.record for single in singles if "x_dot_m_s" in single.record.columns]
    if len(moved) > 1:
        fits = [fit(moved, names) for names in CANDIDATES]
        best = min(fits, key=lambda one: one.criterion)
        claims += _shared_claims(best, fits[1])
        tables += [effects_table(fits), offsets_table(best, moved)]
    if drives:
        tables.append(drive_table(drives))

    # Records that are drawn, evenly among all.
    indices = np.unique(np.linspace(0, len(singles) - 1, MAX_FIGURES, dtype=int)).tolist()
    figures = {}
    recording: list[Run] = []
    for number, index in enumerate(indices):
        figures[f"record_{number + 1}"] = beside(singles[index].estimate, 0)
        recording += _runs(singles[index], 4.0 * number)
    return Outcome(
        tables=tables,
        claims=claims,
        parameters={
            "sources": [f"{source.repository}@{source.commit}" for source in SOURCES],
            "least_steps": MIN_SENSOR_STEPS,
        },
        figures=figures,
        recording=recording,
    )


def _runs(single: Single, aside: float) -> list[Run]:
    """Return a record and its twin, drawn into each other.

    The recorded swing is shown without the errors of its sensor: without bias and delay, and as
    large as it was before it was averaged. An average over a window W takes sinc(W/T) off a swing
    with the period T, and delays it by W/2.

    Args:
        single: The record.
        aside: Distance of both from the axis of the recording [m].
    """
    from cranedyn.recording import Run

    estimate = single.estimate
    record = single.record
    numbers = {name: value for name, (value, _) in estimate.intervals.items()}
    crane = twin_of(estimate).crane
    joint = record.swings[0]
    window = numbers.get("window", 0.0)
    late = numbers.get("delay", 0.0) + 0.5 * window
    twin = estimate.model.run(0, estimate.values, crane).before(record.duration - late)
    period = point_period(float(np.mean(twin["l_m"])), crane.gravity)
    swing = np.interp(twin.t + late, record.t, record.columns[joint.columns[0]])
    q = twin.q.copy()
    v = twin.v.copy()
    i = crane.layout.index(joint.symbol)
    q[:, i] = (swing - numbers.get(f"{joint.symbol}_bias", 0.0)) / np.sinc(window / period)
    v[:, i] = np.gradient(q[:, i], twin.t)
    energies = [energy(crane, State(*qv)) for qv in zip(q, v, strict=True)]
    recorded = replace(twin, q=q, v=v, energy=np.array(energies))
    return [
        Run(f"{record.name}: {name}", crane, run, (0.0, aside, 0.0))
        for name, run in (("recorded", recorded), ("twin", twin))
    ]


def _shared_claims(best: Fit, averaged: Fit) -> list[Claim]:
    """Return the claims on all records of the crane whose trolley moves, fitted together.

    Args:
        best: The fit with the best effects.
        averaged: The fit whose only effect is that the sensor averages over a window.
    """
    effects = " and ".join(best.names[1:]) or "nothing else"
    spread = 1e3 * best.offsets.std()
    former = 1e3 * averaged.offsets.std()
    mean, agree = best.agreement
    gravity, margin = best.gravity
    return [
        Claim(
            f"Beside the sensor's window the records show {effects}, with which their offsets "
            f"spread by less than half as much ({spread:.1f} instead of {former:.1f} mm).",
            spread < 0.5 * former,
        ),
        Claim(
            f"Then the offset of {100 * MIN_AGREEING_SHARE:.0f} % of the records at least agrees "
            f"with the mean, {1e3 * mean:.1f} mm, within its interval ({agree.sum()} of "
            f"{len(agree)}).",
            bool(agree.mean() >= MIN_AGREEING_SHARE),
        ),
        Claim(
            f"Their gravity, {gravity:.3f} ± {margin:.3f} m/s², holds the standard one (an "
            "interval of 0.5 % needs lengths that differ more).",
            abs(gravity - STANDARD_GRAVITY) <= margin,
        ),
    ]


def _records_table(singles: Sequence[Single], count: int) -> ResultTable:
    def number(single: Single, name: str, factor: float) -> tuple[float | None, float | None]:
        value, margin = single.estimate.intervals.get(name, (np.nan, np.nan))
        return finite_or_none(factor * value), finite_or_none(factor * margin)

    others = [s for s in singles if s.held_out is not None]
    offsets = [s.estimate.intervals["l_offset"] for s in others]
    mean = _means([s.estimate for s in others])["l_offset"] if others else np.nan
    within = sum(abs(value - mean) <= margin for value, margin in offsets)
    return make_table(
        "Each record alone",
        singles,
        ("crane", "", lambda s: s.source),
        ("record", "", lambda s: s.record.name),
        ("offset [mm]", ".1f", lambda s: number(s, "l_offset", 1e3)[0]),
        ("±", ".1f", lambda s: number(s, "l_offset", 1e3)[1]),
        ("window [ms]", ".0f", lambda s: number(s, "window", 1e3)[0]),
        ("± [ms]", ".0f", lambda s: number(s, "window", 1e3)[1]),
        ("explained [%]", ".1f", lambda s: 100.0 * s.estimate.least_explained[0]),
        ("held out [%]", ".1f", lambda s: None if s.held_out is None else 100.0 * s.held_out),
        note="Offset: pendulum less recorded cable. ±: half the 95 % interval. Held out: RMS error "
        "predicted with the means of the others, over the standard deviation. "
        f"{within} of {len(others)} intervals hold the mean. {count - len(singles)} of {count} "
        f"records swing by less than {MIN_SENSOR_STEPS} steps of their sensor and are left out.",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser(
        "measured",
        "Public records of real cranes, identified blind and predicted.",
        engines=("compiled",),
    )
    text = "folder with clones of the repositories; without it their commands are printed"
    parser.add_argument("--data", metavar="DIR", default=None, help=text)
    return harness.run_experiment(parser, experiment, argv)
