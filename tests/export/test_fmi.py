"""The crane as an FMU: FMPy finds no fault with it, and it moves as in `simulate`."""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import time
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.__main__ import main
from cranedyn.compiled.crane_block import force_names
from cranedyn.controllers.linear import LinearController, linear_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.base_motion import COORDINATES, BaseMotion
from cranedyn.disturbances.wind import constant_force, wind
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.export import fmi
from cranedyn.export.usual_controllers import CONTROLLERS
from cranedyn.interfaces import Drive
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import BRIDGE, HOOK, CraneVariant
from tests.export.c_tools import tool
from tests.helpers import crane

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed")
from fmpy.fmi1 import FMICallException  # noqa: E402
from fmpy.fmi3 import FMU3Slave  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)

PERIOD = 5e-3
START = {"x_start": 12.0, "l_start": 11.0, "phi_start": 0.1, "theta_dot_start": 0.05}
DRIVES: tuple[Drive, ...] = ("effort", "motion", "velocity")


def damped() -> Crane:
    """A crane with damping and a trolley that soon is at its limit of effort."""
    return crane(damp_swing=2e3, damp_trolley=200.0, trolley_effort=800.0)


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A unit for each kind of drive."""
    folder = tmp_path_factory.mktemp("units")
    return {drive: fmi.export(damped(), folder / f"{drive}.fmu", drive=drive) for drive in DRIVES}


class Unit:
    """An instance of a unit, by the names of its variables."""

    def __init__(self, path: Path, folder: Path, name: str = fmi.NAME) -> None:
        self.description = fmpy.read_model_description(path)
        self.reference = {
            variable.name: variable.valueReference for variable in self.description.modelVariables
        }
        fmpy.extract(path, folder)
        self.told: list[str] = []
        self.slave = FMU3Slave(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=name,
            instanceName="one",
        )
        self.slave.instantiate(
            logMessage=lambda environment, status, category, message: self.told.append(
                message.decode()
            )
        )

    def begin(self, **values: float) -> Unit:
        """Initialize with values."""
        self.slave.enterInitializationMode()
        self.set(**values)
        self.slave.exitInitializationMode()
        return self

    def set(self, **values: float) -> None:
        """Set variables."""
        self.slave.setFloat64([self.reference[name] for name in values], list(values.values()))

    def get(self, *names: str) -> list[float]:
        """Values of variables."""
        return self.slave.getFloat64([self.reference[name] for name in names])

    def step(self, k: int, period: float = PERIOD) -> None:
        """The step from a communication point to the next."""
        self.slave.doStep(currentCommunicationPoint=k * period, communicationStepSize=period)


@pytest.fixture
def unit(units: dict[str, Path], tmp_path: Path) -> Iterator[Unit]:
    """The unit that takes efforts."""
    made = Unit(units["effort"], tmp_path / "unit")
    yield made
    made.slave.freeInstance()


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.slow
def test_fmpy_finds_no_fault_with_a_unit(units: dict[str, Path], drive: Drive) -> None:
    assert validate_fmu(units[drive]) == []
    with zipfile.ZipFile(units[drive]) as unit:
        assert not any(name.endswith((".py", ".pyc")) for name in unit.namelist())


def outputs(unit: Unit, c: Crane, drive: Drive, commands: np.ndarray) -> np.ndarray:
    """State, efforts and energy at each communication point, under commands; frees the unit."""
    named = [f"{name.removesuffix('_command')}_command" for name in input_names(c, drive)]
    rows = []
    for k, command in enumerate(commands):
        unit.set(**dict(zip(named, command.tolist(), strict=True)))
        rows.append(unit.get(*state_names(c), *input_names(c, "effort"), "energy"))
        unit.step(k)
    unit.slave.freeInstance()
    return np.array(rows)


def check_same(found: np.ndarray, run: Trajectory) -> None:
    states = np.hstack([run.q, run.v])[:-1]
    assert_allclose(found[:, : states.shape[1]], states, rtol=0.0, atol=1e-12)
    efforts = found[:, states.shape[1] : -1]
    assert_allclose(efforts, run.effort[:-1], rtol=1e-9, atol=1e-6)  # of 1e4 N
    assert_allclose(found[:, -1], run.energy[:-1], rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.parametrize("drive", DRIVES)
def test_a_unit_moves_as_simulate_does(
    units: dict[str, Path], tmp_path: Path, drive: Drive, engine: Any
) -> None:
    c = damped()
    steps = 1000 if engine == "compiled" else 200
    rng = np.random.default_rng(1)
    scale = {
        "effort": [2e4, 1.5e3, 500.0],
        "motion": [0.02, 0.3, 0.2],
        "velocity": [0.06, 1.0, 0.6],
    }
    commands = rng.uniform(-1.0, 1.0, (steps // 50, 3)).repeat(50, axis=0) * scale[drive]
    commands[:, 2] -= 9810.0 if drive == "effort" else 0.0
    push = (100.0, -50.0, 20.0, 10.0, 0.0, -5.0)
    forces = dict(zip(force_names(c), push, strict=True))
    run = simulate(
        c,
        lambda t, state, setpoint: commands[min(round(t / PERIOD), steps - 1)],
        start=c.state(x=12.0, l=11.0, phi=0.1, theta_dot=0.05),
        duration=steps * PERIOD,
        control_period=PERIOD,
        drive=drive,
        disturbance=constant_force(c, payload=push[:3], trolley=push[3:]),
        validity="mark",
        engine=engine,
    )
    check_same(
        outputs(Unit(units[drive], tmp_path).begin(**START, **forces), c, drive, commands), run
    )
    assert drive != "effort" or (np.abs(commands[:, 1]) > 800.0).any()  # and was cut
    assert drive != "velocity" or (np.abs(run.effort[:, 1]) > 799.0).any()  # and stalls


@pytest.mark.slow
@pytest.mark.parametrize(
    ("version", "controller"),
    [
        pytest.param(2, None, marks=pytest.mark.long),
        (2, "integral"),
        (3, None),
        pytest.param(3, "integral", marks=pytest.mark.long),
    ],
)
def test_sources_of_a_unit_of_either_version_compile_to_the_same_motion(
    version: Any, controller: str | None, tmp_path: Path
) -> None:
    chosen = None if controller is None else CONTROLLERS[controller][1](damped(), PERIOD)
    path = fmi.export(damped(), tmp_path / "u.fmu", version=version, controller=chosen)
    assert validate_fmu(path) == []
    build = pytest.importorskip("fmpy.build", reason="this fmpy builds no sources")
    tool("cmake")
    bare = tmp_path / "bare"
    fmpy.extract(path, bare)
    shutil.rmtree(bare / "binaries")
    build.build_platform_binary(bare)
    start = {"F_x_command": 500.0} if controller is None else {"x": 10.5}
    runs = [
        fmpy.simulate_fmu(
            str(one),
            fmi_type="CoSimulation",
            stop_time=1.0,
            step_size=PERIOD,
            output_interval=PERIOD,
            start_values=start,
        )
        for one in (path, bare)
    ]
    assert len(runs[0]) == 201
    for name in runs[0].dtype.names:
        assert_allclose(runs[1][name].astype(float), runs[0][name].astype(float), rtol=1e-12)


@pytest.fixture(scope="module", params=[2, 3])
def sources(request: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The texts of a unit of either version by the names of their files."""
    path = fmi.export(crane(), tmp_path_factory.mktemp("s") / "c.fmu", version=request.param)
    with zipfile.ZipFile(path) as unit:
        names = [name for name in unit.namelist() if "binaries" not in name]
        return {name.removeprefix("sources/"): unit.read(name).decode() for name in names}


def functions_that_allocate(texts: dict[str, str]) -> set[str]:
    text = "\n".join(text for name, text in texts.items() if name.endswith((".c", ".h")))
    bodies = re.findall(r"^\S.*?(\w+)\([^;{}]*\) \{\n(.*?)^\}", text, re.M | re.S)
    return {name for name, body in bodies if re.search(r"[^\w](m|c|re)alloc\(", body)}


def found(pattern: str, *texts: str) -> set[str]:
    return set(re.findall(pattern, "\n".join(texts)))


STANDARD = {f"{x}.h" for x in "math stdarg stdbool stddef stdint stdio stdlib string".split()}
DOCUMENTED: dict[str, Callable[[dict[str, str], str], bool]] = {
    "FMI 2.0 or 3.0": lambda x, page: len(found(r'fmiVersion="([23]\.0)"', page)) == 1,
    "co-simulation": lambda x, page: len(found(r'<CoSimulation modelId\w+="[a-z_]+"', page)) == 1,
    "behaviour as source code, its files listed": lambda x, page: (
        found(r'File name="(\w+\.c)"', page) == {name for name in x if name.endswith(".c")}
    ),
    "no header beyond its own and those of C": lambda x, page: (
        found(r'#include [<"]([^>"]+)', *x.values()) <= STANDARD | set(x)
    ),
    "no memory is allocated while it steps": lambda x, page: (
        functions_that_allocate(x) <= {"fmi2Instantiate", "instantiate", "save", "deserialize"}
    ),
    "a name of the tool, for its settings": lambda x, page: 'tionTool="cranedyn"' in page,
}
"""What TwinCAT's pages ask of a unit that it compiles (TE1420, overview, questions and integration
of further tools), and what a controller in real time asks."""


@pytest.mark.slow
@pytest.mark.parametrize("requirement", DOCUMENTED)
def test_a_unit_is_what_twincat_documents(sources: dict[str, str], requirement: str) -> None:
    pages = sources["modelDescription.xml"] + sources.get("buildDescription.xml", "")
    assert DOCUMENTED[requirement](sources, pages)


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_model_exchange_goes_where_cosimulation_goes(version: Any, tmp_path: Path) -> None:
    path = fmi.export(damped(), tmp_path / "crane.fmu", version=version, dt=1e-4)
    start = START | {"F_x_command": 500.0, "payload_mass": 1200.0, "F_l_command": -11800.0}
    runs = [
        fmpy.simulate_fmu(
            str(path),
            fmi_type=kind,
            stop_time=2.0,
            step_size=1e-3,
            output_interval=0.1,
            relative_tolerance=1e-9,
            start_values=start,
        )
        for kind in ("ModelExchange", "CoSimulation")
    ]
    for name in state_names(damped()):
        # The error of semi-implicit Euler, of order 1: ω dt/2 of the amplitude and less.
        assert_allclose(runs[0][name][-1], runs[1][name][-1], atol=1e-4)
    assert abs(runs[0]["phi"][-1] - 0.1) > 1e-2


def own_design(c: Crane, period: float) -> LinearController:
    """Proportional and integral control of the trolley about the setpoint of the run, with its rate
    behind a low-pass.
    """
    a = np.array([[1.0, 0.0], [0.0, 0.9]])
    b = np.array([[-period, 0.0], [0.0, 0.1]])
    by_state = np.array([[1e3, -1e4]])
    direct = np.array([[-5e3, 0.0]])
    return linear_controller(
        c, a, b, by_state, direct, about=c.state(x=11.0), inputs=["x", "x_dot"], outputs=["F_x"],
        setpoint="run", period=period,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [CONTROLLERS["integral"][1], pytest.param(own_design, marks=pytest.mark.long)]
)
def test_units_of_a_crane_and_a_controller_together_are_simulate(
    make: Callable[[Crane, float], Any], tmp_path: Path
) -> None:
    c = damped()
    steps = 600
    units = []
    for name, controller in (("crane", None), ("controller", make(c, PERIOD))):
        path = fmi.export(c, tmp_path / f"{name}.fmu", controller=controller)
        units.append(Unit(path, tmp_path / name, f"cranedyn_{name}"))
    plant = units[0].begin(**START)
    law = units[1].begin(x_set=11.0, l_set=11.5)
    measured = [name for name in state_names(c) if name in law.reference]
    commands = [f"{name}_command" for name in input_names(c, "effort")]
    rows = []
    for k in range(steps):
        rows.append(plant.get(*state_names(c)))
        law.set(**dict(zip(measured, plant.get(*measured), strict=True)))
        plant.set(**dict(zip(commands, law.get(*commands), strict=True)))
        for unit in units:
            unit.step(k)
    for unit in units:
        unit.slave.freeInstance()
    run = simulate(
        c,
        make(c, PERIOD),
        hold(c, c.state(x=11.0, l=11.5)),
        start=c.state(x=12.0, l=11.0, phi=0.1, theta_dot=0.05),
        duration=steps * PERIOD,
        validity="mark",
    )
    assert_allclose(rows, np.hstack([run.q, run.v])[:-1], rtol=0.0, atol=1e-10)


@pytest.mark.slow
def test_a_unit_for_another_platform_has_its_library(tmp_path: Path) -> None:
    pytest.importorskip("ziglang", reason="extra cross (ziglang) is not installed")
    both = ("x86_64-linux", "x86_64-windows")
    path = fmi.export(crane(), tmp_path / "crane.fmu", platforms=both)
    with zipfile.ZipFile(path) as unit:
        library = unit.read(f"binaries/x86_64-windows/{fmi.NAME}.dll")
    assert library[:2] == b"MZ" and b"fmi3DoStep" in library


@pytest.mark.slow
@pytest.mark.parametrize("variant", [HOOK, BRIDGE], ids=lambda variant: variant.name)
def test_a_unit_of_a_crane_of_other_topology_moves_as_simulate_does(
    tmp_path: Path, variant: CraneVariant
) -> None:
    c = variant.crane()
    steps = 200
    path = fmi.export(c, tmp_path / "crane.fmu", drive="motion")
    assert validate_fmu(path) == []
    push = np.random.default_rng(2).uniform(-100.0, 100.0, (len(c.points), 3))
    start = c.state(**{c.layout.symbols[i]: 0.1 for i in c.layout.passive.tolist()})
    starts = zip(state_names(c), np.concatenate(start).tolist(), strict=True)
    unit = Unit(path, tmp_path / "unit").begin(
        **{f"{name}_start": value for name, value in starts},
        **dict(zip(force_names(c), push.ravel().tolist(), strict=True)),
    )
    commands = np.full((steps, c.layout.m), 0.1)
    run = simulate(
        c,
        lambda t, state, setpoint: commands[0],
        start=start,
        duration=steps * PERIOD,
        control_period=PERIOD,
        drive="motion",
        disturbance=lambda t, state: push,
        validity="mark",
    )
    check_same(outputs(unit, c, "motion", commands), run)


def renamed(tmp_path: Path, name: str) -> Crane:
    """An overhead crane with its bridge joint of another name, by its URDF."""
    path = tmp_path / "renamed.urdf"
    urdf = load_crane("urdf/overhead_crane.urdf.xacro").urdf
    path.write_text(urdf.replace("bridge_joint", escape(name, {'"': "&quot;"})))
    return load_crane(path, gravity=9.81)


@pytest.mark.slow
def test_names_of_a_strangers_joints_are_texts_to_the_unit_and_never_code(tmp_path: Path) -> None:
    name = 'x", 0.0, 0.0, 0.0}}; int evil(void) { return 1; } /* \\ ü ??/'
    c = renamed(tmp_path, name)
    unit = Unit(fmi.export(c, tmp_path / "crane.fmu"), tmp_path / "unit").begin()
    assert unit.get(name) == [c.start.q[0]]
    with pytest.raises(FMICallException):
        unit.set(**{f"F_{name}_command": np.nan})
    assert unit.told[-1] == f"F_{name}_command is nan; allowed is a number from -inf to inf."
    unit.slave.freeInstance()


@pytest.mark.slow
def test_two_variables_of_one_name_are_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="Two variables of the unit would have the name energy"):
        fmi.export(renamed(tmp_path, "energy"), tmp_path / "crane.fmu")


def test_a_step_of_another_length_is_the_same_motion_and_one_between_physics_steps_is_refused(
    unit: Unit,
) -> None:
    unit.begin(**START)
    for k in range(40):
        unit.step(k)
    fine = unit.get(*state_names(crane()))
    unit.slave.reset()
    unit.begin(**START).step(0, 0.2)
    assert unit.get(*state_names(crane())) == fine
    with pytest.raises(FMICallException):
        unit.slave.doStep(currentCommunicationPoint=0.2, communicationStepSize=7e-4)
    assert unit.told == [
        "The communication step is 0.00069999999999999999 s; allowed is a multiple of its own step "
        "of 0.0005 s."
    ]
    with pytest.raises(FMICallException):
        unit.slave.doStep(currentCommunicationPoint=5.0, communicationStepSize=PERIOD)
    assert "The communication point is 5 s; the unit is at 0.2" in unit.told[-1]
    assert unit.get(*state_names(crane())) == fine


def test_a_state_is_saved_restored_and_sent_to_another_instance(
    unit: Unit, units: dict[str, Path], tmp_path: Path
) -> None:
    names = state_names(crane())
    unit.begin(**START)
    unit.set(F_x_command=300.0)
    for k in range(50):
        unit.step(k)
    saved = unit.slave.getFMUState()
    sent = unit.slave.serializeFMUState(saved)
    for k in range(50, 100):
        unit.step(k)
    expected = unit.get(*names)
    unit.slave.setFMUState(saved)
    assert unit.get("time") == [0.25]
    for k in range(50, 100):
        unit.step(k)
    assert unit.get(*names) == expected  # to the bit
    unit.slave.freeFMUState(saved)
    other = Unit(units["effort"], tmp_path / "other").begin()
    received = other.slave.deserializeFMUState(sent)
    other.slave.setFMUState(received)
    for k in range(50, 100):
        other.step(k)
    assert other.get(*names) == expected
    with pytest.raises(FMICallException):
        other.slave.deserializeFMUState(sent[:-1])
    stranger = Unit(units["motion"], tmp_path / "stranger").begin()
    with pytest.raises(FMICallException):
        stranger.slave.deserializeFMUState(sent)
    assert stranger.told == ["This is no state of this unit."]


@pytest.mark.slow
def test_altered_bytes_of_a_state_are_refused_before_a_table_is_read_with_them(
    tmp_path: Path,
) -> None:
    drive, make = CONTROLLERS["kalman"]
    path = fmi.export(
        crane(), tmp_path / "kalman.fmu", controller=make(crane(), PERIOD), drive=drive
    )
    unit = Unit(path, tmp_path / "unit", fmi.CONTROLLER_NAME).begin()
    states = []
    for k in range(3):
        unit.step(k)
        states.append(unit.slave.serializeFMUState(unit.slave.getFMUState()))
    # The count of calls is the number that is 1, 2 and 3 after these steps; the fault follows it.
    rows = np.array([np.frombuffer(state[len(state) % 4 :], np.int32) for state in states])
    (place,) = np.flatnonzero((rows == [[1], [2], [3]]).all(axis=0))
    count = len(states[-1]) % 4 + 4 * int(place)
    fault = count + 4
    mode = len(states[-1]) - 20

    def sent(position: int, value: bytes) -> list[int]:
        state = bytearray(states[-1])
        state[position : position + len(value)] = value
        return unit.slave.setFMUState(unit.slave.deserializeFMUState(bytes(state)))

    for value in (-1, -805306368, 10**6, 2**31 - 1):
        with pytest.raises(FMICallException):
            sent(count, value.to_bytes(4, "little", signed=True))
    nothing = np.array([np.nan]).tobytes()
    for position, content in ((fault, b"\2"), (mode, b"\7"), (count - 8, nothing)):
        with pytest.raises(FMICallException):
            sent(position, content)
    damaged = "The bytes of the state are damaged: a number in them is outside of what this unit"
    assert len(unit.told) == 7 and all(text.startswith(damaged) for text in unit.told)
    before = unit.get("time")
    sent(count, (3).to_bytes(4, "little"))  # as it was
    assert unit.get("time") == before
    unit.step(3)


def test_what_cannot_be_is_refused_by_the_unit_in_a_sentence(unit: Unit) -> None:
    unit.slave.enterInitializationMode()
    for values, sentence in (
        ({"F_x_command": np.nan}, "F_x_command is nan; allowed is a number from -inf to inf."),
        ({"x_start": 500.0}, "x_start is 500; allowed is a number from 2 to 22."),
        ({"payload_mass": 0.0}, "payload_mass is 0; allowed is a number from 0.001 to 1e+09."),
        ({"phi_damping": -1.0}, "phi_damping is -1; allowed is a number from 0 to inf."),
        ({"x": 1.0}, "Time and outputs cannot be set."),
    ):
        with pytest.raises(FMICallException):
            unit.set(**values)
        assert unit.told[-1] == sentence
    unit.slave.exitInitializationMode()
    with pytest.raises(FMICallException):
        unit.set(x_start=12.0)
    assert unit.told[-1] == "x_start cannot be set once stepping has begun."
    unit.set(F_x_command=1e300, T_gamma_command=1e300)
    with pytest.raises(FMICallException):
        unit.slave.getFloat64([999])
    assert unit.told[-1] == "There is no such variable with value reference 999."


DIMENSIONS = {
    "rad": {"rad": 1},
    "s": {"s": 1},
    "m": {"m": 1},
    "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
}
"""Powers of the base units of the SI in its derived units."""


def dimension(unit: str) -> dict[str, int]:
    """Powers of base units in a unit such as N.m.s/rad or m/s2."""
    powers: dict[str, int] = {}
    above, _, below = unit.partition("/")
    for names, sign in ((above, 1), (below, -1)):
        for name, power in re.findall(r"([A-Za-z]+)(\d?)", names):
            for base, exponent in DIMENSIONS[name].items():
                powers[base] = powers.get(base, 0) + sign * exponent * int(power or 1)
    return {base: power for base, power in powers.items() if power}


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("drive", DRIVES)
def test_the_description_names_the_derivatives_and_the_dimensions_of_its_variables(
    drive: Drive, version: Any, tmp_path: Path
) -> None:
    path = fmi.export(damped(), tmp_path / "u.fmu", drive=drive, version=version)
    with zipfile.ZipFile(path) as unit:
        root = ET.fromstring(unit.read("modelDescription.xml"))
    units = {unit.get("name", ""): unit.find("BaseUnit") for unit in root.iter("Unit")}
    assert {"N.m", "N", "m", "rad", "rad/s"} <= set(units)
    for name, base in units.items():
        assert base is not None
        assert {key: int(power) for key, power in base.attrib.items()} == dimension(name), name
    (experiment,) = root.iter("DefaultExperiment")
    assert float(experiment.get("stepSize", "nan")) == 5e-3  # ten steps of 0.5 ms
    (listed,) = root.iter("ModelVariables")
    kinds = {v.get("name", ""): (v.get("causality"), v.get("variability")) for v in listed}
    # What stands still once stepping has begun, and what may be changed while it runs.
    assert kinds["x_start"] == kinds["theta_dot_start"] == ("parameter", "fixed")
    assert kinds["payload_mass"] == kinds["wind_x"] == ("parameter", "tunable")
    assert kinds["x"] == ("output", "continuous") and kinds["valid"] == ("output", "discrete")
    names = [variable.get("name", "") for variable in listed]
    of = {}
    unit_of = {}
    for variable in listed:
        numbers = variable[0] if version == 2 else variable
        unit_of[variable.get("name", "")] = numbers.get("unit", "")
        if index := numbers.get("derivative"):
            # FMI 2 counts variables from 1; FMI 3 names value references, here from 0.
            of[variable.get("name", "")] = names[int(index) - (version == 2)]
    symbols = damped().layout.symbols
    expected = {f"{symbol}_dot": symbol for symbol in symbols}
    expected |= {f"{symbol}_ddot": f"{symbol}_dot" for symbol in symbols}
    assert of == expected
    for rate, variable in of.items():
        change = dimension(unit_of[rate])
        change["s"] = change.get("s", 0) + 1
        assert {k: n for k, n in change.items() if n} == dimension(unit_of[variable])


HOSTILE = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e155, 1e13, 1e12, 5e-324, -0.0, -0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lqr", "yielding", "shaper"])
def test_a_controller_in_a_unit_never_answers_nan_and_says_that_it_is_at_fault(
    name: str, tmp_path: Path
) -> None:
    drive, make = CONTROLLERS[name]
    c = load_crane()
    path = fmi.export(c, tmp_path / "c.fmu", drive=drive, controller=make(c, PERIOD))
    description = fmpy.read_model_description(path)
    inputs = [v.name for v in description.modelVariables if v.causality == "input"]
    outputs = [
        v.name
        for v in description.modelVariables
        if v.causality == "output" and v.type == "Float64"
    ]
    unit = Unit(path, tmp_path / "unit", fmi.CONTROLLER_NAME)
    valid = [unit.reference["valid"]]
    faults = 0
    for wrong in inputs:
        for value in HOSTILE:
            unit.begin(**{wrong: unit.get(wrong)[0]})
            unit.step(0)
            before = unit.get(*outputs)
            if not np.isfinite(value):
                with pytest.raises(FMICallException):
                    unit.set(**{wrong: value})
            else:
                unit.set(**{wrong: value})
            for k in (1, 2):
                found = unit.get(*outputs)
                assert np.isfinite(found).all()
                assert unit.get(*outputs) == found  # looking is no call
                (sound,) = unit.slave.getBoolean(valid)
                assert sound or name != "shaper" or found == before
                unit.step(k)
            refused = not np.isfinite(value)  # and the input before remains
            impossible = abs(value) > 1e12 or (value < 0.0 and (name, wrong) == NEGATIVE)
            assert sound == (refused or not impossible)
            faults += not sound
            unit.slave.reset()
    unit.slave.freeInstance()
    assert faults >= 4 * len(inputs)


NEGATIVE = ("yielding", "l")
"""A rope has no negative length."""


def test_a_crane_in_a_unit_says_that_an_input_is_impossible_and_stays_as_it_is(unit: Unit) -> None:
    unit.begin(**START)
    unit.step(0)
    before = unit.get(*state_names(damped()))
    unit.set(F_x_command=1e13)
    with pytest.raises(FMICallException):
        unit.step(1)
    assert unit.told[-1].startswith("The run ended between 0.005 and 0.01 s: an input lies beyond")
    assert unit.get(*state_names(damped())) == before
    assert np.isfinite(unit.get(*unit.reference.keys() - {"valid"})).all()


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_model_exchange_discards_states_that_are_no_numbers_and_goes_on_from_others(
    version: Any, tmp_path: Path
) -> None:
    path = fmi.export(damped(), tmp_path / "u.fmu", version=version)
    description = fmpy.read_model_description(path)
    fmpy.extract(path, tmp_path / "unit")
    kind = {2: fmpy.fmi2.FMU2Model, 3: fmpy.fmi3.FMU3Model}[version]
    slave = kind(
        guid=description.guid,
        unzipDirectory=str(tmp_path / "unit"),
        modelIdentifier=fmi.NAME,
        instanceName="one",
    )
    slave.instantiate()
    if version == 2:
        slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.enterContinuousTimeMode()
    n = 2 * damped().layout.n
    states, rates = ((ctypes.c_double * n)() for _ in range(2))
    slave.getContinuousStates(states, n)
    sound = list(states)

    def derivatives() -> list[float]:
        call = slave.getDerivatives if version == 2 else slave.getContinuousStateDerivatives
        call(rates, n)
        return list(rates)

    first = derivatives()
    for i, value in ((0, np.nan), (3, np.inf)):
        states[i] = value
        with pytest.raises(FMICallException):
            slave.setContinuousStates(states, n)
        states[i] = sound[i]
    states[2] = 1e7  # an angle beyond a million rad has no sine
    slave.setContinuousStates(states, n)
    with pytest.raises(FMICallException):
        derivatives()
    states[2] = sound[2]
    slave.setContinuousStates(states, n)
    assert derivatives() == first
    slave.freeInstance()


def test_time_goes_on_from_the_start_that_the_importer_names(unit: Unit) -> None:
    unit.slave.enterInitializationMode(startTime=3.0)
    unit.slave.exitInitializationMode()
    assert unit.get("time") == [3.0]
    unit.slave.doStep(currentCommunicationPoint=3.0, communicationStepSize=PERIOD)
    assert unit.get("time") == [3.0 + PERIOD]


def test_a_run_that_diverges_is_an_error_that_says_when(unit: Unit) -> None:
    unit.begin(gamma_dot_start=2e6)
    with pytest.raises(FMICallException):
        unit.step(0)
    assert unit.told[-1].startswith("The run diverged between 0 and 0.005 s: a joint moves at")


def test_a_unit_says_once_the_model_no_longer_holds(unit: Unit) -> None:
    valid = [unit.reference["valid"]]
    unit.begin(**START)
    assert unit.slave.getBoolean(valid) == [True]
    unit.set(F_l_command=500.0)  # would push the rope
    unit.step(0)
    unit.set(F_l_command=-9806.65)
    unit.step(1)
    assert unit.slave.getBoolean(valid) == [False]


def test_a_unit_is_a_hundred_times_as_quick_as_the_real_crane(unit: Unit) -> None:
    unit.begin(**START)
    step = unit.slave.fmi3DoStep
    names = (ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool(), ctypes.c_double())
    began = time.process_time()
    for k in range(2000):
        step(unit.slave.component, k * PERIOD, PERIOD, True, *map(ctypes.byref, names))
    assert 2000 * PERIOD / (time.process_time() - began) > 100.0


@pytest.mark.slow
def test_a_version_may_be_any_number_that_equals_it(tmp_path: Path) -> None:
    path = fmi.export(damped(), tmp_path / "u.fmu", version=2.0)  # type: ignore[arg-type]
    with zipfile.ZipFile(path) as unit:
        assert b'fmiVersion="2.0"' in unit.read("modelDescription.xml")


def test_what_cannot_be_exported_is_refused_in_a_sentence_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cranedyn.export.fmi.importlib.util.find_spec", lambda name: None)
    with pytest.raises(CraneError, match=r"compiled by Zig: pip install 'cranedyn\[cross\]'"):
        fmi.export(crane(), tmp_path / "crane.fmu", platforms=["x86_64-windows"])
    with pytest.raises(CraneError, match="platform"):
        fmi.export(crane(), tmp_path / "crane.fmu", platforms=["amiga"])
    with pytest.raises(OutOfRange, match="version of FMI is 1"):
        fmi.export(crane(), tmp_path / "crane.fmu", version=1)  # type: ignore[arg-type]
    with pytest.raises(OutOfRange, match="drive is torque"):
        fmi.export(crane(), tmp_path / "crane.fmu", drive="torque")  # type: ignore[arg-type]
    monkeypatch.setattr("cranedyn.export.fmi.shutil.which", lambda name: None)
    with pytest.raises(CraneError, match="none of cc, gcc, clang is installed"):
        fmi.export(crane(), tmp_path / "crane.fmu")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_same_crane_makes_the_same_unit(units: dict[str, Path], tmp_path: Path) -> None:
    again = fmi.export(damped(), tmp_path / "again.fmu")
    assert again.read_bytes() == units["effort"].read_bytes()


@pytest.mark.slow
def test_the_command_line_writes_a_unit_of_the_crane_that_it_describes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "heavy.fmu"
    words = "--set payload_mass:=2000 --gravity 9.8 --drive effort".split()
    assert main(["export", "fmu", str(path), *words]) == 0
    assert capsys.readouterr().out.startswith(f"Written to {path}.\n")
    start = {v.name: v.start for v in fmpy.read_model_description(path).modelVariables}
    # What holds the load.
    assert float(start["F_l_command"]) == pytest.approx(-2000.0 * 9.8, rel=1e-12)


def test_an_option_of_the_crane_is_refused_beside_a_controller(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(tmp_path / "c.fmu"), "--controller", "hold", "--dt", "1e-3"]
    assert main(["export", "fmu", *words]) == 2
    assert "--dt has no effect with --controller" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_period_without_a_controller_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "fmu", str(tmp_path / "c.fmu"), "--period", "0.02"]) == 2
    assert "--period has no effect without --controller" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_command_line_writes_a_controller_of_the_period_that_it_was_designed_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    design = {"A": [[0.9]], "B": [[1.0]], "C": [[20.0]], "D": [[-4000.0]], "dt": 0.02}
    file = tmp_path / "slow.json"
    file.write_text(json.dumps({**design, "inputs": ["x"], "outputs": ["F_x"]}))
    path = tmp_path / "slow.fmu"
    words = ["export", "fmu", str(path), "--controller", str(file)]
    assert main(words) == 2
    assert "allowed is that of the controller, 0.02" in capsys.readouterr().err
    assert main([*words, "--period", "0.02"]) == 0
    assert float(fmpy.read_model_description(path).defaultExperiment.stepSize) == 0.02


SHIP = BaseMotion.sines(
    surge=(0.3, 7.0), heave=(0.5, 8.0), roll=(0.1, 7.0, 0.3), pitch=(0.05, 5.0, 1.0), yaw=(0.2, 9.0)
)
"""A base that moves far in all coordinates but one."""


def base_values(unit: Unit, t: float) -> dict[str, float]:
    """The motion of `SHIP` at a time by the names of the inputs of a unit."""
    values = {}
    for numbers, ending in zip(SHIP.at(np.array([t])), ("", "_dot", "_ddot"), strict=True):
        for coordinate, value in zip(COORDINATES, numbers[0].tolist(), strict=True):
            name = f"base_{coordinate}{ending}"
            # Nothing depends on where the origin is.
            if name in unit.reference:
                values[name] = value
    return values


def on_ship(path: Path, folder: Path, step: float, late: float) -> np.ndarray:
    """State at the end of 2 s on `SHIP`, in the wind, with values of the base that are of a time
    later by `late` than the beginning of each communication step [s].
    """
    unit = Unit(path, folder)
    wind = {"wind_x": 8.0 * np.cos(0.5), "wind_y": 8.0 * np.sin(0.5), "payload_area": 4.0}
    unit.begin(x_start=12.0, l_start=10.0, phi_start=0.05, **wind)
    unit.set(payload_force_x=150.0)
    for k in range(round(2.0 / step)):
        unit.set(**base_values(unit, k * step + late))
        unit.step(k, step)
    found = unit.get(*state_names(crane()))
    unit.slave.freeInstance()
    return np.array(found)


@pytest.mark.slow
def test_a_unit_on_a_base_that_moves_is_simulate_and_a_longer_step_errs_by_its_square(
    tmp_path: Path,
) -> None:
    c = crane(damp_swing=2e3)
    path = fmi.export(c, tmp_path / "ship.fmu", drive="motion", base=True)
    assert validate_fmu(path) == []
    description = fmpy.read_model_description(path)
    unit_of = {variable.name: variable.unit for variable in description.modelVariables}
    assert unit_of["base_heave_ddot"] == "m/s2" and unit_of["base_roll"] == "rad"
    assert "base_heave" not in unit_of

    blows = replace(wind(c, lambda t: 8.0, direction=0.5, payload_area=4.0), base=SHIP)
    pushes = constant_force(c, payload=(150.0, 0.0, 0.0))
    dt = fmi.PHYSICS_STEP
    run = simulate(
        c,
        lambda t, state, setpoint: np.zeros(3),
        start=c.state(x=12.0, l=10.0, phi=0.05),
        duration=2.0,
        control_period=dt,
        drive="motion",
        base=SHIP,
        disturbance=lambda t, state: blows(t, state) + pushes(t, state),
        validity="mark",
    )
    state = np.append(run.q[-1], run.v[-1])
    each_step = on_ship(path, tmp_path / "1", dt, 0.0)
    # The round-off of 4000 steps.
    assert_allclose(each_step, state, rtol=0.0, atol=1e-12)

    # Values of the beginning let the base move late; those of the middle err by the square. The
    # motion of the base that semi-implicit Euler takes is that of the beginning of a physics step.
    early = [np.abs(on_ship(path, tmp_path / f"e{h}", h, 0.0) - state).max() for h in (0.02, 0.01)]
    half = 0.5 * dt
    middle = [
        np.abs(on_ship(path, tmp_path / f"m{h}", h, 0.5 * h - half) - state).max()
        for h in (0.02, 0.01)
    ]
    assert middle[0] < 0.1 * early[0] and middle[1] < 0.4 * middle[0]


def test_a_controller_has_no_base(tmp_path: Path) -> None:
    c = crane()
    with pytest.raises(OutOfRange, match="False for a controller, which has no base"):
        fmi.export(c, tmp_path / "lqr.fmu", controller=CONTROLLERS["lqr"][1](c, PERIOD), base=True)
