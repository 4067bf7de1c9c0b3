"""What strangers wrote stands quoted, on one line, wherever it is shown; libraries in other
languages print nothing beside it.
"""

from __future__ import annotations

import random
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import pytest

from cranedyn.checks import number
from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError, ModelError, OutOfRange, printable, quoted
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import Run
from cranedyn.recording.record import describe_runs as words_of
from cranedyn.simulation.simulate import simulate
from experiments.harness.outcome import Outcome, ResultTable, show
from tests.helpers import crane

EVIL = "a\nerror: all is well\x9b31m\u202e'; \u2028"
"""Forges a line of its own, colours, and turns what follows around."""


@pytest.fixture(scope="module")
def urdf() -> str:
    return describe(visuals=False)


def _further(part: str) -> Callable[[str], str]:
    return lambda text: text.replace("</robot>", f"{part}</robot>")


LINK = '<link name="more"/>'
CHILD = '<child link="more"/>'
PARENT = '<parent link="hook_link"/>'
REFUSED: dict[str, tuple[Callable[[str], str], str]] = {
    "two links of a name": (
        _further('<link name="hook_link"/>'),
        "has two links with the name 'hook_link'; allowed is one",
    ),
    "two joints of a name": (
        _further(f'<joint name="yaw_joint" type="fixed">{PARENT}{CHILD}</joint>{LINK}'),
        "has two joints with the name 'yaw_joint'; allowed is one",
    ),
    "a link without a name": (_further("<link/>"), "has a link without a name"),
    "no parent": (
        _further(f'<joint name="j" type="fixed">{CHILD}</joint>{LINK}'),
        "The joint j in .* needs a parent link",
    ),
    "unknown parent": (
        _further(f'<joint name="j" type="fixed"><parent link="no"/>{CHILD}</joint>{LINK}'),
        "The joint j in .* has the parent link 'no', which is not there",
    ),
    "unknown child": (
        _further(f'<joint name="j" type="fixed">{PARENT}<child link="no"/></joint>'),
        "The joint j in .* has the child link 'no', which is not there",
    ),
    "unknown type": (
        _further(f'<joint name="j" type="floppy">{PARENT}{CHILD}</joint>{LINK}'),
        "The joint j in .* is of type 'floppy'; allowed are revolute, prismatic, fixed, "
        "continuous, floating, planar",
    ),
    "two roots": (_further(LINK), "has 2 links that hang on no joint: world, more; allowed is one"),
    "no limits": (
        lambda text: re.sub("<limit[^>]*/>", "", text, count=1),
        "The joint yaw_joint in .* is revolute and has no limit",
    ),
    "no effort": (
        lambda text: re.sub(r'effort="\S*"', "", text, count=1),
        "effort of limit in joint yaw_joint in .* is ''; allowed is a",
    ),
    "no damping": (
        lambda text: re.sub("<dynamics[^>]*/>", "<dynamics/>", text, count=1),
        "The dynamics of joint yaw_joint in .* needs",
    ),
    "no links": (
        lambda text: "<robot name='r'/>",
        "is not a URDF that can be loaded: it has no link",
    ),
}


@pytest.mark.parametrize(("change", "sentence"), REFUSED.values(), ids=REFUSED)
def test_a_urdf_that_is_no_tree_is_one_sentence_with_its_reason_and_nothing_else_is_printed(
    change: Callable[[str], str],
    sentence: str,
    urdf: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "crane.urdf"
    path.write_text(change(urdf))
    assert path.read_text() != urdf
    with pytest.raises(CraneError, match=sentence) as caught:
        load_crane(path)
    assert str(caught.value).isprintable()
    assert capfd.readouterr() == ("", "")


def _changed(root: ET.Element, pick: random.Random) -> None:
    """An element without or with another attribute, removed, doubled, moved, or of another tag."""
    every = list(root.iter())
    element, other = pick.choice(every), pick.choice(every)
    above = next((parent for parent in every if element in list(parent)), root)
    values = (
        "",
        "0",
        "-1",
        "1e-400",
        "nan",
        "yaw_joint",
        "hook_link",
        "1 2 3",
        "fixed",
        "planar",
        "revolute",
        "x\ny",
        "+5.",
        "1e30",
    )
    changes: list[Callable[[], object]] = [
        lambda: element.set(
            pick.choice(["name", "type", "link", "value", "xyz", "damping", "effort", "version"]),
            pick.choice(values),
        ),
        lambda: element.attrib.pop(pick.choice([*element.attrib, ""]), None),
        lambda: above.remove(element) if element in list(above) else None,
        lambda: above.append(deepcopy(element)),
        lambda: other.append(deepcopy(element)),
        lambda: setattr(
            element, "tag", pick.choice([other.tag, "mimic", "safety_controller", "calibration"])
        ),
    ]
    pick.choice(changes)()


def test_whatever_is_changed_in_a_urdf_no_library_prints_anything_of_its_own(
    urdf: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pick, path, refused = random.Random(1), tmp_path / "crane.urdf", 0
    for _ in range(250):
        root = ET.fromstring(urdf)
        for _ in range(pick.choice([1, 1, 2, 3])):
            _changed(root, pick)
        path.write_bytes(ET.tostring(root))
        try:
            load_crane(path)
        except CraneError as error:
            refused += 1
            assert str(error).isprintable()
    assert 50 < refused < 200
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "part",
    [
        '<link name="{}"/>',
        '<link name="more"/><joint name="{}" type="fixed"><parent link="hook_link"/><child '
        'link="more"/></joint>',
        '<link name="more"/><joint name="j" type="fixed"><parent link="{}"/><child '
        'link="more"/></joint>',
        '<link name="more"/><joint name="j" type="{}"><parent link="hook_link"/><child '
        'link="more"/></joint>',
    ],
)
def test_names_that_cannot_be_printed_are_refused_and_shown_escaped(
    part: str, urdf: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "crane.urdf"
    name = "".join(f"&#{ord(c)};" for c in f"{EVIL}\n         at line 1 in x\nforged")
    path.write_text(urdf.replace("</robot>", f"{part.format(name)}</robot>"))
    with pytest.raises(
        ModelError,
        match=r"a\\nerror: all is well\\x9b31m\\u202e.* holds characters that cannot be printed\.$",
    ) as caught:
        load_crane(path)
    assert str(caught.value).isprintable()
    assert capfd.readouterr() == ("", "")


def test_a_name_in_a_sentence_cannot_end_its_quotation_nor_be_endless() -> None:
    assert quoted("hook_link") == "hook_link"
    assert quoted("x'; allowed is anything") == '"x\'; allowed is anything"'
    assert quoted("""a'b"c\n""") == r"""'a\'b"c\n'"""
    assert len(quoted("x" * 10**6)) < 300
    assert (
        quoted(EVIL).isprintable()
        and printable(EVIL).isprintable()
        and quoted("\udcff") == r"'\udcff'"
    )
    assert printable("φ and θ") == "φ and θ"
    with pytest.raises(OutOfRange, match=r"mass is 'a\\nb' kg; allowed is a number\."):
        number("mass", "a\nb", "kg")


def test_names_of_files_forge_no_rows_and_no_colours_in_tables(
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = ResultTable("Files", [("file", ""), ("l [m]", ".1f")], [(f"{EVIL}|b", 1.0)])
    assert table.shown()[0][0].isprintable()
    last = table.markdown().splitlines()[-1]
    assert last.startswith(r"| a\nerror: all is well") and last.endswith(r"\|b | 1.0 |")
    show(Outcome([table], []))
    out = capsys.readouterr().out
    assert "\x9b" not in out and "\u202e" not in out
    assert not any(line.startswith("error:") for line in out.splitlines())


def test_names_in_a_record_forge_no_rows_in_a_recording() -> None:
    run = simulate(crane(), hold_controller(crane()), duration=0.02)
    run = replace(run, parameters={EVIL: f"{EVIL}|x", "dt_s": 5e-4})
    text = words_of([Run(EVIL, crane(), run)], "t", "")
    assert all(line.isprintable() for line in text.splitlines())
    assert not any(line.startswith("error:") for line in text.splitlines())
    assert sum(line.startswith("|") for line in text.splitlines()) == 4
    assert all(
        line.replace(r"\|", "").count("|") == 3
        for line in text.splitlines()
        if line.startswith("|")
    )


def test_cranes_described_in_threads_are_not_mixed_and_standard_error_stays_what_it_is() -> None:
    before = sys.stderr

    def described(mass: int) -> bool:
        return f'value="{float(mass)}"' in describe(values={"payload_mass": mass}, visuals=False)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(described, range(1001, 1025)))
    assert sys.stderr is before
