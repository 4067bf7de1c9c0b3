"""MJCF means what MuJoCo says it means: masses, ranges, efforts, gravity, frequencies and motion of
random models agree with MuJoCo's, and what no crane can be is refused by name.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from cranedyn.__main__ import main
from cranedyn.data import reading_process
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.identification.prior import Prior
from cranedyn.model import mjcf
from cranedyn.model.load import load_crane
from tests.helpers import long_after
from tests.model.mjcf_models import random_model

pytest.importorskip("mujoco", reason="extra mujoco is not installed")

from tests.model.mjcf_comparison import (
    compare,
    compare_motion,
    compare_random_models,
    compare_rest,
    loaded,
)

pytestmark = pytest.mark.slow
"""Each model is compiled in a process of its own."""

CART = """<mujoco model="cart"><compiler angle="radian"/>{head}<worldbody>
<body name="cart" pos="0 0 8"><joint name="rail" type="slide" axis="1 0 0" range="-4 4"/>
<geom name="plate" type="box" size=".2 .2 .1" mass="60"/>
<body name="hook"><joint name="swing" type="hinge" axis="0 1 0" range="-1.4 1.4"/>
<geom name="ball" type="sphere" size=".1" pos="0 0 -3" mass="8"/>{below}</body></body>{beside}
</worldbody><actuator><motor name="push" joint="rail" {motor}/></actuator>{tail}</mujoco>"""


def cart(**parts: str) -> str:
    """A cart with a pendulum, with further text in some places."""
    places = dict.fromkeys(("head", "below", "beside", "motor", "tail"), "")
    return CART.format(**{**places, **parts})


@pytest.mark.parametrize("seed", long_after(3, [1, 2, 9, 0, 6, 21]))
def test_a_random_model_is_what_mujoco_compiles(tmp_path: Path, seed: int) -> None:
    crane = loaded(tmp_path, random_model(seed))
    compare(crane, tmp_path, seed)
    compare_rest(crane, tmp_path)
    assert compare_motion(crane, tmp_path)


def test_a_centre_of_mass_that_mujoco_takes_for_the_origin_of_its_body_is_taken_so_too(
    tmp_path: Path,
) -> None:
    """A hook of a gram above a load of 900 kg moves the centre by 0.6 µm, which MuJoCo's
    accelerations leave out; the two must not be compared as if it did not.
    """
    hook = '<geom name="hook" type="box" pos="0 0 .55" size=".1 .1 .15" mass=".001"/>'
    load = '<geom name="load" type="box" size=".4 .4 .4" mass="900"/>'
    joint = '<joint name="rope" type="slide" axis="0 0 -1" range="1 5"/>'
    body = f'<body name="slung">{joint}{hook}{load}</body>'
    crane = loaded(tmp_path, cart(below=body))
    compare(crane, tmp_path, seed=1)


@pytest.mark.long
def test_60_random_models_are_what_mujoco_compiles(tmp_path: Path) -> None:
    counts = compare_random_models(60, tmp_path)
    assert counts.compared == 60 and counts.moved > 50


PARTS: dict[str, tuple[dict[str, str], str]] = {
    "free body": ({"beside": "<body><freejoint/><geom size='.1'/></body>"}, "free and moves in 6"),
    "tendon": (
        {"tail": "<tendon><fixed name='r' stiffness='5'><joint joint='swing' coef='1'/>"
         "</fixed></tendon>"},
        "the tendon r exerts forces",
    ),
    "equality": (
        {"tail": "<equality><joint name='e' joint1='rail' joint2='swing'/></equality>"},
        "the equality constraint e couples",
    ),
    "actuator on a tendon": (
        {"tail": "<tendon><fixed name='r'><joint joint='swing' coef='1'/></fixed></tendon>"
         "<actuator><motor name='a' tendon='r'/></actuator>"},
        "the actuator a does not act on a joint",
    ),
    "load that stands": (
        {"beside": "<geom name='floor' type='plane' size='9 9 1' pos='0 0 4.95'/>"},
        "floor of the body world and ball of the body hook touch, and contacts are not simulated",
    ),
    "weightless": ({"beside": "<body gravcomp='1' pos='9 0 0'><joint name='z'/>"
                    "<geom size='.1'/></body>"}, "weight of the body body_3 is compensated"),
    "water": ({"head": "<option density='1000'/>"}, "medium of density 1000"),
    "damping of higher order": (
        {"below": "<body><joint name='k' damping='1 2'/><geom size='.1' pos='.2 0 0'/></body>"},
        "damping of k is not proportional to its rate",
    ),
    "spring of higher order": (
        {"below": "<body><joint name='k' stiffness='9 50'/><geom size='.1' pos='.2 0 0'/></body>"},
        "something that acts on its joints and is not read",
    ),
    "missing default": ({"motor": "class='nope'"}, "unknown default class name 'nope'"),
    "short fromto": (
        {"below": "<geom type='box' fromto='0.5' size='0.1 0.2 0.3'/>"}, "does not have enough data"
    ),
    "text for a number": ({"motor": "gear='heavy'"}, "bad format in attribute 'gear'"),
    "missing file": (
        {"head": "<asset><mesh name='m' file='m.stl'/></asset>"}, "Error opening file 'm.stl'"
    ),
    "file elsewhere": (
        {"head": "<asset><mesh name='m' file='../m.stl'/></asset>"}, "outside of its folder"
    ),
    "folder elsewhere": ({"head": "<compiler meshdir='/etc'/>"}, "names /etc, which is outside"),
    "included file elsewhere": ({"head": "<include file='../x.xml'/>"}, "outside of its folder"),
    "gear of nothing": ({"motor": "gear='0'"}, "gear of the actuator push is 0"),
}  # fmt: skip
"""What no crane is or no file may say, and the words that refuse it."""


@pytest.mark.parametrize("name", PARTS)
def test_what_no_crane_is_is_refused_by_name(tmp_path: Path, name: str) -> None:
    parts, words = PARTS[name]
    with pytest.raises(CraneError, match=words):
        loaded(tmp_path, cart(**parts))


def test_gravity_that_is_not_along_minus_z_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutOfRange, match=r"is 1 0 -9 m/s²; allowed is a vector .*; turn the model"):
        loaded(tmp_path, cart(head="<option gravity='1 0 -9'/>"))
    floating = cart(head="<option><flag gravity='disable'/></option>")
    with pytest.raises(OutOfRange, match=r"is 0\.0 m/s²; allowed is > 0; give another by gravity="):
        loaded(tmp_path, floating)
    assert loaded(tmp_path, floating, gravity=3.7).gravity == 3.7


def test_gravity_that_leans_by_round_off_is_taken(tmp_path: Path) -> None:
    crane = loaded(tmp_path, cart(head="<option gravity='1e-5 0 -9.81'/>"))
    assert crane.gravity == pytest.approx(9.81)


def test_every_child_of_the_world_counts(tmp_path: Path) -> None:
    post = "<body name='post' pos='5 0 2'><geom type='box' size='.2 .2 2' mass='900'/></body>"
    crane = loaded(tmp_path, cart(beside=post).replace("<worldbody>", f"<worldbody>{post}", 1)
                   .replace(post, post.replace("post", "first"), 1))  # fmt: skip
    assert crane.layout.symbols == ("rail", "swing")
    assert crane.payload_mass == 8.0


@pytest.mark.parametrize(
    ("motor", "effort", "note"),
    [
        ("gear='30' ctrlrange='-25 25'", 750.0, ""),
        ("gear='-2' forcerange='-40 40'", 80.0, ""),
        ("ctrlrange='-50 50' forcerange='-40 40'", 40.0, ""),
        ("ctrlrange='0 100'", 100.0, "push|rail exerts 0 to 100 N; ±100 N are taken"),
        ("", 1e6, "rail has no largest effort in the file; 1e\\+06 N are taken"),
    ],
)
def test_the_effort_of_a_drive_is_that_of_its_actuator(
    tmp_path: Path, motor: str, effort: float, note: str
) -> None:
    crane = loaded(tmp_path, cart(motor=motor))
    assert crane.effort_limit.tolist() == [effort]
    assert bool(note) == any(re.search(note, text) for text in crane.assumptions if note)


def test_a_range_of_actuator_forces_on_a_joint_limits_the_sum_of_its_actuators(
    tmp_path: Path,
) -> None:
    text = cart(motor="ctrlrange='-50 50'", tail="<actuator><velocity joint='rail' kv='3' "
                "forcerange='-30 30'/></actuator>")  # fmt: skip
    crane = loaded(tmp_path, text)
    assert crane.effort_limit.tolist() == [80.0]
    assert any("moved by a servo of its own" in note for note in crane.assumptions)
    clipped = text.replace('name="rail"', 'name="rail" actuatorfrcrange="-60 60"')
    assert loaded(tmp_path, clipped).effort_limit.tolist() == [60.0]


def test_slides_keep_their_metres_where_angles_are_in_degrees(tmp_path: Path) -> None:
    text = cart().replace('<compiler angle="radian"/>', "").replace("-1.4 1.4", "-80 80")
    crane = loaded(tmp_path, text)
    assert crane.lower.tolist() == [-4.0, pytest.approx(-math.radians(80.0))]


def test_the_start_is_the_keyframe_home(tmp_path: Path) -> None:
    keys = "<keyframe><key name='far' qpos='3 0'/><key name='home' qpos='-2 0.1'/></keyframe>"
    crane = loaded(tmp_path, cart(tail=keys))
    assert crane.start.q.tolist() == [-2.0, pytest.approx(0.0, abs=1e-12)]  # the load hangs
    assert "The start is the keyframe home of the file." in crane.assumptions


def test_a_ball_joint_turns_about_two_axes(tmp_path: Path) -> None:
    ball = (
        "<body><joint name='rope' type='ball' damping='0.5'/><geom size='.1' pos='0 0 -2'/></body>"
    )
    crane = loaded(tmp_path, cart(below=ball))
    assert crane.layout.symbols == ("rail", "swing", "rope_x", "rope_y")
    assert crane.damping.tolist() == [0.0, 0.0, 0.5, 0.5]
    assert "The ball joint rope turns about X, then Y, not about Z." in crane.assumptions


def test_shapes_are_drawn_where_they_are(tmp_path: Path) -> None:
    crane = loaded(tmp_path, cart(below="<geom type='capsule' fromto='0 0 -1 0 0 -2' size='.05'/>"))
    assert crane.urdf.count("<visual>") == 1 + 1 + 3
    assert 'size="0.4 0.4 0.2"' in crane.urdf


def test_our_own_export_is_the_same_crane_again(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    assert main(["export", "mjcf", str(path)]) == 0
    again = load_crane(path)
    crane = load_crane()
    assert again.layout == crane.layout
    assert again.effort_limit.tolist() == crane.effort_limit.tolist()
    assert again.gravity == crane.gravity
    for name in ("lower", "upper", "damping"):
        assert getattr(again, name).tolist() == getattr(crane, name).tolist()
    np.testing.assert_allclose(again.start.q, crane.start.q, atol=1e-12)
    q = crane.state(phi=0.3, theta=-0.2, gamma=0.5).q
    ours, theirs = (pin.crba(c.model, c.data, q) for c in (crane, again))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-9)


def test_an_included_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "ball.xml").write_text(
        "<mujoco><asset/><worldbody><body name='in' pos='0 0 9'><joint name='far'/>"
        "<geom size='.1' pos='.5 0 0'/></body></worldbody></mujoco>",
        encoding="utf-8",
    )
    crane = loaded(tmp_path, cart(tail="<include file='ball.xml'/>"), payload="swing")
    assert "far" in crane.layout.symbols


def test_without_mujoco_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mujoco.py").write_text("raise ImportError", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(CraneError, match=r"MuJoCo is not installed: pip install 'cranedyn\[muj"):
        loaded(tmp_path, cart())


def test_a_model_that_asks_for_everything_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading_process, "CPU_TIME", 2)
    many = "<replicate count='100000000' offset='0 0 .1'><geom size='.1'/></replicate>"
    with pytest.raises(ModelError, match=r"takes more than 2 s|more than .* GB of memory"):
        loaded(tmp_path, cart(below=many))


def test_a_model_of_too_many_joints_is_refused(tmp_path: Path) -> None:
    body = "<body pos='0 0 -.1'><joint/><geom size='.01' pos='0 0 -.1'/></body>"
    with pytest.raises(ModelError, match="has 132 joints that move; allowed are 128"):
        loaded(tmp_path, cart(below=body * 130))


def test_balls_without_names_and_their_sensors_are_read(tmp_path: Path) -> None:
    ball = "<body><joint type='ball'/><geom size='.1' pos='0 0 -2'/>{}</body>"
    crane = loaded(tmp_path, cart(below=ball.format(ball.format(""))))
    assert len({*crane.layout.symbols}) == 6
    named = ball.format("").replace("<joint", "<joint name='b'")
    sensor = "<sensor><ballquat joint='b'/></sensor>"
    assert loaded(tmp_path, cart(below=named, tail=sensor)).layout.n == 4
    drive = "<actuator><motor name='turn' joint='b'/></actuator>"
    with pytest.raises(ModelError, match="actuator turn acts on the ball joint b; the drives"):
        loaded(tmp_path, cart(below=named, tail=drive))


def test_a_start_beyond_its_range_is_in_the_middle_of_it_for_contacts_too(tmp_path: Path) -> None:
    text = cart(beside="<geom name='floor' type='plane' size='9 9 1' pos='0 0 4.95'/>")
    hoist = 'type="slide" axis="0 0 1" range="1 3"'
    text = text.replace('type="slide" axis="1 0 0" range="-4 4"', hoist)
    crane = loaded(tmp_path, text)
    assert crane.start.q[0] == 2.0
    moved = "rail starts at 2, in the middle of its range, since the 0 of the file is beyond it."
    assert moved in crane.assumptions


def test_a_late_actuator_and_actuators_that_are_off_are_said(tmp_path: Path) -> None:
    late = loaded(tmp_path, cart(motor="delay='0.05' nsample='6'"))
    assert any("an actuator that acts 0.05 s late" in note for note in late.assumptions)
    off = cart(head="<option><flag actuation='disable'/></option>", motor="ctrlrange='-9 9'")
    with pytest.raises(ModelError, match=r"does not say which .* driven.*joints are rail, swing"):
        loaded(tmp_path, off)
    crane = loaded(tmp_path, off, driven=["rail"])
    assert crane.effort_limit.tolist() == [1e6]
    assert "The file switches its actuators off, so that they drive no joint." in crane.assumptions


def test_joints_that_depend_on_each_other_are_refused(tmp_path: Path) -> None:
    slides = "".join(f"<joint type='slide' axis='{axis}'/>" for axis in ("1 0 0", "0 1 0", "1 1 0"))
    text = cart(beside=f"<body pos='9 0 0'>{slides}<geom size='.1'/></body>")
    with pytest.raises(ModelError, match=r"not independent of each other|differ from MuJoCo's"):
        loaded(tmp_path, text, payload="swing")


def test_a_model_whose_joints_do_otherwise_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = mjcf._compiled

    def lighter(path: Path) -> dict[str, Any]:
        model = compiled(path)
        model["bodies"][2]["mass"] *= 1.0 + 1e-4
        return model

    monkeypatch.setattr(mjcf, "_compiled", lighter)
    with pytest.raises(ModelError, match="differ from MuJoCo's by"):
        loaded(tmp_path, cart())


def test_gravity_of_the_file_is_that_of_exports_and_of_the_identified_crane(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moon = cart(head="<option gravity='0 0 -1.62'/>", motor="ctrlrange='-9 9'")
    path = tmp_path / "crane.xml"
    path.write_text(moon, encoding="utf-8")
    assert main(["describe", "--urdf", str(path)]) == 0
    assert "in gravity of 1.62 m/s²" in capsys.readouterr().out
    assert main(["describe", "--urdf", str(path), "--gravity", "3.7"]) == 0
    assert "in gravity of 3.7 m/s²" in capsys.readouterr().out
    assert main(["export", "mjcf", str(tmp_path / "out.xml"), "--urdf", str(path)]) == 0
    assert load_crane(tmp_path / "out.xml").gravity == 1.62
    prior = Prior(path)
    assert prior.crane.gravity == prior.value("gravity") == 1.62
    assert prior.load(gravity=2.0).gravity == 2.0


def test_a_model_that_needs_no_note_becomes_a_urdf_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / "cart.xml"
    path.write_text(
        '<mujoco model="cart"><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>'
        '<body name="cart"><joint name="slide" type="slide" axis="1 0 0" limited="true" '
        'range="-5 5"/><geom type="box" size="0.5 0.5 0.5" mass="10" contype="0" conaffinity="0"/>'
        '<body name="bob"><joint name="hinge" type="hinge" axis="0 1 0" limited="true" '
        'range="-1.5 1.5" damping="0.1"/><geom type="sphere" size="0.1" pos="0 0 -2" mass="3" '
        'contype="0" conaffinity="0"/></body></body></worldbody><actuator><motor joint="slide" '
        'ctrllimited="true" ctrlrange="-100 100"/></actuator></mujoco>'
    )
    crane = load_crane(path)
    assert crane.assumptions == ()
    assert crane.urdf.startswith("<robot")
    again = tmp_path / "cart.urdf"
    again.write_text(crane.urdf)
    same = load_crane(again, driven=["slide"], gravity=9.81)
    np.testing.assert_allclose(same.mass_matrix(same.start.q), crane.mass_matrix(crane.start.q))


def test_a_fixed_body_has_a_joint_of_its_own_name_beside_any_joint_of_the_file(
    tmp_path: Path,
) -> None:
    ballast = "<body name='ballast'><geom type='sphere' size='.1' mass='5'/></body>"
    text = cart(below=ballast).replace('name="rail"', 'name="ballast_fixed"')
    path = tmp_path / "cart.xml"
    path.write_text(text.replace('joint="rail"', 'joint="ballast_fixed"'), encoding="utf-8")
    assert load_crane(path).layout.symbols == ("ballast_fixed", "swing")
