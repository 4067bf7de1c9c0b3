"""Streams of Rerun end with what they record."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
import rerun as rr
import rerun.blueprint as rrb

from cranedyn.recording.stream import recording_file, send_layout

pytestmark = pytest.mark.filterwarnings("error:::rerun")


def recorded(path: Path) -> None:
    with recording_file(path, "cranedyn-test") as recording:
        send_layout(recording, rrb.Blueprint(rrb.TextDocumentView(origin="text", name="Words")))
        recording.log("text", rr.TextDocument("words"), static=True)


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads in /proc")
def test_no_thread_stays_from_one_recording_to_the_next(tmp_path: Path) -> None:
    counts = []
    for number in range(4):
        recorded(tmp_path / f"{number}.rrd")
        counts.append(len(os.listdir("/proc/self/task")))
    assert len(set(counts[1:])) == 1


def test_an_error_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError), recording_file(tmp_path / "a.rrd", "cranedyn-test"):
        raise ValueError
    assert not list(tmp_path.iterdir())
