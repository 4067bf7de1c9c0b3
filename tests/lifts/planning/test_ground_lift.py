"""Lifts from the ground to the ground."""

from __future__ import annotations

import copy
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.errors import OutOfRange
from cranedyn.model.layout import ROLES
from cranedyn.model.load import load_crane

pytest.importorskip("coal", reason="extra planning (coal) is not installed")
pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.lifts.planning import ground_lift
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.coverage import Pairs, hanging_pairs
from cranedyn.lifts.planning.ground_lift import GroundLift, certify_ground_lift, from_ground
from cranedyn.lifts.planning.lift import Lift, NoWay, plan_lift
from cranedyn.lifts.planning.motion_proof import SlewRange
from cranedyn.lifts.planning.site_file import SITES, read_site
from cranedyn.lifts.planning.solids import body, box
from cranedyn.references.flat import smoothstep
from cranedyn.verdict import Check, Verdict
from tests.helpers import pickled

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def planned() -> Lift:
    yard = read_site(SITES / "open_yard.toml")
    yard = replace(yard, crane={**yard.crane, "hoist_max": 30.0})
    assert yard.limits is not None
    obstacles = (
        box("pad", (9.0, -13.0), (4.0, 4.0, 1.5), -1.0),
        box("roof", (0, 9), (9, 9, 1), 9.0),
        box("plinth of the crane", (0, 0), (3, 3, 1), -1.0),
    )
    ends = {"start": np.array([4.0, -15.0]), "goal": np.array([9.0, -13.0])}
    return plan_lift(replace(yard, solids=obstacles, ground=-1.0, **ends), yard.limits)


@pytest.fixture(scope="module")
def lift(planned: Lift) -> GroundLift:
    return from_ground(planned, creep=0.2, sink_rate=0.2)


@pytest.fixture(scope="module")
def certified(lift: GroundLift) -> tuple[Trajectory, list[Check]]:
    return certify_ground_lift(lift)


def test_a_load_is_lifted_off_the_ground_moved_and_set_down_on_an_obstacle(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]]
) -> None:
    run, checks = certified
    assert [check.sentence for check in checks if not check.holds] == []
    changes = np.flatnonzero(np.diff(run.phase)) + 1
    assert run.phase[[0, *changes]].tolist() == [2.0, 0.0, 2.0]
    assert (run.valid == 1.0).all()
    heights = [payload_position(lift.crane, run.q[row])[2] for row in (0, -1)]
    half = 0.6
    sink = lift.ground.sink
    assert heights == pytest.approx([half - 1.0 - sink, half + 0.5 - sink], abs=1e-4)
    assert len(lift.ground.platforms) == 1  # the roof is far away
    pulls = [
        float(x) for x in re.findall(r"[\d.]+(?= (?:of the weight|by closed))", checks[0].sentence)
    ]
    assert 1.0 < pulls[0] < pulls[1] < 1.0 + 2.0 * (pulls[0] - 1.0)


@pytest.mark.parametrize("where", ["beside the start", "beside the goal", "in the load"])
def test_a_post_that_no_measured_row_meets_is_found_between_the_rows_and_in_the_load_itself(
    lift: GroundLift,
    certified: tuple[Trajectory, list[Check]],
    monkeypatch: pytest.MonkeyPatch,
    where: str,
) -> None:
    planned = lift.lift
    run, _ = certified
    (x, y, _), (u, w, _) = planned.clearance.point(planned.ends)
    post = {
        "beside the start": box(where, (x + 1.5, y), (0.4, 0.4, 1.5), -1.0),
        "beside the goal": box(where, (u, w + 1.8), (0.2, 0.2, 3.0), -1.0),
        "in the load": box(where, (x, y), (0.4, 0.4, 0.03), -1.0),
    }[where]
    site = planned.clearance.site
    solids = tuple(solid for solid in site.solids if solid.name != "roof")
    crowded = clearance_of(planned.crane, replace(site, solids=(*solids, post)))
    monkeypatch.setattr(ground_lift, "simulate", lambda *_, **__: run)
    monkeypatch.setattr(
        Clearance, "nearest_row", lambda _, q: int(np.argmin(q[:, 4]))
    )  # the highest
    _, checks = certify_ground_lift(replace(lift, lift=replace(planned, clearance=crowded)))
    distances = next(check for check in checks if "Above its supports" in check.sentence)
    assert distances.verdict is Verdict.FAILS and "not proven at t = " in distances.sentence


def test_a_load_that_sinks_into_its_support_has_no_certificate(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is set down on the pad as it was, and in one row it is 2 cm lower than it stands."""
    run, checks = certified
    q = run.q.copy()
    assert lift.crane.springs.rope is not None
    q[-100, lift.crane.springs.rope.stretch] += 0.02
    monkeypatch.setattr(ground_lift, "simulate", lambda *_, **__: replace(run, q=q))
    for certificate, verdict in (
        (checks, Verdict.HOLDS),
        (certify_ground_lift(lift)[1], Verdict.FAILS),
    ):
        contact = next(check for check in certificate if "stays on what it stands" in str(check))
        assert contact.verdict is verdict
        assert "into ground" in contact.sentence and "into pad" in contact.sentence


def test_a_load_is_set_down_on_no_mesh_that_is_not_convex(planned: Lift) -> None:
    """A channel, open at its top, stands where the load is set down, its floor on the pad."""
    import shapely

    x, y, _ = planned.clearance.site.to_site(planned.clearance.point(planned.ends[1]))
    profile = [(-4, 0), (4, 0), (4, 2), (3, 2), (3, 0.1), (-3, 0.1), (-3, 2), (-4, 2)]
    channel = trimesh.creation.extrude_polygon(shapely.Polygon(profile), 6.0)
    upright = trimesh.transformations.rotation_matrix(np.pi / 2.0, [1, 0, 0])
    channel.apply_transform(upright)
    channel.apply_translation([x, y + 3.0, 0.5])
    obstacle = body("channel", np.array(channel.vertices), np.array(channel.faces))
    assert not obstacle.parts
    site = planned.clearance.site
    solids = (*site.solids, obstacle)
    crowded = clearance_of(planned.crane, replace(site, solids=solids))
    with pytest.raises(NoWay, match="At the goal the load would stand on or in channel, a mesh"):
        from_ground(replace(planned, clearance=crowded))
    from_ground(replace(planned, clearance=crowded), stands=(True, False))


def test_a_load_that_stands_is_a_box(planned: Lift) -> None:
    """A cone on its tip would stand on the corners of its box."""
    cone = np.array([[1.0, 0, 0.6], [0, 1.5, 0.6], [-1.0, 0, 0.6], [0, -1.5, 0.6], [0, 0, -0.6]])
    site = replace(planned.clearance.site, load=cone)
    with pytest.raises(NoWay, match="must be an upright box; this one fills 17 % of its box"):
        from_ground(replace(planned, clearance=clearance_of(planned.crane, site)))


def test_a_jib_that_leaves_the_angles_that_are_free_and_a_pair_left_out_are_told(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]], monkeypatch: pytest.MonkeyPatch
) -> None:
    run, checks = certified
    assert all(check.holds for check in checks)
    monkeypatch.setattr(ground_lift, "simulate", lambda *_, **__: run)
    slew = run.q[:, lift.motion.drives[0]]
    narrow = SlewRange(float(slew.min()) + 1e-3, float(slew.max()), "", "")
    (sentence,) = red(certify_ground_lift(replace(lift, lift=replace(lift.lift, slews=narrow))))
    assert sentence == "Slewing: the jib leaves the angles that are proven free."

    def in_motion_none(clearance: Clearance) -> Pairs:
        return hanging_pairs(clearance) if clearance.contacts else frozenset()

    monkeypatch.setattr(ground_lift, "hanging_pairs", in_motion_none)
    (sentence,) = red(certify_ground_lift(lift))
    assert sentence.startswith("No proof compares hook and own base, hook and own mast")


def test_a_rope_that_is_too_short_for_the_ground_has_no_certificate(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pivot is 29 m above the ground: on 26.4 m a load of 1.2 m hangs in the air."""
    run, _ = certified
    monkeypatch.setattr(ground_lift, "simulate", lambda *_, **__: run)
    short = load_crane(values={**lift.lift.clearance.site.crane, "hoist_max": 26.4})
    planned = replace(lift.lift, clearance=clearance_of(short, lift.lift.clearance.site))
    (sentence,) = red(certify_ground_lift(replace(lift, lift=planned)))
    assert re.fullmatch(r"The cable is 28\.\d+ m long at most, of 26.40 m; .*", sentence)


def red(certificate: tuple[Trajectory, list[Check]]) -> list[str]:
    return [check.sentence for check in certificate[1] if not check.holds]


def test_a_load_that_turns_in_its_sling_is_where_no_proof_was(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]], monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _ = certified
    turned = run.q.copy()
    row = round(lift.phases["motion"] / lift.motion.period)
    turned[row, lift.crane.layout.index("sling_radial")] += 0.5
    monkeypatch.setattr(ground_lift, "simulate", lambda *_, **__: replace(run, q=turned))
    assert "not proven" in str(certify_ground_lift(lift)[1])


def certified_as(
    lift: GroundLift, run: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> dict[str, Check]:
    """The checks of a run that was not simulated, by their first words."""
    monkeypatch.setattr(ground_lift, "simulate", lambda *_, **__: run)
    _, checks = certify_ground_lift(lift)
    return {check.sentence.partition(":")[0]: check for check in checks}


def test_a_load_that_swings_in_its_motion_has_no_certificate(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]], monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _ = certified
    layout = lift.crane.layout
    allowed = lift.lift.clearance.site.swing
    row = round(lift.phases["motion"] / lift.motion.period) + 500
    for swing, holds in ((0.8 * allowed, True), (1.2 * allowed, False)):
        q = run.q.copy()
        q[row, layout.at("phi", "theta", "sling_radial", "sling_tangential")] = swing, 0, 0, 0
        checks = certified_as(lift, replace(run, q=q), monkeypatch)
        assert checks["Motion"].holds is holds, checks["Motion"].sentence


def test_a_load_is_set_down_at_the_speed_of_the_rope_that_first_slackens_and_leaves_it_slack(
    lift: GroundLift, certified: tuple[Trajectory, list[Check]], monkeypatch: pytest.MonkeyPatch
) -> None:
    run, checks = certified
    weight = lift.crane.payload_mass * lift.crane.gravity
    tension = JointForces.of(lift.crane).tension(run.q.T, run.v.T)
    down = round(lift.phases["set-down"] / lift.motion.period)
    touched = next(row for row in range(down, len(run)) if tension[row] < 0.9 * weight)
    hoist = lift.crane.layout.index("l")
    assert 0.05 < run.v[touched, hoist] <= 0.2  # the sink rate of this lift
    assert f"touches at {run.v[touched, hoist]:.3f} m/s" in checks[-1].sentence
    fast = run.v.copy()
    tight = run.q.copy()
    fast[touched, hoist] = 0.25
    tight[-1, lift.crane.layout.index("rope_stretch")] = 1e-4
    for changed in (replace(run, v=fast), replace(run, q=tight)):
        assert not certified_as(lift, changed, monkeypatch)["Set-down"].holds


def test_a_crane_of_a_strange_urdf_lifts_off_as_the_crane_of_this_project_does(
    planned: Lift, lift: GroundLift, tmp_path: Path
) -> None:
    text = planned.crane.urdf
    for word in ("yaw_joint", "hoist_joint", "hook_link"):
        text = text.replace(f'"{word}"', f'"strange_{word}"')
    hoist = '<axis xyz="0 0 -1"/>'
    assert text.count(hoist) == 1  # the hook is turned by a quarter
    text = text.replace(hoist, f'<origin rpy="0 0 {np.pi / 2}"/>{hoist}')
    (tmp_path / "strange.urdf").write_text(text)
    strange = {"slew": "strange_yaw_joint", "hoist": "strange_hoist_joint"}
    crane = load_crane(
        tmp_path / "strange.urdf",
        joints={role: strange.get(role, part.joint) for role, part in ROLES.items()},
    )
    clearance = clearance_of(crane, planned.clearance.site)
    own = lift.crane
    crane = from_ground(replace(planned, clearance=clearance)).crane
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-0.3, 0.3, (3, own.layout.n))
    efforts = [pin.rnea(one.model, one.data, q, v, a) for one in (crane, own)]
    assert efforts[0] == pytest.approx(efforts[1], rel=1e-9, abs=1e-6)  # N m of 1e6
    assert crane.model.armature == pytest.approx(own.model.armature)


@pytest.mark.long
@pytest.mark.parametrize("stands", [(True, False), (False, True)])
def test_a_lift_stands_at_one_end_and_hangs_at_the_other(
    planned: Lift, stands: tuple[bool, bool]
) -> None:
    lift = from_ground(planned, creep=0.2, sink_rate=0.2, stands=stands)
    run, checks = certify_ground_lift(lift)
    assert [check.sentence for check in checks if not check.holds] == []
    assert len(checks) == 9 and [run.phase[0] == 2.0, run.phase[-1] == 2.0] == list(stands)


@pytest.mark.long
def test_a_load_that_is_lifted_off_lead_and_set_down_beside_its_goal_has_no_certificate(
    lift: GroundLift,
) -> None:
    motion = lift.motion
    q = motion.q.copy()
    q[:, motion.drives[1]] += 0.7 * smoothstep(np.arange(len(q)) * motion.period / 4.0)
    aside = replace(motion, q=q)
    leaning = replace(lift, motion=aside, controller=lqr(lift.lift.crane, aside))
    _, checks = certify_ground_lift(leaning)
    assert not checks[0].holds and "without a bound" in checks[0].sentence
    assert not checks[-1].holds and "mm from its goal" in checks[-1].sentence


def test_falls_of_the_site_carry_the_load_together(planned: Lift) -> None:
    """Two falls are half as elastic as one, so that a load that is lifted off pulls more."""

    def stiffness(lift: Lift, **given: int) -> float:
        rope = from_ground(lift, rope_stiffness=1e7, **given).crane.springs.rope
        assert rope is not None
        return float(rope.stiffness)

    clearance = planned.clearance
    assert clearance.site.falls == 2
    assert stiffness(planned) == 2e7
    assert stiffness(planned, falls=4) == 4e7
    nobody_knows = clearance_of(planned.crane, replace(clearance.site, falls=None))
    assert stiffness(replace(planned, clearance=nobody_knows)) == 1e7
    with pytest.raises(OutOfRange, match="number of falls is 0"):
        from_ground(planned, falls=0)


def test_bad_input_is_a_sentence(planned: Lift) -> None:
    with pytest.raises(OutOfRange, match="creep speed"):
        from_ground(planned, creep=0.0)
    with pytest.raises(OutOfRange, match="sink rate"):
        from_ground(planned, sink_rate=-0.1)
    with pytest.raises(OutOfRange, match="EA of the rope"):
        from_ground(planned, rope_stiffness=0.0)


@pytest.mark.parametrize("speed", [1e-300, 1e-6, 5.0, 1e6, math.nan])
def test_speeds_near_the_ground_that_cannot_be_meant_are_refused_before_anything_is_computed(
    speed: float, planned: Lift
) -> None:
    fastest = planned.limits.rates[2]
    assert fastest < 5.0
    for name, words in (("creep", "creep speed"), ("sink_rate", "sink rate")):
        with pytest.raises(OutOfRange, match=f"{words} is {speed} m/s; allowed is ") as refused:
            from_ground(planned, **{name: speed})
        assert math.isnan(speed) or f"0.001 to {fastest:g}" in str(refused.value)


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_lifts_and_lifts_from_the_ground_are_copied_with_all_that_they_command(
    copied: Any, lift: GroundLift
) -> None:
    same = copied(lift)
    assert (same.motion.q == lift.motion.q).all() and same.phases == lift.phases
    state = lift.crane.start
    setpoint = lift.setpoint(0.0)
    command = np.array(lift.command(0.0, state, setpoint))
    assert (command == same.command(0.0, state, setpoint)).all()
    place = lift.lift.ends[0]
    assert same.lift.clearance.envelope(5.0) == lift.lift.clearance.envelope(5.0)
    assert (same.lift.clearance.point(place) == lift.lift.clearance.point(place)).all()
