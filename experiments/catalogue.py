"""Catalogue of the experiments: titles, captions, arguments for the report; a list by subject."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from cranedyn import plugins
from cranedyn.command import Parser, next_lines


class Entry(NamedTuple):
    """An experiment of the catalogue.

    Attributes:
        title: Title on a page.
        line: What it shows, in a line.
        arguments: The arguments with which the report makes it.
        quick: Arguments that make the least of it; its claims need not hold then.
        figures: Captions by the name of the figure; a star at the end is for any end.
    """

    title: str
    line: str
    arguments: tuple[str, ...] = ()
    quick: tuple[str, ...] = ()
    figures: Mapping[str, str] = MappingProxyType({})

    def caption(self, figure: str) -> str:
        """Return the caption of a figure, by default its name."""
        if figure == "validity":
            return "Where the model does not hold: a bar for each run."
        for name, caption in self.figures.items():
            if name == figure or (name.endswith("*") and figure.startswith(name[:-1])):
                return caption
        return figure.replace("_", " ")


_ARTICLE = ("--gravity", "9.8")

EXPERIMENTS = {
    "a1": Entry(
        "A1, free swing",
        "Free swing at four cable lengths: period, error budget.",
        _ARTICLE,
        ("--length", "5", *_ARTICLE),
        {
            "waveform": "Swing over time, and the same at the period of a point pendulum.",
            "period": "Period over cable length, and its error beside the published one.",
            "budget": "What each cause adds to the period, beside simulated and published.",
        },
    ),
    "a2": Entry(
        "A2, hoisting",
        "Hoisting while swinging: amplitude over cable length.",
        _ARTICLE,
        _ARTICLE,
        {
            "hoisting": "Swing, cable length, and the period of each half swing beside theory.",
            "fits": "Amplitude over cable length: all points, and those where the cable runs.",
        },
    ),
    "a3": Entry(
        "A3, slewing",
        "Slewing: tangential swing beside the paper's Eq. (10).",
        _ARTICLE,
        _ARTICLE,
        {
            "slewing": "The trolley's acceleration, and the swing simulated and by Eq. (10).",
            "stages": "What is left of the difference as one cause after the other is removed.",
        },
    ),
    "energy": Entry(
        "Energy",
        "Where the energy of a swing goes, to the last joule.",
        figures={
            "ledger": "Energy of the swing, what damping took, and what the ledger leaves open.",
            "remainder": "What the ledger leaves open at three time steps.",
        },
    ),
    "gazebo": Entry(
        "Gazebo",
        "The same runs in the article's own simulator.",
        figures={"difference": "Swing angle in Gazebo less that here, over time, for each run."},
    ),
    "mass_ratio": Entry(
        "Light links",
        "Links of a milligram beside a load of a tonne.",
        figures={"links": "Period of a free swing as the links between its joints become lighter."},
    ),
    "validate": Entry(
        "Validation",
        "The simulated crane beside closed forms of mechanics.",
        quick=("--halvings", "3"),
        figures={
            "convergence": "Error over time step, relative to the coarsest: slopes 1 and 2.",
            "ripple": "Energy of a large swing at steps of which each is half of the one before.",
            "oval": "The load from above, and where the far ends of its oval must come to lie.",
        },
    ),
    "linear_vs_full": Entry(
        "Linear models",
        "The paper's linear equations beside the full model.",
        figures={
            "swing_*": "Swing of the multibody, of the paper's equations, and with all rates kept.",
            "slews": "Error of the linear equations over slew rate and slew angle, for each crane.",
            "dropped": "How large the terms are that the linear equations leave out.",
        },
    ),
    "b1": Entry(
        "B1, planned moves",
        "The paper's moves: splines, two LQRs and a hoist PID.",
        figures={
            "tracking_*": "The drives and where they should be, under the paper's control.",
            "swing_*": "Radial (solid) and tangential (dashed) swing under each strategy.",
        },
    ),
    "cranes": Entry("Other cranes", "Cranes with other joints: closed forms, engines, control."),
    "compare": Entry(
        "Comparison",
        "17 strategies, also on cranes that differ from the plan.",
        quick=("--only", "spline alone", "flat + LQR"),
        figures={
            "swing": "Swing over time under each strategy, on one scale.",
            "robustness": "Swing 20 s after arrival as load, cable, sensors and air change.",
        },
    ),
    "observer": Entry(
        "Unknown loads",
        "Unknown loads and cables, seen by the drives alone.",
        quick=("--sensors", "drives"),
        figures={"left": "How much of the grid ends below a swing, for each set of sensors."},
    ),
    "margins": Entry(
        "Margins",
        "Stability margins of each strategy, over the workspace.",
        quick=("--points", "2"),
        figures={
            "margins_map": "Least damping and tolerated delay over trolley radius and cable length."
        },
    ),
    "sweep": Entry(
        "Sweep",
        "100,000 moves of cranes that differ from the plan.",
        quick=("--points", "2", "--durations", "2"),
        figures={
            "sweep_map": "Swing left over load and cable, for each strategy.",
            "sweep_timing": "Swing left over the time for the move: median, least and most.",
        },
    ),
    "lift": Entry(
        "A lift, planned",
        "From a site to a motion that is proven clear, and what wind does to it.",
        (),
        ("--site", "open_yard", "--lifts", "20"),
        {
            "site_*": "Plan and elevation of the site with the way of the load.",
            "time_*": "Clearance, swing and drives over time.",
        },
    ),
    "lift_benchmark": Entry(
        "Lifts on random sites",
        "Random sites: success, time to plan, duration.",
        ("--sites", "20"),
        ("--sites", "1"),
    ),
    "lift_report": Entry(
        "A lift, judged",
        "GO, NO GO or NOT COMPLETE: utilisation, clearance, wind, robustness.",
        (),
        ("--lifts", "20", "--gusts", "1"),
        {
            "clearance": "Clearance and swing over time.",
            "loads": "Utilisation, load moment and the rope's angles over time.",
            "chart": "Chart with the way of the load, and the jib's largest moments.",
            "wind": "Utilisation, swing and clearance over the speed of a gust.",
        },
    ),
    "factors": Entry(
        "Factors of the standards",
        "Factors of the standards, and what control needs.",
        figures={
            "factors": "ψ_h over mass ratio, β2 of hoisting classes: formula and simulation.",
            "needed": "What each strategy needs of the ψ_h that a standard allows for.",
        },
    ),
    "liftoff": Entry(
        "Lift-off and set-down",
        "Lift-off from the ground and set-down: rope, swing, ground.",
        figures={"lift_off": "Tension over weight at lift-off by speed: φ2 and simulation."},
    ),
    "hook": Entry(
        "A load attached and released",
        "Attach, carry, set down, release: impacts and energy.",
        figures={"round_trip": "Height and pull of the rope; shaded where the box hangs or lies."},
    ),
    "rope": Entry(
        "A rope with mass",
        "A heavy rope: periods, pull, winding up; friction of sheaves.",
        figures={
            "rope": "Errors by number of bodies; angle of the load in hoisting; force of the hoist."
        },
    ),
    "cylinders": Entry(
        "Cylinders of a mobile crane",
        "Cylinders by energy and points; four drives on a pump.",
        figures={"cylinders": "Forces of cylinders by the angle of the boom, and in a move."},
    ),
    "ship": Entry(
        "A crane on a ship",
        "A base that moves: resonance, heave compensation, swing control.",
        figures={"heave": "Height of the load on a base that heaves, by hoist."},
    ),
    "site": Entry(
        "Several cranes on a site",
        "Overlapping cranes: contacts and time lost, supervised or not.",
        ("--site", "luffing_between", "--minutes", "6"),
        ("--site", "two_towers", "--hours", "0.02", "--minutes", "6", "--cycles", "50"),
        {
            "invariant": "Slew of two cranes over time, in the boxes that they hold.",
            "timetable": "Lifts of a shift over time, by crane.",
        },
    ),
    "tandem": Entry(
        "Two cranes at one load",
        "A beam on two cranes: shares, late and stopped drives.",
        figures={"shares": "Pull of each rope over its static share, by lift."},
    ),
    "identify": Entry(
        "A crane, identified",
        "A crane's numbers, with intervals, from its records.",
        (),
        ("--coverage", "2", "--workers", "1"),
        {
            "twin_*": "Swing as recorded and by the twin, what is left of it, and both spectra.",
            "gazebo": "The same of a free swing in Gazebo Classic.",
            "correlation": "What setpoints alone cannot tell apart: red and blue are alike.",
        },
    ),
    "demo": Entry(
        "Demo",
        "The article's seven legs, with swing control.",
        ("--cycles", "1", "--control", "flat"),
        ("--cycles", "0.2"),
        {"swing": "Swing over time; where it is shaded the drives stand still."},
    ),
}
"""By name, in the order of the report."""

SUBJECTS: dict[str, dict[str, str]] = {
    "The article": {
        "a1": "10 s",
        "a2": "20 s",
        "a3": "10 s",
        "energy": "10 s",
        "gazebo": "15 s",
        "demo": "endless",
    },
    "Mechanics": {
        "validate": "40 s",
        "mass_ratio": "20 s",
        "linear_vs_full": "25 s",
        "ship": "1 min",
        "hook": "10 s",
        "rope": "30 s",
        "cylinders": "10 s",
        "cranes": "1 min",
    },
    "Control": {
        "b1": "25 s",
        "compare": "10 min",
        "observer": "1 min",
        "margins": "2 min",
        "sweep": "3 min",
    },
    "Lifts": {
        "lift": "4 min",
        "lift_report": "3 min",
        "lift_benchmark": "5 min",
        "factors": "1 min",
        "liftoff": "20 s",
    },
    "Sites": {"site": "3 min", "tandem": "20 s"},
    "Identification": {"identify": "1 min", "measured": "1 min"},
}
"""Experiments by subject, each with about the time that it takes on two processors."""


def expected_duration(name: str) -> float:
    """Return about the time that an experiment takes [s], see `SUBJECTS`; of one that does not end
    by itself, or is not among them, a minute.
    """
    for times in SUBJECTS.values():
        number, _, unit = times.get(name, "").partition(" ")
        if unit:
            return float(number) * {"s": 1.0, "min": 60.0}[unit]
    return 60.0


def example(name: str) -> tuple[str, ...]:
    """Return arguments of an experiment that show what it does."""
    entry = EXPERIMENTS.get(name)
    return (entry.arguments or entry.quick) if entry else ()


def main(argv: Sequence[str] | None = None) -> int:
    """Print all experiments by subject, those of other packages last; return the exit code."""
    Parser(prog="cranedyn list", description="List the experiments.").parse_args(argv)
    others = {*plugins.names("experiment")}
    for times in SUBJECTS.values():
        others -= times.keys()
    for subject, times in {**SUBJECTS, "Other packages": dict.fromkeys(sorted(others), "")}.items():
        if times:
            print(subject)
        for name, time in times.items():
            entry = EXPERIMENTS.get(name)
            line = entry.line if entry else plugins.description("experiment", name)
            text = f"  {name:15} {time:7} {line}"
            print(textwrap.fill(text, 80, subsequent_indent=" " * 26))
    print(next_lines(f"cranedyn run a1 {' '.join(_ARTICLE)}", "cranedyn report --quick"))
    return 0
