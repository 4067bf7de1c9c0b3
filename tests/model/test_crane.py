"""Loading: what is a crane, what is not, and what the numbers of it are."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.errors import CraneError, DataError, MissingRole, ModelError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import STANDARD_GRAVITY, Crane
from cranedyn.model.description import XACRO, arguments, describe
from cranedyn.model.layout import ROLES
from cranedyn.model.load import load_crane
from experiments.scenarios.crane_variants import POINT
from tests.helpers import G, crane, efforts, states, turned

Load = Callable[..., Crane]


@pytest.fixture(scope="module")
def urdf() -> str:
    return describe()


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Loads a text as a file of the user's own."""

    def load(text: str | bytes, **arguments: Any) -> Crane:
        path = tmp_path / "mine.urdf"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_crane(path, **arguments)

    return load


def refused(refusal: str) -> AbstractContextManager[object]:
    """Expect a sentence of an OutOfRange, or of a ModelError where that stands before it."""
    sentence = refusal.removeprefix("ModelError: ")
    return pytest.raises(OutOfRange if sentence == refusal else ModelError, match=sentence)


# --- what a crane knows ---------------------------------------------------------------------------


def test_the_default_crane_has_the_numbers_of_the_article() -> None:
    c = load_crane()
    assert list(c.model.names)[1:] == [role.joint for role in ROLES.values()]
    assert (c.payload_mass, c.trolley_mass, c.dummy_inertia) == (1000.0, 500.0, (100.0, 50.0))
    assert c.payload_inertia.tolist() == (400.0 * np.eye(3)).tolist()
    assert c.gravity == STANDARD_GRAVITY == 9.80665
    assert c.damping.tolist() == [0.0, 0.0, 1.0, 1.0, 0.0]
    assert c.lower[[1, 2, 4]].tolist() == [2.0, -1.5708, 3.4]
    assert c.upper[[1, 2, 4]].tolist() == [22.0, 1.5708, 26.4]
    assert c.effort_limit.tolist() == [1e6, 1e6, 1e5]


def test_arguments_reach_the_crane() -> None:
    c = crane(
        payload_mass=2000,
        payload_inertia=0,
        dummy_inertia=7,
        damp_hoist=3,
        damp_slew=4,
        hoist_init=20,
        slew_init=0.5,
        hoist_effort=9e4,
    )
    assert (c.payload_mass, c.dummy_inertia) == (2000.0, (14.0, 7.0))
    assert not c.payload_inertia.any()
    assert c.damping.tolist() == [4.0, 0.0, 1.0, 1.0, 3.0]
    assert c.effort_limit.tolist() == [1e6, 1e6, 9e4]
    assert c.start.q.tolist() == [0.5, 10.0, 0.0, 0.0, 20.0]
    assert not c.start.v.any()


NO_CRANE = r"""
gravity=0.0 => gravity is .* m/s²; allowed is .*> 0
gravity=-9.81 => gravity is .* m/s²; allowed is .*> 0
gravity=math.nan => gravity is .* m/s²; allowed is .*> 0
gravity=math.inf => gravity is .* m/s²; allowed is .*> 0
gravity="down" => gravity is down; allowed is .*> 0 .m/s²
gravity=1e308 => ModelError: masses, lengths or gravity are beyond what a number holds
trolley_min=30 => range of trolley_joint is 30 to 22 m; allowed is finite, lower below upper
hoist_init=50 => hoist_joint at the start is 50.0 m; allowed is 3.4 to 26.4
payload_mass=0 => payload_mass is 0 kg; allowed is > 0
payload_mass=5e-324 => payload mass is 5e-324 kg; allowed is 1e-15 to 1e30
payload_mass=1e-310 => payload mass is 1e-310 kg; allowed is 1e-15 to 1e30
payload_mass=1e-200 => payload mass is 1e-200 kg; allowed is 1e-15 to 1e30
payload_mass=1e-20 => payload mass is 1e-20 kg; allowed is 1e-15 to 1e30
payload_mass=1e20 => smallest eigenvalue .* allowed is > 1e-10: its masses and
payload_mass=1e200 => value of mass in link hook_link .* number up to 1e\+30
pivot_height=1e29 => ModelError: masses and lengths differ so much that accelerations lose all their
hoist_min=1e-9, hoist_init=1e-9, **POINT => ModelError: so much that accelerations lose all their
"""
"""Arguments of a crane, and the error with which they are refused."""


@pytest.mark.parametrize("row", NO_CRANE.strip().splitlines())
def test_numbers_that_make_no_crane_are_refused(row: str) -> None:
    arguments, refusal = row.split(" => ")
    with refused(refusal):
        eval(f"load_crane({arguments})", {"load_crane": load_crane, "math": math, "POINT": POINT})


@pytest.mark.slow
@pytest.mark.parametrize("value", [5e-324, 1e29])
def test_whatever_number_a_crane_has_it_accelerates_as_its_mass_matrix_says_or_is_refused(
    value: float,
) -> None:
    loaded = 0
    for name in [*arguments(), "gravity"]:
        try:
            c = load_crane(**{name: value})
        except CraneError:
            continue
        loaded += 1
        tau = dynamics.over_all_joints(c, c.effort_limit) + c.springs.effort(c.start.q)
        mass = np.triu(pin.crba(c.model, c.data, c.start.q))
        mass += np.triu(mass, 1).T
        expected = np.linalg.solve(
            mass, tau - pin.rnea(c.model, c.data, c.start.q, *np.zeros((2, c.layout.n)))
        )
        found = dynamics.acceleration(c, c.start, c.effort_limit)
        assert (
            np.abs((found - expected) * np.sqrt(mass.diagonal())).max()
            <= 1e-3 * np.abs(expected * np.sqrt(mass.diagonal())).max()
        ), name
    assert loaded > 5


# --- what is loaded, and when ---------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "values",
    [{}, {"payload_mass": 2e3, "mast_height": 40.0, "pivot_height": 43.0, "damp_swing": 0.1 + 0.2}],
)
def test_a_crane_is_built_without_its_looks_and_is_the_crane_of_its_whole_urdf(
    values: dict[str, float], load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    monkeypatch.setattr(
        "cranedyn.model.load.describe",
        lambda *given, **how: made.append(describe(*given, **how)) or made[-1],
    )
    c = load_crane(**values)
    assert [text.count("<visual>") for text in made] == [0]
    assert c.urdf == describe(values=values)
    assert c.urdf.count("<visual>") > 200
    whole = load(c.urdf)
    assert whole.model == c.model
    assert np.array_equal(whole.start, c.start)
    assert whole.urdf == c.urdf


@pytest.mark.slow
@pytest.mark.parametrize(
    ("height", "sentence"),
    [(1e40, "xyz of origin in link upper_link"), (1e200, "cannot be expanded")],
)
def test_looks_that_cannot_be_drawn_are_refused_when_they_are_asked_for(
    height: float, sentence: str
) -> None:
    c = load_crane(total_height=height)
    with pytest.raises(CraneError, match=sentence):
        c.urdf_source()


@pytest.mark.slow
def test_loading_and_running_a_crane_imports_nothing_that_only_others_need() -> None:
    program = """
import sys
from cranedyn.controllers import hold_controller
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
crane = load_crane()
simulate(crane, hold_controller(crane), duration=0.1)
heavy = ("scipy.linalg", "scipy.interpolate", "scipy.optimize", "pyarrow", "matplotlib", "rerun")
print([name for name in heavy if name in sys.modules])
"""
    command = [sys.executable, "-c", program]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "[]\n"


# --- states ---------------------------------------------------------------------------------------


def test_a_state_is_the_start_with_the_named_values_changed() -> None:
    state = crane().state(x=5, phi=-0.1, theta_dot=0.3)
    assert state.q.tolist() == [0.0, 5.0, -0.1, 0.0, 15.0]
    assert state.v.tolist() == [0.0, 0.0, 0.0, 0.3, 0.0]
    assert crane().start.q.tolist() == [0.0, 10.0, 0.0, 0.0, 15.0]


@pytest.mark.parametrize("name", ["phi", "theta"])
def test_a_start_of_ninety_degrees_is_refused_and_anything_less_is_not(name: str) -> None:
    below = math.nextafter(math.pi / 2, 0.0)
    assert crane().state(**{name: -below}).q.min() == -below
    with pytest.raises(
        OutOfRange,
        match=r"at the start is 1.5707963267948966 rad; allowed is -1.5707963267948963 to "
        r"1.5707963267948963",
    ):
        crane().state(**{name: math.pi / 2})


def test_a_limit_of_many_digits_is_a_limit_to_the_last_of_them() -> None:
    c = crane(hoist_max=26.4567501, hoist_init=26.4567501)
    assert c.start.q[4] == c.state(l=26.4567501).q[4] == 26.4567501
    with pytest.raises(
        OutOfRange, match=r"l at the start is 26.45676 m; allowed is 3.4 to 26.4567501"
    ):
        c.state(l=26.45676)


# --- a URDF of one's own --------------------------------------------------------------------------

DRIVEN = ["yaw_joint", "trolley_joint", "hoist_joint"]


def _own(frames: np.random.Generator) -> str:
    """The same crane by another hand: every frame turned at random, more links bolted on, other
    names, no xacro.
    """
    turn = np.eye(3)
    parts = ['<robot name="mine">', '<link name="ground"/>']
    parent = "ground"
    body = {
        "yaw_joint": (3000.0, 1e6, (0.0, 0.0, 25.99), (0.0, 0.0, 2.01)),
        "trolley_joint": (500.0, 50.0, (0.0, 0.0, 2.01), (0.0, 0.0, 0.0)),
        "swing_radial_joint": (50.0, 50.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        "swing_tangential_joint": (50.0, 50.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        "hoist_joint": (800.0, 400.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    }
    limits = {"yaw_joint": (-31.4, 31.4), "trolley_joint": (2, 22), "hoist_joint": (3.4, 26.4)}
    for role in ROLES.values():
        mass, inertia, at, centre = body[role.joint]
        own = pin.exp3(frames.normal(size=3))
        xyz = turn.T @ at
        rpy = pin.rpy.matrixToRpy(turn.T @ own)
        axis = own.T @ np.array(role.axis, dtype=float)
        com = own.T @ centre
        low, high = limits.get(role.joint, (-1.5, 1.5))
        texts = [
            " ".join(repr(float(number)) for number in vector) for vector in (xyz, rpy, axis, com)
        ]
        parts.append(
            f'<joint name="{role.joint}" type="{role.kind}"><parent link="{parent}"/><child '
            f'link="of_{role.joint}"/>'
            f'<origin xyz="{texts[0]}" rpy="{texts[1]}"/><axis xyz="{texts[2]}"/>'
            f'<limit lower="{low}" upper="{high}" effort="1e6" velocity="9"/></joint>'
            f'<link name="of_{role.joint}"><inertial><origin xyz="{texts[3]}"/><mass '
            f'value="{mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" '
            'iyz="0"/></inertial></link>'
        )
        parent = f"of_{role.joint}"
        turn = own
    parts.append(
        '<link name="hook_block"><inertial><mass value="200"/><inertia ixx="0" iyy="0" izz="0" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="bolts" type="fixed"><parent link="{parent}"/><child '
        'link="hook_block"/></joint>'
        '<link name="camera"/><joint name="glue" type="fixed"><parent '
        'link="of_trolley_joint"/><child link="camera"/></joint></robot>'
    )
    return "".join(parts)


@pytest.mark.slow
def test_a_urdf_by_another_hand_moves_alike(load: Load) -> None:
    mine = load(_own(np.random.default_rng(1)), driven=DRIVEN)
    mine.model.gravity.linear = np.array([0.0, 0.0, -G])
    ours = crane(damp_swing=0)
    assert (mine.payload_mass, mine.trolley_mass) == (1000.0, 500.0)

    @given(states, efforts)
    def alike(state: State, effort: np.ndarray) -> None:
        # the digits of roll, pitch, yaw: 1e-16, through accelerations of up to 1e2
        assert_allclose(
            dynamics.acceleration(mine, state, effort),
            dynamics.acceleration(ours, state, effort),
            atol=1e-10,
            rtol=1e-9,
        )
        assert_allclose(
            dynamics.payload_position(mine, state.q),
            dynamics.payload_position(ours, state.q),
            atol=1e-12,
        )

    alike()


def test_a_crane_without_initial_values_starts_hanging_in_the_middle_of_its_ranges(
    load: Load,
) -> None:
    start = load(_own(np.random.default_rng(2)), driven=DRIVEN).start
    assert_allclose(start.q, [0.0, 12.0, 0.0, 0.0, 14.9], atol=1e-12)  # rounding
    assert not start.v.any()


def test_a_plain_urdf_takes_no_arguments(urdf: str, tmp_path: Path) -> None:
    (tmp_path / "mine.urdf").write_text(urdf)
    with pytest.raises(DataError, match="has no arguments, so that payload_mass cannot be set"):
        load_crane(tmp_path / "mine.urdf", payload_mass=2)


def test_a_file_that_is_missing_is_named_as_missing_whatever_is_set_in_it(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"Cannot read .*nosuch\.urdf"):
        load_crane(tmp_path / "nosuch.urdf", payload_mass=2)


def _hoist_from_trolley(text: str) -> str:
    return turned('<parent link="swing_t_link"/>', '<parent link="trolley_link"/>', text)


def _swapped(text: str) -> str:
    return (
        text.replace("swing_radial_joint", "@")
        .replace("swing_tangential_joint", "swing_radial_joint")
        .replace("@", "swing_tangential_joint")
    )


def _vane(text: str) -> str:
    """On the trolley, free to turn about a vertical axis through its own centre of mass."""
    vane = (
        '<link name="vane"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>'
    )
    vane += (
        '<joint name="vane_joint" type="revolute"><parent link="trolley_link"/><child link="vane"/>'
    )
    vane += (
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    return turned("</robot>", vane, text)


REFUSALS = {
    "no drives": (
        lambda u: u.replace("command_interface", "remark"),
        r"does not say which joints are driven, .*; say it by load_crane\(driven=\[...\]\)",
    ),
    "wrong order": (
        _swapped,
        r"has swing_tangential_joint along \[1.0, 0.0, 0.0\] of the world; it must be \[0, 1, 0\]",
    ),
    "branch": (
        _hoist_from_trolley,
        r"is a tree that ends in hoist_joint, swing_tangential_joint; say which joint carries the "
        r"payload by load_crane\(payload=...\)",
    ),
    "extra joint": (
        _vane,
        "is a tree that ends in hoist_joint, vane_joint; say which joint carries the payload",
    ),
    "not XML": (lambda u: "solid crane", "is not XML"),
    "half a file": (lambda u: u[:5000], "is not XML"),
    "no robot": (lambda u: "<scene/>", "is not a URDF that can be loaded"),
    "empty": (lambda u: "", "is not XML"),
}


def test_a_crane_whose_hoist_no_drive_moves_has_its_payload_as_the_last_point(
    tmp_path: Path,
) -> None:
    text = describe()
    control = text[text.index("<ros2_control") : text.index("</ros2_control>")]
    path = tmp_path / "free.urdf"
    path.write_text(text.replace(f"{control}</ros2_control>", ""))
    crane = load_crane(path, driven=["yaw_joint", "trolley_joint"])
    assert [point.name for point in crane.points] == ["payload", "trolley"]


@pytest.mark.slow
def test_a_chain_of_joints_that_would_take_all_memory_is_refused(tmp_path: Path) -> None:
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
    parts = ['<link name="l0"/>']
    for i in range(1, 900):
        parts.append(
            f'<link name="l{i}">{inertial} iyz="0"/></inertial></link><joint name="j{i}" '
            f'type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><axis xyz="1 0 0"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    (tmp_path / "chain.urdf").write_text(f'<robot name="chain">{"".join(parts)}</robot>')
    with pytest.raises(ModelError, match="has 899 joints that move; allowed are 128"):
        load_crane(tmp_path / "chain.urdf", driven=["j1"])


@pytest.mark.parametrize(("change", "sentence"), REFUSALS.values(), ids=REFUSALS)
def test_what_is_no_crane_is_refused_in_a_sentence(
    change: Callable[[str], str], sentence: str, urdf: str, load: Load
) -> None:
    with pytest.raises(ModelError, match=sentence) as caught:
        load(change(urdf))
    assert "\n" not in str(caught.value)


def test_a_tower_crane_is_one_by_what_its_joints_do_whatever_their_names(
    urdf: str, load: Load
) -> None:
    text = urdf
    for i, role in enumerate(ROLES.values()):
        text = text.replace(role.joint, f"axis_{i}")
    other = load(text)
    ours = crane()
    assert other.layout.symbols == ours.layout.symbols
    assert other.layout.tower("A plan") == (0, 1, 2, 3, 4)
    assert other.model.inertias.tolist() == load_crane().model.inertias.tolist()
    turned_off = turned('<axis xyz="1 0 0"/>', '<axis xyz="-1 0 0"/>', text)
    drives = ["axis_0", "axis_1", "axis_4"]
    assert load(turned_off).layout.symbols == tuple(f"axis_{i}" for i in range(5))
    bare = text.replace("ros2_control", "unknown")
    assert load(bare, driven=drives).layout.symbols == ours.layout.symbols
    assert load(bare, driven=drives[:2]).layout.symbols[0] == "axis_0"  # its hoist hangs free


def test_a_joint_by_another_name_is_what_it_is_called_where_roles_are_given(
    urdf: str, load: Load
) -> None:
    text = urdf.replace("yaw_joint", "slewing_joint")
    rest = {role: one.joint for role, one in ROLES.items() if role != "slew"}
    other = load(text, joints=rest)
    assert other.layout.symbols == ("slewing", "x", "phi", "theta", "l")
    with pytest.raises(
        MissingRole,
        match="A plan needs a joint in the role slew; the joints of this crane are slewing_joint, "
        "trolley_joint, swing_radial",
    ):
        other.layout.tower("A plan")
    own = load(text, joints=rest | {"slew": "slewing_joint"})
    assert own.layout.symbols == crane().layout.symbols


def test_swing_joints_in_another_order_are_another_crane(urdf: str, load: Load) -> None:
    other = load(_swapped(urdf), check_axes=False)
    assert other.layout.symbols == ("gamma", "x", "theta", "phi", "l")
    sentence = (
        "A plan is made for slew, trolley, radial_swing, tangential_swing, hoist in this "
        "order; this crane has slew, trolley, tangential"
    )
    with pytest.raises(ModelError, match=sentence):
        other.layout.tower("A plan")


def test_a_tree_is_a_crane_once_it_is_said_what_carries_the_payload(urdf: str, load: Load) -> None:
    tree = load(_vane(urdf), payload="hoist_joint")
    layout = tree.layout
    ours = crane(trolley_mass=501.0)
    assert {*layout.symbols} == {*ours.layout.symbols, "vane"}
    assert [layout.symbols[i] for i in layout.drives] == ["gamma", "x", "l"]
    assert (tree.payload_mass, layout.symbols[tree.payload.body]) == (1000.0, "l")
    with pytest.raises(
        ModelError,
        match="A plan is made for a tower crane of five joints; this one also moves in vane_joint",
    ):
        layout.tower("A plan")
    tree.model.gravity.linear = ours.model.gravity.linear
    where = [layout.index(symbol) for symbol in ours.layout.symbols]

    @given(states, efforts)
    def alike(state: State, effort: np.ndarray) -> None:
        q, v = np.zeros((2, layout.n))
        q[where], v[where] = state
        a = dynamics.acceleration(tree, State(q, v), effort)
        expected = dynamics.acceleration(ours, state, effort)
        # Rounding, through accelerations of up to 1e2.
        assert_allclose(a[where], expected, atol=1e-10, rtol=1e-9)
        # nothing turns the vane, so it stays as it is in the world
        assert a[layout.index("vane")] == pytest.approx(-expected[0], abs=1e-10, rel=1e-9)

    alike()


INERTIA = 'ixx="400.0" ixy="0" ixz="0" iyy="400.0" iyz="0" izz="400.0"'
NOT_OURS = r"""
<mass value="1000.0"/> => <mass value="1_000"/> => value of mass in link hook_link .* is '1_000'
<mass value="1000.0"/> => <mass value="١٠٠٠"/> => value of mass in link hook_link
<mass value="1000.0"/> => <mass value="1000.0"/><mass value="1"/> => ModelError: There are 2
<mass value="1000.0"/> => <visual/> => ModelError: The inertial of link hook_link .* needs a mass
<inertia ixx="400.0" => <inertia xx="400.0" => ixx of inertia in link hook_link .* is ''
<axis xyz="0 0 -1"/> => <axis xyz="0 -1"/> => xyz of axis in joint hoist_joint .* 3 decimal numbers
upper="26.4" => upper="1e400" => upper of limit in joint hoist_joint .* is '1e400'
upper="26.4" => upper="1e31" => allowed is a decimal number up to 1e\+30
damping="0.0"/> => damping="0.0" friction="-5"/> => dry friction of joint .* is -5; allowed is >= 0
<axis xyz="1 0 0"/> => <mimic joint="mast"/> => ModelError: joint .* mimics mast, which is no joint
<child link="hook_link"/> => <child link="trolley_link"/> => ModelError: two joints with the child
rgba="0.42 0.42 0.40 1" => rgba="0.42 0.42" => rgba of color in material concrete
<box size= => <box sizes= => size of box in link
hoist_joint" type="prismatic" => hoist_joint" type="fixed" => ModelError: names hoist_joint as
trolley_joint" type="prismatic" => trolley_joint" type="revolute" => ModelError: must be prismatic
hoist_joint" type="prismatic" => hoist_joint" type="floating" => ModelError: without limits or with
xyz="0 1 0"/> => xyz="0 -1 0"/> => ModelError: swing_tangential_joint along \[0.0, -1.0, 0.0\] of
xyz="1 0 0"/> => xyz="-1 0 0"/> => ModelError: swing_radial_joint along \[-1.0, 0.0, 0.0\] of the
<mass value="500.0"/> => <mass value="nan"/> => value of mass in link trolley_link .* 'nan'
<mass value="500.0"/> => <mass value="-1"/> => mass of link trolley_link .* is -1 kg
<mass value="1000.0"/> => <mass value="0"/> => ModelError: hoist_joint .* carries the payload
ixx="400.0" => ixx="4OO" => ixx of inertia in link hook_link .* is '4OO'; allowed is a decimal
ixx="400.0" => ixx="-400.0" => inertia of link hook_link in .* positive semidefinite
INERTIA => ixx="20" ixy="0" ixz="0" iyy="20" iyz="0" izz="60" => is 20, 20, 60 kg m²; allowed .* sum
INERTIA => ixx="40" ixy="39" ixz="0" iyy="40" iyz="0" izz="40" => is 1, 40, 79 kg m²; allowed .* sum
lower="3.4" => lower="0" => shortest cable in .* is 0.0 m; allowed is > 0
"initial_value">15.0< => "initial_value">99< => hoist_joint at the start is 99 m; allowed is 3.4
"initial_value">15.0< => "initial_value">up< => hoist_joint at the start is up; allowed is a number
damping="1.0" => damping="-1.0" => damping of swing_radial_joint in .* is -1.0 N m s/rad; allowed
"""
"""Texts of a URDF, others in their place, and the error that refuses the crane. Pinocchio's parser
would drop, double or ignore many of them, saying so on standard error at most.
"""


@pytest.mark.parametrize("row", NOT_OURS.strip().splitlines())
def test_a_urdf_with_one_thing_that_no_crane_has_is_refused(
    row: str, urdf: str, load: Load
) -> None:
    old, new, refusal = row.replace("INERTIA", INERTIA).split(" => ")
    assert old in urdf
    with refused(refusal):
        load(urdf.replace(old, new, 1))


@pytest.mark.parametrize("moments", ["33.3 66.7 100", "0 400 400", "0 0 0", "1e-9 1e-9 2e-9"])
def test_inertias_of_plates_rods_and_points_are_taken_as_rounded(
    moments: str, urdf: str, load: Load
) -> None:
    ixx, iyy, izz = moments.split()
    new = f'ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"'
    assert load(turned(INERTIA, new, urdf))


@pytest.mark.parametrize("name", ["missing.urdf", "missing.xacro", "."])
def test_a_file_that_is_not_there_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="Cannot read "):
        load_crane(tmp_path / name)


def test_a_binary_file_is_refused(load: Load) -> None:
    with pytest.raises(DataError, match=r"Cannot read .*it is not text"):
        load(bytes(range(256)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "axis", "mirror"),
    [("swing_radial_joint", "1 0 0", 2), ("swing_tangential_joint", "0 1 0", 3)],
)
def test_a_flipped_axis_is_refused_from_xacro_and_mirrors_the_swing_when_unchecked(
    joint: str, axis: str, mirror: int, tmp_path: Path, load: Load
) -> None:
    folder = tmp_path / "urdf"
    folder.mkdir()
    for path in XACRO.parent.glob("*.xacro"):
        (folder / path.name).write_text(path.read_text())
    own = folder / XACRO.name
    opposite = " ".join("-1" if n == "1" else n for n in axis.split())
    text = own.read_text()
    own.write_text(turned(f'<axis xyz="{axis}"/>', f'<axis xyz="{opposite}"/>', text))
    text = describe(own)
    with pytest.raises(CraneError, match=f"has {joint} along"):
        load(text)
    flipped = load(text, check_axes=False)
    q = np.array([0.3, 10.0, 0.2, 0.1, 15.0])
    mirrored = q.copy()
    mirrored[mirror] *= -1.0
    # rounding
    assert_allclose(
        dynamics.payload_position(flipped, mirrored),
        dynamics.payload_position(crane(), q),
        atol=1e-12,
    )


@pytest.mark.parametrize("elastic", [{"tower_twist_stiffness": 2e7}, {"jib_bend_stiffness": 2e8}])
def test_an_elastic_tower_or_jib_is_no_swing_of_the_load(elastic: dict[str, float]) -> None:
    rigid = crane()
    c = crane(**elastic)
    assert c.winch == rigid.winch == 2
    assert c.layout.points == rigid.layout.points
    pivot = c.points[1].body
    assert c.layout.joints[pivot].role == "radial_swing"


def test_inertias_are_about_the_axes_of_joints_whatever_their_frames(load: Load) -> None:
    c = load(_own(np.random.default_rng(1)), driven=DRIVEN)
    pin.forwardKinematics(c.model, c.data, np.zeros(5))
    # Moments about the axes of the world with all joints at zero.
    for joint in (1, 3, 4):
        turn = c.data.oMi[joint].rotation
        moments = turn.T @ np.diag([4e6, 3e6, 2e6]) @ turn
        c.model.inertias[joint] = pin.Inertia(3000.0, np.zeros(3), moments)
    assert c.slewing_inertia == pytest.approx(2e6)
    assert c.dummy_inertia == pytest.approx((8e6, 3e6))


def test_the_hook_is_on_the_way_to_the_payload_whatever_else_hangs_on_the_hoist(
    load: Load,
) -> None:
    hooked = describe(values={"hook_mass": 200.0})
    # A vane of the name "a…" on the hook comes before the sling in the order of the coordinates.
    vane = (
        '<link name="vane"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>'
        '<joint name="a_vane" type="revolute"><parent link="hook_link"/><child link="vane"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    c = load(turned("</robot>", vane, hooked), payload="sling_tangential_joint")
    names = [c.layout.joints[point.body].name for point in c.points]
    assert names == ["sling_tangential_joint", "swing_radial_joint", "hoist_joint"]
