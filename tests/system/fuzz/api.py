"""Calls of the public functions of Python, with one or two of their arguments replaced by numbers
out of range and arrays of wrong shapes.
"""

from __future__ import annotations

import importlib
import io
import os
import re
import tempfile
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import cranedyn
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Setpoint
from tests.helpers import ROOT
from tests.studies import squares
from tests.system.fuzz.core import LETTERS, Broken, Generator, outcome

MODULES = [
    f"cranedyn.{name}"
    for name in (
        "identification simulation.simulate simulation.stepper compiled.batch model.crane "
        "model.description model.load model.machines model.options controllers controllers.damping "
        "controllers.integral controllers.velocity_command compiled.horizon.receding "
        "dynamics.contact dynamics.converters estimation references references.limits "
        "references.shaped lifts.planning.optimal lifts.planning.itinerary "
        "lifts.planning.joystick analysis.prediction analysis.swing dynamics.validity "
        "theory data.trajectory dynamics.linearisation disturbances.wind "
        "lifts.judging.loads lifts.judging.chart lifts.judging.factors "
        "lifts.judging.wind_standards lifts.judging.wind_limit sweep recording "
        "recording.snapshot lifts.planning.site_file lifts.planning.lift "
        "lifts.planning.least_time lifts.planning.certificate lifts.planning.perturbed "
        "compiled.fleet interfaces interop.gymnasium interop.commissioning.words "
        "interop.commissioning.served_crane export.matlab interop.commissioning.serve "
        "export.controller_block compiled.crane_block lifts.sites.crane_site_file "
        "lifts.sites.crane_site lifts.sites.placed_capsules lifts.sites.brakes "
        "lifts.sites.distance_proof lifts.sites.obstacles lifts.sites.supervisor "
        "lifts.sites.guard lifts.sites.site_simulation lifts.sites.plan interop.margins "
        "data.external compiled.plant.cranes"
    ).split()
]
"""Modules that people import from."""

CALLS = {
    "simulate": """
        simulate(crane, law, still, start=start, duration=0.05, dt=5e-4, control_period=5e-3)
        simulate(crane, law, still, duration=0.05, dt=5e-4, engine='compiled')
        simulate(crane, law, start=start, duration=0.05, validity='mark', t_start=1.0)
        Stepper(crane, start=start, dt=5e-4, control_period=5e-3, drive='effort').step(three)
        Stepper(crane, forces=True, engine='compiled').step(three, points)
        Ground(box_corners(2.0, 3.0, 1.0), friction=0.4, restitution=0.2, sink=0.002)
        Platform((10.0, 5.0), (2.0, 2.0), 1.0, 0.1)
        Ground(points, (Hull(((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))),), height=-1.0)
        load_crane(**box_load(900.0, 2.0, 3.0, 1.0))
        simulate_batch(crane, law, still, start=start, duration=0.05, threads=1)
        simulate_batch(crane, law, duration=0.05, dt=5e-4, control_period=5e-3, record=2)
        Fleet(crane, 2, dt=1e-3, control_period=0.1, drive='motion', threads=1).step(commands)
        TowerCraneEnv(crane=crane, control_period=0.1, wind=2.0, swing=0.1).reset(seed=1)
        CraneEnv(crane=crane, dt=1e-2, tolerance=0.05, swing_limit=0.5, reach=three).reset(seed=1)
        CraneEnv(crane=crane, action='effort', control_period=0.1, efforts=three).reset(seed=1)
        """,
    "crane": """
        crane.state(x=12.0, phi=0.1)
        crane.swing_angles(five)
        crane.resting(five)
        crane.hanging(five)
        load_crane(payload_mass=900.0, gravity=9.81, damp_swing=2.0)
        load_crane('crane.urdf', driven=['yaw_joint', 'trolley_joint', 'hoist_joint'])
        parse_values(['payload_mass:=900'])
        arguments('crane.urdf')
        describe(values={'payload_mass': 900.0})
        load_crane(machine='tower_hkcrc', gravity=9.8, payload_mass=900.0)
        """,
    "controllers": """
        Hold(crane, three, three, three)
        Tracking(5e-3, tracking.feed_forward, tracking.gain, tracking.setpoint)
        follow(crane, still)
        hold_controller(crane, gravity=9.81, stiffness=(5e5, 3e5, 3e4), damping=(1e6, 5e4, 2e4))
        lqr(crane, short)
        linear_controller(crane, half, half, half, half, about=start, period=5e-3, **named)
        linear_controller(crane, half, half, half, half, about=short, period=5e-3, **named)
        paper_controller(crane, short)
        with_damping(crane, still, limits=limits)
        HoistIntegral(crane, tracking, 1.0, 1.0)
        receding(crane, limits, stages=5, stage=0.4, swing_limit=0.3)
        as_velocity_command(crane, law, drive='effort')
        Converters(three, three, three, three, three)
        converters(crane, lags={'x': 0.2})
        mpc(crane, short)
        with_load_estimate(law, crane, short, disturbance=five, noise=ten)
        with_longer_cable(crane, short, 1.0)
        with_observer(law, crane, short, delay=1)
        with_sensor_model(crane, law, rng=np.random.default_rng(1), delay=1)
        """,
    "references": """
        Motion(5e-3, motion.q, motion.v, motion.a, crane.layout.drives)
        flat(crane, start, goal, 6.0)
        hanging_reference(crane, still, 6.0)
        hold(crane, start)
        pulse(crane, still, 'x', 0.1, at=1.0, width=1.0)
        ramp(crane, still, 'x', 1.0, rate=1.0, at=1.0)
        ei(0.05)
        zv(0.1)
        zvd(0.1)
        shaped(still, zv(), 5e-3)
        shaped_hoisting(crane, still, zv(), 4.0)
        shortest(crane, start, [(0.0, 12.0, 10.0)], rates=(0.1, 1.0, 1.0), accelerations=three)
        spline(crane, start, [(0.0, 12.0, 10.0)], [5.0])
        Limits((0.1, 1.0, 1.0), (0.1, 0.5, 0.5))
        use(crane, motion, limits)
        fastest(crane, lambda duration: flat(crane, start, goal, duration), limits)
        optimal(crane, start, goal, limits, duration=9.0, interval=0.5)
        itinerary(crane, start, legs, rates=(0.1, 1.0, 1.0), dwell=1.0)
        joystick(crane, start, [JoystickPulse('x', 0.5, 1.0, 2.0)], accelerations=(0.1, 0.5, 0.5))
        tour(crane, legs, lambda start, goal: flat(crane, start, goal, 6.0), dwell=1.0)
        constant_force(crane, payload=(0.0, 0.0, 1.0), at=1.0)
        wind(crane, steady(8.0), direction=0.3, payload_area=4.0)
        step_gust(steady(8.0), 1.0, at=1.0)
        cosine_gust(steady(8.0), 1.0, at=1.0, lasts=2.0)
        turbulence(steady(8.0), 0.3, np.random.default_rng(1), duration=6.0)
        """,
    "linear": """
        linear(crane, start)
        sampled(crane, start, dt=5e-4, control_period=5e-3)
        feedback_gain(crane, (5e5, 3e5, 3e4), (1e6, 5e4, 2e4))
        free_modes(crane, start)
        dominant_mode(loop, 5e-3, 2)
        free_swing(crane, law, still, crane.state(phi=0.1), since=1.0, until=3.0)
        fit_swing(t, 0.1 * np.exp(-0.01 * t) * np.cos(t))
        zero_crossings(t, np.cos(t))
        peaks(t, np.cos(t))
        fit_power_law(np.arange(1.0, 9.0), np.arange(1.0, 9.0) ** 2)
        agreement(np.cos(t), 0.9 * np.cos(t))
        swing_amplitude(np.full((7, 2), 0.1), np.full((7, 2), 0.1), 10.0, 9.81)
        settling_time(t, np.exp(-t), 0.1)
        events(crane, trajectory)
        conditions(crane, trajectory.q, trajectory.v, trajectory.effort[:, 2])
        """,
    "exports": """
        controller_block(crane, tracking, control_period=5e-3, duration=2.0)
        controller_block(crane, still_shaped, drive='effort', duration=1.0)
        crane_block(crane, drive='motion', dt=1e-3)
        linear_system(crane, start, drive='velocity', control_period=5e-3, dt=5e-4)
        loop_margins(crane, law, start, dt=5e-4, control_period=5e-3)
        ServedCrane(crane, start=start, duration=0.5).cycle()
        word_map(crane, converters(crane))
        address('127.0.0.1:4840')
        """,
    "theory": """
        point_period(10.0, 9.81)
        rigid_period(10.0, 9.81, 1000.0, 1.0)
        amplitude_factor(0.1)
        pivot_compliance(10.0, 9.81, 1000.0, 3e5, 1e4, 500.0)
        hoist_compliance(0.1, 10.0, 9.81, 1000.0, 3e4, 1e3)
        constant_hoisting(t, 10.0, 0.5, 9.81, 0.1, 0.1)
        constant_hoisting_envelope(t, 10.0, 0.5, 9.81, 0.1, 0.1)
        radial_paper(0.1, length=10.0, gravity=9.81, excitation=1.0)
        adiabatic_amplitude(np.linspace(5.0, 20.0, 5), 10.0, 0.1)
        apsidal_precession(10.0, 0.1, 0.05)
        airy_precession(10.0, 0.1, 0.05)
        slewing_swing(1.0, 10.0, 1.0, 9.81)
        slewing_tension(1.0, 10.0, 1.0, 9.81, 1000.0)
        rolling_period(10.0, 9.81, 1000.0, 500.0)
        pulse_residual(1.0, 1.0, 10.0, 9.81)
        coast_residual(1.0, 1.0, 1.0, 10.0, 9.81)
        quintic_residual(1.0, 6.0, 10.0, 9.81)
        double_pendulum(10.0, 2.0, 200.0, 1000.0, 9.81)
        bifilar(1000.0, 500.0, 1.0, 20.0, 9.81)
        rope_bounce(1e6, 10.0, 1000.0)
        reeving_efficiency(4, 0.98)
        fall_factor(0.5, 1e5, 1e4)
        twisting_tower(1e6, 1e7, 20.0, 10.0, 1000.0, 9.81)
        bending_tower(1e6, 1e9, 1e6, 30.0, 10.0, 1000.0, 9.81)
        convolved_zv(0.7, (0.1, 0.1, 0.1))
        """,
    "trajectory": """
        trajectory['t_s']
        trajectory.state(1)
        trajectory.since(0.05)
        trajectory.before(0.05)
        trajectory.between(0.01, 0.05)
        trajectory.write('new.csv')
        join([trajectory])
        read('good.csv')
        read_columns('good.parquet', ('t_s', 'phi_rad'))
        read_record('good.parquet')
        grid(x=[1.0, 2.0]).rows(0, 1)
        cross(grid(x=[1.0, 2.0]), grid(y=[1.0, 2.0]))
        sample(4, seed=1, x=(0.0, 1.0))
        record('new.rrd', [Run('r', crane, trajectory)], title='t')
        Live(crane, 'a', title='t', file='new.rrd').close()
        check_port(28431)
        """,
    "sites": """
        read_crane_site('two_towers')
        crane_bodies(crane, np.ones(3), 0.1)
        brakes(crane, 'gears', reaction=1.0)
        Brakes(1.0, three, three)
        Station('a', crane, np.ones(3), 0.1, converters(crane), brakes(crane))
        CraneSite('a yard', yard.stations, 0.0, 1.0, 0.1)
        Supervisor(yard, reserved)
        Guard(yard.stations[0], 0.1).step(0.1, State(start.q[None], start.v[None]), three[None])
        simulate_site(yard, [push, push], duration=0.2, dt=0.002, seed=1)
        simulate_site(yard, [push, push], duration=0.1, channel=MessageChannel(0.1, 0.2))
        simulate_site(yard, [push, push], duration=0.1, wind=SiteWind(steady(8.0), 0.3, 4.0))
        """,
    "lifting": """
        loads(crane, trajectory)
        jib_moment(crane, trajectory, np.array([0.0, 5.0]))
        RatedLoads(1, np.array([10.0, 20.0]), np.array([2000.0, 1000.0])).at(12.0)
        utilisation(carried, chart)
        Reeving(4, 0.98, 0.2).columns(crane, trajectory)
        Reeving(4).line_pull(np.full(5, 1e4), np.linspace(-1.0, 1.0, 5))
        Reeving(4).capacity(1e4, 9.81)
        cut_outs(t, np.cos(t))
        assess_run(crane, trajectory, chart)
        read_chart(CHARTS / 'laboratory.toml')
        phi_2(hoisting='HC2', speed=1.0, drive='HD1')
        pick_up_speed('HD1', 1.0, 0.1)
        phi_3(0.5)
        stopping(1.0, 2.5)
        buffer_stroke(1.0, 2.5)
        wind_pressure(1.0)
        speed_of_pressure(1.0)
        height_factor(1.0)
        recurrence_factor(20)
        out_of_service_speed(1.0, 1.0, 50)
        wind_force(1.0, 1.0)
        wind_lean(1.0, 1000.0, 9.81)
        read_site(SITE)
        identify(model)
        preflight(model)
        read_twin(twin_of(identify(model)).write('new.json'))
        load_record(RECORDING, crane)
        """,
}
"""Good calls of public functions, in the names of `namespace`."""

NOT_CALLED = {*"check_display check_enabled open_viewer serve view sweep results".split()}
"""Functions of public packages that open a window or a port, start processes, or read a sweep."""

VALUES = {
    "three": "five (1.0,2.0) [[1.0]*3] [nan]*3 [1e300]*3 [-1.0]*3 np.zeros(0) np.ones(3)*1j",
    "five": "three -five [0.0]*4 [nan]*5 [1e300]*5 five[None] np.ma.masked_all(5)",
    "start": "goal start.q State(np.zeros(4),np.zeros(5)) State(start.q*nan,start.v) "
    "State(start.q*1e300,start.v) State(start.q,np.full(5,1e200)) crane.state(phi=1.5)",
    "law": "tracking follow(crane,still) (lambda*a:np.zeros(2)) (lambda*a:np.full(3,nan)) "
    "(lambda*a:np.full(3,1e300)) (lambda*a:np.zeros((3,1)))",
    "still": "motion short (lambda*a:np.zeros(3)) (lambda*a:Setpoint(*np.zeros((3,2)))) "
    "(lambda*a:Setpoint(*np.full((3,3),nan)))",
    "motion.q": "motion.q*nan motion.q[1:] motion.q[:,1:] motion.q[:0] motion.q*1e300",
    "motion": "short elsewhere still",
    "t": "t[::-1] t[:0] t[:1] t*nan t[:,None] np.zeros(1200) np.full(1200,1e300) t.astype('f2')",
    "reserved": "[reserved[0]]*2 [box*nan for box in reserved] "
    "[box+[[-1e300],[1e300]] for box in reserved]",
    "push": "(lambda*a:np.zeros(2)) (lambda*a:np.full(3,nan)) (lambda*a:np.full(3,1e300)) law",
    "points": "points[:1] points*nan points[0] points+1e300",
    "half": "np.eye(2) [[inf]] [[nan]] 0.5 [[1e300]] np.zeros((1,0)) [[1j]]",
    "named": "{} dict(inputs=['x','x'],outputs=['F_x']) dict(inputs=['w'],outputs=['F_x']) "
    "dict(inputs=['x'],outputs=['w']) dict(inputs=['x'],outputs=['F_x'],anti_windup=half) "
    "dict(inputs=['x'],outputs=['F_x'],setpoint='run')",
    "commands": "commands[:1] commands*nan commands[:,:1] commands+1e300 commands.astype(complex)",
    "trajectory": "trajectory.before(-1.0) trajectory.before(0.006)",
}
"""Values of the same kind, by name."""

_NUMBER = r"\d+\.?\d*(?:e-?\d+)?"
_PLACES = re.compile(
    rf"(?<![\w.'])(?:{_NUMBER}|{'|'.join(map(re.escape, VALUES))})(?![\w.=(])|'[^']*'"
)

_OURS = str(ROOT / "cranedyn")


@cache
def namespace() -> dict[str, Any]:
    """Return names for expressions: everything public, and some good things made of it."""
    names: dict[str, Any] = {"np": np, "squares": squares, "nan": np.nan, "inf": np.inf}
    for module in map(importlib.import_module, MODULES):
        names |= {name: value for name, value in vars(module).items() if name[0] != "_"}
    package = Path(cranedyn.__file__).parent
    names |= {
        "SITE": package / "lifts" / "planning" / "sites" / "open_yard.toml",
        "RECORDING": package.parent / "experiments" / "recordings" / "gazebo" / "a1_l5.parquet",
        "State": names["State"],
        "Setpoint": Setpoint,
    }
    for name, text in {
        "crane": "load_crane()",
        "start": "crane.start",
        "goal": "crane.state(gamma=0.3, x=12.0, l=10.0)",
        "still": "hold(crane, start)",
        "law": "hold_controller(crane)",
        "motion": "flat(crane, start, goal, 16.0)",
        "short": "flat(crane, start, crane.state(x=start.q[1] + 0.1), 1.0)",
        "elsewhere": "Motion(5e-3, *np.zeros((3, 9, 4)), np.array([0, 1]))",
        "tracking": "lqr(crane, short)",
        "limits": "Limits((0.1, 1.0, 1.0), (0.1, 0.5, 0.5))",
        "still_shaped": "shaped(still, zv(), 5e-3)",
        "legs": "[Leg('out', x=12.0), Leg('back', x=float(start.q[1]))]",
        "trajectory": "simulate(crane, law, duration=0.1)",
        "carried": "loads(crane, trajectory)",
        "chart": "read_chart(CHARTS / 'laboratory.toml')",
        "gain": "feedback_gain(crane, (5e5, 3e5, 3e4), (1e6, 5e4, 2e4))",
        "loop": "sampled(crane, goal).closed(gain)",
        "t": "np.linspace(0.0, 60.0, 1200)",
        "three": "np.ones(3)",
        "five": "0.5 * start.q",
        "ten": "np.full(10, 1e-3)",
        "points": "np.zeros((2, 3))",
        "commands": "np.zeros((3, 2))",
        "half": "[[0.5]]",
        "named": "{'inputs': ['x'], 'outputs': ['F_x']}",
        "yard": "read_crane_site('two_towers')",
        "reserved": "[Guard(station, 0.1).box for station in yard.stations]",
        "push": "lambda t, states: 0.01 * three",
        "model": "Model.of(Prior(), [Record.of(crane, {'t_s': t, 'phi_rad': 0.1 * np.sin(t)})], "
        "['phi_bias'])",
    }.items():
        names[name] = eval(text, names)
    return names


def calls(group: str) -> list[str]:
    """Return the good calls of a group."""
    return [line.strip() for line in CALLS[group].strip().splitlines()]


def draw(group: str, rng: Random) -> str:
    """Return a call with one or two of its values replaced."""
    _contents()  # imports libraries, which crash later if they are interrupted meanwhile
    call = rng.choice(calls(group))
    places = [*_PLACES.finditer(call)]
    chosen = rng.sample(places, min(rng.choice([1, 1, 2]), len(places)))
    for place in sorted(chosen, key=lambda place: -place.start()):
        call = call[: place.start()] + _odd_value(place[0], rng) + call[place.end() :]
    return call


def _odd_value(text: str, rng: Random) -> str:
    if text in VALUES:
        return rng.choice(VALUES[text].split())
    if text[0] == "'":
        return repr(rng.choice([*LETTERS, "good.csv", "folder", "pipe", "/dev/zero", "x", "rk4"]))
    return rng.choice(
        ["nan", "inf", "-inf", "2.5", "2**63", "-1", "0", "1e300", "-1e300", "1e-300"]
    )


def furnish(folder: Path) -> None:
    """Go to a folder, and put there the files that calls name."""
    os.chdir(folder)
    for name, content in _contents().items():
        (folder / name).write_bytes(content)
    (folder / "folder").mkdir()
    os.mkfifo("pipe")


@cache
def _contents() -> dict[str, bytes]:
    trajectory: Trajectory = namespace()["trajectory"]
    with tempfile.TemporaryDirectory() as folder:
        paths = [trajectory.write(Path(folder) / f"good.{end}") for end in ("csv", "parquet")]
        files = {path.name: path.read_bytes() for path in paths}
    return files | {"crane.urdf": namespace()["crane"].urdf.encode()}


def attempt(call: str, folder: Path) -> str:
    """Evaluate a call: it answers, or refuses in a sentence, and writes into no argument.

    A value of a wrong type may be Python's own error, and so may what is no value at all.
    """
    names = dict(namespace())
    arrays = {name: names[name].copy() for name in ("three", "five", "ten", "t", "points")}
    furnish(folder)
    silence = io.StringIO()
    with redirect_stdout(silence), redirect_stderr(silence), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            word = outcome(lambda: _check(eval(call, names)))
        except Exception as error:
            files = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
            wrong_type = isinstance(error, TypeError | AttributeError)
            if not wrong_type and any(_OURS in file for file in files):
                raise
            word = "Python's own error"
    for name, before in arrays.items():
        if not np.array_equal(before, namespace()[name]):
            raise Broken(f"the argument {name} is written to")
    return word


def _check(answer: Any) -> None:
    """Return if a number, trajectory or reference is finite; else raise `Broken`."""
    if isinstance(answer, float | np.ndarray) and not np.isfinite(answer).all():
        raise Broken("an answer is not finite", answer)
    if isinstance(answer, Trajectory) and not np.isfinite(answer.q).all():
        raise Broken("a trajectory that is not finite was returned as good")
    if callable(answer) and type(answer).__module__.startswith("cranedyn.references"):
        for t in (0.0, 0.7, 3.0, 1e4):
            if not np.isfinite(answer(t)).all():
                raise Broken("a reference was accepted that is not finite", t)


GENERATORS = [
    Generator(f"api {group}", partial(draw, group), attempt, long=True) for group in CALLS
]
