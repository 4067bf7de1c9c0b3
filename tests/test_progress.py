"""Bars while work takes long: on a terminal only, and with the time that is left."""

from __future__ import annotations

import io
import sys
import time

import pytest

from cranedyn.progress import bar


class Terminal(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self) -> bool:
        """Return that it is one."""
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kind of terminal on which bars are drawn, whatever the surroundings say."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


def drawn(out: io.StringIO, err: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return what a bar of a work of 10 s draws on standard error, seen until the third second."""
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    with bar("export", 10.0) as show_done:
        for second in range(1, 4):
            show_done(float(second))
            time.sleep(0.15)
    assert out.getvalue() == ""
    return err.getvalue()


@pytest.mark.usefixtures("terminal")
def test_a_bar_on_a_terminal_says_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    text = drawn(Terminal(), Terminal(), monkeypatch)
    assert "export" in text
    assert "left" in text


@pytest.mark.usefixtures("terminal")
@pytest.mark.parametrize(
    ("out", "err"),
    [(io.StringIO, io.StringIO), (io.StringIO, Terminal), (Terminal, io.StringIO)],
)
def test_nothing_is_drawn_where_an_output_is_no_terminal(
    out: type[io.StringIO], err: type[io.StringIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert drawn(out(), err(), monkeypatch) == ""
