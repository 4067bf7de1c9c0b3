"""Numbers of experiments that documents state outside of generated tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

from tests.helpers import ROOT

Result = Any
"""An experiment's result, whose `table` returns the rows of a table by its title."""

Sentences = tuple[list[str], list[str]]
"""Pieces of text in README.md and in docs/results/article.md."""

_NUMBER = re.compile(r"([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)")


def missing(sentences: Iterable[str], document: str) -> list[str]:
    """Return the sentences, with numbers as printed, that a document lacks; line breaks do not
    count.

    A number with decimals may differ by one of its last digit: half is rounding, and half is what
    other processors and libraries may add to a printed digit.
    """
    text = " ".join((ROOT / document).read_text(encoding="utf-8").split())
    return [sentence for sentence in sentences if not _contains(text, sentence)]


def _contains(text: str, sentence: str) -> bool:
    fragments = _NUMBER.split(sentence)  # words and numbers in turn
    numbers = fragments[1::2]
    pattern = _NUMBER.pattern.join(map(re.escape, fragments[::2]))
    return any(
        all(map(_agree, numbers, match.groups()))
        # A match does not begin inside a number.
        for match in re.finditer(rf"(?<![\d.])(?={pattern}(?!\.?\d))", text)
    )


def _agree(number: str, stated: str) -> bool:
    mantissa, _, exponent = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    digit = 10.0 ** (int(exponent or 0) - decimals) if decimals else 0.0
    return abs(float(number) - float(stated)) <= (1.0 + 1e-9) * digit


def _row(numbers: Iterable[float], form: str, separator: str = " | ") -> str:
    return f"| {separator.join(format(number, form) for number in numbers)} "


def _a1(result: Result) -> Sentences:
    article = result.table("Free swing beside")
    budget = result.table("Error budget")
    periods = [abs(row["diff [%]"]) for row in result.table("Predicted")]
    causes = "payload inertia,dummy inertia,pivot spring,pivot damper,amplitude,gravity"
    residual = [
        f"{row['simulated less article']:+.6f}" for row in result.table("Where the damping ratio")
    ]
    error = max(abs(row["error [%]"] - row["art."]) for row in article)
    amplitude = max(abs(row["A [rad]"] - row["art. 3"]) for row in article)
    return [f"period within {max(periods):.4f} % of its prediction"], [
        f"{_row((row['error [%]'] for row in article), '+.3f', ', ')}% |",
        f"{_row((abs(row['residual']) for row in budget[:4]), '.3f', ', ')}% |",
        f"{_row((row['ζ'] for row in article), '.6f', ', ')}|",
        *(
            f"{_row((row[cause] for row in budget[:4]), '+.3f')}|"
            for cause in [*causes.split(","), "hoist compliance", "sum"]
        ),
        f"within {max(periods[:4]):.4f} %",
        f"({periods[4]:.4f} % with the soft one)",
        f"{', '.join(residual[:3])} and {residual[3]} of ζ",
        f"{error:.3f} points of the error and {amplitude:.5f} rad of the amplitude",
    ]


def _a2(result: Result) -> Sentences:
    stages = [row["exponent"] for row in result.table("Where the exponent")][:-1]
    ours, stiff, _ = result.table("Hoisting while swinging")
    exponent = f"{ours['exp. hoisting']:.4f}"
    return [f"exponent {exponent} (-0.75 in theory) |"], [
        *(f"{_row([stage], '.4f')}|" for stage in stages),
        f"{ours['mean [%]']:+.2f} % here",
        f"({ours['max [%]']:.2f} % here",
        f"({ours['exp. all']:.3f} here",
        f"{ours['A after']:.3f} rad at the end",
        f"with a stiff one {stiff['A after']:.3f} rad",
        f"| -0.7398 | {exponent} |",
    ]


def _a3(result: Result) -> Sentences:
    rows = result.table("Tangential swing")
    amplitude = f"{rows[0]['θ measured [rad]']:.4f}"
    rms = f"{rows[0]['RMS [rad]']:.5f}"
    correlation = f"{rows[0]['correlation']:+.4f}"
    soft, stiff = (
        [row["of amplitude [%]"] for row in rows if row["slew drive"] == drive]
        for drive in ("soft", "stiff")
    )
    return [f"correlation {correlation} with the tangential swing of Eq. (10)"], [
        *(f"{_row(pair, '.2f')}|" for pair in zip(soft, stiff, strict=True)),
        f"| {amplitude}, {correlation}, {rms} |",
    ]


def _energy(result: Result) -> Sentences:
    damping = result.table("Damping of the swing joints")
    steps = [f"{row['at most [J]']:.2f}" for row in result.table("What the ledger")]
    unexplained = damping[1]["unexplained, at most [J]"]
    return [f"open by {unexplained:.2f} J of 1652 J at most"], [
        f"closes to within {unexplained:.2f} J",
        f"({steps[0]}, {steps[1]} and {steps[2]} J at 1, 0.5 and 0.25 ms)",
        f"leaves {damping[2]['energy left [J]']:.1f} J after six seconds",
        f"the closed form says {damping[2]['closed form, fixed pivot [J]']:.1f} J",
        f"differ by {damping[1]['dissipated [J]']:.3f} J",
    ]


def _mass_ratio(result: Result) -> Sentences:
    rows = result.table("Free swing with ever lighter links")
    error = f"{max(abs(row['relative error']) for row in rows):.1e}".replace("e-0", "e-")
    return [], [f"within {error} at every mass"]


STATEMENTS: dict[str, Callable[[Result], Sentences]] = {
    "a1": _a1,
    "a2": _a2,
    "a3": _a3,
    "energy": _energy,
    "mass_ratio": _mass_ratio,
}
"""Text with the numbers of an experiment, by its name."""
