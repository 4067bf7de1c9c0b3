"""A crane and controllers in C: numbers of Python, without findings of compilers and linters."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.compiled.crane_block import crane_block
from cranedyn.compiled.horizon.receding import receding
from cranedyn.controllers import follow, hold_controller, lqr, paper_controller
from cranedyn.controllers.damping import with_damping
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.disturbances.wind import steady, wind
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.estimation import with_observer, with_sensor_model
from cranedyn.export import c_code
from cranedyn.export.controller_block import controller_block, reference_calls
from cranedyn.export.usual_controllers import CONTROLLERS
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.references.limits import Limits
from cranedyn.references.shaped import shaped, zvd
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import BRIDGE, HOOK
from tests.export.c_tools import STRICT, CompiledBlock, output, tool
from tests.helpers import crane, long_after
from tests.linear_laws import PERIOD, filtered, integrating

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

CRANE = crane()
MOTION = flat(CRANE, CRANE.state(), CRANE.state(gamma=0.1, x=10.5, l=14.7), 4.0)
LIMITS = Limits([0.08, 1.5, 1.0], [0.03, 0.6, 0.6])


def drifting(t: float) -> Setpoint:
    """A reference that moves."""
    rates = np.array([0.01, 0.5 + 0.1 * t, -0.2])
    return Setpoint(np.array([0.0, 10.0, 15.0]), rates, 0.0 * rates)


def damping() -> Any:
    return with_damping(CRANE, drifting, recovery=0.3, limits=LIMITS)


MADE: dict[str, tuple[Any, Callable[[], Any]]] = {
    "hold": ("effort", lambda: hold_controller(CRANE)),
    "lqr along a motion": ("effort", lambda: lqr(CRANE, MOTION)),
    "integral along a motion": ("effort", lambda: paper_controller(CRANE, MOTION)),
    "follow": ("motion", lambda: follow(CRANE, MOTION)),
    "yielding": ("motion", damping),
    "yielding, rates": ("velocity", lambda: as_velocity_command(CRANE, damping(), drive="motion")),
    "lqr, rates": (
        "velocity",
        lambda: as_velocity_command(CRANE, lqr(CRANE, MOTION), drive="effort"),
    ),
    "observer": ("effort", lambda: with_observer(lqr(CRANE, MOTION), CRANE, MOTION)),
    "shaper": ("effort", lambda: shaped(hold(CRANE), zvd(0.02), [0.71, 0.2])),
    "states": ("effort", lambda: filtered(setpoint="run")),
    "states, rates": ("velocity", lambda: filtered("velocity")),
    # Stiff enough that noise of 0.05 m takes the trolley from one limit to the other.
    "states at the limit": ("effort", lambda: integrating(4e7, about=CRANE.start, d=[[-4e7]])),
    "predictive, efforts": ("effort", lambda: predictive("effort")),
    "predictive, rates": ("velocity", lambda: predictive("velocity")),
}


def predictive(drive: Any, **settings: Any) -> Any:
    return receding(CRANE, LIMITS, drive=drive, stages=20, stage=0.6, swing_limit=0.05, **settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        # Each with efforts, and rates of other controllers, are in the default run.
        pytest.param(
            name, marks=[pytest.mark.long] * (name in {"predictive, rates", "states, rates"})
        )
        for name in MADE
    ],
)
def test_a_controller_in_c_commands_what_it_commands_in_python(name: str, tmp_path: Path) -> None:
    drive, make = MADE[name]
    # Optimisations multiply the round-off.
    is_predictive = "predictive" in name
    check_commands(
        CRANE,
        drive,
        make,
        tmp_path,
        control_period=PERIOD if "states" in name else 5e-3,
        rows=200 if is_predictive else 900,
        tolerance=1e-10 if is_predictive else 1e-12,
    )


def check_commands(
    one: Crane,
    drive: Any,
    make: Callable[[], Any],
    folder: Path,
    *,
    control_period: float = 5e-3,
    rows: int,
    tolerance: float,
) -> None:
    """Check that a controller in C commands what it does in Python, within the round-off of sums in
    another order, as a share of the largest command.
    """
    block = controller_block(one, make(), drive=drive, control_period=control_period, duration=20.0)
    compiled = CompiledBlock(block, folder)
    inputs, expected = reference_calls(one, make(), block, rows=rows)
    names = [variable.name for variable in block.of_kind("output")]
    given = block.of_kind("input")
    found = []
    for row in inputs.tolist():
        for variable, value in zip(given, row, strict=True):
            setattr(compiled.memory, variable.name, value)
        assert compiled.call()
        found.append([getattr(compiled.memory, name) for name in names])
    off = np.abs(np.array(found) - expected).max(axis=0)
    assert (off <= tolerance * np.maximum(np.abs(expected).max(axis=0), 1.0)).all()
    assert np.ptp(expected) > 0.0


@pytest.mark.long
def test_predictive_control_of_a_crane_on_a_soft_rope_commands_in_c_what_it_does_in_python(
    tmp_path: Path,
) -> None:
    soft = load_crane(rope_stiffness=1e6, rope_damping=500.0)

    def make() -> Any:
        return receding(soft, LIMITS, stages=20, stage=0.6, swing_limit=0.05)

    check_commands(soft, "effort", make, tmp_path, rows=200, tolerance=1e-10)


@pytest.mark.long
def test_predictive_control_in_c_agrees_with_python_at_random_states_within_its_swing_limit(
    tmp_path: Path,
) -> None:
    """See docs/howto/controller_code.md, which says where it does not."""
    drive, make = CONTROLLERS["predictive"]
    controller = make(CRANE, 5e-3)
    rng = np.random.default_rng(3)
    block = controller_block(CRANE, make(CRANE, 5e-3), drive=drive)
    compiled = CompiledBlock(block, tmp_path)
    inputs = block.of_kind("input")
    outputs = block.of_kind("output")
    lower = [v.lower for v in outputs]
    upper = [v.upper for v in outputs]
    found = []
    expected = []
    for _ in range(150):
        compiled.call("reset")
        controller.begin_run(0.0, 5e-3)
        for k in range(12):
            noise = 0.05 * rng.normal(size=(2, 5))
            state = State(CRANE.start.q + noise[0], noise[1])
            target = CRANE.start.q[CRANE.layout.drives] + 0.15 * rng.normal(size=3)
            for variable, value in zip(inputs, [*state.q, *state.v, *target], strict=True):
                setattr(compiled.memory, variable.name, value)
            assert compiled.call()
            found.append([getattr(compiled.memory, variable.name) for variable in outputs])
            command = controller(k * 5e-3, state, Setpoint(target, np.zeros(3), np.zeros(3)))
            expected.append(np.clip(command, lower, upper))
    # The optimisation ends where its gap is 1e-8 of that at its start.
    off = np.abs(np.array(found) - expected).max(axis=0)
    assert (off <= 1e-8 * np.abs(expected).max(axis=0)).all()


SCALE = {"effort": [2e4, 1.5e3, 500.0], "motion": [0.02, 0.3, 0.2], "velocity": [0.06, 1.0, 0.6]}
"""Commands of the drives that move the crane, by the kind of drives."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "precision"),
    [
        *((drive, "double") for drive in SCALE),
        *long_after(1, [("motion", "single"), ("effort", "single"), ("velocity", "single")]),
    ],
)
def test_a_crane_in_c_moves_as_in_simulate(drive: Any, precision: Any, tmp_path: Path) -> None:
    c = crane(damp_swing=2e3)
    block = crane_block(c, drive=drive)
    compiled = CompiledBlock(block, tmp_path, precision)
    steps = 400
    start = c.state(x=12.0, l=11.0, phi=0.1, theta_dot=0.05, x_dot=0.2)
    commands = np.random.default_rng(1).uniform(-1.0, 1.0, (steps // 40, 3)).repeat(40, axis=0)
    commands *= SCALE[drive]
    drives = drive
    if drive == "velocity":  # another ramp than the typical one
        compiled.memory.x_ramp = 0.2
        drives = converters(c, accelerations={"x": 0.2})
    commands[:, 2] -= 9810.0 if drive == "effort" else 0.0
    names = [variable.name for variable in block.of_kind("state")]
    inputs = block.of_kind("input")
    for name, value in zip(names, np.concatenate(start).tolist(), strict=True):
        setattr(compiled.memory, name, value)
    run = simulate(
        c,
        lambda t, state, setpoint: commands[min(round(t / 5e-3), steps - 1)],
        start=start,
        duration=steps * 5e-3,
        drive=drives,
        validity="mark",
    )
    found = []
    for command in commands.tolist():
        for variable, value in zip(inputs, command, strict=False):
            setattr(compiled.memory, variable.name, value)
        compiled.call("outputs")
        found.append([getattr(compiled.memory, name) for name in (*names, "energy")])
        for _ in range(10):
            compiled.call()
    off = np.abs(np.array(found)[:, :-1] - np.hstack([run.q, run.v])[:-1]).max()
    # 4,000 roundings of numbers up to 12: random in double, in single to the same side.
    assert off < (1e-12 if precision == "double" else 4000 * 12 * 2.0**-24)
    relative = 1e-11 if precision == "double" else 1e-5
    assert np.allclose(np.array(found)[:, -1], run.energy[:-1], rtol=relative)
    assert np.ptp(run.v[:, 1]) > 0.03


@pytest.mark.slow
def test_a_rope_in_c_goes_slack_as_in_simulate(tmp_path: Path) -> None:
    c = crane(rope_stiffness=2e6)
    commands = np.zeros((160, 3))
    commands[20:80, 2] = 12.0
    commands[80:, 2] = -7.0
    compiled = CompiledBlock(crane_block(c, drive="motion"), tmp_path)
    run = simulate(
        c,
        lambda t, state, setpoint: commands[min(round(t / 5e-3), 159)],
        duration=0.8,
        drive="motion",
        validity="mark",
    )
    for command in commands.tolist():
        compiled.memory.l_ddot_command = command[2]
        for _ in range(10):
            compiled.call()
    assert run.q[:, 5].min() < 0.0 < run.q[:, 5].max()
    assert compiled.memory.rope_stretch == pytest.approx(run.q[-1, 5], abs=1e-12)


@pytest.mark.slow
def test_parameters_of_a_crane_in_c_are_those_of_another_crane(tmp_path: Path) -> None:
    compiled = CompiledBlock(crane_block(crane()), tmp_path)
    heavy = CompiledBlock(crane_block(crane(payload_mass=2000.0, damp_swing=3e3)), tmp_path / "2")
    compiled.memory.payload_mass = 2000.0
    compiled.memory.phi_damping = compiled.memory.theta_damping = 3e3
    compiled.memory.cable_offset = 0.5
    heavy.memory.l = compiled.memory.l + 0.5
    for one in (compiled, heavy):
        one.memory.phi = 0.1
        one.memory.F_l_command = -19000.0
        for _ in range(2000):
            one.call()
    assert compiled.memory.phi == pytest.approx(heavy.memory.phi, abs=1e-12)
    assert compiled.memory.l + 0.5 == pytest.approx(heavy.memory.l, abs=1e-12)


@pytest.mark.slow
def test_wind_on_a_crane_in_c_is_that_of_simulate(tmp_path: Path) -> None:
    compiled = CompiledBlock(crane_block(CRANE), tmp_path)
    compiled.memory.wind_y = -8.0
    compiled.memory.payload_area = 5.0
    load = wind(CRANE, steady(8.0), direction=-np.pi / 2.0, payload_area=5.0)
    command = np.array([0.0, 0.0, -9810.0])
    run = simulate(
        CRANE,
        lambda t, state, setpoint: command,
        duration=2.0,
        control_period=5e-4,
        dt=5e-4,
        disturbance=load,
        validity="mark",
    )
    for _ in range(4000):
        compiled.call()
    assert compiled.memory.phi == pytest.approx(run.q[-1, 2], abs=1e-12)
    assert abs(run.q[-1, 2]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("relative", [HOOK, BRIDGE], ids=lambda relative: relative.name)
def test_a_crane_of_another_topology_and_rule_in_c_passes_its_own_test(
    relative: Any, tmp_path: Path
) -> None:
    folder = c_code.export(relative.crane(), tmp_path / "c", dt=1e-3, integrator=rk4)
    output(tool("gcc"), *STRICT, "crane.c", "test.c", "-o", "t", folder=folder)
    assert "largest relative difference" in output(folder / "t", folder=folder)


SIZES = {"integral": 168, "predictive": 126768}
"""Bytes of memory of the LQR with its integral, and of the predictive controller."""


@pytest.fixture(
    scope="module", params=["integral", pytest.param("predictive", marks=pytest.mark.long)]
)
def exported(request: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the command line, with a controller."""
    folder = tmp_path_factory.mktemp("exported") / request.param
    assert main(["export", "c", str(folder), "--controller", request.param]) == 0
    return folder


SOURCES = ("crane.c", "controller.c", "test.c")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compiler", "package", "emulator", "flags"),
    [
        ("gcc", "gcc", (), ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")),
        ("clang", "clang", (), ()),
        ("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu", ("qemu-aarch64",), ("-static",)),
    ],
)
def test_the_exported_folder_passes_its_test_with_every_compiler(
    exported: Path, tmp_path: Path, compiler: str, package: str, emulator: Any, flags: Any
) -> None:
    program = tmp_path / "test"
    run = [tool(name, "qemu-user") for name in emulator]
    quick = ("-O0",) if exported.name == "predictive" else ()
    options = (*STRICT, *flags, *quick)
    output(tool(compiler, package), *options, *SOURCES, "-o", program, folder=exported)
    printed = output(*run, program, folder=exported)
    assert re.search(r"crane: .* 320 bytes of memory, 0 of constant tables", printed)
    assert re.search(rf"controller: 200 calls, .* {SIZES[exported.name]} bytes", printed)
    (off,) = re.findall(r"controller: .* Python ([\d.e+-]+)", printed)
    assert 0.0 <= float(off) <= c_code.TOLERANCE["double"]


@pytest.mark.slow
def test_the_test_of_the_exported_folder_fails_if_a_gain_is_another(
    exported: Path, tmp_path: Path
) -> None:
    text = (exported / "controller.c").read_text()
    gain, *_ = re.findall(r"(?:self->x_dot|v\d+) \* (\d{3,}\.\d+)", text)
    for name in ("crane.c", "crane.h", "controller.h", "test.c"):
        shutil.copy(exported / name, tmp_path)
    (tmp_path / "controller.c").write_text(text.replace(gain, "0.5", 1))
    output(tool("gcc"), *STRICT, "-O0", *SOURCES, "-o", "t", folder=tmp_path)
    with pytest.raises(AssertionError, match="largest relative difference"):
        output(tmp_path / "t", folder=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "flag"), [("hold", ""), ("hold", "--single")])
def test_the_test_of_the_exported_folder_takes_round_off_and_no_more(
    name: str, flag: str, tmp_path: Path
) -> None:
    folder = tmp_path / "c"
    assert main(["export", "c", str(folder), "--controller", name, *flag.split()]) == 0
    check_tolerance(folder, 1e-3 if flag else 1e-12, tmp_path)


@pytest.mark.slow
def test_the_test_of_an_exported_controller_takes_what_the_page_promises(
    exported: Path, tmp_path: Path
) -> None:
    # docs/howto/controller_code.md: equal to 1e-12, predictive control to 1e-8.
    check_tolerance(exported, 1e-8 if exported.name == "predictive" else 1e-12, tmp_path)


def check_tolerance(folder: Path, tolerance: float, workspace: Path) -> None:
    """Check that the test of a folder fails where one expected number is another by ten times the
    tolerance, and passes where it is another by less than it by far.
    """
    text = (folder / "test.c").read_text()
    head, rows = text.split("controller_expected[200][3] = {")
    first, rest = rows.split("},", 1)
    *others, last = first.removeprefix("\n  {").split(", ")
    columns = [float(row.split(", ")[-1]) for row in re.findall(r"  {(.*)},", rows.split("};")[0])]
    size = max(1.0, *map(abs, columns))
    for share, passes in ((10.0, False), (-10.0, False), (0.01, True), (-0.01, True)):
        wrong = repr(float(last) + share * tolerance * size)
        changed = (
            f"{head}controller_expected[200][3] = {{\n  {{{', '.join([*others, wrong])}}},{rest}"
        )
        (workspace / "test.c").write_text(changed)
        sources = [folder / "crane.c", folder / "controller.c", workspace / "test.c"]
        program = workspace / "t"
        options = (*STRICT, "-O0", "-I", folder)
        output(tool("gcc"), *options, *sources, "-o", program, folder=folder)
        done = subprocess.run([program], capture_output=True, check=False)
        assert (done.returncode == 0) == passes


@pytest.mark.slow
def test_cppcheck_finds_nothing(exported: Path) -> None:
    options = ("-q", "--enable=all", "--inconclusive", "--error-exitcode=1")
    hidden = ("--suppress=missingIncludeSystem", "--suppress=unusedFunction")
    if exported.name == "predictive":
        # cppcheck takes the first pass of a loop for all of them.
        hidden = (*hidden, "--suppress=knownConditionTrueFalse")
    found = output(tool("cppcheck"), *options, *hidden, *SOURCES[:2], folder=exported)
    assert found == ""


def test_the_code_needs_no_library_and_no_heap(exported: Path) -> None:
    for name in ("crane", "controller"):
        text = (exported / f"{name}.c").read_text() + (exported / f"{name}.h").read_text()
        included = set(re.findall(r"#include (\S+)", text))
        assert included == {f'"{name}.h"', "<stdbool.h>", "<stdint.h>"}


@pytest.mark.slow
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.0000001e12, -1.0000001e12])
def test_an_input_out_of_range_is_a_fault_until_the_reset(bad: float, tmp_path: Path) -> None:
    compiled = CompiledBlock(controller_block(CRANE, hold_controller(CRANE)), tmp_path)
    compiled.memory.x = bad
    assert not compiled.call() and compiled.memory.F_l_command == -9810.0
    compiled.memory.x = 11.0
    assert not compiled.call()
    compiled.call("reset")
    compiled.memory.x = 11.0
    assert compiled.call() and compiled.memory.F_x_command == pytest.approx(-3e5)


@pytest.mark.slow
def test_what_cannot_be_exported_is_refused_in_a_sentence_and_leaves_nothing(
    tmp_path: Path,
) -> None:
    noisy = with_sensor_model(CRANE, hold_controller(CRANE), rng=np.random.default_rng(0))
    late = with_observer(lqr(CRANE, MOTION), CRANE, MOTION, delay=2)
    for controller, reason in (
        (noisy, "SensorModelController is neither affine in the state"),
        (late, "this one has a delay"),
        (predictive("effort", motion=MOTION), "to a setpoint, not along a motion"),
        (predictive("effort", control_period=1e-3), "control period"),
        (follow(CRANE, MOTION, 1e-3), "control_period|control period"),
    ):
        with pytest.raises(CraneError, match=reason):
            c_code.export(CRANE, tmp_path / "c", controller)
    with pytest.raises(ModelError, match="needs double precision"):
        c_code.export(CRANE, tmp_path / "c", predictive("effort"), precision="single")
    with pytest.raises(ModelError, match="slack, which a block cannot follow"):
        c_code.export(crane(rope_stiffness=2e6), tmp_path / "c", integrator=rk4)
    with pytest.raises(OutOfRange, match="the tables still change at its end"):
        c_code.export(CRANE, tmp_path / "c", lqr(CRANE, MOTION), duration=2.0)
    assert list(tmp_path.iterdir()) == []


STARTUP = """
#include <stdint.h>
void _start(void);
static void reset(void) {
  *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* the floating-point unit */
  __asm__ volatile("dsb\\n isb");
  _start();
}
__attribute__((section(".vectors"), used)) static void *const vectors[] = {
  (void *)0x20400000, (void *)reset};
"""


@pytest.mark.slow
def test_the_exported_folder_passes_its_test_on_a_cortex_m7(exported: Path, tmp_path: Path) -> None:
    emulator = tool("qemu-system-arm")
    (tmp_path / "startup.c").write_text(STARTUP)
    kind = "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16 -O2 -ffp-contract=off"
    place = "--specs=rdimon.specs -Wl,--section-start=.vectors=0 -Wl,-Tdata=0x20000000"
    files = [tmp_path / "startup.c", *SOURCES, "-o", tmp_path / "test"]
    compiler = tool("arm-none-eabi-gcc", "gcc-arm-none-eabi libnewlib-arm-none-eabi")
    output(compiler, *kind.split(), *place.split(), *files, folder=exported)
    board = "-M mps2-an500 -nographic -semihosting-config enable=on,target=native -kernel"
    printed = output(emulator, *board.split(), tmp_path / "test", folder=exported)
    assert re.search(rf"controller: 200 calls, .* {SIZES[exported.name]} bytes", printed)


@pytest.mark.slow
def test_a_step_takes_so_many_instructions_of_an_aarch64(exported: Path, tmp_path: Path) -> None:
    emulator = tool("qemu-aarch64", "qemu-user")
    compiler = tool("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu")
    # A third more than they take now; of the predictive one a call that optimises without bounds.
    most_of = {"integral": 400, "predictive": 1_000_000}
    for name, most in (("crane", 1500), ("controller", most_of[exported.name])):
        (tmp_path / "count.c").write_text(
            f'#include "{name}.h"\nint main(int n, char **words) {{\n  static {name} block;\n'
            f"  (void)words;\n  {name}_reset(&block);\n"
            f"  while (--n) {name}_step(&block);\n  return block.x > 1e9;\n}}\n"
        )
        options = ("-std=c99", "-O2", "-ffp-contract=off", "-static", "-I", ".")
        files = (tmp_path / "count.c", f"{name}.c", "-o", tmp_path / "count")
        output(compiler, *options, *files, folder=exported)
        counts = []
        for words in ("", "1"):
            single = f"{emulator} -singlestep -d exec,nochain -D /dev/stdout"
            lines = f"{single} {tmp_path / 'count'} {words} | grep -c Trace"
            counts.append(int(output("sh", "-c", lines, folder=tmp_path)))
        assert 100 < counts[1] - counts[0] < most
