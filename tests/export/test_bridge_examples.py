"""Every example runs, and does what it says."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.model.load import load_crane
from cranedyn.recording.process import free_port
from tests.helpers import ROOT

EXAMPLES = ROOT / "examples" / "bridges"


def main(name: str) -> Callable[..., Any]:
    """The entry of an example."""
    spec = importlib.util.spec_from_file_location(f"examples_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def control_design(out: Path) -> None:
    pytest.importorskip("control", reason="extra control (python-control) is not installed")
    found = main("control_design")(["--out", str(out)])
    assert (out / "control_design.png").stat().st_size > 20_000
    assert found["swing left [mrad]"] < 0.05
    margins = [value for name, value in found.items() if "margin" in name]
    # An LQR in continuous time has 60 degrees and 1; sampled at 200 Hz it has nearly that.
    assert len(margins) == 6
    assert all(value > (58.0 if value > 2.0 else 0.95) for value in margins)


def cosimulation(out: Path) -> None:
    pytest.importorskip("fmpy", reason="fmpy is not installed")
    off, _ = main("cosimulation")(["--out", str(out)])
    assert off < 1e-12


def learn_to_stop_the_swing(out: Path) -> None:
    pytest.importorskip(
        "stable_baselines3", reason="extra learning (stable-baselines3) is not installed"
    )
    learned = main("learn_to_stop_the_swing")(
        ["--steps", "9700", "--cranes", "32", "--beside", "spline alone", "--out", str(out)]
    )
    assert (out / "model.zip").exists()
    assert (out / "curve.png").exists()
    assert len(learned.curve) >= 1
    assert np.isfinite(learned.curve).all()
    assert set(learned.scores) > {"spline alone", "learned"}


def learn_overhead_crane(out: Path) -> None:
    pytest.importorskip("gymnasium", reason="extra gymnasium is not installed")
    learned = main("learn_overhead_crane")(["--iterations", "10", "--out", str(out)])
    scores = learned.scores
    np.testing.assert_allclose(np.loadtxt(out / "policy.csv", delimiter=","), learned.matrix)
    # Ten of 400 iterations bring the load nearer, but not to its place.
    assert scores["learned"].mean_return > scores["standing still"].mean_return + 5.0
    assert scores["standing still"].solved == scores["random"].solved == 0.0


def soft_plc(out: Path) -> None:
    pytest.importorskip("asyncua", reason="extra serve (asyncua) is not installed")
    from cranedyn.interop.commissioning.serve import keep_time, servers
    from cranedyn.interop.commissioning.served_crane import ServedCrane

    crane = ServedCrane(load_crane(), duration=60.0)
    port = free_port()
    with servers(crane, opcua=("127.0.0.1", port)):
        clock = threading.Thread(target=keep_time, args=(crane, 1600))
        clock.start()
        words = ["--url", f"opc.tcp://127.0.0.1:{port}/", "--to", "12", "--seconds", "7"]
        place = main("soft_plc")(words)
        clock.join()
    assert place == pytest.approx(12.0, abs=0.02)
    assert not crane.events


TESTS = {
    "soft_plc": soft_plc,
    "control_design": control_design,
    "cosimulation": cosimulation,
    "learn_overhead_crane": learn_overhead_crane,
    "learn_to_stop_the_swing": learn_to_stop_the_swing,
}


def test_every_example_has_a_test() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(TESTS)


@pytest.mark.parametrize("name", TESTS)
@pytest.mark.slow
def test_an_example_does_what_it_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    TESTS[name](Path("out"))
