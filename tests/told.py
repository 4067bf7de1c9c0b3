"""Numbers that documents tell of experiments outside of tables between marks, as they must stand
there.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

from tests.helpers import ROOT

Result = Any
"""What an experiment left: an object whose `table` gives the rows of the table with a title, by
header."""

Told = tuple[list[str], list[str]]
"""What README.md and docs/results/article.md tell."""


_NUMBER = re.compile(r"([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)")


def missing(sentences: Iterable[str], document: str) -> list[str]:
    """Return the sentences, with numbers as printed, that a document does not tell, however its
    lines are broken.

    A number with decimals is told if it is off by one of its last digit: half is rounding, and half
    is what other processors and libraries may add to a digit that is printed.
    """
    text = " ".join((ROOT / document).read_text(encoding="utf-8").split())
    return [sentence for sentence in sentences if not _is_told(sentence, text)]


def _is_told(sentence: str, text: str) -> bool:
    parts = _NUMBER.split(sentence)  # words and numbers in turn
    numbers = parts[1::2]
    pattern = "".join(
        _NUMBER.pattern if at % 2 else re.escape(part) for at, part in enumerate(parts)
    )
    return any(
        all(map(_near, numbers, found.groups()))
        # not from the middle of another number on
        for found in re.finditer(rf"(?<![\d.])(?={pattern}(?!\.?\d))", text)
    )


def _near(number: str, told: str) -> bool:
    mantissa, _, exponent = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    digit = 10.0 ** (int(exponent or 0) - decimals) if decimals else 0.0
    return abs(float(number) - float(told)) <= (1.0 + 1e-9) * digit


def _row(numbers: Iterable[float], form: str, between: str = " | ") -> str:
    return f"| {between.join(format(number, form) for number in numbers)} "


def _of_a1(result: Result) -> Told:
    article, budget = result.table("Free swing beside"), result.table("Error budget")
    periods = [abs(row["diff [%]"]) for row in result.table("Predicted")]
    stiff, soft = f"{max(periods[:4]):.4f} %", f"{periods[4]:.4f} %"
    readme = [f"period within {max(periods):.4f} % of its prediction"]
    causes = [
        "payload inertia",
        "dummy inertia",
        "pivot spring",
        "pivot damper",
        "amplitude",
        "gravity",
        "hoist compliance",
        "sum",
    ]
    left = [
        f"{row['simulated less article']:+.6f}" for row in result.table("Where the damping ratio")
    ]
    errors, amplitudes = (
        max(abs(row[one] - row[other]) for row in article)
        for one, other in (("error [%]", "art."), ("A [rad]", "art. 3"))
    )
    findings = [
        f"{_row((row['error [%]'] for row in article), '+.3f', ', ')}% |",
        f"{_row((abs(row['residual']) for row in budget[:4]), '.3f', ', ')}% |",
        f"{_row((row['ζ'] for row in article), '.6f', ', ')}|",
        *(f"{_row((row[cause] for row in budget[:4]), '+.3f')}|" for cause in causes),
        f"within {stiff}",
        f"({soft} with the soft one)",
        f"{', '.join(left[:3])} and {left[3]} of ζ",
        f"{errors:.3f} points of the error and {amplitudes:.5f} rad of the amplitude",
    ]
    return readme, findings


def _of_a2(result: Result) -> Told:
    stages = [row["exponent"] for row in result.table("Where the exponent")][:-1]
    ours, stiff, _ = result.table("Hoisting while swinging")
    findings = [
        *(f"{_row([exponent], '.4f')}|" for exponent in stages),
        f"{ours['mean [%]']:+.2f} % here",
        f"({ours['max [%]']:.2f} % here",
        f"({ours['exp. all']:.3f} here",
        f"{ours['A after']:.3f} rad at the end",
        f"with a stiff one {stiff['A after']:.3f} rad",
    ]
    exponent = f"{ours['exp. hoisting']:.4f}"
    return [f"exponent {exponent} |"], [*findings, f"| -0.7398 | {exponent} |"]


def _of_a3(result: Result) -> Told:
    rows = result.table("Tangential swing")
    amplitude, correlation, rms = (
        format(rows[0][name], form)
        for name, form in (
            ("θ measured [rad]", ".4f"),
            ("correlation", "+.4f"),
            ("RMS [rad]", ".5f"),
        )
    )
    soft, stiff = (
        [row["of amplitude [%]"] for row in rows if row["slew drive"] == drive]
        for drive in ("soft", "stiff")
    )
    findings = [f"{_row(pair, '.2f')}|" for pair in zip(soft, stiff, strict=True)]
    readme = [f"correlation {correlation} with Eq. (10)"]
    return readme, [*findings, f"| {amplitude}, {correlation}, {rms} |"]


def _of_energy(result: Result) -> Told:
    damped, steps = (
        result.table("Damping of the swing joints"),
        [row["at most [J]"] for row in result.table("What the ledger")],
    )
    most = damped[1]["unexplained, at most [J]"]
    findings = [
        f"open by {most:.2f} J at most",
        f"({steps[0]:.2f}, {steps[1]:.2f} and {steps[2]:.2f} J at 1, 0.5 and 0.25 ms)",
        f"leaves {damped[2]['energy left [J]']:.1f} J after six seconds",
        f"the closed form says {damped[2]['closed form, fixed pivot [J]']:.1f} J",
        f"differ by {damped[1]['dissipated [J]']:.3f} J",
    ]
    return [f"open by {most:.2f} J of 1652 J at most"], findings


def _of_mass_ratio(result: Result) -> Told:
    rows = result.table("Free swing with ever lighter links")
    worst = f"{max(abs(row['relative error']) for row in rows):.1e}".replace("e-0", "e-")
    return [], [f"within {worst} at every mass"]


TOLD: dict[str, Callable[[Result], Told]] = {
    "a1": _of_a1,
    "a2": _of_a2,
    "a3": _of_a3,
    "energy": _of_energy,
    "mass_ratio": _of_mass_ratio,
}
"""By experiment."""
