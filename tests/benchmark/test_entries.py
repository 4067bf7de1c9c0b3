"""Entries that are no functions in Python: each kind with real files, and the files of an entry."""

from __future__ import annotations

import py_compile
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.benchmark.entries.c_library import HEADER
from cranedyn.benchmark.entries.observation import Observer, training_environment
from cranedyn.benchmark.entries.targets import Targets
from cranedyn.benchmark.entry import Briefing, Entry, briefing_of
from cranedyn.benchmark.entry_kinds import open_entry
from cranedyn.benchmark.entry_process import EntryFailed, EntryLimits, EntryProcess
from cranedyn.benchmark.entry_source import EntrySource, find_entry
from cranedyn.benchmark.evaluate import Evaluator, InstanceResult, run_instance
from cranedyn.benchmark.result import run_benchmark, verify_result
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, DataError
from cranedyn.export import fmi
from cranedyn.export.usual_controllers import usual_controller
from cranedyn.interfaces import Setpoint
from cranedyn.recording.process import free_port
from tests.benchmark.toys import (
    InThisProcess,
    from_page,
    page_controller,
    still,
    towards_goal,
    toy,
    toy_instance,
)


def run_here(opened: object, kind: str, **values: float) -> InstanceResult:
    """The result of an opened entry in a short task, in this process."""
    process: Any = InThisProcess(opened)  # type: ignore[arg-type]
    return run_instance(toy_instance(kind, **values), process)


@contextmanager
def process_of(text: str, **arguments: Any) -> Iterator[EntryProcess]:
    """An entry in a process of its own."""
    process = EntryProcess(find_entry(text, **arguments), EntryLimits())
    try:
        yield process
    finally:
        process.close()


# --- C --------------------------------------------------------------------------------------------

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


def compiled(folder: Path, text: str, name: str = "mine") -> Path:
    """A shared library of a text in C, compiled without a warning as the page says."""
    (folder / f"{name}.c").write_text(text, encoding="utf-8")
    shutil.copy(HEADER, folder / "crane_entry.h")
    library = folder / f"{name}.so"
    words = ["cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2", "-fPIC"]
    words += ["-shared", f"{name}.c", "-o", library.name, "-lm"]
    subprocess.run(words, cwd=folder, check=True)
    return library


@needs_compiler
@pytest.mark.slow
def test_the_library_of_the_page_moves_as_the_function_of_the_page(tmp_path: Path) -> None:
    library = compiled(tmp_path, from_page("c", "crane_begin"))
    for kind in ("move", "wind"):
        with process_of(str(library)) as process:
            found = run_instance(toy_instance(kind, start_swing=0.02), process)
        expected = run_here(page_controller(), kind, start_swing=0.02)
        assert found.status == expected.status
        # The same law in the same precision; the compiler may add in another order.
        assert found.metrics == pytest.approx(expected.metrics, rel=1e-9)


FAULTY = """
#include "crane_entry.h"
static int32_t told;
int32_t crane_begin(const crane_briefing *briefing) {
  if (briefing->goal == 0) return briefing->kind[0] == 'o' ? 1 : 7;
  told = briefing->drives;
  return 0;
}
int32_t crane_command(const crane_reading *reading, double *rates) {
  if (reading->t > 1.0) *(volatile double *)0 = 1.0;
  for (int i = 0; i < told; i++) rates[i] = 0.0;
  if (reading->swing[0] > 0.04) return 2;
  return 0;
}
const char *crane_message(void) { return "The swing is too large."; }
"""


@needs_compiler
@pytest.mark.slow
def test_a_library_that_crashes_fails_its_instance_and_not_the_others(tmp_path: Path) -> None:
    library = compiled(tmp_path, FAULTY)
    with process_of(str(library)) as process:
        crashed = run_instance(toy_instance("move"), process)
        told = run_instance(toy_instance("move", start_swing=0.05), process)
        declined = run_instance(toy_instance("operator"), process)
        refused = run_instance(toy_instance("path"), process)
    assert crashed.reason == "Its process was ended by SIGSEGV."
    assert told.reason == "crane_command returned 2: The swing is too large."
    assert (declined.status, declined.reason) == ("declined", "The swing is too large.")
    assert (refused.status, refused.reason) == (
        "failed",
        "crane_begin returned 7: The swing is too large.",
    )


@needs_compiler
def test_a_library_without_the_functions_is_refused(tmp_path: Path) -> None:
    library = compiled(tmp_path, "int other(void);\nint other(void) { return 0; }\n")
    with pytest.raises(DataError, match="has no function crane_begin"):
        open_entry(str(library))
    (tmp_path / "text.so").write_text("no library", encoding="utf-8")
    with pytest.raises(DataError, match="is no shared library of this machine"):
        open_entry(str(tmp_path / "text.so"))


def test_the_header_is_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["benchmark", "header"]) == 0
    assert (tmp_path / "crane_entry.h").read_bytes() == HEADER.read_bytes()
    assert main(["benchmark", "header"]) == 2


# --- targets --------------------------------------------------------------------------------------


def test_a_target_is_the_goal_the_path_the_start_or_where_the_operator_sent_the_drives() -> None:
    zero = np.zeros(3)

    def reading(t: float, operator: np.ndarray = zero) -> SensorReading:
        return SensorReading(t, zero, zero, zero[:2], zero[:2], operator)

    for kind in ("move", "wind"):
        briefing = briefing_of(toy(kind))
        assert briefing.goal is not None
        target = Targets(briefing)(reading(0.5))
        assert target.position.tolist() == briefing.goal.q[briefing.crane.layout.drives].tolist()
        assert not target.rate.any()
    briefing = briefing_of(toy("path"))
    assert briefing.path is not None
    assert Targets(briefing)(reading(0.5)).rate.tolist() == briefing.path(0.5).velocity.tolist()

    briefing = briefing_of(toy("operator"))
    start = briefing.start.q[briefing.crane.layout.drives]
    targets = Targets(briefing)
    asked = np.array([0.3, 0.0, -0.1])
    found = [targets(reading(0.02 * k, asked)) for k in range(6)]
    # A rate that is asked for acts from its period on: after five periods of 20 ms, 0.1 s.
    assert found[0].position == pytest.approx(start, abs=1e-15)
    assert found[5].position == pytest.approx(start + 0.1 * asked, abs=1e-15)
    assert found[5].rate.tolist() == asked.tolist()


# --- FMU ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_an_exported_controller_moves_as_it_does_in_python(version: Any, tmp_path: Path) -> None:
    pytest.importorskip("fmpy", reason="extra fmi (fmpy) is not installed")
    task = toy("move")
    crane = task.crane()
    controller, drive = usual_controller("lqr", crane, task.period, "velocity")
    file = fmi.export(
        crane,
        tmp_path / "lqr.fmu",
        controller=controller,
        drive=drive,
        control_period=task.period,
        version=version,
    )

    def in_python(briefing: Briefing) -> Entry:
        own, kind = usual_controller("lqr", briefing.crane, briefing.period, "velocity")
        if briefing.kind != "operator":
            return briefing.entry(own, briefing.motion, kind)
        targets = Targets(briefing)

        def rates(reading: SensorReading) -> np.ndarray:
            setpoint = Setpoint(*targets(reading), np.zeros(3))
            return own(reading.t, briefing.state(reading), setpoint)

        return rates

    with process_of(str(file)) as process:
        for kind in ("move", "operator"):
            found = run_instance(toy_instance(kind, start_swing=0.02), process)
            expected = run_here(in_python, kind, start_swing=0.02)
            assert found.status == expected.status
            assert found.metrics == pytest.approx(expected.metrics, rel=1e-9)


@pytest.mark.slow
def test_an_fmu_without_the_outputs_declines_and_one_with_other_inputs_is_refused(
    tmp_path: Path,
) -> None:
    pytest.importorskip("fmpy", reason="extra fmi (fmpy) is not installed")
    task = toy("move")
    plant = fmi.export(task.crane(), tmp_path / "plant.fmu")
    result = run_here(open_entry(str(plant)), "move")
    assert result.status == "declined"
    assert "on this crane it needs one for each drive" in result.reason
    (tmp_path / "text.fmu").write_text("no zip", encoding="utf-8")
    with pytest.raises(DataError, match="is no FMU"):
        open_entry(str(tmp_path / "text.fmu"))

    from cranedyn.benchmark.entries import fmu

    with pytest.raises(DataError, match="has the input wind; on this crane inputs are bridge"):
        fmu._Signals("mine.fmu", ["x", "wind"], briefing_of(task))


def test_it_is_found_out_whether_outputs_follow_the_inputs_at_once() -> None:
    pytest.importorskip("fmpy", reason="extra fmi (fmpy) is not installed")
    from cranedyn.benchmark.entries import fmu

    class Sampled:
        """A unit that computes its output in a step, as those of some tools do."""

        inputs = ("x",)
        value = output = 0.0

        def set(self, names: object, values: list[float]) -> None:
            self.value = values[0]

        def get(self, names: object) -> np.ndarray:
            return np.array([self.output])

    class AtOnce(Sampled):
        """One that follows at once."""

        def get(self, names: object) -> np.ndarray:
            return np.array([2.0 * self.value])

    assert fmu._follows_at_once(AtOnce(), ["y"], [0.3])  # type: ignore[arg-type]
    assert not fmu._follows_at_once(Sampled(), ["y"], [0.3])  # type: ignore[arg-type]


# --- policies -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_policy_observes_what_it_observed_in_training() -> None:
    pytest.importorskip("gymnasium", reason="extra gymnasium is not installed")
    env = training_environment("inteco/move")
    first, _ = env.reset(seed=3)
    from cranedyn.benchmark.task import select_tasks

    (task,) = select_tasks(["inteco/move"])
    briefing = briefing_of(task)
    drives = briefing.crane.layout.drives
    goal = env.task.goal[:, 0]
    z = env.task.fleet.z[:, 0]
    n = briefing.crane.layout.n
    told = replace(briefing, goal=briefing.crane.state(bridge=goal[0], x=goal[1], l=goal[2]))
    observer = Observer(told)
    zero = np.zeros(3)
    swings = briefing.crane.swings
    reading = SensorReading(0.0, z[drives], z[n + drives], z[swings], z[n + swings], zero)
    assert observer.observe(reading) == pytest.approx(first, abs=1e-6)
    assert len(observer.names) == 13
    # An action moves the drives in both alike; at rest and far from the ends of the ranges it is a
    # share of the largest rates.
    assert observer.rates(np.array([0.5, -0.5, 2.0])) == pytest.approx([0.15, -0.15, 0.3])
    with pytest.raises(CraneError, match="returned 2 numbers; needed are 3"):
        observer.rates(np.zeros(2))
    with pytest.raises(CraneError, match="needed are finite numbers"):
        observer.rates(np.full(3, np.nan))


def onnx_policy(file: Path, inputs: int) -> Path:
    """A policy in ONNX whose action is 8 times the distances to the targets."""
    onnx = pytest.importorskip("onnx", reason="the package onnx is not installed")
    gain = np.zeros((inputs, 3), dtype=np.float32)
    gain[:3] = 8.0 * np.eye(3)
    helper = onnx.helper
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "gain"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", onnx.TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, [1, 3])],
        [onnx.numpy_helper.from_array(gain, "gain")],
    )
    opset = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=9)
    onnx.save(model, str(file))
    return file


@pytest.mark.slow
def test_a_policy_in_onnx_moves_as_its_formula(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="extra onnx (onnxruntime) is not installed")
    file = onnx_policy(tmp_path / "policy.onnx", 13)

    def formula(briefing: Briefing) -> Entry:
        observer = Observer(briefing)
        return lambda reading: observer.rates(8.0 * observer.observe(reading)[:3])

    with process_of(str(file)) as process:
        found = run_instance(toy_instance("move", start_swing=0.02), process)
    expected = run_here(formula, "move", start_swing=0.02)
    assert found.metrics["swing_rad"] > 0.02
    # Products in single precision, to 6e-8.
    assert found.metrics == pytest.approx(expected.metrics, rel=1e-5)
    other = run_here(open_entry(str(onnx_policy(tmp_path / "other.onnx", 12))), "move")
    assert (other.status, "an observation has 13" in other.reason) == ("declined", True)
    (tmp_path / "text.onnx").write_text("no policy", encoding="utf-8")
    with pytest.raises(DataError, match="is no policy in ONNX"):
        open_entry(str(tmp_path / "text.onnx"))


@pytest.mark.slow
def test_a_policy_of_stable_baselines_is_unpickled_with_consent_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sb3 = pytest.importorskip(
        "stable_baselines3", reason="extra learning (stable-baselines3) is not installed"
    )
    monkeypatch.chdir(tmp_path)
    script = from_page("python", "training_environment")
    assert "model.learn(2048)" in script
    exec(script.replace("seed=0", "seed=0, n_steps=64").replace("2048", "64"), {})
    with pytest.raises(CraneError, match="can run any code in it"):
        find_entry("policy.zip")
    with process_of("policy.zip", trusted=True) as process:
        found = run_instance(toy_instance("move"), process)

    model = sb3.PPO.load("policy.zip", device="cpu")

    def predicted(briefing: Briefing) -> Entry:
        observer = Observer(briefing)

        def rates(reading: SensorReading) -> np.ndarray:
            return observer.rates(model.predict(observer.observe(reading), deterministic=True)[0])

        return rates

    expected = run_here(predicted, "move")
    assert found.metrics == pytest.approx(expected.metrics, rel=1e-6)
    (tmp_path / "text.zip").write_text("no zip", encoding="utf-8")
    with pytest.raises(DataError, match="is no file of Stable-Baselines3"):
        open_entry("text.zip")


# --- OPC UA ---------------------------------------------------------------------------------------


@pytest.fixture
def client(tmp_path: Path) -> Path:
    """The program of the page."""
    pytest.importorskip("asyncua", reason="extra serve (asyncua) is not installed")
    file = tmp_path / "client.py"
    file.write_text(from_page("python", "asyncua"), encoding="utf-8")
    return file


@pytest.mark.slow
def test_a_program_on_opc_ua_moves_as_the_function_of_the_page_however_slow_it_is(
    client: Path,
) -> None:
    expected = run_here(page_controller(), "move", start_swing=0.02)
    with process_of(f"opcua:{client}") as process:
        found = run_instance(toy_instance("move", start_swing=0.02), process)
    assert found.metrics == expected.metrics
    assert found.command_us == ()
    text = client.read_text(encoding="utf-8")
    slow = client.with_name("slow.py")
    wait = "last = cycle\n        __import__('time').sleep(0.02 * (cycle % 7 == 0))"
    slow.write_text(text.replace("last = cycle", wait), encoding="utf-8")
    with process_of(f"opcua:{slow}") as process:
        again = run_instance(toy_instance("move", start_swing=0.02), process)
    assert again.metrics == expected.metrics


@pytest.mark.slow
def test_a_program_that_ends_or_declines_does_so_in_its_instance(client: Path) -> None:
    text = client.read_text(encoding="utf-8")
    ends = client.with_name("ends.py")
    ends.write_text(text.replace("last = cycle", "sys.exit(3)"), encoding="utf-8")
    with process_of(f"opcua:{ends}") as process:
        ended = run_instance(toy_instance("move"), process)
    assert ended.reason.endswith("The program ended with the exit code 3.")
    declines = client.with_name("declines.py")
    declines.write_text(text.replace('!= ["bridge"', '!= ["none"'), encoding="utf-8")
    with process_of(f"opcua:{declines}") as process:
        declined = run_instance(toy_instance("move"), process)
    assert declined.status == "declined"
    assert declined.reason == "It is for cranes with a bridge, a trolley and a hoist."


@pytest.mark.slow
def test_a_program_that_the_user_starts_is_waited_for(client: Path) -> None:
    url = f"opc.tcp://127.0.0.1:{free_port()}"
    source = find_entry(url)
    assert (source.file, source.files, source.max_jobs) == (None, {}, 1)
    with process_of(url) as process:
        process.open()
        program = subprocess.Popen([sys.executable, str(client), url])
        try:
            found = run_instance(toy_instance("move"), process)
        finally:
            program.kill()
            program.wait()
    assert found.metrics == run_here(page_controller(), "move").metrics
    for wrong in ("opc.tcp://0.0.0.0:4840", "opc.tcp://127.0.0.1", "opc.tcp://127.0.0.1:99999"):
        with pytest.raises(DataError, match="the benchmark listens there, on this machine only"):
            find_entry(wrong)


# --- files and processes --------------------------------------------------------------------------

WITH_HELPERS = """
import os
from pathlib import Path

import numpy as np

from cranedyn.benchmark import Declined
from law import gain


def towards(briefing):
    shares = np.loadtxt(Path(__file__).with_name("data") / "shares.csv")
    goal = briefing.goal.q[briefing.crane.layout.drives]
    return lambda reading: gain() * shares * (goal - reading.position)


def where(briefing):
    raise Declined(f"Process {os.getpid()}.")
"""


@pytest.fixture
def helpers(tmp_path: Path) -> Path:
    """An entry with a module and a table beside it."""
    (tmp_path / "mine.py").write_text(WITH_HELPERS, encoding="utf-8")
    (tmp_path / "law.py").write_text("def gain():\n    return 2.0\n", encoding="utf-8")
    # Python then opens what it has compiled, and not the source.
    py_compile.compile(str(tmp_path / "law.py"), doraise=True)
    (tmp_path / "unused.py").write_text("", encoding="utf-8")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "shares.csv").write_text("1.0\n1.0\n1.0\n", encoding="utf-8")
    return tmp_path / "mine.py"


@pytest.mark.slow
def test_a_result_names_all_files_of_an_entry_and_verification_says_which_one_changed(
    helpers: Path,
) -> None:
    text = f"{helpers}:towards"
    tasks = [toy("move")]
    result = run_benchmark(tasks, find_entry(text), text, seeds="public")
    assert list(result.files) == ["mine.py", "data/shares.csv", "law.py"]
    assert verify_result(result, tasks, sample=1).differences == []

    # Whatever the file of the entry itself is called here.
    renamed = helpers.with_name("yours.py")
    shutil.copy(helpers, renamed)
    same = verify_result(result, tasks, text=f"{renamed}:towards", sample=1)
    assert same.differences == []

    law = helpers.with_name("law.py")
    law.write_text("def gain():\n    return 2.5\n", encoding="utf-8")
    with pytest.raises(CraneError, match=r"^\S+law\.py is not the file of the result[^/]*$"):
        verify_result(result, tasks)
    law.unlink()
    with pytest.raises(CraneError, match=r"law\.py is missing"):
        verify_result(result, tasks)

    fewer = {name: sha for name, sha in result.files.items() if name != "data/shares.csv"}
    law.write_text("def gain():\n    return 2.0\n", encoding="utf-8")
    found = verify_result(replace(result, files=fewer), tasks, sample=1)
    assert found.differences == [
        "The entry uses data/shares.csv here, which the result does not name."
    ]
    outside = {**result.files, "../law.py": "0"}
    with pytest.raises(DataError, match="not in the folder of the entry"):
        verify_result(replace(result, files=outside), tasks)


@pytest.mark.slow
def test_one_process_serves_all_tasks_of_an_entry(helpers: Path) -> None:
    evaluator = Evaluator(find_entry(f"{helpers}:where"), EntryLimits())
    try:
        reasons = set()
        for kind in ("move", "wind"):
            for found in evaluator.evaluate(toy(kind), seeds="public").results:
                reasons.add(found.reason)
    finally:
        evaluator.close()
    (reason,) = reasons
    assert re.fullmatch(r"Process \d+\.", reason)


@pytest.mark.slow
def test_a_file_that_changes_while_an_entry_runs_is_found(helpers: Path) -> None:
    with process_of(f"{helpers}:towards") as process:
        run_instance(toy_instance("move"), process)
        table = helpers.with_name("data") / "shares.csv"
        table.write_text("1.0\n1.0\n0.50\n", encoding="utf-8")
        run_instance(toy_instance("move"), process)
    assert process.changed == {"data/shares.csv"}


def test_opened_entries_in_this_process_are_as_before() -> None:
    """The stand-in of the other tests moves as it should."""
    assert run_here(towards_goal, "move").status == "passed"
    assert run_here(still, "move").status == "failed"
    with pytest.raises(EntryFailed):
        EntryProcess(EntrySource("none", "none.txt", None), EntryLimits()).open()
