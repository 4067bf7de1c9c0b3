"""Landings on a deck that moves: closed forms, and the contact of a simulated load."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cranedyn.controllers import follow
from cranedyn.controllers.landing import landing_reference, least_impact_landing
from cranedyn.controllers.moving_base import heave_compensated
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.contact import ON_GROUND, Ground, box_corners, box_load, damping_ratio
from cranedyn.dynamics.equations_of_motion import point_positions
from cranedyn.errors import OutOfRange
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate
from tests.helpers import G

HEAVE = 0.3
PERIOD = 6.0
OMEGA = 2.0 * math.pi / PERIOD
DECK = BaseMotion.sines(heave=(HEAVE, PERIOD))
LOWERING = 0.4
SIDES = (1.5, 3.0, 1.2)


def test_a_load_lands_softest_where_the_deck_falls_fastest() -> None:
    """While it is lowered faster than the deck ever moves, it can land at any phase: at v - a ω at
    the least, and at v + a ω at the most.
    """
    window = {"height": 2.0, "lowering": LOWERING, "earliest": 0.0, "latest": 2.0 * PERIOD}
    soft = least_impact_landing(DECK, (0.0, -12.0, 0.0), **window)
    # Beginnings are 0.01 s apart, which is 0.0105 rad of the phase: its square over two counts.
    assert soft.speed == pytest.approx(LOWERING - HEAVE * OMEGA, abs=1e-4)
    assert soft.worst_speed == pytest.approx(LOWERING + HEAVE * OMEGA, abs=1e-4)
    assert math.cos(OMEGA * soft.contact) == pytest.approx(-1.0, abs=1e-3)
    fall = soft.lowering * (soft.contact - soft.begin)
    assert fall == pytest.approx(2.0 - HEAVE * math.sin(OMEGA * soft.contact), abs=1e-4)
    assert soft.impulse(1000.0, 0.5) == pytest.approx(1500.0 * soft.speed)
    # Half a second early or late costs speed, and less where that is planned for.
    robust = least_impact_landing(DECK, (0.0, -12.0, 0.0), tolerance=0.5, **window)
    assert soft.speed <= robust.speed <= robust.speed_within_tolerance < soft.worst_speed


def test_a_deck_that_rolls_meets_a_load_at_its_side() -> None:
    roll = BaseMotion.sines(roll=(0.05, PERIOD))
    window = {"height": 2.0, "lowering": 0.8, "earliest": 0.0, "latest": PERIOD}
    landing = least_impact_landing(roll, (0.0, 10.0, 0.0), **window)
    assert landing.speed == pytest.approx(0.8 - 10.0 * 0.05 * OMEGA, rel=2e-3)
    amid = least_impact_landing(roll, (0.0, 0.0, 0.0), **window)
    assert amid.speed == pytest.approx(0.8, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"height": 0.2}, "height of the load over the deck is 0.2 m; allowed is more than 0.2"),
        ({"lowering": 0.0}, "lowering speed is 0.0 m/s; allowed is > 0"),
        ({"latest": -1.0}, "latest beginning is -1.0 s; allowed is >= 0"),
        ({"tolerance": -1.0}, "tolerance of the beginning is -1.0 s"),
    ],
)
def test_what_is_no_landing_is_refused(changes: dict[str, float], sentence: str) -> None:
    window = {"height": 2.0, "lowering": LOWERING, "earliest": 0.0, "latest": PERIOD}
    with pytest.raises(OutOfRange, match=sentence):
        least_impact_landing(DECK, (0.0, 0.0, 0.0), **(window | changes))
    table = BaseMotion.from_table(np.arange(8.0), heave=0.1 * np.sin(np.arange(8.0)))
    with pytest.raises(OutOfRange, match="for which a table of 8 rows is given"):
        least_impact_landing(table, (0.0, 0.0, 0.0), **window)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["softest", "hardest"])
def test_a_simulated_load_lands_at_that_speed_and_rebounds_as_a_load_on_a_spring(kind: str) -> None:
    restitution = 0.6
    crane = load_crane(**box_load(1000.0, *SIDES), rope_stiffness=math.inf)
    start = crane.state(x=12.0, l=10.0)
    place = point_positions(crane, start.q)[0]
    bottom = place[2] - SIDES[2] / 2.0
    ground = Ground(box_corners(*SIDES), height=bottom - 1.0, restitution=restitution, sink=5e-4)
    window = {"height": 1.0, "lowering": LOWERING, "earliest": 0.0, "latest": PERIOD}
    landing = least_impact_landing(DECK, place, **window)
    if kind == "hardest":
        # A landing half a period later meets the deck where it rises fastest.
        late = [
            least_impact_landing(DECK, place, **(window | {"earliest": t, "latest": t}))
            for t in np.arange(0.0, PERIOD, 0.05)
        ]
        landing = max(late, key=lambda one: one.speed)
    reference = landing_reference(
        crane, heave_compensated(crane, hold(crane, start), DECK), landing
    )
    setpoint = reference(0.0)
    v = start.v.copy()
    v[crane.layout.drives] = setpoint.velocity
    run = simulate(
        crane,
        follow(crane, reference, 1e-3),
        reference,
        start=start._replace(v=v),
        duration=landing.contact + 0.05,
        control_period=1e-3,
        dt=1e-4,
        drive="motion",
        base=DECK,
        ground=ground,
        validity="mark",
    )
    first = int(np.argmax(run.phase == ON_GROUND))
    # Rows are 1 ms apart; and where lowering begins, the hoist takes a control period of 1 ms to
    # its rate, in which the load lags behind by half of v times 1 ms.
    lag = 0.5 * LOWERING * 1e-3
    assert run.t[first] == pytest.approx(landing.contact, abs=1.1e-3 + lag / landing.speed)
    # Relative to the deck the load falls at the rate of its rope, and of the slack.
    symbols = crane.layout.symbols
    stretch = crane.springs.rope.stretch
    rates = -(run.v[:, symbols.index("l")] + run.v[:, stretch])
    assert -rates[first - 2] == pytest.approx(landing.speed, abs=2e-3)

    # A load on a spring with a damper that only pushes, on a deck that moves.
    k = G / 5e-4
    c = 2.0 * damping_ratio(restitution) * math.sqrt(k)

    def on_deck(t: float, y: np.ndarray) -> list[float]:
        depth, rate = y
        push = max(k * depth + c * rate, 0.0) if depth > 0.0 else 0.0
        deck = DECK.at(np.array([landing.contact + t])).acceleration[0, 2]
        return [rate, G + deck - push]

    fall = solve_ivp(on_deck, (0.0, 0.045), [0.0, landing.speed], max_step=1e-5)
    after = run.t > landing.contact
    # Semi-implicit substeps of the contact, and rows of 1 ms.
    rebound = rates[after].max()
    assert rebound == pytest.approx(-fall.y[1].min(), abs=0.03 * landing.speed + 2e-3)
    if kind == "hardest":
        # Of the impulse by the closed form, the weight takes its share within the contact.
        impulse = 1000.0 * (landing.speed + rebound)
        assert impulse == pytest.approx(landing.impulse(1000.0, restitution), rel=0.1)
