"""Every example runs, and does what it says."""

from __future__ import annotations

import importlib.util
import threading
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.__main__ import main as command
from cranedyn.compiled.c_text import c_header, c_source
from cranedyn.export.controller_block import controller_block
from cranedyn.export.usual_controllers import usual_controller
from cranedyn.interfaces import Drive
from cranedyn.model.load import load_crane
from cranedyn.recording.process import free_port
from tests.export.c_tools import tool
from tests.helpers import ROOT
from tests.system.test_pages import scripts

EXAMPLES = ROOT / "examples" / "bridges"


def module(name: str) -> Any:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(f"examples_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    return example


def main(name: str) -> Callable[..., Any]:
    """The entry of an example."""
    return module(name).main  # type: ignore[no-any-return]


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


def train_benchmark_policy(out: Path) -> None:
    pytest.importorskip(
        "stable_baselines3", reason="extra learning (stable-baselines3) is not installed"
    )
    from cranedyn.benchmark.policy import read_policy

    out.mkdir()
    for algorithm in ("ppo", "sac"):
        file = out / f"{algorithm}.npz"
        words = [algorithm, "inteco/move", "--minutes", "0.02", "--out", str(file)]
        made = main("train_benchmark_policy")(words)
        read = read_policy(file)
        assert read.algorithm == algorithm.upper()
        observation = np.linspace(-0.5, 0.5, 13)[None]
        action = read.of_observation(observation, 3)
        np.testing.assert_allclose(action, made.of_observation(observation, 3), atol=1e-6)
        assert (np.abs(action) <= 1.0).all()


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


def c_block(folder: Path, name: str, drive: Drive, period: float) -> Path:
    """The folder of a controller in C, as ``cranedyn export c`` writes it, without the crane."""
    crane = load_crane()
    controller, _ = usual_controller(name, crane, period, drive)
    block = controller_block(
        crane, controller, drive=drive, control_period=period, name="controller"
    )
    folder.mkdir(parents=True)
    (folder / "controller.h").write_text(c_header(block, "double"), encoding="utf-8")
    (folder / "controller.c").write_text(c_source(block, "double"), encoding="utf-8")
    return folder


def moved_over(protocol: str, block: Path, folder: Path, words: Sequence[str]) -> Any:
    """What the example prints about a move over a protocol, of a plant that keeps step with it."""
    pytest.importorskip("asyncua", reason="extra serve (asyncua) is not installed")
    pytest.importorskip("pymodbus", reason="extra serve (pymodbus) is not installed")
    tool("cc", "gcc")
    from cranedyn.interop.commissioning.serve import servers
    from cranedyn.interop.commissioning.served_crane import ServedCrane
    from cranedyn.interop.commissioning.words import write_map

    plant = ServedCrane(load_crane(), duration=60.0)
    word_map = write_map(folder / f"{protocol}.csv", plant.image.words)
    port = free_port()

    def wait() -> None:
        """Let the plant move on by a cycle of the program, 20 ms."""
        for _ in range(4):
            plant.cycle()

    server = {protocol: ("127.0.0.1", port)}
    address = f"127.0.0.1:{port}" if protocol == "modbus" else f"opc.tcp://127.0.0.1:{port}/"
    with servers(plant, **server):
        options = [str(block), str(word_map), f"--{protocol}", address, *words]
        done = main("block_on_plant")(options, wait=wait)
    assert not plant.events
    return done


def block_on_plant(out: Path) -> None:
    out.mkdir()
    block = c_block(out / "block", "lqr", "velocity", 0.02)
    done = moved_over("modbus", block, out, ["--to", "x=14", "--seconds", "2"])
    # The setpoint is at 10 m + 0.4 m/s * 2 s, and the drive lags behind it.
    assert 10.2 < done.positions["x"] < 10.8
    assert done.positions["gamma"] == pytest.approx(0.0, abs=1e-3)
    assert done.fault == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "period", "message"),
    [("velocity", 0.005, "export it with --period 0.02"), ("effort", 0.02, "--drive velocity")],
)
def test_a_block_that_does_not_fit_the_plant_is_refused(
    drive: Drive, period: float, message: str, tmp_path: Path
) -> None:
    tool("cc", "gcc")
    block = c_block(tmp_path / "block", "lqr", drive, period)
    word_map = tmp_path / "words.csv"
    word_map.write_text("name,opc_ua_node\n", encoding="utf-8")
    with pytest.raises(SystemExit, match=message):
        main("block_on_plant")([str(block), str(word_map), "--modbus", "127.0.0.1:5020"])


class ScriptedLink:
    """A plant at rest that reports the same in each cycle, but for one reading from a cycle on."""

    def __init__(self, name: str, value: int, cycle: int) -> None:
        self._trouble = {name: value}
        self._cycle = cycle
        self.written: list[Mapping[str, int]] = []

    def read(self) -> dict[str, int]:
        """The readings of the next cycle."""
        readings = {"fault": 0, "phi.angle": 0, "theta.angle": 0}
        for drive, position in (("gamma", 0), ("x", 100_000), ("l", 150_000)):
            readings[f"{drive}.encoder"] = position
            readings[f"{drive}.actual_speed"] = 0
        return readings | (self._trouble if len(self.written) >= self._cycle else {})

    def write(self, commands: Mapping[str, int]) -> None:
        """Keep the commands of a cycle."""
        self.written.append(dict(commands))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [("fault", 1), ("phi.angle", -32768)])
def test_the_program_around_a_block_disables_all_drives_at_a_fault_or_a_lost_sensor(
    name: str, value: int, tmp_path: Path
) -> None:
    tool("cc", "gcc")
    example = module("block_on_plant")
    block = example.Block(c_block(tmp_path / "block", "lqr", "velocity", 0.02))
    word = example.Word("", 0, "INT16", 1e-4, False)
    words = defaultdict(lambda: word)
    link = ScriptedLink(name, value, cycle=10)
    example.move(link, words, block, {"x": 14.0}, 1.0, wait=lambda: None)
    enabled = [
        [written[f"{drive}.control"] for drive in example.DRIVES] for written in link.written
    ]
    # Enabled until then, disabled in the cycle of the fault, and once more at the end.
    assert enabled == 10 * [[1, 1, 1]] + 2 * [[0, 0, 0]]


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["modbus", "opcua"])
def test_a_plant_that_is_not_served_is_told_in_one_sentence(protocol: str) -> None:
    example = module("block_on_plant")
    port = free_port()
    with pytest.raises(SystemExit, match=r"server at .*; start cranedyn serve first"):
        if protocol == "modbus":
            pytest.importorskip("pymodbus", reason="extra serve (pymodbus) is not installed")
            example.ModbusLink("127.0.0.1", port, {})
        else:
            pytest.importorskip("asyncua", reason="extra serve (asyncua) is not installed")
            example.OpcUaLink(f"opc.tcp://127.0.0.1:{port}/", {})


def test_the_rate_of_the_swing_is_that_of_an_angle_that_rises_steadily() -> None:
    example = module("block_on_plant")
    rates = example.SwingRates()
    # After twenty time constants nothing is left of the start.
    for k in range(100):
        found = rates.update({"phi": 0.05 * k * example.CYCLE})
    assert found == pytest.approx({"phi_dot": 0.05}, rel=1e-6)


@pytest.mark.long
def test_the_design_of_the_how_to_moves_the_served_crane_over_both_protocols(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("control", reason="extra control (python-control) is not installed")
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {"__name__": "page"}
    for script in scripts(ROOT / "docs/howto/served_plant.md"):
        exec(compile(script, "served_plant.md", "exec", dont_inherit=True), scope)
    export = ["export", "c"]
    period = ["--period", "0.02"]
    assert command([*export, "block", "--controller", "my_gain.json", *period]) == 0
    assert command([*export, "hold", "--controller", "hold", "--drive", "velocity", *period]) == 0

    words = ["--to", "gamma=0.1", "x=14", "l=13"]
    over = {name: moved_over(name, Path("block"), tmp_path, words) for name in ("modbus", "opcua")}
    # The plant waits for each cycle, so that both see the same words.
    assert over["modbus"] == over["opcua"]
    done = over["opcua"]
    targets = {"gamma": 0.1, "x": 14.0, "l": 13.0}
    assert done.positions == pytest.approx(targets, abs=0.01)
    # What the page says; the angles come in steps of 0.1 mrad.
    assert done.last_swing <= 5e-4
    (tmp_path / "modbus.csv").unlink()
    blind = moved_over("modbus", Path("hold"), tmp_path, words)
    assert blind.last_swing > 10.0 * done.last_swing


TESTS = {
    "block_on_plant": block_on_plant,
    "soft_plc": soft_plc,
    "control_design": control_design,
    "cosimulation": cosimulation,
    "learn_overhead_crane": learn_overhead_crane,
    "learn_to_stop_the_swing": learn_to_stop_the_swing,
    "train_benchmark_policy": train_benchmark_policy,
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
