"""Tables on terminals of any width, and what is said of long runs where there is none."""

from __future__ import annotations

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console
from rich.progress import Progress

from experiments.harness.outcome import Claim, Outcome, ResultTable, show
from experiments.harness.progress import LINE_INTERVAL, ProgressLines, ProgressReporter
from experiments.harness.terminal import blocks

HEADS = st.lists(
    st.sampled_from(
        ["l [m]", "T [s]", "at arrival [mrad]", "hoist compliance", "ζ", "art.", "F_x [N]"]
    ),
    min_size=1,
    max_size=14,
)


@st.composite
def tables(draw: st.DrawFn) -> ResultTable:
    """Tables as experiments make them: a name or a number in front, numbers behind."""
    heads = draw(HEADS)
    count = draw(st.integers(1, 6))
    number = st.floats(-1e6, 1e6) | st.none()
    rows = [[f"strategy {i} with words", *(draw(number) for _ in heads)] for i in range(count)]
    return ResultTable(
        "A title",
        [("strategy", ""), *((head, ".6g") for head in heads)],
        rows,
        "A note of some words. " * 4,
    )


def printed(table: ResultTable, width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    for part in blocks(table, width):
        console.print(part)
    text = console.file.getvalue()
    assert isinstance(text, str)
    return text


@pytest.mark.slow
@given(tables(), st.sampled_from([60, 80, 100, 200, 400]))
def test_no_number_is_cut_and_no_line_is_wider_than_the_terminal(
    table: ResultTable, width: int
) -> None:
    text = printed(table, width)
    assert max(map(cell_len, text.splitlines())) <= width
    assert "…" not in text
    words = text.split()
    for row in table.shown():
        for cell in row[1:]:
            assert words.count(cell) >= sum(other[1:].count(cell) for other in table.shown())
    for head, _ in table.columns:
        assert all(word in words for word in head.split())


def test_a_table_that_fits_is_one_block_and_stays_upright() -> None:
    table = ResultTable("t", [("a", ""), ("b [m]", "g"), ("c", "g")], [("x", 1.0, 2.0)])
    assert len(list(blocks(table, 80))) == 1
    assert "┃ a ┃ b [m] ┃ c ┃" in printed(table, 80)


def test_a_table_with_few_rows_and_many_columns_is_turned() -> None:
    table = ResultTable(
        "t",
        [("l [m]", "g"), *((f"quantity {i}", ".4f") for i in range(12))],
        [[5.0, *[1.0] * 12], [10.0, *[2.0] * 12]],
    )
    (part,) = blocks(table, 80)
    assert [column.header.plain for column in part.columns] == ["l [m]", "5", "10"]
    assert part.row_count == 12


def test_rows_that_two_columns_tell_apart_keep_both_in_every_block() -> None:
    columns = [("l [m]", "g"), ("k_p", ".0e"), *((f"cause number {i}", "+.3f") for i in range(12))]
    table = ResultTable("t", columns, [[15.0, 3e5, *[0.1] * 12], [15.0, 3e4, *[0.2] * 12]])
    parts = list(blocks(table, 80))
    assert len(parts) > 1
    assert all(
        [column.header.plain for column in part.columns[:2]] == ["l [m]", "k_p"] for part in parts
    )
    assert [bool(part.title) for part in parts] == [True, *[False] * (len(parts) - 1)]


def test_without_a_terminal_a_claim_is_one_line_and_columns_are_80(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    table = ResultTable(
        "t", [("a", ""), *((f"number {i}", ".6f") for i in range(14))], [("x", *[1.0] * 14)] * 20
    )
    show(Outcome([table], [Claim("A long sentence. " * 12, True)]))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[:-2])) <= 80
    assert lines[-2].startswith("holds      A long sentence.")
    assert lines[-2].count("A long") == 12
    monkeypatch.setenv("COLUMNS", "250")
    show(Outcome([table], []))
    assert max(map(len, capsys.readouterr().out.splitlines())) > 150


@pytest.mark.slow
@pytest.mark.parametrize("width", [60, 80])
def test_a_screen_has_24_lines_the_failed_claim_whole_and_says_what_is_left_out(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal, where claims fold
    columns = [("name", ""), *((f"number {i}", ".6f") for i in range(14))]
    table = ResultTable("t", columns, [("some words", *[1.0] * 14)] * 30, "A note. " * 20)
    claims = [Claim(f"Claim {i}. " * 12, None if i % 2 else True) for i in range(30)]

    left_out = show(Outcome([table, table], claims), whole=False)

    text = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    lines = text.splitlines()
    assert len(lines) <= 21  # and three of pointers
    assert max(map(cell_len, lines)) <= width
    counts = {noun: n for n, noun in re.findall(r"(\d+) (\w+?)s?(?:, | and |$)", left_out)}
    assert left_out.count(" and ") == 1
    names = [line for line in lines if "some" in line]
    assert int(counts["row"]) == 30 - len(names)
    assert counts["table"] == "1"
    # What was not judged stands first, and each claim that is shown is whole.
    claims_shown = text.count("not judged ")
    assert claims_shown >= 1
    assert "holds " not in text
    assert int(counts["claim"]) == 30 - claims_shown
    assert text.count("Claim") == 12 * claims_shown
    assert lines[-1] == "15 of 30 claims hold, 15 not judged."

    show(Outcome([table], [Claim("It does not. " * 20, False)]), whole=False)
    text = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert " ".join(text.split()).count("not.") == 20
    assert show(Outcome([], [Claim("It holds.", True)]), whole=False) == ""


def test_a_long_run_says_a_line_now_and_then_and_a_short_one_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = 0.0
    lines = ProgressReporter(lines=ProgressLines(lambda: now))
    update = lines.run("l = 5 m", 70.0)
    assert update is not None
    for k in range(300):
        now = 0.1 * k
        update(now)
    first = next(0.1 * k for k in range(300) if 0.1 * k >= LINE_INTERVAL)
    assert capsys.readouterr().err.splitlines() == [
        f"l = 5 m: {first:.1f} of 70 s",
        "l = 5 m: 20.0 of 70 s",
    ]
    lines.count("cases", 7)(3)
    assert capsys.readouterr().err == ""
    now = 1000.0
    lines.count("cases", 7)(3)
    assert capsys.readouterr().err == "cases: 3 of 7\n"


def test_work_without_a_known_end_has_a_moving_bar_with_its_number_until_the_next_begins() -> None:
    bars = Progress(disable=True)
    reporter = ProgressReporter(bars)
    show_predictions = reporter.message("records", "predictions")
    assert show_predictions is not None
    show_predictions(19)
    (first,) = bars.tasks
    assert (first.total, first.fields["speed"]) == (None, "19 predictions")
    reporter.message("assumed inertias", "changes tried")
    assert [task.finished for task in bars.tasks] == [True, False]
