"""A crane is whatever its URDF says; nothing else knows a joint's number, and what is no crane is
refused in a sentence.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import cranedyn
from cranedyn.errors import CraneError, ModelError, OutOfRange, UnknownName
from cranedyn.model.crane import Crane
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.references.flat import flat
from tests.helpers import ROOT
from tests.indices import everywhere, integer_indices

ENDING = "</robot>"


@pytest.fixture(scope="module")
def urdf() -> str:
    return describe(visuals=False)


@pytest.fixture
def loaded(tmp_path: Path, urdf: str) -> Callable[..., Crane]:
    """A crane from the tower crane's URDF with texts replaced."""

    def load(*changes: tuple[str, str], **how: object) -> Crane:
        text = urdf
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        path = tmp_path / "other.urdf"
        path.write_text(text)
        return load_crane(path, **how)  # type: ignore[arg-type]

    return load


# --- numbers of joints ----------------------------------------------------------------------------


@pytest.mark.slow
def test_no_coordinate_has_its_number_outside_of_the_model() -> None:
    package = Path(cranedyn.__file__).parent
    assert everywhere([package, ROOT / "experiments"], package / "model") == []


@pytest.mark.parametrize(
    "planted",
    "state.q[2]; phi = q[3]; v[3:5] = 0.0; run.q[:, 2]; run.v[-1, 2:4]; batch.end.q[:, [2, 3]]; "
    "crane.start.q[-1]; run.effort[:, 2]; motion.v[..., 4]; setpoint.position[:, 0]".split("; "),
)
def test_a_planted_number_is_found(planted: str) -> None:
    assert len(integer_indices(f"def f():\n    {planted}\n")) == 1


@pytest.mark.parametrize(
    "fine",
    "run.q[-1]; motion.q[0]; state.q[i]; q[crane.swings]; run.q[1:, drives]; "
    "path[:, 2]; run.v[row : row + 1]; v[:n]".split("; "),
)
def test_rows_and_what_a_layout_says_are_no_such_numbers(fine: str) -> None:
    assert integer_indices(fine) == []


# --- what is no crane -----------------------------------------------------------------------------


def test_a_joint_that_is_driven_here_and_passive_there_is_refused(
    loaded: Callable[..., Crane],
) -> None:
    words = r"<ros2_control> that drives move .*, the argument says yaw_joint, swing_r.*; leave one"
    with pytest.raises(ModelError, match=words):
        loaded(driven=["yaw_joint", "swing_radial_joint"])
    with pytest.raises(CraneError, match="hook_joint"):
        loaded(('<joint name="hoist_joint">', '<joint name="hook_joint">'))
    powered = loaded(
        ("ros2_control", "unknown"),
        driven=["yaw_joint", "trolley_joint", "swing_radial_joint", "hoist_joint"],
    )
    assert powered.layout.m == 4
    words = "trolley and hoist; in this one they move slew, trolley, radial_swing, hoist"
    with pytest.raises(ModelError, match=words):
        flat(powered, powered.start, powered.state(x=12.0), 10.0)


def test_a_urdf_without_drives_says_what_to_do(loaded: Callable[..., Crane]) -> None:
    with pytest.raises(ModelError, match=r"joints are driven, .* say it by load_crane\(driven="):
        loaded(("ros2_control", "unknown"))
    with pytest.raises(UnknownName, match="moving joint 'winch'"):
        loaded(("ros2_control", "unknown"), driven=["winch"])


def test_roles_are_named_once_and_known(loaded: Callable[..., Crane]) -> None:
    with pytest.raises(ModelError, match="yaw_joint is given two roles, slew and trolley; allowed"):
        loaded(joints={"slew": "yaw_joint", "trolley": "yaw_joint"})
    with pytest.raises(UnknownName, match="no role 'boom'; there are slew, trolley"):
        loaded(joints={"boom": "yaw_joint"})
    with pytest.raises(UnknownName, match="moving joint 'yaw'"):
        loaded(joints={"slew": "yaw"})
    with pytest.raises(ModelError, match="trolley_joint; it must be revolute"):
        loaded(joints={"slew": "trolley_joint"})


@pytest.mark.parametrize(
    ("tag", "text", "words"),
    [
        ("springStiffness", "-5", "spring stiffness of swing_radial_joint is -5.*; allowed is >="),
        ("springStiffness", "soft", "spring stiffness of swing_radial_joint is soft"),
        ("springReference", "nan", "rest position of the spring of swing_radial_joint is nan"),
        ("ropeStiffness", "1e6", "swing_radial_joint; it must be a passive prismatic joint"),
        ("fallSpacing", "1", "swing_radial_joint; it must be a passive revolute joint about"),
        ("springStiffness", "1</springStiffness><springStiffness>2", "swing_radial_joint twice"),
    ],
)
def test_a_spring_that_is_none_is_refused(
    loaded: Callable[..., Crane], tag: str, text: str, words: str
) -> None:
    element = f'<gazebo reference="swing_radial_joint"><{tag}>{text}</{tag}></gazebo>'
    with pytest.raises(CraneError, match=words):
        loaded((ENDING, element + ENDING))


def test_a_spring_at_no_joint_is_refused_and_other_tags_of_gazebo_are_not_ours(
    loaded: Callable[..., Crane],
) -> None:
    spring = '<gazebo reference="swing"><springStiffness>1</springStiffness></gazebo>'
    with pytest.raises(UnknownName, match="moving joint 'swing'"):
        loaded((ENDING, spring + ENDING))
    friction = '<gazebo reference="hook_link"><mu1>0.2</mu1></gazebo>'
    assert not loaded((ENDING, friction + ENDING)).springs.any


@pytest.mark.slow
def test_a_second_rope_is_refused_with_both_places(tmp_path: Path) -> None:
    path = tmp_path / "ropes.urdf"
    second = '<gazebo reference="trolley_joint"><ropeStiffness>5</ropeStiffness></gazebo></robot>'
    path.write_text(load_crane(rope_stiffness=1e7).urdf.replace("</robot>", second))
    with pytest.raises(ModelError, match=r"ropeStiffness of .* and of trolley_joint; allowed"):
        load_crane(path)


@pytest.mark.slow
def test_a_rope_whose_stiffness_is_not_positive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rope.urdf"
    text = load_crane(rope_stiffness=1e7).urdf
    path.write_text(text.replace("<ropeStiffness>10000000.0<", "<ropeStiffness>0<"))
    with pytest.raises(OutOfRange, match=r"EA of the rope at .* is 0.*; allowed"):
        load_crane(path)
