"""Least squares over records: known numbers found again, and intervals that hold the truth."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binom

from cranedyn.controllers import follow, hold_controller
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, DataError, UnknownName
from cranedyn.identification import Estimate, Model, Prior, Record, identify, load_record
from cranedyn.identification.drive_motion import lagged
from cranedyn.identification.estimate import is_white
from cranedyn.identification.least_squares import jacobian
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.simulation.simulate import simulate
from experiments.gazebo import RECORDINGS
from experiments.identify.coverage import NAMES, NOISE, PLANTS, coverage, synthetic

pytestmark = pytest.mark.slow

PRIOR = Prior()
TRUTH = {"payload_mass": 1300.0, "damp_swing": 900.0, "l_offset": 0.37, "delay": 0.08}
BIAS = {"phi": 4e-3, "theta": -3e-3}
FRICTION = 250.0


@cache
def recorded() -> dict[str, np.ndarray]:
    """Columns of a crane that is not as one believes, by the plain loop of Pinocchio: drives by
    prescribed motion, a sensor of the swing that is late and off, a trolley with dry friction.
    """
    crane = PRIOR.load(payload_mass=TRUTH["payload_mass"], damp_swing=TRUTH["damp_swing"])
    start = crane.state(x=8.0, l=12.0 + TRUTH["l_offset"], phi=0.03)
    pulses = [JoystickPulse("x", 0.6, 2.0, 4.0), JoystickPulse("gamma", 0.08, 8.0, 4.0),
              JoystickPulse("l", 0.4, 16.0, 4.0), JoystickPulse("x", -0.5, 22.0, 4.0)]  # fmt: skip
    aims = joystick(crane, start, pulses, accelerations=(0.05, 0.3, 0.3))
    run = simulate(crane, follow(crane, aims, 0.01), start=start, duration=34.0, dt=0.01,
                   control_period=0.01, drive="motion", integrator=rk4)  # fmt: skip
    t = run.t[::5]
    columns = {"t_s": t, **{name: run[name][::5] for name in ("gamma_rad", "x_m", "l_m")}}
    columns["l_m"] = columns["l_m"] - TRUTH["l_offset"]
    for symbol, bias in BIAS.items():
        columns[f"{symbol}_rad"] = np.interp(t - TRUTH["delay"], run.t, run[f"{symbol}_rad"]) + bias
    columns["F_l_N"] = run["F_l_N"][::5]
    columns["F_x_N"] = run["F_x_N"][::5] + FRICTION * np.sign(run["x_dot_m_s"][::5])
    return columns


@cache
def found() -> Estimate:
    return identify(Model.of(PRIOR, [Record.of(PRIOR.crane, recorded())]))


def test_known_numbers_are_found_from_wrong_starts() -> None:
    """Without noise; what is left of swings is the straight line between rows of the sensor, of
    efforts that the spline through the trolley's positions rings where its rate has a corner, by
    0.3 m/s² times 0.05 s over six, so that a row beside it shows some of the friction at rest.
    """
    estimate = found()
    assert estimate.intervals.keys() == {*TRUTH, "phi_bias", "theta_bias", "x_friction"}
    for name, value in TRUTH.items():
        assert estimate.value(name) == pytest.approx(value, rel=1e-3), name
    for symbol, bias in BIAS.items():
        assert estimate.value(f"{symbol}_bias") == pytest.approx(bias, abs=1e-5)
    assert estimate.value("x_friction") == pytest.approx(FRICTION, rel=1e-2)
    assert estimate.at_bound == ()


def test_a_cable_that_is_three_metres_longer_than_recorded_is_found() -> None:
    """Over the whole record the swing would be a turn and a half behind: the search must begin with
    a part of it.
    """
    columns = {**recorded(), "l_m": recorded()["l_m"] + TRUTH["l_offset"] - 3.0}
    model = Model.of(PRIOR, [Record.of(PRIOR.crane, columns)])
    assert identify(model).value("l_offset") == pytest.approx(3.0, abs=1e-3)


def test_a_slope_is_that_of_differences_to_both_sides() -> None:
    model, _ = synthetic(0)
    values = model.first + 0.3 * model.scale
    slope = jacobian(model, values, 0).slope
    for place in range(len(values)):
        step = np.zeros(len(values))
        step[place] = 30.0 * model.steps[place]
        ahead, behind = model.predicted(0, np.array([values + step, values - step]))
        central = (ahead - behind) / (2.0 * step[place])
        off = np.abs(slope[:, :, place] - central).max(axis=1)
        size = np.abs(central).max(axis=1)
        # A one-sided slope errs by half its step times the curvature, some 1e-5 of itself.
        assert (off <= 1e-4 * size + 1e-9 * size.max()).all(), model.parameters[place].name


@pytest.mark.parametrize("plant", PLANTS)
def test_logged_efforts_under_a_swing_of_20_degrees_tell_delay_and_dry_friction(
    plant: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    monkeypatch.setitem(NOISE, "swing", 0.0)
    monkeypatch.setitem(NOISE, "effort", 0.0)
    model, truth = synthetic(1, plant=plant)
    estimate = identify(model)
    # Half of MuJoCo's step of 0.5 ms, in which its force is held.
    assert estimate.value("delay") == pytest.approx(truth["delay"], abs=2.5e-4)
    # About 5 of 100 rows of a moving drive are at less than twice the rate at which it stands, and
    # lack a few per cent of the friction there.
    assert estimate.value("x_friction") == pytest.approx(truth["x_friction"], rel=2e-3)


@pytest.mark.parametrize(
    ("plant", "cranes"), [("simulate", 6), pytest.param("mujoco", 3, marks=pytest.mark.long)]
)
def test_intervals_of_95_percent_hold_the_truth_as_often(plant: str, cranes: int) -> None:
    """Fewer cranes than `python -m experiments.identify --coverage 1000`, by the same study; what
    is allowed is binomial, at one in ten thousand to either side.
    """
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    seeds = np.arange(100, 100 + cranes)
    exact = {"plant": np.full(cranes, plant), "resolution": np.zeros(cranes)}
    study = coverage({"seed": seeds, **exact})
    # Each of four channels is taken for coloured one time in a thousand.
    assert study["not_white"].sum() <= binom.ppf(1.0 - 1e-4, 4 * cranes, 1e-3)
    scores = np.array([study[f"{name}_off"] / study[f"{name}_margin"] for name in NAMES])
    hits = int((np.abs(scores) <= 1.0).sum())
    count = scores.size
    assert binom.ppf(1e-4, count, 0.95) <= hits
    # As wide as they say: the spread of errors over standard errors is one, within 1 / sqrt(2 n).
    assert np.std(1.96 * scores) == pytest.approx(1.0, abs=5.0 / np.sqrt(2.0 * count))


@pytest.mark.long
def test_intervals_hold_the_truth_of_cranes_whose_encoders_count_whole_centimetres() -> None:
    """Fewer cranes than `python -m experiments.identify --coverage 60 --resolution 0.01`. The
    intervals may be wider than needed, since errors of a smoothed motion have a memory, but not by
    much.
    """
    cranes = 6
    cases = {"plant": np.full(cranes, "simulate"), "resolution": np.full(cranes, 0.01)}
    study = coverage({"seed": np.arange(100, 100 + cranes), **cases})
    scores = np.array([study[f"{name}_off"] / study[f"{name}_margin"] for name in NAMES])
    assert binom.ppf(1e-4, scores.size, 0.95) <= int((np.abs(scores) <= 1.0).sum())
    assert 0.5 < np.std(1.96 * scores) < 1.0 + 5.0 / np.sqrt(2.0 * scores.size)


def test_the_mass_that_hangs_is_found_from_positions_in_steps_of_10_mm() -> None:
    """Rows 50 ms apart: a second difference of rounded positions is some 3 m/s², a third of
    gravity. On average over swings and moves the hoist carries the weight.
    """
    columns = dict(recorded())
    for name in ("x_m", "l_m"):
        columns[name] = 0.01 * np.round(columns[name] / 0.01)
    record = Record.of(PRIOR.crane, columns)
    assert [note[:10] for note in record.notes] == ["record: x_", "record: l_"]
    estimate = identify(Model.of(PRIOR, [record]))
    weighed = -float(np.mean(columns["F_l_N"])) / 9.80665
    assert estimate.value("payload_mass") == pytest.approx(weighed, rel=0.01)
    truth = {**TRUTH, "x_friction": FRICTION}
    truth |= {f"{symbol}_bias": bias for symbol, bias in BIAS.items()}
    for name, value in truth.items():
        # One interval in twenty misses its truth, and hardly one by half of its width.
        assert abs(estimate.value(name) - value) < 1.5 * estimate.margin(name), name
    # Found as well as a smoothed motion allows, where noise in its second difference would be 30 %
    # of the weight, and friction where it is not known whether the trolley stands says nothing.
    assert estimate.margin("payload_mass") < 0.01 * TRUTH["payload_mass"]
    assert estimate.margin("x_friction") < 0.02 * FRICTION
    force = [channel.column for channel in estimate.model.channels[0]].index("F_x_N")
    assert 0.02 < np.mean(estimate.residuals[0][force] == 0.0) < 0.2


def test_the_rounding_of_a_cable_at_two_lengths_is_in_the_interval_of_its_offset() -> None:
    """A standing hoist is rounded in the same way in each row, which no residual tells: r²/12 for
    one length, and between half of that and all of it for two.
    """
    names = ["l_offset", "damp_swing", "delay", "phi_bias", "theta_bias"]
    margins = []
    for step in (0.0, 0.02):
        columns = {name: values for name, values in recorded().items() if name[0] != "F"}
        if step > 0.0:
            columns["l_m"] = step * np.round(columns["l_m"] / step)
        record = Record.of(PRIOR.crane, columns)
        margins.append(identify(Model.of(PRIOR, [record], names)).margin("l_offset"))
    rounding = 1.96 * 0.02 / np.sqrt(12.0)
    assert margins[0] < 0.1 * rounding
    assert np.sqrt(0.4) * rounding < margins[1] < 1.2 * rounding


def _noisy(noise: np.ndarray) -> Estimate:
    """Return the estimate from swings with a noise of 2 mrad."""
    columns = {name: values for name, values in recorded().items() if name[0] != "F"}
    columns["phi_rad"] = columns["phi_rad"] + 2e-3 * noise[: len(columns["t_s"])]
    names = ["l_offset", "damp_swing", "phi_bias", "theta_bias", "delay"]
    return identify(Model.of(PRIOR, [Record.of(PRIOR.crane, columns)], names))


def test_coloured_errors_widen_the_intervals_and_never_narrow_them() -> None:
    steps = np.random.default_rng(3).standard_normal(2000)
    walk = np.zeros(2000)
    for k in range(1, 2000):
        walk[k] = 0.9 * walk[k - 1] + steps[k]
    assert is_white(steps)
    assert not is_white(walk)
    white, with_memory, alternating = (
        _noisy(noise)
        for noise in (steps[1:], walk * np.sqrt(1.0 - 0.9**2), np.diff(steps) / np.sqrt(2.0))
    )
    # The mean of such errors is sqrt(1.9 / 0.1), 4.4 times as wide as that of white ones.
    assert with_memory.margin("phi_bias") > 2.0 * white.margin("phi_bias")
    # The mean of alternating errors is surer than that of white ones, which nobody may build on.
    assert "record: phi_rad" in alternating.not_white
    # Of the same power within 1 / sqrt(n), 4 %, and twice that.
    assert alternating.margin("phi_bias") > 0.92 * white.margin("phi_bias")


def test_the_delay_of_a_free_swing_is_left_open_and_not_lost_in_round_off() -> None:
    """A late sensor of a swing over standing drives records what an earlier release would: the
    record tells their sum only, so that the interval of the delay is wider than any sensor is late.
    Its variance is what remains of terms that are 10⁸ times as large.
    """
    crane = PRIOR.crane
    start = crane.state(x=10.0, l=15.1, phi=0.1)
    standing = np.zeros(3)
    run = simulate(crane, lambda *now: standing, start=start, duration=40.0, dt=0.02,
                   control_period=0.02, drive="motion", integrator=rk4)  # fmt: skip
    columns = {"t_s": run.t, "phi_rad": np.deg2rad(np.round(np.rad2deg(run["phi_rad"]), 4)),
               "l_m": np.full(len(run.t), 15.0)}  # fmt: skip
    names = ["l_offset", "damp_swing", "delay", "phi_bias"]
    estimate = identify(Model.of(PRIOR, [Record.of(crane, columns)], names))
    assert np.all(np.diag(estimate.covariance) > 0.0)
    assert np.isfinite(estimate.margin("delay"))
    assert estimate.margin("delay") > 0.5
    assert estimate.value("l_offset") == pytest.approx(0.1, abs=1e-4)


def test_a_drive_behind_its_setpoint_is_the_closed_form() -> None:
    t = np.arange(0.0, 4.0, 0.02)
    ramp = np.clip(t - 1.0, 0.0, 2.0)
    position, velocity = lagged(ramp, 0.02, 0.25)
    exact = solve_ivp(
        lambda s, y: (np.clip(s - 1.0, 0.0, 2.0) - y) / 0.25, (0.0, 3.98), [0.0], t_eval=t,
        rtol=1e-10, atol=1e-12, max_step=0.01,
    ).y[0]  # fmt: skip
    np.testing.assert_allclose(position, exact, atol=1e-8)
    np.testing.assert_allclose(velocity, (ramp - position) / 0.25)


def test_recorded_efforts_that_act_again_find_the_friction_of_the_trolley() -> None:
    """Efforts alone, no position: the plain loop's run under a brake, made again from them."""
    crane = PRIOR.load(damp_trolley=2e3, damp_swing=900.0)
    start = crane.state(phi=0.1)
    run = simulate(crane, hold_controller(crane), start=start, duration=17.0, integrator=rk4,
                   dt=5e-3, engine="compiled")  # fmt: skip
    columns = {name: run[name] for name in ("t_s", "phi_rad", "T_gamma_Nm", "F_x_N", "F_l_N")}
    record = Record.of(PRIOR.crane, columns)
    model = Model.of(PRIOR, [record], ["damp_trolley", "damp_swing"])
    assert model.drives == "effort"
    estimate = identify(model)
    assert estimate.value("damp_trolley") == pytest.approx(2e3, rel=1e-3)
    assert estimate.value("damp_swing") == pytest.approx(900.0, rel=1e-3)


def test_gravity_and_dummy_inertia_of_gazebo_are_found_from_two_files() -> None:
    """Recordings of the article's own simulator; two cable lengths tell the two apart. What is left
    of them are Gazebo's chords (experiment gazebo).
    """
    records = [
        load_record(RECORDINGS / f"a1_{name}.parquet", PRIOR.crane, since=12.0)
        for name in ("l5", "l20")
    ]
    estimate = identify(Model.of(PRIOR, records, ["gravity", "dummy_inertia", "damp_swing"]))
    assert estimate.value("gravity") == pytest.approx(9.8, rel=1e-6)
    assert estimate.value("dummy_inertia") == pytest.approx(50.0, rel=1e-3)
    assert estimate.value("damp_swing") == pytest.approx(1.0, rel=2e-2)


def test_a_swing_of_one_degree_taken_for_one_radian_is_told_by_what_the_drives_make_of_it() -> None:
    """One that is beyond 90 when taken for radians is refused before; this one is not."""
    slow = {"t_s": recorded()["t_s"], "x_m": 8.0 + 0.15 * (recorded()["x_m"] - 8.0)}
    record = Record.of(PRIOR.crane, {**slow, "phi_rad": recorded()["phi_rad"]})
    model = Model.of(PRIOR, [record], ["l_offset"])
    swing = model.predicted(0, np.zeros((1, len(model.parameters))))[0][0]
    assert 0.5 < np.degrees(np.abs(swing).max()) < 1.5
    wrong = Record.of(PRIOR.crane, {**slow, "phi_rad": np.degrees(swing)})
    with pytest.raises(DataError, match=r"phi_rad swings 57.* as degrees do; allowed are radians"):
        identify(Model.of(PRIOR, [wrong], ["l_offset"]))


@pytest.mark.parametrize(
    ("names", "drives", "sentence"),
    [
        (["rope_colour"], None, "There is no parameter 'rope_colour'; there are delay, window"),
        (["x_lag"], None, "x_lag cannot be found: x_setpoint_m is not there"),
        (["l_lag"], None, "l_lag cannot be found: l_setpoint_m never moves"),
        (["x_stiffness"], "motion", "drives beside x_stiffness is motion; allowed is hold"),
        (["x_friction"], "effort", "A record has no effort of some drive"),
        ([], None, "There is nothing to find"),
    ],
)
def test_what_no_column_could_tell_is_refused(
    names: list[str], drives: str | None, sentence: str
) -> None:
    still = np.full(len(recorded()["t_s"]), 12.0)
    record = Record.of(PRIOR.crane, {**recorded(), "l_setpoint_m": still})
    with pytest.raises(CraneError, match=sentence):
        Model.of(PRIOR, [record], names, drives=drives)  # type: ignore[arg-type]


def test_parameters_that_were_not_estimated_are_refused() -> None:
    with pytest.raises(UnknownName, match="There is no parameter 'x_lag'; there are l_offset"):
        found().value("x_lag")
