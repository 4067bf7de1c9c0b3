"""Which experiments there are: what each is called in front of people, and with which arguments the report makes it."""

from __future__ import annotations

from typing import NamedTuple


class Entry(NamedTuple):
    """An experiment of the catalogue.

    Attributes:
        title: What it is called on a page.
        line: What it shows.
        words: The arguments with which the report makes it.
        quick: Arguments that make the least of it; its claims need not hold then.
    """

    title: str
    line: str
    words: tuple[str, ...] = ()
    quick: tuple[str, ...] = ()


_ARTICLE = ("--gravity", "9.8")

EXPERIMENTS = {
    "a1": Entry("A1, free swing", "Free swing at four cable lengths: period and error budget.", _ARTICLE, ("--length", "5")),
    "a2": Entry("A2, hoisting", "Hoisting while the load swings: amplitude over cable length.", _ARTICLE),
    "a3": Entry("A3, slewing", "Slewing: the tangential swing beside the paper's Eq. (10).", _ARTICLE),
    "energy": Entry("Energy", "Where the energy of a swing goes, to the last joule."),
    "mass_ratio": Entry("Light links", "Links of a milligram beside a load of a tonne."),
    "validate": Entry("Validation", "The plant against closed forms of mechanics.", (), ("--halvings", "3")),
    "linear_vs_full": Entry("Linear models", "The paper's linear equations beside the whole multibody."),
    "b1": Entry("B1, planned moves", "The paper's moves: splines, two LQRs and a hoist PID."),
    "compare": Entry("Comparison", "Fifteen strategies under the same limits, then on a changed crane."),
    "sweep": Entry("Sweep", "A hundred thousand moves of cranes that are not as planned.", (), ("--points", "2", "--durations", "2")),
    "demo": Entry(
        "Demo", "The seven legs of the article, with their swing controlled.", ("--cycles", "1", "--control", "flat"), ("--cycles", "0.2")
    ),
}
"""By name, in the order of the report."""

TOOLS = {
    "report": "All experiments on one page, out/report.html.",
    "snapshot": "Pictures of a recording, without a display.",
}
"""Commands that are no experiments and run like one."""
