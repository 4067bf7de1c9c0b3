"""Several cranes on one site: what covers them, what proves them apart, and what keeps them so."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError, DataError, ModelError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.planning.crane_bodies import shape_corners
from cranedyn.lifts.sites.adversaries import attacks_on
from cranedyn.lifts.sites.brakes import brakes, largest_rate, stopping_distance
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.sites.crane_site_file import EXAMPLES, SITES, read_crane_site
from cranedyn.lifts.sites.distance_proof import proven_apart
from cranedyn.lifts.sites.guard import BoxRequest, Guard
from cranedyn.lifts.sites.operators import LiftOperator, reach
from cranedyn.lifts.sites.placed_capsules import (
    crane_bodies,
    place_capsules,
    segment_distance,
    stacked,
)
from cranedyn.lifts.sites.site_simulation import (
    MessageChannel,
    SiteRun,
    simulate_copies,
    simulate_site,
)
from cranedyn.lifts.sites.supervisor import Supervisor
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from tests.helpers import long_after

slow = pytest.mark.slow


@cache
def site_of(name: str = "two_towers") -> CraneSite:
    return read_crane_site(name)


def at_rest(station: Station) -> State:
    """Return a copy of the start of a crane on one copy of a site."""
    return State(*(values[None].copy() for values in station.crane.start))


def asking(number: int, held: np.ndarray, wanted: np.ndarray) -> BoxRequest:
    """Return the request of the crane on one copy of a site."""
    return BoxRequest(np.array([0]), np.array([number]), held, wanted)


def capsules(site: CraneSite, i: int, low: np.ndarray, high: np.ndarray, swing: float):
    count = len(site.stations[i].bodies.names)
    ends = (site.positions(i, values)[None].repeat(count, 0) for values in (low, high))
    return place_capsules(site.bodies, np.full(count, i), np.arange(count), *ends, swing)


def draw(station: Station, rng: np.random.Generator) -> np.ndarray:
    low, high = station.ranges
    return rng.uniform(np.maximum(low, -3.0), np.where(high > 30.0, np.minimum(high, 60.0), high))


@slow
# A luffing crane stands between two of the towers.
@pytest.mark.parametrize("name", long_after(2, ["luffing_between", "two_bridges", "two_towers"]))
def test_every_corner_of_every_shape_lies_in_a_capsule(name: str) -> None:
    site = site_of(name)
    rng = np.random.default_rng(1)
    for i, station in enumerate(site.stations):
        crane = station.crane
        foot = station.bodies.foot
        swings = station.crane.swings
        for _ in range(5):
            q = np.array(crane.start.q)
            drives = draw(station, rng)
            q[crane.layout.drives] = drives
            q[swings] -= crane.swing_angles(q)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            q[swings] += site.swing * np.array([np.cos(angle), np.sin(angle)])
            data = crane.model.createData()
            pin.forwardKinematics(crane.model, data, q)
            placed = capsules(site, i, drives, drives, site.swing)
            pivot = int(swings[0]) + 1
            load = int(crane.layout.drives[crane.winch]) + 1
            reach = data.oMi[pivot].actInv(data.oMi[load].translation)
            rope = np.linspace(0.0, 1.0, 20)[:, None] * reach
            for joint, corners in [*shape_corners(crane), (pivot, rope)]:
                points = np.array([data.oMi[joint].act(corner) for corner in corners])
                points = points @ foot[:, :3].T + foot[:, 3]
                gaps = [
                    segment_distance(points, ends) - radius
                    for ends, radius in zip(placed.ends, placed.radius, strict=True)
                ]
                assert np.min(gaps, axis=0).max() <= 1e-6


@slow
@pytest.mark.parametrize("swing", [0.1, 0.5])
def test_a_wide_load_that_leans_to_any_side_and_turns_about_its_rope_lies_in_its_capsule(
    swing: float,
) -> None:
    """A container 12 m long, drawn by its inertia. Two swing joints turn it by more than the rope
    leans, and a load on a hook turns about the rope: a body about that axis covers both.
    """
    inertia = {"payload_ixx": 48000.0, "payload_iyy": 4800.0, "payload_izz": 48000.0}
    crane = load_crane(values={"payload_mass": 4000.0, **inertia})
    bodies = crane_bodies(crane, np.zeros(3), -np.pi / 2.0)
    position = np.array([[0.4, 30.0, 12.0]])
    load = np.array([len(bodies.names) - 1])
    placed = place_capsules(stacked([bodies]), np.array([0]), load, position, position, swing)

    data = crane.model.createData()
    corners = np.concatenate([x for joint, x in shape_corners(crane) if joint == crane.layout.n])
    assert np.ptp(corners, axis=0).max() > 11.0
    rng = np.random.default_rng(3)
    farthest = -np.inf
    for _ in range(200):
        # The rope leans by the largest swing: cos s = cos φ cos θ.
        radial = rng.uniform(-swing, swing)
        tangential = np.arccos(np.cos(swing) / np.cos(radial)) * rng.choice([-1.0, 1.0])
        q = np.array(crane.start.q)
        q[crane.layout.drives] = position[0]
        q[crane.swings] = radial, tangential
        pin.forwardKinematics(crane.model, data, q)
        about_rope = pin.exp3(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
        points = corners @ about_rope.T @ data.oMi[crane.layout.n].rotation.T
        points += data.oMi[crane.layout.n].translation
        gaps = segment_distance(points, placed.ends[0]) - placed.radius[0]
        farthest = max(farthest, float(gaps.max()))
    # A capsule without the swing would not hold the load.
    assert bodies.radius[-1] - placed.radius[0] < farthest <= 1e-6


@pytest.mark.slow
def test_rope_and_load_of_a_box_lie_in_those_of_any_larger_box() -> None:
    site = site_of("four_towers")
    rng = np.random.default_rng(5)
    for _ in range(20):
        low, smaller, larger = np.sort(rng.uniform([0.0, 2.0, 4.0], [0.0, 2.0, 88.0], (3, 3)), 0)
        small, large = (capsules(site, 3, low, high, site.swing) for high in (smaller, larger))
        for ends, radius in zip(small.ends, small.radius, strict=True):
            for z in np.linspace(*ends[:, 2], 9):
                inside = np.minimum(large.ends[:, 0, 2], large.ends[:, 1, 2]) - 1e-9 <= z
                inside &= z <= np.maximum(large.ends[:, 0, 2], large.ends[:, 1, 2]) + 1e-9
                near = np.linalg.norm(large.ends[:, 0, :2] - ends[0, :2], axis=1) < 1e-9
                assert (large.radius[inside & near] >= radius - 1e-9).any()


def coal_distance(site: CraneSite, cranes: list[int], values: list[np.ndarray]) -> float:
    """Return the least distance of two cranes at positions [m], by coal."""
    shapes = []
    for i, value in zip(cranes, values, strict=True):
        placed = capsules(site, i, value, value, site.swing)
        shapes.append([])
        for ends, radius in zip(placed.ends, placed.radius, strict=True):
            along = ends[1] - ends[0]
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along)
            length = float(np.linalg.norm(along))
            turn = turn.toRotationMatrix() if length > 0.0 else np.eye(3)
            place = coal.Transform3s(turn, ends.mean(axis=0))
            shapes[-1].append((coal.Capsule(float(radius), length), place))
    return min(
        coal.distance(*one, *other, coal.DistanceRequest(), coal.DistanceResult())
        for one, other in itertools.product(*shapes)
    )


@slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_no_sample_of_the_largest_proven_boxes_is_too_near_by_the_distances_of_coal(
    name: str,
) -> None:
    site = site_of(name)
    rng = np.random.default_rng(2)
    cut = 0
    pairs = list(itertools.combinations(range(len(site.stations)), 2))
    for _ in range(6):
        cranes = list(pairs[rng.integers(len(pairs))])
        middles = [draw(site.stations[i], rng) for i in cranes]
        halves = [rng.uniform(0.1, 1.0) * np.array([0.6, 0.1, 3.0]) for _ in cranes]

        def boxes(share: float, middles=middles, halves=halves) -> list[np.ndarray]:
            pairs = zip(middles, halves, strict=True)
            return [np.array([middle - share * h, middle + share * h]) for middle, h in pairs]

        def proven(share: float, cranes=cranes, boxes=boxes) -> bool:
            ends = (site.positions(i, x)[None] for i, x in zip(cranes, boxes(share), strict=True))
            a, b = np.array(cranes)[:, None]
            first, second = ends
            return proven_apart(site.bodies, a, first, b, second, site.distance, site.swing)[0]

        low = 0.0
        for step in 5.0 / 2.0 ** np.arange(1, 11):
            low += step if proven(low + step) else 0.0
        cut += 0.0 < low < 4.99
        for _ in range(12 if low else 0):
            corner = [rng.beta(0.2, 0.2, 3) * np.ptp(box, axis=0) + box[0] for box in boxes(low)]
            assert coal_distance(site, cranes, corner) >= site.distance - 1e-5
    assert cut


@pytest.mark.slow
def test_a_crane_stops_within_its_stopping_distance_and_no_rate_is_larger_than_that() -> None:
    station = site_of().stations[0]
    for name in ("converters", "gears"):
        mine = brakes(station.crane, name)
        rate = largest_rate(np.array([0.3, 8.0, 5.0]), mine.reaction, mine.decelerations)
        ahead = mine.tube(np.zeros(3), rate, rate)[1] - mine.tolerances
        assert np.allclose(ahead, [0.3, 8.0, 5.0], rtol=1e-12)
    measured = brakes(station.crane, "gears", reaction=1e-9)
    # Gear 3 of the measured crane turned at (15.05 s - 2.3791 s)/3.5284 and ran on by 24.25°.
    gear_3 = np.radians((15.05 - 2.3791) / 3.5284)
    way = stopping_distance(gear_3, measured.reaction, measured.decelerations[0])
    assert way >= np.radians(24.25)


class Wild:
    """An operator who pushes at random, at full rates; ten seconds in forty without numbers."""

    def __init__(self, station: Station, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.rates = station.converters.rates
        self.until = 0.0
        self.command = np.zeros(len(self.rates))

    def __call__(self, t: float, states: object) -> np.ndarray:
        """Return the rates [rad/s or m/s], shape (m,)."""
        if t >= self.until:
            self.command = self.rng.integers(-1, 2, len(self.rates)) * self.rates
            self.until = t + self.rng.uniform(2.0, 20.0)
        return self.command if t % 40.0 < 30.0 else np.nan * self.command


@cache
def wild_run(name: str, latency: float = 0.1, loss: float = 0.1) -> SiteRun:
    site = site_of(name)
    operators = [Wild(station, 7 + i) for i, station in enumerate(site.stations)]
    return simulate_site(site, operators, duration=120.0, channel=MessageChannel(latency, loss))


def keeps(run: SiteRun) -> bool:
    """Return whether all ropes and boxes of a run keep what the invariant says; measured without
    errors, drives leave most of their tolerance to spare.
    """
    return bool(
        run.outside.max() <= -1e-3
        and run.swing.max() <= run.site.swing
        and run.least_distance >= run.site.distance
        and not run.contacts
    )


@slow
@pytest.mark.parametrize(
    ("name", "latency", "loss"),
    long_after(
        2, [("two_towers", 0.2, 0.5), ("luffing_between", 0.3, 0.2), ("two_towers", 0.0, 0.0)]
    ),
)
def test_wild_operators_keep_to_boxes_and_swing_with_half_of_the_messages_lost(
    name: str, latency: float, loss: float
) -> None:
    run = wild_run(name, latency, loss)
    assert keeps(run)
    assert min(np.abs(np.diff(states[:, 0])).sum() for states in run.states) > 0.2


@slow
@pytest.mark.parametrize(("seed", "hoist"), [(13, 0.3), (54, 0.6)])
def test_no_rope_swings_beyond_its_envelope_while_slow_drives_hoist_turn_and_slide(
    tmp_path: Path, seed: int, hoist: float
) -> None:
    text = (SITES / "two_towers.toml").read_text("utf-8")
    slow_drives = f"drives = {{accelerations = [1.0, 0.3, {hoist}]}}"
    file = tmp_path / "site.toml"
    file.write_text(text.replace('brakes = "converters"', slow_drives), "utf-8")
    site = read_crane_site(file)
    operators = [Wild(station, seed + 10 * i) for i, station in enumerate(site.stations)]
    run = simulate_site(site, operators, duration=80.0, channel=MessageChannel(0.1, 0.1))
    assert keeps(run)
    assert run.swing.max() > 0.5 * site.swing


@slow
def test_a_drive_that_still_goes_faster_than_commanded_is_slowed_down_more() -> None:
    site = site_of()
    rates = []
    drives = site.stations[0].crane.layout.drives
    for speed in (0.0, 0.06):
        guard = Guard(site.stations[0], site.swing)
        state = at_rest(site.stations[0])
        state.v[0, drives[0]] = speed
        guard.rates = np.array([[0.035, 0.0, 0.0]])
        guard.box = state.q[:, None, drives] + [[[-0.5, -1.0, -1.0], [0.05, 1.0, 1.0]]]
        guard._granted = guard.box
        rates.append(guard.step(0.0, state, np.array([[0.06, 0.0, 0.0]]))[0][0, 0])
    assert 0.0 < rates[1] < 0.9 * rates[0]


@slow
def test_cranes_that_hear_nothing_stay_in_their_first_box() -> None:
    run = wild_run("two_towers", 0.0, 1.0)
    assert keeps(run)
    for station, states in zip(run.site.stations, run.states, strict=True):
        position = states[:, station.crane.layout.drives]
        assert (np.ptp(position, axis=0) <= 2.0 * station.brakes.tolerances).all()


@slow
def test_without_a_supervisor_crossing_jibs_touch() -> None:
    site = site_of()
    rates = [np.array([0.05, 0.0, 0.0]), np.array([-0.05, 0.0, 0.0])]
    operators = [lambda t, states, rate=rate: rate for rate in rates]
    contacts = simulate_site(site, operators, duration=90.0, supervised=False).contacts
    assert not simulate_site(site, operators, duration=contacts[0].t + 5.0).contacts


@slow
@pytest.mark.parametrize("proven", [True, False])
def test_copies_of_a_site_run_as_alone_and_touch_where_nothing_is_proven(
    proven: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not proven:
        monkeypatch.setattr(CraneSite, "apart", lambda *_: np.ones((*_[2].shape[:-2], 2), bool))
    site = site_of()
    signs = np.array([[1.0, -1.0], [-1.0, -1.0], [1.0, 0.5]])
    duration = 60.0
    shares = np.array([0.9, 0.1, 0.0])
    operators = [lambda t, states, sign=x: sign[:, None] * shares * full for x in signs.T]
    full = site.stations[0].converters.rates
    channel = MessageChannel(0.2, 0.0)
    together = simulate_copies(site, operators, copies=3, duration=duration, channel=channel)
    assert together.contacts.any() != proven
    for copy, pair in enumerate(signs):
        mine = [lambda t, states, sign=sign: sign * shares * full for sign in pair]
        alone = simulate_site(site, mine, duration=duration, channel=channel)
        numbers = [alone.least_distance, alone.swing.max(), alone.outside.max()]
        assert np.allclose([x[copy] for x in together[1:]], numbers, rtol=0.0, atol=1e-9)
        assert together.contacts[copy] == len(alone.contacts)


@slow
def test_a_grant_for_an_older_request_is_ignored_and_a_fault_brakes() -> None:
    site = site_of()
    guard = Guard(site.stations[0], site.swing)
    supervisor = Supervisor(site, [Guard(station, site.swing).box for station in site.stations])
    state = at_rest(site.stations[0])
    rate = site.stations[0].converters.rates[None]
    _, first = guard.step(0.0, state, rate)
    late = supervisor.receive(0, first)
    _, second = guard.step(1.0, state, -rate)
    assert second.number == [2] and len(late.copies)
    guard.receive(late)
    _, third = guard.step(1.1, state, -rate)
    assert not len(third.copies) and (guard.box == second.held).all()  # it still waits
    assert not len(supervisor.receive(0, first).copies)
    outside = second.held + np.array([[-1.0], [1.0]])
    assert not len(supervisor.receive(0, asking(9, outside, outside)).copies)
    broken = State(np.full_like(state.q, np.nan), state.v)
    guard.rates = 0.1 * rate
    rates, request = guard.step(1.2, broken, rate)
    assert guard.fault.all() and not len(request.copies) and (np.abs(rates) < 0.1 * rate).all()


@slow
def test_of_cranes_that_wait_for_each_other_one_withdraws_to_where_the_other_can_pass() -> None:
    site = site_of()
    rates = [np.array([0.05, 0.0, 0.0]), np.array([-0.05, 0.0, 0.0])]
    operators = [lambda t, states, rate=rate: rate for rate in rates]
    run = simulate_site(site, operators, duration=90.0)
    assert keeps(run) and run.deadlocks
    q = [states[round(run.deadlocks[0].t / 0.1), [0, 1, 4]] for states in run.states]
    slack = [station.brakes.tolerances for station in site.stations]
    boxes = [np.array([[x - y, x + y]]) for x, y in zip(q, slack, strict=True)]
    ahead = [np.array([[0.0] * 3, [1.0, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0], [0.0] * 3])]
    supervisor = Supervisor(site, boxes)
    targets = [None, None]
    for number in range(1, 99):
        for i in (0, 1):
            held = supervisor.boxes[i]
            box = np.stack([np.maximum(held, boxes[i])[:, 0], np.minimum(held, boxes[i])[:, 1]], 1)
            wanted = box if supervisor.passing[0, i] >= 0 else box + ahead[i]  # it cannot leave
            grant = supervisor.receive(i, asking(number, box, wanted))
            assert len(grant.copies)
            if np.isfinite(grant.target).all() and targets[i] is None:
                way = 0.4 if targets[1 - i] is not None else 1.0
                targets[i] = grant.target
                there = np.stack([grant.target - slack[i], grant.target + slack[i]], axis=1)
                others = [box + way * more for box, more in zip(boxes, ahead, strict=True)]
                assert way < 1.0 or not site.apart(i, box, others).all()
                assert site.apart(i, there, others).all()
    assert targets[0] is not None and targets[1] is not None


@slow
def test_boxes_of_cranes_a_centimetre_beyond_the_required_distance_are_proven() -> None:
    site = site_of("luffing_between")  # a rope beside the jib of the higher crane
    rope = np.array([[0.5142, 0.6169, 45.7117], [0.5183, 0.6209, 45.9768]])
    jib = np.array([[1.9584, 31.5445, 4.3499], [2.0474, 31.6445, 4.4500]])
    nearest = [box[[1, 0, 0], range(3)] for box in (rope, jib)]
    assert coal_distance(site, [1, 2], nearest) < site.distance + 0.01
    assert site.pair_apart(1, rope, 2, jib)


@slow
@pytest.mark.parametrize("name", [*EXAMPLES, "two_bridges"])
def test_a_crane_is_apart_from_all_others_at_once_as_from_each_alone(name: str) -> None:
    site = site_of(name)
    rng = np.random.default_rng(4)
    answers = []
    for _ in range(100):
        boxes = []
        for station in site.stations:
            low = draw(station, rng)
            boxes.append(np.array([low, low + rng.uniform(0.0, 0.3, low.shape)])[None])
        # Of a pair the first crane is the first of the proof in both.
        together = site.apart(0, boxes[0], boxes)[0, 1:]
        others = range(1, len(boxes))
        alone = [site.pair_apart(0, boxes[0], other, boxes[other])[0] for other in others]
        assert together.tolist() == alone
        answers += alone
    assert {*answers} == {True, False}


@slow
def test_a_guard_counts_that_a_plumb_rope_swings_to_twice_what_turning_inclines_it_by() -> None:
    station = site_of().stations[0]
    swing = 0.08
    radius = 48.0
    crane = station.crane
    drives = station.crane.layout.drives
    turning = station.converters.rates * [1.0, 0.0, 0.0]
    inclined = turning[0] ** 2 * radius / crane.gravity
    assert swing < 2.0 * inclined < 1.1 * swing
    for angle in (0.0, inclined):
        guard = Guard(station, swing)
        state = at_rest(station)
        state.q[:, drives[1]] = radius
        state.v[:, drives] = turning
        guard.rates = turning[None]
        state.q[:, crane.swings[0]] -= angle
        guard.box = guard._granted = np.array([[[-9.0, 2.0, 3.4], [9.0, 50.0, 38.0]]])
        rates, _ = guard.step(0.0, state, station.converters.rates[None])
        assert (rates[0, 1] > 0.01) == (angle > 0.0)


@slow
def test_of_cranes_in_two_circles_at_the_required_distance_one_of_each_withdraws() -> None:
    site = site_of("four_towers")  # as operators brought them there after four hours
    supervisor = Supervisor(site, [Guard(station, site.swing).box for station in site.stations])
    position = (
        [2.35, 26.72, 15.52],
        [-1.24, 49.32, 41.56],
        [-2.13, 56.75, 55.94],
        [2.4, 40.17, 64.29],
    )
    ahead = [-0.1, 0.003, -2.5], [-0.1, 0.001, -2.5], [-0.02, 0.0, 0.0], [-0.007, 0.7, 2.5]
    supervisor.boxes = [np.array([[q, q + np.array([0.004, 0.1, 0.1])]]) for q in position]
    for number, (i, box) in itertools.product(range(1, 300), enumerate(supervisor.boxes)):
        wanted = box + np.array([np.minimum(ahead[i], 0.0), np.maximum(ahead[i], 0.0)])
        wanted = np.clip(wanted, *site.stations[i].ranges)
        supervisor.receive(i, asking(number, box, wanted))
    assert {*np.flatnonzero(supervisor.passing[0] >= 0)} == {2, 3}


@slow
def test_a_crane_has_the_right_of_way_that_has_waited_longer() -> None:
    site = site_of("four_towers")
    rng = np.random.default_rng(3)
    supervisor = Supervisor(site, [Guard(station, site.swing).box for station in site.stations])
    wide = supervisor.boxes[0] + np.array([[-2.6, 0.0, 0.0], [0.0] * 3])
    grant = supervisor.receive(0, asking(1, supervisor.boxes[0], wide))
    assert grant.blocked_by.tolist() == [[False, False, False, True]]
    held = supervisor.boxes[3]
    while True:
        wanted = held + rng.uniform(0.0, [2.0, 10.0, 45.0]) * [[-1.0], [1.0]]
        wanted = np.clip(wanted, *site.stations[3].ranges)
        beside = [wide, *supervisor.boxes[1:]]
        free = site.apart(3, wanted, supervisor.boxes)
        if free.all() and not site.apart(3, wanted, beside)[0, 0]:
            break
    grant = supervisor.receive(3, asking(1, held, wanted))
    assert grant.blocked_by.tolist() == [[True, False, False, False]]
    assert not (grant.box == wanted).all()


@slow
def test_boxes_that_overlap_at_the_start_are_refused() -> None:
    site = site_of()
    boxes = [np.add(Guard(station, site.swing).box, [[-4.0], [4.0]]) for station in site.stations]
    with pytest.raises(DataError, match="At the start"):
        Supervisor(site, boxes)
    with pytest.raises(DataError, match="1 boxes are given for 2 cranes"):
        Supervisor(site, boxes[:1])


@slow
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "south"', 'name = "north"', r"line \d+, \[crane\] name: 2 cranes or pairs"),
        ('name = "south"', 'name = "obstacles"', r"\[crane\] name: .* called north_obstacles"),
        ("[0.0, -55.0, 0.0]", "[1.0, 1.0, 0.0]", r"line \d+, \[crane\] position: The towers of"),
        ("[0.0, -55.0, 0.0]", "[1e20, 1.0, 0.0]", r"line \d+, \[crane\] position: .* -1e7 to 1e7"),
        ("heading = 90.0", 'heading = "up"', r"line \d+, \[crane\] heading"),
        ('brakes = "converters"', 'brakes = "none"', r"line \d+, \[crane\] brakes"),
        ("distance = 1.0", "distance = -1.0", r"line \d+, \[site\] distance"),
        ("swing = 6.0", "swing = 0.0", r"line \d+, \[site\] swing: .* allowed is 0.1 to 28"),
        ('brakes = "converters"', "reaction = 0.5", r"line \d+, \[crane\] reaction: .* >= 0.52"),
        ("hoist_init", "hook_mass = 9.0, hoist_init", r"line \d+, \[crane\] values: A crane on a"),
    ],
)  # fmt: skip
def test_a_bad_site_is_refused_with_line_and_field(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    text = (SITES / "two_towers.toml").read_text("utf-8")
    assert old in text
    file = tmp_path / "site.toml"
    file.write_text(text.replace(old, new), "utf-8")
    with pytest.raises(DataError, match=words):
        read_crane_site(file)


@slow
def test_a_crane_alone_on_a_site_is_worked_and_attacked_like_any_other(tmp_path: Path) -> None:
    file = tmp_path / "site.toml"
    file.write_text('[[crane]]\nname = "a"\n', "utf-8")
    alone = read_crane_site(file)
    low, high = reach(alone, 0)
    assert (low[0], high[0]) == (-np.pi, np.pi)
    run = simulate_site(alone, [LiftOperator(alone, 0, 1)], duration=5.0)
    assert not run.contacts and np.ptp(run.trajectories[0].q[:, 4]) > 0.1  # it hoists first
    for attack in attacks_on(alone, 360.0, [1]):
        assert attack.contacts == 0 and attack.outside < 0.0


@slow
def test_a_zone_in_which_no_place_lies_is_refused_and_not_searched_for_ever() -> None:
    crane_site = site_of()
    box = np.array([[-1.0, 10.0, 3.4], [1.0, 40.0, 20.0]])
    words = "No place of a lift of north lies in its zone: there l is from 3.4 to 20 m, and places"
    with pytest.raises(CraneError, match=words):
        LiftOperator(crane_site, 0, 1, box)
    box[1, 2] = 38.0
    assert LiftOperator(crane_site, 0, 1, box).zone is box


def test_no_brake_is_stronger_than_the_ramp_of_its_drive() -> None:
    """Guards that counted on more would let the drives leave their boxes."""
    station = site_of().stations[0]
    brake = station.brakes
    strong = replace(brake, decelerations=brake.decelerations * [1.0, 1.2, 1.0])
    words = "deceleration of the brake of x of north is 0.6839 m/s²; allowed is up to 0.6332"
    with pytest.raises(OutOfRange, match=words):
        replace(station, brakes=strong)
    ramps = replace(brake, decelerations=station.converters.accelerations)
    assert replace(station, brakes=ramps).brakes is ramps


def wall_crane(folder: Path, old: str, new: str) -> Crane:
    text = Path("examples/wall_crane.urdf").read_text("utf-8")
    (folder / "own.urdf").write_text(text.replace(old, new), "utf-8")
    return load_crane(folder / "own.urdf", driven=["bracket", "carriage", "winch"])


def test_the_jib_of_an_own_urdf_points_along_its_heading(tmp_path: Path) -> None:
    for axis in ("0 -1 0", "1 0 0", "-0.6 0.8 0"):
        crane = wall_crane(tmp_path, "0 -1 0", axis)
        station = Station("own", crane, np.ones(3), 0.5, converters(crane), brakes(crane))
        way = station.rope(crane.start.q[None])[0][0, :2] - 1.0
        assert np.allclose(way, 3.2 * np.array([np.cos(0.5), np.sin(0.5)]), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<axis xyz="0 0 -1"/>', '<origin xyz="0 0 -1"/><axis xyz="0 0 -1"/>', "one origin"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 1"/>', "lower from 0"),
        ('<link name="gimbal"/>', '<link name="gimbal"><collision><geometry><mesh '
         'filename="x.stl"/></geometry></collision></link>', "shows a mesh"),
    ],
)  # fmt: skip
def test_an_own_urdf_whose_rope_or_shapes_no_capsule_would_cover_is_refused(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    with pytest.raises(ModelError, match=words):
        crane_bodies(wall_crane(tmp_path, old, new), np.zeros(3), 0.0)
