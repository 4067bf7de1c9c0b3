"""Simulated sites: runs that end early, messages that are late, and what is between two rows."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.data.trajectory import read_columns
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import State
from cranedyn.lifts.planning.solids import box
from cranedyn.lifts.sites import site_simulation as simulation
from cranedyn.lifts.sites.crane_site import SiteWind
from cranedyn.lifts.sites.plan import plan_site
from cranedyn.lifts.sites.site_simulation import (
    MessageChannel,
    SiteRun,
    SiteRunError,
    simulate_site,
)
from tests.lifts.sites.cases import site_of

pytestmark = pytest.mark.slow

RATES = np.array([0.01, 0.1, 0.2])


def good(t: float, states: Sequence[State]) -> np.ndarray:
    return RATES


def ends_with_nan(t: float, states: Sequence[State]) -> np.ndarray:
    return np.full(3, math.nan) if t > 1.95 else RATES


def ends_with_an_error(t: float, states: Sequence[State]) -> np.ndarray:
    return RATES / 0 if t < 0.0 else RATES if t < 1.95 else 1 / 0  # type: ignore[return-value]


def ends_with_ctrl_c(t: float, states: Sequence[State]) -> np.ndarray:
    if t > 1.95:
        raise KeyboardInterrupt
    return RATES


def ends_with_a_wrong_shape(t: float, states: Sequence[State]) -> np.ndarray:
    return np.zeros(2) if t > 1.95 else RATES


ENDS = {
    "NaN": (ends_with_nan, RunError, "The run of south ended at t = 2 s: .* needs a finite number"),
    "an error": (ends_with_an_error, ZeroDivisionError, "The run of south ended .* Zero"),
    "Ctrl-C": (ends_with_ctrl_c, None, "The run of south was interrupted at t = 2.000 s"),
    "a wrong shape": (ends_with_a_wrong_shape, OutOfRange, "The run of south ended at t = 2 s"),
}


@pytest.mark.parametrize("supervised", [False, True])
@pytest.mark.parametrize("how", ENDS)
def test_a_run_that_ends_early_keeps_all_rows_of_all_cranes(
    how: str, supervised: bool, tmp_path: Path
) -> None:
    operator, cause, words = ENDS[how]
    if how == "NaN" and supervised:
        return  # a guard takes it for a fault and brakes
    site = site_of()
    with pytest.raises(SiteRunError, match=words) as caught:
        simulate_site(site, [good, operator], duration=5.0, supervised=supervised)
    error = caught.value
    assert isinstance(error, RunError)
    assert error.t == pytest.approx(2.0)
    assert error.crane == "south"
    assert (error.__cause__ is None) if cause is None else isinstance(error.__cause__, cause)
    run = error.trajectory
    assert isinstance(run, SiteRun)
    assert len(run) == 20
    whole = simulate_site(site, [good, good], duration=2.0, supervised=supervised)
    assert len(run.t) == 20
    assert (run.t == whole.t).all()
    for mine, other in zip(run.trajectories, whole.trajectories, strict=True):
        assert (mine.q == other.q).all()
        assert (mine.t == other.t).all()
    assert (run.distances == whole.distances).all()
    assert len(run.boxes) == 2 * supervised
    columns = read_columns(run.write(tmp_path / "early.parquet"), ["north_x_m", "south_l_m"])
    assert len(columns["north_x_m"]) == len(columns["south_l_m"]) == 20
    again = pickle.loads(pickle.dumps(SiteRunError("text", t=1.0, crane="north", run=None)))
    assert (again.crane, again.t, again.trajectory, str(again)) == ("north", 1.0, None, "text")


def test_a_crane_that_was_ahead_of_one_that_ends_a_run_is_cut_to_whole_cycles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = simulation._SiteCrane.step

    def step(self: simulation._SiteCrane, *args: object) -> State:
        if self.name == "south" and self.t > 0.95:
            raise RunError("diverged", t=self.t, joint="slew_joint", value=9.0)
        return real(self, *args)

    monkeypatch.setattr(simulation._SiteCrane, "step", step)
    with pytest.raises(SiteRunError, match="The run of south ended at t = 1 s: diverged") as caught:
        simulate_site(site_of(), [good, good], duration=5.0)
    run = caught.value.trajectory
    assert (caught.value.joint, caught.value.value) == ("slew_joint", 9.0)
    assert run is not None
    assert [len(path.t) for path in run.trajectories] == [10, 10]
    assert len(run.t) == 10


def test_a_run_that_ends_before_its_first_row_says_so() -> None:
    operators: list[Callable] = [good, lambda t, states: np.zeros(2)]
    with pytest.raises(OutOfRange, match="command"):
        simulate_site(site_of(), operators, duration=1.0)
    operators = [good, lambda t, states: 1 / 0]
    with pytest.raises(SiteRunError, match="The run of south ended at t = 0 s") as caught:
        simulate_site(site_of(), operators, duration=1.0)
    assert caught.value.trajectory is None
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_an_error_of_the_wind_ends_a_run_with_its_rows() -> None:
    wind = SiteWind(lambda t: 1 / 0 if t > 0.95 else 0.0)
    with pytest.raises(SiteRunError, match="ended at t = 1 s: ZeroDivisionError") as caught:
        simulate_site(site_of(), [good, good], duration=2.0, wind=wind)
    assert len(caught.value.trajectory) == 10


@pytest.mark.parametrize(("latency", "row"), [(0.0, 1), (0.1, 2), (0.2, 4)])
def test_a_box_grows_once_a_request_and_its_answer_have_arrived(latency: float, row: int) -> None:
    run = simulate_site(site_of(), [good, good], duration=1.0, channel=MessageChannel(latency, 0.0))
    changed = np.flatnonzero((run.boxes[0] != run.boxes[0][0]).any(axis=(1, 2)))
    assert changed[0] == row


def test_bodies_that_may_bulge_between_two_rows_by_thrice_a_fall_are_not_proven_apart() -> None:
    # A point whose acceleration is 3 g leaves the straight line by 3 g T²/8 = 0.0368 m at most.
    sagitta = 3.0 * 9.81 * 0.1**2 / 8.0
    site = site_of()
    bodies = site.stations[0].bodies
    radius = float(bodies.radius[bodies.names.index("load")])
    paths = [x.crane.start.q[None, None].repeat(3, axis=0) for x in site.stations]
    for gap, proven in ((sagitta, False), (0.1, True)):
        # A post beside the load, which hangs 30 m along y, as far from it as the gap.
        post = box("post", [radius + gap + 0.5, 30.0], [1.0, 1.0, 0.1], 20.5)
        watch = simulation._Watch(replace(site, solids=(post,)))
        watch.measure(paths)
        assert bool(watch.contacts) != proven


@pytest.mark.parametrize("copy", [0, 1])
def test_states_that_are_no_numbers_count_as_a_contact(copy: int) -> None:
    site = site_of()
    paths = [np.repeat(x.crane.start.q[None, None], 2, axis=1).copy() for x in site.stations]
    watch = simulation._Watch(site)
    watch.measure(paths)
    assert not watch.contacts
    paths[0][0, copy] = math.nan
    watch.measure(paths, np.full((2, 1), site.distance))
    assert [index for index, _ in watch.contacts] == [copy]


def test_the_operator_of_a_plan_leads_its_drives_by_their_delay_their_lag_and_half_a_cycle() -> (
    None
):
    site = site_of()
    plan = plan_site(site, [("north", [-8.9, -6.7, 15.9])])
    motion = plan.lifts[0].motion
    station = site.stations[0]
    times = np.arange(len(motion.q)) * motion.period
    for t in (0.3 * motion.arrival, 0.6 * motion.arrival):
        position = [np.interp(t, times, column) for column in motion.q.T]
        state = State(np.array(position), np.zeros(len(position)))
        rates = plan.operators()[0](t + plan.lifts[0].begin, [state])
        for k, drive in enumerate(motion.drives):
            drives = station.converters
            lag = np.broadcast_to(drives.lags, len(motion.drives))[k]
            ahead = t + drives.delay + 0.05 + lag
            expected = np.interp(ahead, times, motion.v[:, drive])
            assert rates[k] == pytest.approx(expected, abs=2e-3 * station.converters.rates[k])
