"""The functions that people call from Python, found by inspection, with numbers out of range and
arrays of wrong shapes.

An argument is an expression in the names of `namespace`, so that a case is a line to paste. What is
right for a parameter is found by its name and its annotation in `RIGHT`; a function for which
nothing is right there is told of by a test, and gets its line there.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import os
import pkgutil
import re
import tempfile
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import cranedyn
from cranedyn.controllers.affine import Affine
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics import linearisation as linear
from cranedyn.errors import CraneError
from cranedyn.interfaces import Setpoint
from cranedyn.recording import Run
from cranedyn.simulation.simulate import simulate
from tests.studies import squares
from tests.system.fuzz.core import Broken, Case
from tests.system.fuzz.lines import cheap

PUBLIC = {
    "identification": ("cranedyn.identification",),
    "simulate": ("cranedyn.simulation.simulate", "cranedyn.simulation.stepper"),
    "batch": ("cranedyn.compiled.batch",),
    "crane": ("cranedyn.model.crane", "cranedyn.model.description", "cranedyn.model.load"),
    "controllers": (
        "cranedyn.controllers",
        "cranedyn.controllers.damping",
        "cranedyn.controllers.integral",
        "cranedyn.compiled.horizon.receding",
        "cranedyn.controllers.velocity_command",
        "cranedyn.dynamics.converters",
        "cranedyn.estimation",
    ),
    "references": (
        "cranedyn.references",
        "cranedyn.references.limits",
        "cranedyn.planning.optimal",
        "cranedyn.planning.itinerary",
        "cranedyn.planning.joystick",
    ),
    "linear": ("cranedyn.dynamics.linearisation", "cranedyn.analysis.prediction"),
    "analysis": ("cranedyn.analysis.swing", "cranedyn.dynamics.validity"),
    "theory": ("cranedyn.theory",),
    "trajectory": ("cranedyn.data.trajectory",),
    "wind": ("cranedyn.disturbances.wind",),
    "lifting": tuple(
        f"cranedyn.lifting.{name}" for name in ("loads", "chart", "factors", "wind", "wind_limit")
    ),
    "sweep": ("cranedyn.sweep",),
    "recording": ("cranedyn.recording", "cranedyn.recording.snapshot"),
    "planning": tuple(
        f"cranedyn.planning.{name}"
        for name in (
            "site_file",
            "lift",
            "least_time",
            "certificate",
            "perturbed",
        )
    ),
}
"""What people import from, by the name of a generator."""

INTERNAL = tuple(
    f"cranedyn.{name}"
    for name in (
        "__main__ checks clocks command compiled data.columns data.external data.files "
        "data.tables data.time_series display dynamics errors interfaces lifting lifting.analysis "
        "lifting.checks lifting.figures lifting.judgement lifting.page "
        "lifting.tables lifting.wrench "
        "model.joints model.layout model.solvability model.springs "
        "model.urdf model.values "
        "version planning.bim planning.bodies planning.clearance planning.curve "
        "planning.drive_trajectory planning.fields planning.half_spaces "
        "planning.ifc_shapes planning.move planning.proof planning.search "
        "planning.site planning.solids planning.timing "
        "planning.transcription plant plotting plugins processes simulation.engine simulation.log "
        "simulation.record bridges"
    ).split()
)
"""What only our own code calls, in inner loops or with what was checked before; of the packages
above, what they do not name as theirs."""

NOT_CALLED = ("main", "open_viewer", "serve", "view", "check_display")
"""What would open a window or a port; their arguments are tried on the command line."""

WITHIN = (
    "add_arguments",
    "add_values",
    "check_bounded",
    "write_description",
    "gust_shape",
    "drag_force",
    "corner_forces",
    "over_period",
    "usual_input_weight",
    "bounds",
    "drive_bounds",
    "within_efforts",
    "saturate_acceleration",
    "fitting",
    "hoisting",
    "leg_target",
    "columns_by_quantity",
    "as_command",
    "as_force",
    "late",
    "simulate_perturbed",
    "unproven_time",
    "Receding",
    "Marks",
)
"""What only our own code calls, of modules that people import from."""

HEAVY = {
    "optimal": 0.03,
    "mpc": 0.1,
    "receding": 0.03,
    "record": 0.1,
    "Live": 0.1,
    "sweep": 0.3,
    "fastest": 0.3,
    "check_limits": 0.3,
    "in_least_time": 0.01,
    "plan_lift": 0.03,
    "certify": 0.03,
    "perturb": 0.03,
    "wind_limit": 0.03,
    "identify": 0.05,
    "preflight": 0.05,
    "twin_of": 0.05,
}
"""How often what takes its time is tried, beside the others."""


# --- what is right --------------------------------------------------------------------------------

RIGHT: dict[str, str] = dict(
    entry.strip().split(": ", 1)  # type: ignore[misc]
    for entry in r"""
simulate.duration: 0.05; simulate_batch.duration: 0.05; simulate_batch.threads: 1;
fit_swing.swing: 0.1 * np.exp(-0.01 * t) * np.cos(t); fit_power_law.x: np.arange(1.0, 9.0);
fit_power_law.y: np.arange(1.0, 9.0) ** 2; swing_amplitude.swing: np.full((7, 2), 0.1);
swing_amplitude.rates: np.full((7, 2), 0.1); settling_time.distance: np.exp(-t);
settling_time.within: 0.1; conditions.hoist: trajectory.effort[:, 2];
conditions.q: trajectory.q; conditions.v: trajectory.v; swing_mode.loop: loop;
swing_mode.coordinate: 2; swing_mode.period: 0.005; hanging.q: start.q; resting.q: start.q;
swing_angles.q: start.q; feedback_gain.stiffness: (5e5, 3e5, 3e4);
feedback_gain.damping: (1e6, 5e4, 2e4); closed.gain: np.zeros((3, 10)); free_swing.since: 1.0;
free_swing.until: 3.0; free_swing.start: crane.state(phi=0.1); optimal.duration: 9.0;
with_longer_cable.by: 1.0; with_load_estimate.sensors: 'drives';
with_load_estimate.motion_of: lambda by: with_longer_cable(crane, motion, by);
with_load_estimate.disturbance: np.full(5, 1e-2);
with_load_estimate.noise: np.full(10, 1e-3); optimal.interval: 0.5; in_least_time.interval: 0.5;
spline.waypoints: [(0.0, 12.0, 10.0)]; spline.durations: [5.0];
shortest.waypoints: [(0.0, 12.0, 10.0)]; shortest.rates: (0.1, 1.0, 1.0);
shortest.accelerations: (0.1, 0.5, 0.5); itinerary.rates: (0.1, 1.0, 1.0);
joystick.accelerations: (0.1, 0.5, 0.5); shaped_hoisting.duration: 4.0;
tour.plan: lambda start, goal: flat(crane, start, goal, 6.0);
tour.legs: [Leg('out', x=12.0), Leg('back', x=float(start.q[1]))];
with_sensor_model.rng: np.random.default_rng(1); grid.values: {'x': [1.0, 2.0]};
sample.ranges: {'x': (0.0, 1.0)}; sample.count: 4; wind.values: {'payload_area': 4.0};
constant_force.values: {'payload': (0.0, 0.0, 1.0)}; state.values: {'x': 12.0};
load_crane.values: {'payload_mass': 900.0}; load_crane.numbers: {'damp_swing': 2.0};
sweep.folder: 'swept'; sweep.workers: 1;
results.folder: 'done'; rows.first: 0; rows.last: 1; Crane.layout: crane.layout;
Crane.urdf_source: crane.urdf_source; Crane.model: crane.model; Crane.damping: crane.damping;
Crane.springs: crane.springs; Crane.lower: crane.lower; Crane.upper: crane.upper;
Crane.effort_limit: crane.effort_limit; Crane.points: crane.points; Crane.record: crane.record;
Tracking.period: tracking.period; Tracking.feed_forward: tracking.feed_forward;
Tracking.gain: tracking.gain; Tracking.setpoint: tracking.setpoint; Motion.period: motion.period;
Motion.q: motion.q; Motion.v: motion.v; Motion.a: motion.a; Motion.drives: motion.drives;
HoistIntegral.tracking: tracking; as_velocity_command.drive: 'effort';
converters.values: {'lags': {'x': 0.2}};
Shaper.fractions: (0.0, 0.5); Shaper.amplitudes: (0.5, 0.5);
itinerary.legs: [Leg('out', x=12.0), Leg('back', x=float(start.q[1]))];
small_swing.swing: np.zeros(2); small_swing.rates: np.zeros(2); before.t: 0.05; since.t: 0.05;
parse_values.pairs: ['payload_mass:=900']; read.path: 'good.csv';
read_record.path: 'good.parquet'; read_columns.path: 'good.parquet';
read_columns.columns: ('t_s', 'phi_rad'); write.path: 'new.csv'; record.path: 'new.rrd';
snapshot.recording: 'good.rrd'; animate.recording: 'good.rrd'; snapshot.folder: 'pictures';
animate.path: 'new.gif'; snapshot.times: [0.01]; animate.span: (0.0, 0.1);
check_port.port: 28431; __getitem__.column: 't_s';
step_gust.base: steady(8.0); cosine_gust.base: steady(8.0); turbulence.base: steady(8.0);
wind.direction: 0.3; cross.a: design; cross.b: grid(y=[1.0, 2.0]); trolley_plane.gravity: 9.81;
bending_tower.stiffness: 1e9; read_site.path: SITE; read_chart.path: CHARTS / 'laboratory.toml';
at.radius: 12.0; utilisation.loads: carried; wind_limit.swing: 0.1; wind_limit.utilisation: 1.0;
jib_moment.stations: np.array([0.0, 5.0]); loads_of_rows.q: trajectory.q;
loads_of_rows.v: trajectory.v; loads_of_rows.effort: trajectory.effort;
loads_of_rows.force: trajectory.force; pick_up_speed.drive: 'HD1'; phi_2.drive: 'HD1';
phi_2_least.drive: 'HD1'; pick_up_speed.creep: 0.1; buffer_stroke.deceleration: 2.5;
out_of_service_speed.years: 50; recurrence_factor.years: 20; certify.clearance: lift.clearance;
certify.controller: controller_of(lift); perturb.spread: Spread(); plan_lift.start: site.start;
plan_lift.goal: site.goal; load_record.path: RECORDING;
read_twin.path: twin_of(identify(model)).write('new.json');
Mapping[str, np.ndarray]: {'x': [1.0, 2.0]};
drive: 'x'; duration: 6.0; dwell: 1.0; t: t; y: np.cos(t); seed: 1; dt: 5e-4;
control_period: 5e-3; period: 5e-3; study: squares; title: 't'; name: 'a'; goal: goal;
damping_ratio: 0.1; tolerance: 0.05; amplitude: 0.1; swing: 0.1; mass: 1000.0; length: 10.0;
gravity: 9.81; lengths: np.linspace(5.0, 20.0, 5); measured: np.cos(t);
modelled: 0.9 * np.cos(t); pulses: [JoystickPulse('x', 0.5, 1.0, 2.0)];
legs: [Leg('out', x=12.0)]; pieces: [trajectory]; runs: [run]; share: 0.5; beta: 0.5; a: 0.1;
hoisting: 'HC2'; radii: np.array([10.0, 20.0]); rated: np.array([2000.0, 1000.0]);
used: np.cos(t); falls: 2; least: 2.0; near: 0.05; far: 0.1; lasts: 2.0; site: site; count: 1;
Model: model; Estimate: identify(model); Crane: crane; State: start; Controller: law;
Reference: still; Motion: motion; Lift: lift; Chart: chart; Base: Base(4.5, 6e4); Loads: carried;
Certificate: certificate; Limits: limits; Trajectory: trajectory; Run: run; Hold: law;
Shaper: zv(); Design: design; Speed: steady(8.0); float: 1.0; int: 1; bool: False; str: 'a';
np.random.Generator: np.random.default_rng(1); np.ndarray: np.ones(3);
Sequence[float]: (0.1, 0.1, 0.1); Setpoint: still(0.0);
Callable[[float], Motion]: lambda duration: flat(crane, start, goal, duration);
""".split(";")
    if entry.strip()
)
"""Good expressions: by function and parameter, by parameter, by annotation."""


class Mine(Exception):
    """What a function of the caller's own raises."""


def raises(
    error: BaseException | None = None, answer: object = None, after: int = 0
) -> Callable[..., Any]:
    """A function that raises when it has been called some times, and gives an answer before; it
    takes anything.
    """
    calls = 0

    def function(*given: object) -> object:
        nonlocal calls
        calls += 1
        if calls > after:
            raise Mine("mine") if error is None else error
        return answer

    return function


def writes(part: str) -> Callable[..., Any]:
    """A controller that writes into the state that it is shown."""

    def controller(t: float, state: Any, setpoint: object) -> np.ndarray:
        getattr(state, part)[...] = 1.0
        return np.zeros(3)

    return controller


class Malformed:
    """An affine controller whose common form has one part replaced, and whose calls are those of a
    good one.
    """

    def __init__(self, **replaced: Any) -> None:
        self._replaced = replaced

    def __call__(self, t: float, state: Any, as_setpoint: Any) -> np.ndarray:
        """As a hold."""
        return namespace()["law"](t, state, as_setpoint)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        """The form of a hold, less what is replaced."""
        return dataclasses.replace(namespace()["law"].affine(times, positions), **self._replaced)


class Pretending:
    """A reference whose tabulation answers something of its own."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def __call__(self, t: float) -> Any:
        """As a hold."""
        return namespace()["still"](t)

    def at(self, times: np.ndarray) -> Any:
        """What it was given."""
        return self._answer


@cache
def namespace() -> dict[str, Any]:
    """Names for expressions: everything public, and some good things made of it."""
    names: dict[str, Any] = {}
    for modules in PUBLIC.values():
        for module in modules:
            names |= {
                name: thing
                for name, thing in vars(importlib.import_module(module)).items()
                if not name.startswith("_")
            }
    names |= {
        "np": np,
        "math": math,
        "Path": Path,
        "squares": squares,
    }
    names |= {
        "Mine": Mine,
        "raises": raises,
        "writes": writes,
        "Malformed": Malformed,
        "Pretending": Pretending,
        "Affine": Affine,
        "Setpoint": Setpoint,
        "Run": Run,
    }
    for name, text in {
        "crane": "load_crane()",
        "start": "crane.start",
        "goal": "crane.state(gamma=0.3, x=12.0, l=10.0)",
        "still": "hold(crane, start)",
        "law": "hold_controller(crane)",
        "motion": "flat(crane, start, goal, 16.0)",
        "elsewhere": "Motion(5e-3, *np.zeros((3, 9, 4)), np.array([0, 1]))",
        "short": "flat(crane, start, crane.state(x=start.q[1] + 0.1), 1.0)",
        "tracking": "lqr(crane, short)",
        "limits": "Limits((0.1, 1.0, 1.0), (0.1, 0.5, 0.5))",
        "trajectory": "simulate(crane, law, duration=0.1)",
        "run": "Run('r', crane, trajectory)",
        "carried": "loads(crane, trajectory)",
        "chart": "read_chart(CHARTS / 'laboratory.toml')",
        "design": "grid(x=[1.0, 2.0])",
        "loop": "linear.sampled(crane, crane.state(l=10.0)).closed(feedback_gain(crane, (5e5, 3e5, "
        "3e4), (1e6, 5e4, 2e4)))",
        "t": "np.linspace(0.0, 60.0, 1200)",
        "SITE": "Path(cranedyn.__file__).parent / 'planning' / 'sites' / 'open_yard.toml'",
        "RECORDING": "Path(cranedyn.__file__).parents[1] / 'experiments' / 'recordings' / 'gazebo' "
        "/ 'a1_l5.parquet'",
        "model": "Model.of(Prior(), [Record.of(crane, {'t_s': t, 'phi_rad': 0.1 * np.sin(t)})], "
        "['phi_bias'])",
        "site": "read_site(Path(cranedyn.__file__).parent / 'planning' / 'sites' / "
        "'open_yard.toml')",
    }.items():
        names[name] = eval(text, names | {"linear": linear, "cranedyn": cranedyn})
    return names


# --- what is wrong --------------------------------------------------------------------------------

_NUMBERS = (
    "0 -0.0 -1 1e300 -1e300 1e-300 5e-324 np.nan np.inf -np.inf 1e15 1.5 0.1 2 1e-9"
).split()

_ARRAYS = [
    *("np.zeros(0)", "np.zeros((0, 5))", "np.zeros((0, 3))", "np.zeros(1)", "np.zeros(3)"),
    *("np.zeros(5)", "np.zeros(10)", "np.zeros((3, 1))", "np.zeros((5, 3))", "np.zeros((3, 10))"),
    *("np.zeros((10, 10))", "np.full(3, np.nan)", "np.full(5, np.inf)", "np.full(1200, np.nan)"),
    *("np.zeros(3, dtype='>f8')", "np.zeros(3, dtype='f2')", "np.arange(6.0)[::2]"),
    *("np.ma.masked_all(3)", "np.zeros((1,) * 32)", "np.broadcast_to(1.0, (3,))", "[1, 2, 3]"),
    *("np.full(3, 1e300)", "np.full(3, 5e-324)", "-np.ones(3)", "np.ones(3) * 1e-9", "[1] * 1200"),
    *("np.zeros((4, 5))", "np.zeros((1200, 2))", "np.zeros(1200)", "np.arange(1200.0)[::-1]"),
    *("[[1.0] * 5] * 2", "np.full((3, 3), np.nan)", "np.ones((10, 10)) * np.nan"),
]

_SEQUENCES = ["()", "(1.0, 2.0)", "(np.nan,) * 3", "(1e300,) * 3", "(-1.0,) * 3", "(0, 0, 0)"]

_FORMS = [
    *("np.zeros(0)", "np.zeros((0, 3))", "np.zeros((0, 3, 10))", "np.zeros((1, 2))", "np.zeros(4)"),
    *("np.zeros((1, 3, 9))", "np.zeros((1, 3))", "np.zeros((4000, 3))", "np.full((1, 3), np.nan)"),
    *("np.zeros((1, 10))", "np.zeros((2, 3), dtype=complex)", "np.zeros((11, 3, 10), dtype='f4')"),
    *("np.zeros((2, 10))", "[[0.0] * 10]", "np.zeros((1, 3, 10))[:, ::-1]", "np.full(3, np.nan)"),
]

_CONTROLLERS = [
    *(
        f"Malformed({name}={form})"
        for name in ("feed_forward", "gain", "setpoint", "integral_gain", "limit", "integral")
        for form in _FORMS
    ),
    *("raises()", "raises(answer=np.zeros(3), after=2)", "raises(ValueError('x'), np.zeros(3), 1)"),
    *("raises(SystemExit(3), np.zeros(3), 1)", "writes('q')", "writes('v')", "tracking"),
    *("lambda *a: np.zeros(2)", "lambda *a: np.full(3, np.nan)", "lambda *a: np.zeros((3, 1))"),
    *("lambda *a: np.zeros(3, dtype='f4')", "lambda *a: [1e300] * 3", "lambda *a: 1.0"),
    *("lambda *a: np.full(3, 1e300)", "lambda *a: np.full((2, 3), np.nan)", "lambda *a: None"),
    *("with_observer(tracking, crane, short)", "mpc(crane, short)", "follow(crane, still)"),
]

_REFERENCES = [
    *("raises()", "raises(ValueError('x'), still(0.0), 1)", "elsewhere", "motion"),
    *("lambda t: Setpoint(*np.zeros((3, 2)))", "lambda t: Setpoint(*np.full((3, 3), np.nan))"),
    *("lambda t: Setpoint([0.0, 10.0, 10.0], [0.0] * 3, [0.0] * 3)", "lambda t: np.zeros(3)"),
    *("Pretending(Setpoint(*np.zeros((3, 4, 2))))", "Pretending(Setpoint(*np.zeros((3, 1, 3))))"),
    *("Pretending(Setpoint(*np.full((3, 11, 3), np.nan)))", "Pretending(None)"),
]

_STATES = [
    *("State(np.zeros(5), np.zeros(5))", "State(np.zeros(4), np.zeros(5))", "(start.q, start.v)"),
    *("State(start.q, np.full(5, np.nan))", "State(start.q, np.full(5, 1e300))", "goal"),
    *("State(start.q * 1e300, start.v)", "State(start.q[::-1], start.v)", "crane.state(phi=1.5)"),
    *("State(list(start.q), list(start.v))", "State(np.zeros((0, 5)), np.zeros((0, 5)))"),
    *("State(np.tile(start.q, (2, 1)), np.zeros((2, 5)))", "State(start.q, np.zeros((2, 5)))"),
    *("State(start.q * np.nan, start.v)", "start._replace(q=-start.q)"),
]

_WORDS = [
    *("''", "'a\\0b'", "'\\udcff'", "'a' * 300", "'a/b/c.csv'", "'.'", "'/'", "'folder'"),
    *("'/dev/null'", "'/proc/x.csv'", "'pipe.csv'", "'new'", "'a\\nb'", "'rk4'", "'good.txt'"),
    *("'../x.csv'", "'good.csv'", "'/dev/zero'", "'-'", "'α' * 130", "'.csv'"),
]

_VALUES = ["{'x': np.nan}", "{'': 1.0}", "{'x': 1e300}", "{'a\\0': 1}", "{'x': -1.0}"]

WRONG = {
    "float": _NUMBERS,
    "int": [*_NUMBERS, "2**63", "10**400"],
    "np.ndarray": _ARRAYS,
    "Sequence[float]": _SEQUENCES,
    "tuple[float, float, float]": _SEQUENCES,
    "Controller": _CONTROLLERS,
    "Reference": _REFERENCES,
    "Motion": ["elsewhere"],
    "State": _STATES,
    "Speed": ["lambda t: np.nan", "raises()"],
    "str": _WORDS,
    "Path": _WORDS,
    **dict.fromkeys(("Drive", "DirectDrive", "Validity", "EngineName"), _WORDS),
    "Mapping[str, np.ndarray]": ["{'x': np.zeros(0)}", "{'': [1.0]}", "{'x': [np.nan]}", "{}"],
    "values": _VALUES,
}
"""Expressions by annotation: values of the right kind, of which most are out of range."""


def wrong_for(annotation: str) -> list[str]:
    """Return expressions for a parameter of a type; none for one whose values are all right."""
    return [text for kind in annotation.split(" | ") for text in WRONG.get(kind, [])]


# --- functions ------------------------------------------------------------------------------------


class _Files:
    """Makes the files that a function may be given, where it runs."""

    @staticmethod
    @cache
    def contents() -> dict[str, bytes]:
        """Good ones."""
        with tempfile.TemporaryDirectory() as folder:
            run: Trajectory = namespace()["trajectory"]
            for ending in (".csv", ".parquet"):
                run.write(Path(folder) / f"good{ending}")
            namespace()["record"](Path(folder) / "good.rrd", [namespace()["run"]], title="t")
            with cheap(cut=False):
                namespace()["sweep"](
                    squares, namespace()["design"], Path(folder) / "done", workers=1
                )
            return {
                str(path.relative_to(folder)): path.read_bytes()
                for path in Path(folder).rglob("*")
                if path.is_file()
            }

    @classmethod
    def furnish(cls, folder: Path) -> None:
        """Put them into a folder."""
        for name, content in cls.contents().items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(content)
        (folder / "folder").mkdir()
        os.mkfifo(folder / "pipe.csv")


@cache
def functions(group: str) -> dict[str, Callable[..., Any]]:
    """The functions, classes and methods of a group of modules, by name."""
    found: dict[str, Callable[..., Any]] = {}
    for module in map(importlib.import_module, PUBLIC[group]):
        for name in getattr(module, "__all__", None) or [
            name for name in vars(module) if not name.startswith("_")
        ]:
            thing = getattr(module, name)
            if (
                not (inspect.isfunction(thing) or inspect.isclass(thing))
                or not thing.__module__.startswith("cranedyn")
                or name in (*NOT_CALLED, *WITHIN)
            ):
                continue
            if not hasattr(module, "__all__") and thing.__module__ != module.__name__:
                continue
            if inspect.isclass(thing):
                found |= _methods(name, thing)
            if (
                inspect.isfunction(thing)
                or "__post_init__" in vars(thing)
                or ("__init__" in vars(thing) and not dataclasses.is_dataclass(thing))
            ):
                found[name] = thing  # what is a record of values and no more has nothing to refuse
    return found


_INSTANCES = {
    "Crane": "crane",
    "Trajectory": "trajectory",
    "Design": "design",
    "Sampled": "Sampled(np.eye(10), np.zeros((10, 3)), 0.005)",
}


def _methods(name: str, thing: type) -> dict[str, Callable[..., Any]]:
    """Methods that say in their names what they are, of what there is a good one of."""
    if name not in _INSTANCES:
        return {}
    one = eval(_INSTANCES[name], namespace())
    return {
        f"{name}.{key}": getattr(one, key)
        for key, value in vars(thing).items()
        if inspect.isfunction(value) and not key.startswith("_")
    }


def parameters(name: str, function: Callable[..., Any]) -> dict[str, str]:
    """Annotations of what a function takes, by name; that of `**values` is ``values``."""
    found = {}
    for key, parameter in inspect.signature(function).parameters.items():
        found[key] = (
            "values" if parameter.kind is parameter.VAR_KEYWORD else str(parameter.annotation)
        )
    return found


def right_for(name: str, key: str, annotation: str) -> str | None:
    """A good argument, None if nobody knows one."""
    short = name.rpartition(".")[2]
    kinds = [part.strip() for part in annotation.split("|")]
    for known in (
        f"{name}.{key}",
        f"{short}.{key}",
        key,
        *kinds,
        *(kind.replace("Sequence[", "").rstrip("]") for kind in kinds),
    ):
        if known in RIGHT:
            return RIGHT[known]
    return None


def right(name: str, function: Callable[..., Any]) -> dict[str, str]:
    """Good arguments for all that must be given, and for those that have a line of their own in
    `RIGHT`.
    """
    short, made = name.rpartition(".")[2], {}
    for key, parameter in inspect.signature(function).parameters.items():
        kind = parameters(name, function)[key]
        if parameter.kind is parameter.VAR_POSITIONAL:
            continue
        if parameter.default is parameter.empty or f"{short}.{key}" in RIGHT:
            if (known := right_for(name, key, kind)) is not None and not (
                kind == "values" and f"{short}.{key}" not in RIGHT
            ):
                made[key] = known
    return made


def called(function: Callable[..., Any], texts: dict[str, str]) -> Any:
    """What a function answers to arguments given as expressions."""
    names = dict(namespace())
    for lazy, made in (("lift", _lift), ("certificate", _certificate)):
        if any(re.search(rf"\b{lazy}\b", text) for text in texts.values()):
            names[lazy] = made()
    given = {key: eval(text, dict(names)) for key, text in texts.items()}
    positional: list[Any] = []
    keyed: dict[str, Any] = {}
    for key, parameter in inspect.signature(function).parameters.items():
        if key not in given:
            continue
        if parameter.kind is parameter.POSITIONAL_ONLY:
            positional.append(given[key])
        elif parameter.kind is parameter.VAR_KEYWORD:
            values = given[key] if isinstance(given[key], dict) else {"x": given[key]}
            if "Options" in str(parameter.annotation):  # any other name is Python's own error
                values = {"t_start": next(iter(values.values()), 0.0)}
            keyed |= values
        elif parameter.kind is not parameter.VAR_POSITIONAL:
            keyed[key] = given[key]
    before = {
        key: value.copy()
        for key, value in given.items()
        if isinstance(value, np.ndarray) and value.dtype.kind == "f"
    }
    answer = function(*positional, **keyed)
    for key, value in before.items():
        if not np.array_equal(value, given[key], equal_nan=True):
            raise Broken(
                f"an argument is written to: {getattr(function, '__qualname__', function)}({key})"
            )
    return answer


@cache
def _lift() -> Any:
    return eval("plan_lift(site, limits)", namespace())


@cache
def _certificate() -> Any:
    return eval("certify(lift)", namespace() | {"lift": _lift()})


@dataclass(frozen=True)
class Calls:
    """Calls of the functions of some modules, each with one argument or a few that are wrong."""

    group: str
    weight: float
    interruptible: bool = True

    @property
    def name(self) -> str:
        """Of the kind."""
        return f"api {self.group}"

    def draw(self, rng: Random) -> Case:
        """A function, and what is wrong."""
        found = functions(self.group)
        name = rng.choices(
            list(found), [HEAVY.get(name.rpartition(".")[2], 1.0) for name in found]
        )[0]
        kinds, fast = parameters(name, found[name]), rng.random() < 0.5
        keys = [key for key, kind in kinds.items() if wrong_for(kind)]
        if not keys:
            return Case((name, fast), [])
        weights = [3.0 if key in right(name, found[name]) else 1.0 for key in keys]
        chosen = rng.choices(keys, weights, k=rng.choice([1, 1, 1, 2, 3]))
        wrong = {key: rng.choice(wrong_for(kinds[key])) for key in chosen}
        return Case((name, fast), list(wrong.items()))

    def attempt(self, case: Case, folder: Path) -> str:
        """Call it: it answers, or refuses in a sentence; what it answers is as it says."""
        name, fast = case.head
        function = functions(self.group)[name]
        texts = right(name, function) | dict(case.parts)
        if fast and self.group == "simulate" and "engine" not in texts and name == "simulate":
            texts["engine"] = "'compiled'"
        _Files.furnish(folder)
        os.chdir(folder)
        with (
            open(os.devnull, "w") as nowhere,
            redirect_stdout(nowhere),
            redirect_stderr(nowhere),
            warnings.catch_warnings(),
            cheap(cut=False),
        ):
            warnings.simplefilter("ignore")
            try:
                answer = called(function, texts)
            except CraneError as error:
                if not (str(error).isprintable() and str(error)):
                    raise Broken(
                        "an error that is no printable sentence", repr(str(error))
                    ) from None
                return (
                    "interrupted" if isinstance(error.__context__, KeyboardInterrupt) else "refused"
                )
            # Whoever asks to end the program ends it, from a controller as from anywhere.
            except (Mine, SystemExit) as error:
                theirs = (
                    ()
                    if isinstance(error, SystemExit)
                    else ("controller", "reference", "disturbance")
                )
                word = "SystemExit" if isinstance(error, SystemExit) else ""
                if any(
                    text.startswith("raises") and word in text and key not in theirs
                    for key, text in case.parts
                ):
                    return "own error"
                raise
            _check(answer, str(inspect.signature(function).return_annotation))
            if self.group == "batch" or texts.get("engine") == "'compiled'":
                _check_form(texts.get("controller", ""), known=self.group == "batch")
            _close(answer)
        return "good"

    def shown(self, case: Case) -> str:
        """The call."""
        name, fast = case.head
        texts = right(name, functions(self.group)[name]) | dict(case.parts)
        if fast and name == "simulate":
            texts.setdefault("engine", "'compiled'")
        return f"{name}({', '.join(f'{key}={text}' for key, text in texts.items())})"


def _check(answer: Any, annotation: str) -> None:
    """A reference that was accepted says finite things, and a crane that was accepted moves."""
    if annotation in ("Reference", "Motion") and callable(answer):
        for t in (0.0, 0.7, 3.0, 1e4):
            try:
                setpoint = answer(t)
            except (CraneError, Mine):  # of the reference beneath, when it is asked
                return
            if not all(np.isfinite(part).all() and np.shape(part) == (3,) for part in setpoint):
                raise Broken(
                    "a reference was accepted that says what is not finite, or not three numbers "
                    f"({type(answer).__name__})",
                    f"t = {t}: {setpoint}",
                )
    if (
        annotation == "Trajectory"
        and isinstance(answer, Trajectory)
        and len(answer) > 1
        and not np.isfinite(answer.q).all()
    ):
        raise Broken("a trajectory that is not finite was returned as good")
    if annotation == "Crane":
        with suppress(CraneError):  # that it diverges is an answer
            simulate(answer, namespace()["law"], duration=0.005, validity="mark")


_SHAPES = {
    "feed_forward": (3,),
    "gain": (3, 10),
    "setpoint": (10,),
    "integral_gain": None,
    "limit": None,
    "integral": None,
}
"""Of a row of each part of the common form; None for those of three numbers that have no rows."""


def _check_form(text: str, *, known: bool) -> None:
    """A common form that was accepted is one: what native code reads has the shape that it reads.

    In a batch its numbers are known, too. A single run leaves a block that holds unknown ones
    undone and asks the controller itself; of a limit they are refused.
    """
    if not text.startswith("Malformed("):
        return
    ((name, value),) = eval(text, dict(namespace()))._replaced.items()
    with suppress(TypeError, ValueError):
        found, shape = np.asarray(value, dtype=float), _SHAPES[name]
        rows = found.shape == (3,) if shape is None else len(found) > 0 and found.shape[1:] == shape
        if rows and not ((known or name == "limit") and np.isnan(found).any()):
            return
    raise Broken(f"a common form was accepted whose {name} is none", text)


def _close(answer: Any) -> None:
    with suppress(Exception):
        answer.close()


def unlisted() -> list[str]:
    """Modules that are neither public nor internal."""
    found = pkgutil.walk_packages(cranedyn.__path__, "cranedyn.")
    # a package that names nothing as its own has nothing but its modules
    modules = [
        module.name
        for module in found
        if not module.ispkg or hasattr(importlib.import_module(module.name), "__all__")
    ]
    public = [name for names in PUBLIC.values() for name in names]
    packages = [name for name in public if hasattr(importlib.import_module(name), "__all__")]
    known = {*public, *INTERNAL}
    return [
        name
        for name in modules
        if name not in known
        and not any(name.startswith(f"{one}.") for one in (*INTERNAL, *packages))
    ]


GENERATORS = [Calls(group, 3.0 if group in ("simulate", "batch") else 1.0) for group in PUBLIC]
