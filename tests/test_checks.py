"""Values of a wrong range, shape or size are refused where the API takes them, in one sentence."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from cranedyn.analysis import swing as analysis
from cranedyn.checks import finite, number, short_repr, whole
from cranedyn.clocks import clocks, intervals
from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.lqr import riccati
from cranedyn.data.trajectory import QUANTITIES, read
from cranedyn.errors import CraneError, OutOfRange, RunError
from cranedyn.interfaces import Setpoint, State
from cranedyn.references import Motion, hanging_reference, hold
from cranedyn.references.limits import Limits
from cranedyn.references.shaped import Shaper
from cranedyn.references.simple import Spline
from cranedyn.simulation.simulate import simulate
from cranedyn.simulation.stepper import Stepper
from experiments.scenarios.crane_variants import moved
from tests.helpers import crane
from tests.system.fuzz.api import namespace

C = crane()
REST = crane().start
BRAKE = hold_controller(C)
STILL = hold(C, REST)
MOTION = hanging_reference(C, STILL, 0.1)
LIMITS = Limits((0.0838, 1.583, 1.0), (0.02, 0.4, 0.4))
T = np.linspace(0.0, 30.0, 600)

MISTAKES = r"""
run(duration=nan) => duration is nan s; allowed is > 0.
number('mass', '2000 kg', 'kg', '> 0') => mass is '2000 kg'; allowed is the number alone, in kg.
constant_force(crane, payload=(1, 2)) => force on the payload is an array of shape (2,); allowed is
constant_force(crane, payload=1.0) => force on the payload is an array of shape ()
constant_force(crane, trolley=(nan, 0, 0)) => force on the trolley is nan
constant_force(crane, hook=(0, 0, 1)) => There is no point 'hook'; there are payload, trolley
steady(inf) => wind speed is inf
cosine_gust(steady(1), 1.0, at=0.0, lasts=0.0) => duration of the gust is 0
turbulence(steady(1), -0.1, rng, duration=1.0) => turbulence intensity is -0.1
wind(crane, steady(1), direction=0.0, payload_area=-1.0) => drag area of the payload is -1
wind(crane, steady(1), direction=0.0, hook_area=1.0) => There is no drag area 'hook_area'; there are
pulse(crane, still, 'phi', 1.0, at=1.0, width=1.0) => There is no drive 'phi'; there are
ramp(crane, still, 'phi', 1.0, rate=1.0, at=1.0) => There is no drive 'phi'; there are
pulse(crane, still, 'x', nan, at=1.0, width=1.0) => pulse amplitude is nan; allowed is a finite
pulse(crane, still, 'x', 1.0, at=inf, width=1.0) => pulse start is inf s; allowed is a finite number
pulse(crane, still, 'x', 1.0, at=1.0, width=0.0) => pulse width is 0.0 s; allowed is > 0
ramp(crane, still, 'x', nan, rate=1.0, at=1.0) => ramp distance is nan; allowed is a finite number
ramp(crane, still, 'x', 1.0, rate=1.0, at=nan) => ramp start is nan s; allowed is a finite number
ramp(crane, still, 'x', 1.0, rate=0.0, at=1.0) => ramp rate is 0.0 rad/s or m/s; allowed is > 0
run(dt=0.0) => dt is 0.0 s; allowed is > 0
run(dt=3e-4) => control_period is 0.005 s; allowed is a multiple of dt = 0.0003 s
run(control_period=0.0) => control_period is 0.0 s; allowed is > 0
run(control_period=inf) => control_period is inf s; allowed is > 0
run(drive='speed') => drive is speed; allowed is effort or motion or velocity
run(validity='ignore') => validity is ignore
run(validity='buffers', drive='motion') => validity is buffers
run(start=(five, nan * five)) => gamma_dot at the start is nan rad/s; allowed is a finite
run(dt=1e-14) => dt is 1e-14 s; allowed is 1e-09 to 1000
run(t_start=1e17) => time at the start is 1e+17 s; allowed is -1e9 to 1e9
run(disturbance=lambda t, state: three) => force of the disturbance is an array of shape (3,)
run(disturbance=lambda t, state: nan * points) => force of the disturbance is
run(duration=0.0) => duration is 0.0 s; allowed is > 0
run(duration=0.1234) => duration is 0.1234 s; allowed is a multiple of control_peri
run(duration=1e5) => duration is 100000 s; allowed is 3.68e+04 s at most: its 20000001 rows would
run(dt=1e-9, control_period=1e-9, duration=100.0) => dt is 1e-09 s; allowed is 1e-08 or more for a
simulate(crane, lambda *_: 'up', duration=1.0) => command of the controller is no array
run(dt=10**5000) => dt is int that cannot be written out
run(drive=2) => drive is 2; allowed is effort or motion
simulate(crane, law, other, duration=0.1) => reference is a motion of 4 coordinates, the drives [0,
run(start=four) => start is a state of 4 coordinates and 4 rates;
run(integrator='rk4') => integrator is 'rk4'; allowed is an Integrator, such as rk4 of
lqr(crane, still) => motion is Still(...); allowed is a Motion, such as hanging_reference
load_crane(payload='crate') => There is no moving joint 'crate'; there are yaw_joint, trolley_joint
load_crane(payload=2000) => payload is 2000; allowed is the name of a joint; its mass is
read_site('open_yart') => There is no site 'open_yart'; there are open_yard, city_block
read_crane_site('two_tower') => There is no site 'two_tower'; there are two_towers, four_towers
Stepper(crane, start=four) => start is a state of 4 coordinates and 4 rates
simulate_batch(crane, law, start=four, duration=0.1) => coordinates at the start is an array of
optimal(crane, four, start, limits) => start is a state of 4 coordinates and 4 rates; allowed is 5
optimal(crane, start, goal, limits, duration=9.0, begin=other) => begin is a motion of 4 coordinates
optimal(crane, start, goal, limits, duration=1e9) => duration is 1000000000.0 s; allowed is 20000 or
flat(crane, start, four, 9.0) => goal is a state of 4 coordinates
flat(crane, start, goal, 1e15) => duration is 1000000000000000.0 s; allowed is 20000 or less:
use(crane, other, limits) => motion is a motion of 4 coordinates
spline(crane, start, [[0, 12]], [5.0]) => waypoint is [0, 12]; allowed is three numbers: slew,
hanging_reference(crane, still, 1e15) => duration is 1000000000000000.0 s; allowed is 20000
turbulence(steady(1), 0.1, rng, duration=1e15) => duration of the turbulence is 1000000
tour(crane, legs, lambda a, b: flat(crane, a, b, 9.0), dwell=1e12) => dwell is 1000000000000.0 s
tour(crane, legs, lambda a, b: other, dwell=1.0) => motion that was planned is a motion of 4
hold_controller(crane, stiffness=(1, 2)) => stiffness is (1, 2); allowed is three numbers: slew,
hold_controller(crane, gravity=nan) => gravity is nan m/s²; allowed is a finite number.
with_sensor_model(crane, law, rng=rng, delay=10**5000) => delay of the sensors is int that cannot be
Motion(5e-3, rows, rows[1:], rows, drives) => v of a motion is an array of shape (1, 5); allowed is
Tracking(5e-3, rows[:, 2:], np.zeros((2, 3, 9)), rows) => setpoint is an array of shape (2, 5);
Limits((1, 1), (1, 1, 1)) => acceleration limits is (1, 1, 1) per s²; allowed is one number for each
dominant_mode(np.eye(3), 5e-3, 2) => loop is an array of shape (3, 3); allowed is one of shape (2
sampled(crane, start, dt=1e-3, control_period=1.5e-3) => control_period is 0.0015 s; allowed is a
fit_swing(t, t[:9]) => swing is an array of shape (9,); allowed is one of shape (1200,).
agreement(t, nan * t) => modelled is nan; allowed is finite
fit_swing(0.0 * t, t) => The times of a record must increase from row to row where a swing is to be
riccati(2.0 * one, 0.0 * one, one[0], one[0]) => There is no linear-quadratic regulator for this
conditions(crane, rows, rows[:1], rows[:, 2]) => v is an array of shape (1, 5); allowed is
trajectory.state(21) => row is 21; allowed is a whole number from -21 to 20.
trajectory.state(0.5) => row is 0.5; allowed is a whole number from -21 to 20.
grid(x=[1.0, 2.0]).rows(0, 3) => last is 3; allowed is 0 to 2.
rigid_period(10.0, -9.81, 1000.0, 1.0) => the result of rigid_period(10.0, -9.81, 1000.0, 1.0) is
small_swing(t, t, length=9.0, gravity=9.8, **quiet) => swing is an array of shape (1200,); allowed
hold(crane, four) => state is a state of 4 coordinates and 4 rates
lqr(crane, other) => motion is a motion of 4 coordinates, the drives [0, 1]; allowed is one of 5,
crane.state(x=10**5000) => x at the start is int that cannot be written out; allowed is a number [m]
crane.state(**{"x\0": 1.0}) => There is no coordinate 'x\x00'
load_crane("a\0b.urdf") => Cannot read a b.urdf:
load_crane(**{"payload\0mass": 1.0}) => There is no argument 'payload\x00mass'
finite("a", [[1, 2]], ("n", 3), unit="m") => a is an array of shape (1, 2); allowed is one of shape
finite("a", [[1, 2], [3]], ("n",)) => a is no array of numbers but list;
finite("a", [1j, 2], ("n",)) => a is no array of numbers but one of complex numbers;
finite("a", [1, inf], (2,)) => a is inf; allowed is finite (entry 2 of 2).
crane.layout.for_drives("rate", [1, 2, 0], "/s", "> 0") => rate of l is 0 m/s; allowed is > 0.
number("a", [1]) => a is [1]; allowed is a number.
whole("a", 2**64, 0) => a is 18446744073709551616; allowed is a whole number up to 9
whole("a", 2.0, 0) => a is 2.0; allowed is a whole number >= 0.
intervals("a", 1.0, 0.0) => step is 0.0 s; allowed is > 0.
clocks(1.0, 10**5000, 1.0) => dt is int that cannot be written out; allowed is
with_sensor_model(crane, law, rng=rng, delay=-1) => delay of the sensors is -1 control periods; allo
with_sensor_model(crane, law, rng=rng, noise=[1.0]) => noise of the sensors is [1.0]; allowed is 10
with_sensor_model(crane, law, rng=rng, noise=[*ten[:9], -1.0]) => noise of the sensors is -1.0; allo
with_observer(law, crane, motion, noise=np.zeros(6)) => noise of the observer is 0.0; allowed is > 0
with_observer(law, crane, motion, noise=[1.0]) => noise of the observer is [1.0]; allowed is 6 stand
with_observer(law, crane, motion, disturbance=[-1.0] * 5) => disturbance of the observer is -1.0; al
with_observer(law, crane, motion, initial_std=[inf] * 10) => initial deviation of the observer is in
with_observer(law, crane, motion, delay=-1) => delay of the observer is -1 control periods; allowed
with_observer(law, crane, motion, every=0) => rows between linearisations is 0; allowed is a whole n
with_observer(law, crane, motion, dt=3e-4) => control period is 0.005 s; allowed is a multiple of dt
with_load_estimate(law, crane, motion, sensors='eyes') => sensors is eyes; allowed is drives or swin
with_load_estimate(law, crane, motion, load_std=-0.1) => load_std is -0.1; allowed is >= 0.
with_load_estimate(law, crane, motion, cable_std=nan) => cable_std is nan; allowed is >= 0.
with_load_estimate(law, crane, motion, delay=0.5) => delay of the observer is 0.5 control periods; a
with_load_estimate(law, crane, motion, noise=[1.0]) => noise of the observer is [1.0]; allowed is 10
with_load_estimate(law, crane, motion, noise=np.zeros(10)) => noise of the observer is 0.0; allowed
with_load_estimate(law, crane, motion, disturbance=[1.0]) => disturbance of the observer is [1.0]; a
mpc(crane, short, period=0.052) => period is 0.052 s; allowed is a multiple of the motion's period =
mpc(crane, short, period=-0.05) => period is -0.05 s; allowed is > 0.
mpc(crane, short, dt=3e-4) => control period is 0.05 s; allowed is a multiple of dt = 0.0003 s.
mpc(crane, short, horizon=0) => horizon is 0 periods; allowed is a whole number >= 1.
mpc(crane, short, effort_limit=(1e4, -2.0, 1e4)) => effort limit of x is -2.0 N; allowed is > 0.
mpc(crane, short, effort_limit=(1e4, 1e3)) => effort limit is (10000.0, 1000.0); allowed is three nu
mpc(crane, short, rate_limit=(0.0, 1.0, 1.0)) => rate limit of gamma is 0.0 rad/s; allowed is > 0.
mpc(crane, short, swing_limit=0.0) => swing limit is 0.0 rad; allowed is > 0.
mpc(crane, short, swing_limit=2.0) => swing limit is 2.0 rad; allowed is 0 to 1.5708.
mpc(crane, short, effort_weight=np.zeros((3, 3))) => effort weight is a matrix of 3 by 3 with the ei
receding(crane, limits, period=0.052) => period is 0.052 s; allowed is a multiple of control_period
receding(crane, limits, stage=0.052) => stage is 0.052 s; allowed is a multiple of control_period =
receding(crane, limits, stages=1) => stages is 1 stages; allowed is a whole number >= 2.
receding(crane, limits, stages=1000) => stages is 1000; allowed is 2 to 200.
receding(crane, limits, swing_limit=0.0) => swing limit is 0.0 rad; allowed is > 0.
receding(crane, limits, swing_limit=2.0) => swing limit is 2.0 rad; allowed is 0 to 1.57.
receding(crane, limits, settling=1e-4) => settling is 0.0001 s; allowed is 0.005 to 1000.
receding(crane, limits, input_weight=np.eye(2)) => input weight is an array of shape (2, 2); allowed
receding(crane, limits, drive='steam') => drive is steam; allowed is effort or motion or velocity.
receding(crane, limits, drive='motion', control_period=0.0) => control_period is 0.0 s; allowed is >
receding(crane, Limits((1.0, 1.0), (1.0, 1.0))) => rate limit is (1.0, 1.0); allowed is three number
receding(load_crane(jib_bend_stiffness=1e8), limits) => This predictive controller is made for a cra
Preference(swing=-1.0) => weight of the swing is -1.0; allowed is >= 0.
Preference(swing=0.0, acceleration=0.0, jerk=0.0) => sum of the weights is 0.0; allowed is > 0.
Preference(longer=0.5) => longer is 0.5; allowed is 0 to 0.1.
converters(crane, lags={'x': 0.0}) => lags of converters is 0.0; allowed is > 0.
converters(crane, jerks={'x': nan}) => jerks of x is nan; allowed is a finite number.
converters(crane, delay=-1.0) => delay of converters is -1.0 s; allowed is >= 0.
converters(crane, rolls={'x': 1.0}) => There is no number of converters 'rolls'; there are rates, ac
converters(crane, rates={'phi': 1.0}) => There is no drive 'phi'; there are gamma, x, l.
Ground(points, friction=-0.1) => coefficient of friction is -0.1; allowed is >= 0.
Ground(points, restitution=1.1) => coefficient of restitution is 1.1; allowed is 0 to 1.
Ground(points, sink=0.0) => static sink of the load is 0.0 m; allowed is 0.0005 to 0.1.
Ground(()) => points of a load is () m; allowed is one or more of three numbers each.
Hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]) => corners of a hull is '[[0, 0, 0], [1, 0, 0], [
Hull([[0, 0, 0], [1, 0, nan]]) => corners of a hull is nan m; allowed is finite
phi_1(0.2) => a is 0.2; allowed is 0 to 0.1.
phi_2('HC9', 1.0) => hoisting is HC9; allowed is HC1 or HC2 or HC3 or HC4.
phi_2('HC1', -1.0) => hoisting speed is -1.0 m/s; allowed is >= 0.
pick_up_speed('HD2', 0.5, 0.6) => creep speed is 0.6 m/s; allowed is 0 to 0.5.
phi_3(1.5) => share is 1.5; allowed is 0 to 1.
psi_h(0.0) => mass_ratio is 0.0; allowed is > 0.
buffer_stroke(1.0, 6.0) => deceleration is 6.0 m/s²; allowed is 0.001 to 5.
out_of_service_speed(10.0, 40.0, 1) => years of recurrence is 1; allowed is 2 to 1000.
height_factor(0.0) => height is 0.0 m; allowed is > 0.
Base(0.0, 1.0) => spacing of the corners is 0.0 m; allowed is > 0.
Arm(-1.0, 1.0) => mass of an arm is -1.0 kg; allowed is >= 0.
carried['nothing'] => There is no column 'nothing'; there are t_s, rope_N, pull_N, slack_margin, sna
carried.write('x.txt') => Cannot write x.txt: the ending must be .csv or .parquet.
loads(load_crane(hook_mass=9.0), trajectory) => run is of joints gamma, x, phi, theta, l; allowed is
loads_of_rows(crane, nan * trajectory.q, trajectory.v, trajectory.effort) => q is nan; allowed is fi
loads_of_rows(crane, trajectory.q, [], trajectory.effort) => v is an array of shape (0,); allowed is
Reeving(2.5) => number of falls is 2.5; allowed is a whole number >= 1.
Reeving(2, 1.1) => efficiency of a sheave is 1.1; allowed is 0.5 to 1.
Reeving(2, 0.98, 0.0) => radius of the drum is 0.0 m; allowed is > 0.
fit_power_law(np.array([1.0, 2.0]), np.ones(2)) => A power law needs three points of different absci
fit_power_law(np.full(4, 3.0), np.ones(4)) => A power law needs three points of different abscissa,
agreement(0.0 * t, t) => The measured signal does not move, so there is nothing to compare.
agreement(t, 0.0 * t) => The modelled signal does not move, so there is nothing to compare.
fit_swing(t[:90], np.cos(t[:90])) => The record from 0 to 4.45371 s holds 0 half swings; at least fo
fit_swing(t, 0.0 * t) => The record from 0 to 60 s holds 0 half swings; at least four are needed for
fit_swing(t[:0], t[:0]) => The record holds no row where a swing is to be fitted.
Motion(0.1, rows, rows, rows, np.array([])) => drives of a motion is []; allowed is different whole
Motion(0.1, rows, rows, rows, np.array([0, 0])) => drives of a motion is [0.0, 0.0]; allowed is diff
Motion(0.1, rows, rows, rows, np.array([0.5])) => drives of a motion is [0.5]; allowed is different
Motion(0.1, rows, rows, rows, np.array([5])) => drives of a motion is [5.0]; allowed is different wh
Motion(0.1, rows, rows, rows, np.array([-1])) => drives of a motion is [-1.0]; allowed is different
load_crane(falls=2.5) => falls is 2.5; allowed is a whole number >= 1.
load_crane(rope_stiffness=-1.0) => rope_stiffness is -1.0 N; allowed is >= 0 or inf.
load_crane(drum_inertia=inf) => drum_inertia is inf kg; allowed is > 0.
load_crane(fall_spacing=-1.0) => fall_spacing is -1.0 m; allowed is >= 0.
Ground([[0.0, 1.0]]) => points of a load is ((0.0, 1.0),) m; allowed is one or more of three numbers
Platform((0.0, 0.0), (1.0, 0.0), 1.0) => size of a platform is 0.0 m; allowed is 1e-06 to 1e+06.
Ground(points, (Platform((0.0, 0.0), (1.0, 1.0), 2.0),), height=2.0) => height of a platform above t
standing(crane, Ground(points), start) => A load can stand on the ground only below a rope that stre
batch(crane=[crane] * 8) => number of cranes is 8; allowed is 9, as many as there are of others, or
batch(controller=[law]) => number of controllers is 1; allowed is 9, as many as there are of others,
batch(reference=[still] * 10) => number of cranes is 9; allowed is 10, as many as there are of other
batch(start=[]) => number of starts is 0; allowed is 9, as many as there are of others, or one alone
batch(start=[3.0] * 9) => start is list; allowed is a State, one with rows, or a sequence of States.
batch(start=State(np.zeros((9, 4)), nine.v)) => coordinates at the start is an array of shape (9, 4)
batch(start=State(nine.q, nine.v[:8])) => rates at the start is an array of shape (8, 5); allowed is
batch(start=State(nine.q, nine.v + nan)) => rates at the start is nan; allowed is finite
batch(start=[State(five, np.zeros(3 + i % 2)) for i in range(9)]) => rates at the start is no array
batch(force=np.zeros((9, 5))) => force is an array of shape (9, 5); allowed is one of shape (m, 6) o
batch(force=np.zeros((8, 3, 6))) => force is an array of shape (8, 3, 6); allowed is one of shape (m
batch(force=np.zeros((0, 6))) => force is an array of shape (0, 6); allowed is one with a row at lea
batch(force=np.full((2, 6), inf)) => force is inf N; allowed is finite
batch(force_interval=2) => force_interval is 2; allowed is 1 where there is no force.
batch(sensor_offset=np.zeros(9)) => sensor_offset is an array of shape (9,); allowed is one of shape
batch(sensor_offset=np.full(10, nan)) => sensor_offset is nan; allowed is finite
batch(sensor_offset=np.zeros((8, 4, 10))) => sensor_offset is an array of shape (8, 4, 10); allowed
batch(sensor_offset=np.zeros((9, 0, 10))) => sensor_offset is an array of shape (9, 0, 10); allowed
batch(sensor_delay=-1) => sensor_delay is -1 control periods; allowed is a whole number >= 0.
batch(sensor_delay=1001) => sensor_delay is 1001 control periods; allowed is 0 to 1000.
batch(sensor_delay=[1, 2]) => number of sensor delays is 2; allowed is 9, or one alone for all.
batch(record=2.5) => record is 2.5; allowed is a whole number >= 0.
batch(threads=0) => threads is 0; allowed is a whole number >= 1.
batch(threads=10**9) => threads is 1000000000; allowed is 1 to 1024.
batch(drive='speed') => drive is speed; allowed is effort or motion or velocity.
batch(drive='motion', buffers=True) => buffers is True; allowed is False where the drives take no ef
batch(residual_from=0.6) => residual_from is 0.6 s; allowed is 0 to 0.5.
batch(t_start=inf) => time at the start is inf s; allowed is -1e9 to 1e9.
batch(dt=3e-3) => control_period is 0.005 s; allowed is a multiple of dt = 0.003 s.
batch(integrator=Integrator('mine', lambda *_: None, 0.0)) => integrator of compiled code is mine; a
envs(action='torque') => action is torque; allowed is velocity, acceleration or effort.
envs(reach=(1.0, 2.0)) => reach is (1.0, 2.0); allowed is three numbers: slew, trolley, hoist.
envs(swing_limit=2.0) => swing_limit is 2.0 rad; allowed is 0.001 to 0.785398.
envs(wind=-1.0) => wind is -1.0 m/s; allowed is 0 to 1000.
envs(wind=-1.0) => wind is -1.0 m/s; allowed is 0 to 1000
envs(autoreset_mode='Never') => autoreset_mode is 'Never'; allowed is one of NextStep, SameStep, Dis
envs(num_envs=0) => num_envs is 0; allowed is a whole number >= 1.
envs(max_episode_steps=0) => max_episode_steps is 0; allowed is a whole number >= 1.
envs(render_mode='human') => render_mode is 'human'; allowed is None for many cranes; one crane alon
envs(control_period=0.0007) => control_period is 0.0007 s; allowed is a multiple of dt = 0.01 s.
envs(control_period=100.0, dt=5e-4) => steps in a control period is 200000; allowed is 100000 or les
envs(crane=[]) => number of cranes to choose from is 0; allowed is 1 or more.
envs(payload_area=1e300) => drag area of the payload is 1e+300 m²; allowed is 0 to 1e+06.
grid() => A design needs columns of one length, with a case at least; there is no column.
grid(a=[1.0], b=[]) => A design needs columns of one length, with a case at least; b has 0.
grid(case=[1.0]) => A parameter cannot be called 'case'; allowed is any word but case and error.
Design({'': np.zeros(2)}) => A parameter cannot be called ''; allowed is any word but case and error
grid(a=[1.0, nan]) => a of case 1 is nan; allowed is a finite number.
grid(a=[1.0, 'x']) => a value of a is 1.0; allowed is a printable word, as others.
grid(a=[[1.0]]) => shape of a is (1, 1); allowed is one row of values.
grid(a=['x', '']) => a value of a is ''; allowed is a printable word, as others.
grid(a=[object()]) => type of a is object; allowed is numbers or words.
sample(0, seed=1, a=(0, 1)) => number of points is 0; allowed is a whole number >= 1.
sample(4, seed=-1, a=(0, 1)) => seed is -1; allowed is a whole number >= 0.
sample(4, seed=1, method='halton', a=(0, 1)) => method is 'halton'; allowed is one of sobol, latin h
sample(4, seed=1, a=(1, 1)) => range of a is (1, 1); allowed is two numbers, the smaller first.
sample(4, seed=1, a=3) => range of a is 3; allowed is two numbers, the smaller first.
sample(4, seed=1, a=(0, inf)) => largest a is inf; allowed is a finite number.
Stepper(crane).step([1.0, 2.0]) => command of the controller is an array of shape (2,); allowed is t
Stepper(crane).step([1.0, 2.0, 3.0], points) => force is given; allowed is none, unless the stepper
Stepper(crane).reset(four) => start is a state of 4 coordinates and 4 rates; allowed is 5 of each: g
Stepper(crane, drive='motion', buffers=True) => buffers is True; allowed is False where the drives t
crane.state(l=3.0) => l at the start is 3.0 m; allowed is 3.4 to 26.4.
crane.state(x=23.0) => x at the start is 23.0 m; allowed is 2 to 22.
crane.state(phi=1.58) => phi at the start is 1.58 rad; allowed is -1.5708 to 1.5708.
crane.state(gamma=nan) => gamma at the start is nan rad; allowed is a finite number.
crane.state(l_dot=inf) => l_dot at the start is inf m/s; allowed is a finite number.
crane.state(x='far') => x at the start is far; allowed is a number [m].
riccati(one, one, -one[0], one[0]) => state weight is a matrix of 1 by 1 with the eigenvalue -1; all
riccati(one, one, one[0], 0.0 * one[0]) => effort weight is a matrix of 1 by 1 with the eigenvalue 0
riccati(np.eye(2)[None], np.ones((1, 2, 1)), np.tri(2), one[0]) => state weight is a matrix o
optimum(goal=moved(x=20.0)) => x at the goal is 30.0 m; allowed is 2 to 22.
optimum(start=moved(l=-14.0)) => l at the start is 1.0 m; allowed is 3.4 to 26.4.
optimum(start=moved(phi=0.2)) => phi at the start is 0.2 rad; allowed is -0.1 to 0.1.
optimum(goal=moved(x=9.0, x_dot=2.0)) => x_dot at the goal is 2.0 m/s; allowed is -1.583 to 1.583.
optimum(goal=start) => goal is the start itself; allowed is another place.
optimum(swing=math.pi / 2) => swing is 1.5707963267948966 rad; allowed is above 0 and below π/2.
optimum(duration=-1.0) => duration is -1.0 s; allowed is > 0.
optimum(ramp=-1.0) => ramp is -1.0 s; allowed is >= 0.
optimum(ramp=1e-5) => ramp is 1e-05 s; allowed is 0.001 to 3600.
optimum(interval=0.0) => interval is 0.0 s; allowed is > 0.
optimum(tolerance=1.0) => tolerance is 1.0; allowed is 1e-12 to 0.01.
optimum(iterations=0) => iterations is 0; allowed is a whole number >= 1.
optimum(still=('phi',)) => There is no drive 'phi'; there are gamma, x, l.
optimum(still=('x',)) => still is x; allowed is drives that have no way to go.
optimum(crane=load_crane(hoist_effort=5e3)) => share of the hoist's effort limit that holds the load
regulator(crane, lambda *_: three, start, t=0.0, period=5e-3) => The controller function is not affi
margins(sampled(crane, start), Regulator(*[rows] * 4)) => a of the controller is an array of shape (
flat(crane, crane.state(l=4.0), crane.state(l=26.0), 2.0) => duration is 2.0 s; allowed is longer: t
flat(crane, start, goal, 20.0, ramp=0.0) => ramp is 0.0 s; allowed is 0.005 to 10.
flat(crane, start, goal, 20.0, ramp=10.1) => ramp is 10.1 s; allowed is 0.005 to 10.
fastest(crane, lambda lasts: flat(crane, start, goal, lasts), Limits(1e-9 * three, three)) => limits
as_velocity_command(crane, Hold(crane, three, 0.0 * three, three), drive='effort') => damping of a h
with_damping(crane, still, limits=limits, ratio=-0.1) => damping ratio is -0.1; allowed is 0 to 1.
with_damping(crane, still, limits=limits, ratio=1.1) => damping ratio is 1.1; allowed is 0 to 1.
with_damping(crane, still, limits=limits, recovery=-1.0) => recovery is -1.0 1/s; allowed is >= 0.
parse_sources(['phi_rad']) => phi_rad is not a column; it is given as phi_rad=NAME or phi_rad=NAME[d
parse_sources(['phi_rad=a[deg']) => 'phi_rad=a[deg' is not a column; it is given as phi_rad=NAME or
parse_sources(['phi_rad=a[m]']) => There is no unit of phi_rad 'm'; there are rad, deg, mrad.
parse_sources(['x_N=a[deg]']) => There is no unit of x_N 'deg'; there are N, kN.
run(drive=converters(crane, lags={'x': 0.01}), dt=0.02, control_period=0.1) => shortest lag of the c
run(drive=converters(crane, delay=0.4)) => delay of converters is 0.4 s; allowed is 0.32 or less: 64
run(drive='velocity', validity='buffers') => validity is buffers; allowed is stop or mark, or buffer
sampled(load_crane(gravity=1e40), start) => what a control period does to a state is inf; allowed is
with_longer_cable(crane, motion, -11.0) => length of the shortest cable is -1.0 m; allowed is > 0.
free_modes(crane, State(np.array([0.0, 10.0, math.pi, 0.0, 15.0]), five)) => At gamma = 0 rad, x = 1
free_modes(crane, start).amplitudes(np.zeros((3, 7)), rows) => q is an array of shape (3, 7); allowe
itinerary(crane, start, [Leg('away', x=15.0)], rates=three, dwell=6.0) => end of the tour is [0.0, 1
itinerary(crane, start, [], rates=three, dwell=6.0) => tour is empty; allowed is one leg at least th
itinerary(crane, start, legs, rates=(0.08, 0.0, 0.8), dwell=6.0) => rate of x is 0.0 m/s; allowed is
itinerary(crane, start, legs, rates=(0.1, 5e-324, 1.0), dwell=1.0) => time that leg out takes at the
itinerary(crane, start, legs, rates=three, dwell=-1.0) => dwell is -1.0 s; allowed is >= 0.
itinerary(crane, start, [Leg('nowhere', x=nan), *legs], rates=three, dwell=6.0) => x of leg nowhere
tour(crane, [], lambda a, b: short, dwell=1.0) => tour is empty; allowed is one leg at least that mo
tour(crane, legs[:1], lambda a, b: flat(crane, a, b, 9.0), dwell=1.0) => end of the tour is [0.0, 12
tour(crane, [Leg('too far', x=23.0)], lambda a, b: short, dwell=1.0) => x at the start is 23.0 m; al
tour(crane, legs, lambda a, b: flat(crane, a, b, 9.0), dwell=-1.0) => dwell is -1.0 s; allowed is >=
join([trajectory, trajectory.since(9.0)]) => A piece to join has no rows.
chart.on().at(1.9) => radius on 2 falls is 1.9 m; allowed is 2 to 22, where the chart is.
chart.on().at(30.0) => radius on 2 falls is 30 m; allowed is 2 to 22, where the chart is.
chart.on().at(nan) => radius on 2 falls is nan m; allowed is 2 to 22, where the chart is.
load_cranes(payload_mass=[1.0, 2.0], l=[5.0]) => arrays of values is payload_mass of shape (2,), l o
load_cranes(payload_mass=3.0) => arrays of values is none; allowed is one or more of one length.
load_cranes(payload_mass=[1.0, nan]) => payload_mass is nan; allowed is finite
load_cranes(payload_mass=[1000.0, -1.0]) => payload_mass is -1.0 kg; allowed is > 0.
load_cranes(payload_mass=[1000.0, 2000.0], nowhere=3.0) => There is no coordinate 'nowhere'; there a
load_cranes(l=[5.0, 500.0]) => l at the start is 500.0 m; allowed is 3.4 to 26.4.
load_cranes(payload_mass=[1000.0, 2000.0], rope_stiffness=2e7) => These cranes are elastic, each han
load_crane(machine='../urdf') => There is no machine '../urdf'; there are container_aalborg, gantry_
load_crane('crane.urdf', machine='tower_hkcrc') => machine is 'tower_hkcrc' beside urdf; allowed is
load_crane(from_record={}, machine='tower_hkcrc') => machine is given beside from_record; allowed is
crane.state(length=10) => There is no coordinate 'length'; there are gamma, x, phi, theta, l, gamma_
describe(values={'damp_swing': -1}) => damp_swing is -1 N m s/rad; allowed is >= 0.
describe(values={'dummy_mass': -1e-9}) => dummy_mass is -1e-09 kg; allowed is >= 0.
describe(values={'slew_init': 'nan'}) => slew_init is nan rad; allowed is a finite number.
describe(values={'hoist_min': 0}) => hoist_min is 0 m; allowed is > 0.
Model.of(Prior(), []) => There is no record to identify a crane from; give one or more.
simulate(crane, lambda *_: np.array([1j, 0, 0]), duration=0.1) => command of the controller is no ar
grid(**{name: range(1000) for name in 'abcd'}) => A design of 1000000000000 cases would take
sample(2**30, seed=1, **{f'x{i}': (0, 1) for i in range(2000)}) => A design of 1073741824 cases woul
linear_system(crane, outputs=['swing']) => There is no state 'swing'; there are gamma, x
linear_system(crane, drive='torque') => drive is torque; allowed is effort or motion or velocity
linear_system(crane, control_period=7e-4) => control_period is 0.0007 s; allowed is a multiple of dt
to_matlab('crane.txt', crane) => Cannot write crane.txt: the ending must be .mat
"""
"""Calls, and how the sentence begins with which they are refused."""


@cache
def names() -> dict[str, Any]:
    """Return the names of calls."""
    api = namespace()
    rest, crane, law = (api[name] for name in ("start", "crane", "law"))
    nine = State(np.tile(rest.q, (9, 1)), np.zeros((9, 5)))
    return api | {
        **dict(finite=finite, number=number, whole=whole, intervals=intervals, clocks=clocks),
        **dict(riccati=riccati, rng=np.random.default_rng(1), one=np.ones((1, 1, 1))),
        "run": partial(simulate, crane, law, **{"duration": 0.1}),
        "batch": partial(
            simulate_batch, crane=[crane] * 9, controller=law, **{"duration": 0.5, "start": nine}
        ),
        "nine": nine,
        "moved": partial(moved, crane),
        "optimum": partial(
            api["optimal"], crane=crane, start=rest, goal=moved(crane, x=2.0), limits=LIMITS
        ),
        "envs": partial(api["TowerCraneVectorEnv"], crane=crane),
        "four": State(np.zeros(4), np.zeros(4)),
        "other": Motion(5e-3, *np.zeros((3, 2, 4)), np.array([0, 1])),
        "rows": np.zeros((2, 5)),
        "drives": C.layout.drives,
        "quiet": dict.fromkeys(
            ["length_rate", "x", "x_rate", "x_acceleration", "slew_rate", "slew_acceleration"], 0.0
        ),
    }


@pytest.mark.slow
@pytest.mark.parametrize("row", MISTAKES.strip().splitlines())
def test_a_value_out_of_range_is_a_sentence_that_says_what_was_given_and_what_is_allowed(
    row: str,
) -> None:
    call, sentence = row.split(" => ")
    with pytest.raises(CraneError, match=f"^{re.escape(sentence)}") as caught:
        eval(call, dict(names()))
    assert str(caught.value).isprintable() and str(caught.value).endswith(".")


def test_lists_and_whole_numbers_are_arrays_of_doubles() -> None:
    lists = Hold(C, [1, 2, 3], [1, 2, 3], [0, 0, 0])  # type: ignore[arg-type]
    assert lists.stiffness.dtype == float
    q = MOTION.q.tolist()
    v = MOTION.v.astype(int).tolist()
    a = MOTION.a.tolist()
    assert Motion(5e-3, q, v, a, [0, 1, 4]).v.dtype == float  # type: ignore[arg-type]
    assert Shaper([0, 1], [1, 0]).fractions.dtype == float  # type: ignore[arg-type]
    assert Spline([0, 1], [[1, 2], [3, 4]])(0.5).position.tolist() == [2.0, 3.0]  # type: ignore[arg-type]
    rows = 600
    assert analysis.peaks(T.tolist(), np.cos(T).tolist())[0].size > 3  # type: ignore[arg-type]
    assert finite("a", range(rows), ("n",)).dtype == float


def test_values_are_shown_shortly() -> None:
    values = (np.zeros((2, 6)), np.arange(2.0), [1, 2], REST.q.tolist() * 9, "x" * 999)
    assert [len(short_repr(value)) < 60 for value in values] == [True] * 5
    assert short_repr(values[0]) == "array of shape (2, 6)"
    assert repr(BRAKE).startswith("Hold(crane=Crane with") and "\n" not in repr(MOTION)


# --- what goes wrong in a run ---------------------------------------------------------------------


def _from(t0: float, then: Callable[[], Any], usual: Callable[..., Any]) -> Callable[..., Any]:
    """A callable of a run that does something else from a time on; it is the first of what it is
    given.
    """
    return lambda t, *more: usual(t, *more) if t < t0 else then()


def _as_monitor(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda row, t, state: function(t, state)


NAN = np.array([0.0, math.nan, 15.0])
INF = np.full(3, math.inf)
BAD_SETPOINTS: list[tuple[Any, str]] = [
    (None, "answer of the reference is None; allowed is a cranedyn.Setpoint: position, velocity"),
    (np.zeros(3), r"answer of the reference is \[0\.0, 0\.0, 0\.0\]"),
    (Setpoint(*np.zeros((3, 2))), r"position of the setpoint is an array of shape \(2,\)"),
    (Setpoint(NAN, np.zeros(3), np.zeros(3)), "position of the setpoint is nan; allowed is finite"),
    (Setpoint(np.zeros(3), INF, np.zeros(3)), "velocity of the setpoint is inf; allowed is finite"),
    (Setpoint("a", "b", "c"), "position of the setpoint is no array of numbers but str"),  # type: ignore[arg-type]
]


@pytest.mark.parametrize(("answer", "sentence"), BAD_SETPOINTS)
def test_a_setpoint_that_is_none_ends_a_run_that_keeps_its_rows(
    answer: Any, sentence: str, tmp_path: Any
) -> None:
    with pytest.raises(OutOfRange, match=sentence):
        simulate(C, BRAKE, lambda t: answer, duration=0.1)
    with pytest.raises(RunError, match=rf"^At t = 0\.05 s: {sentence}") as caught:
        simulate(C, BRAKE, _from(0.05, lambda: answer, STILL), duration=0.1)
    kept = caught.value.trajectory
    assert kept is not None and len(kept) == 10
    assert len(read(kept.write(tmp_path / "a.parquet"))) == 10


def test_a_setpoint_of_lists_is_three_numbers_as_well() -> None:
    found = simulate(C, BRAKE, lambda t: Setpoint([0, 10, 15], [0] * 3, [0] * 3), duration=0.05)  # type: ignore[arg-type]
    assert np.array_equal(found.q, simulate(C, BRAKE, STILL, duration=0.05).q)


@pytest.mark.parametrize("who", ["controller", "reference", "disturbance", "monitor"])
def test_an_error_of_whoever_a_run_calls_is_its_cause_and_its_rows_are_kept(who: str) -> None:
    usual = {
        "controller": BRAKE,
        "reference": STILL,
        "disturbance": lambda t, state: np.zeros((2, 3)),
        "monitor": lambda t, state: None,
    }
    for first, rows in ((0.0, 0), (0.05, 10)):
        given: dict[str, Any] = {**usual, who: _from(first, lambda: {}["x"], usual[who])}
        given["monitors"] = [_as_monitor(given.pop("monitor"))]
        with pytest.raises(
            RunError,
            match=rf"^At t = {first:g} s: KeyError in <lambda>, line \d+ of test_checks\.py: "
            r"'x'\.$",
        ) as caught:
            simulate(C, **given, duration=0.1)
        assert isinstance(caught.value.__cause__, KeyError)
        kept = caught.value.trajectory
        # A monitor is called after the row is logged.
        assert kept is not None and len(kept) == rows + (who == "monitor")
        assert all(np.isfinite(getattr(kept, name)).all() for name in QUANTITIES)


def test_masked_numbers_are_no_numbers(recwarn: pytest.WarningsRecorder) -> None:
    """NumPy makes plain arrays of masked ones by forgetting the mask."""
    hidden = np.ma.masked_array([0.0, 1.0, 2.0], mask=[False, True, False])
    for take in (
        lambda: finite("command", hidden, (3,)),
        lambda: Stepper(crane()).step(hidden),
        lambda: simulate(crane(), lambda *_: hidden, duration=0.01),
    ):
        with pytest.raises(OutOfRange):
            take()
    assert not recwarn.list
    bare = np.ma.masked_array([0.0, 1.0, 2.0], mask=False)
    assert finite("command", bare, (3,)).tolist() == [0.0, 1.0, 2.0]


def test_every_row_of_a_table_of_setpoints_must_be_there_and_finite() -> None:
    class Table:
        def __init__(self, rows: int, columns: int, value: float = 0.0) -> None:
            self.answer = Setpoint(*np.full((3, rows, columns), value))

        def __call__(self, t: float) -> Setpoint:
            return Setpoint(*(part[0] for part in self.answer))

        def at(self, times: np.ndarray) -> Setpoint:
            return self.answer

    assert len(hanging_reference(C, Table(21, 3), 0.1).q) == 21
    for table in (Table(20, 3), Table(22, 3), Table(21, 2), Table(21, 3, math.nan)):
        with pytest.raises(
            OutOfRange, match=r"position of the setpoint is (an array of shape|nan)"
        ):
            hanging_reference(C, table, 0.1)


@pytest.mark.parametrize(
    ("value", "unit", "sentence"),
    [
        (
            "3600,0",
            "kg",
            "mass is '3600,0'; allowed is a number [kg]. Use a decimal point: 3600.0.",
        ),
        ("heavy", "kg", "mass is heavy; allowed is a number [kg]."),
        (math.nan, "kg", "mass is nan kg; allowed is a finite number."),
    ],
)
def test_a_decimal_comma_is_told_to_be_a_point_and_only_a_number_has_a_unit(
    value: object, unit: str, sentence: str
) -> None:
    with pytest.raises(OutOfRange) as caught:
        number("mass", value, unit)
    assert str(caught.value) == sentence


def test_a_cost_that_was_computed_is_not_blamed_on_a_weight_that_nobody_gave(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(riccati.__globals__, "stationary", lambda *_: -np.eye(18))
    a = np.eye(18)[None]
    b = np.ones((1, 18, 1))
    with pytest.raises(CraneError) as caught:
        riccati(a, b, np.eye(18), np.eye(1))
    sentence = str(caught.value)
    assert sentence.startswith("There is no linear-quadratic regulator about the end of this")
    assert "a matrix of 18 by 18 with the eigenvalue -1" in sentence
    assert "[[" not in sentence and len(sentence) < 400
