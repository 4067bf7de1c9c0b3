"""What strangers wrote stands quoted, on one line, wherever it is shown; libraries in other
languages print nothing beside it.
"""

from __future__ import annotations

import re
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from cranedyn.checks import number
from cranedyn.controllers import hold_controller
from cranedyn.data import kept_files
from cranedyn.errors import CraneError, ModelError, OutOfRange, printable, quoted
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import Run
from cranedyn.recording.recorder import describe_runs as words_of
from cranedyn.simulation.simulate import simulate
from experiments.harness.outcome import Outcome, ResultTable, show
from tests.helpers import crane

EVIL = "a\nerror: all is well\x9b31m\u202e'; \u2028"
"""Forges a line of its own, colours, and turns what follows around."""


@pytest.fixture(scope="module")
def urdf() -> str:
    return describe(visuals=False)


REFUSED = r"""
<link name="hook_link"/> => has two links with the name 'hook_link'; allowed is one
<joint name="yaw_joint" type="fixed">PARENT CHILD</joint>MORE => has two joints with the name 'yaw_
<link/> => has a link without a name
<joint name="j" type="fixed">CHILD</joint>MORE => The joint j in .* needs a parent link
<joint name="j" type="fixed"><parent link="no"/>CHILD</joint>MORE => has the parent link 'no', which
<joint name="j" type="fixed">PARENT<child link="no"/></joint> => has the child link 'no', which is
<joint name="j" type="floppy">PARENT CHILD</joint>MORE => is of type 'floppy'; allowed are revolute
MORE => has 2 links that hang on no joint: world, more; allowed is one
<limit[^>]*/> => <visual/> => The joint yaw_joint in .* is revolute and has no limit
effort="\S*" => name="" => effort of limit in joint yaw_joint in .* is ''; allowed is a
<dynamics[^>]*/> => <dynamics armature="1.0"/> => The dynamics of joint yaw_joint in .* needs a
(?s).* => <robot name="r"/> => is not a URDF that can be loaded: it has no link
"""
"""What is added to the crane, or takes the place of what, and what is said of it."""

_MORE = '<link name="more"/>'
_CHILD = '<child link="more"/>'
_PARENT = '<parent link="hook_link"/>'


@pytest.mark.parametrize("row", REFUSED.strip().splitlines())
def test_a_urdf_that_is_no_tree_is_one_sentence_with_its_reason_and_nothing_else_is_printed(
    row: str, urdf: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    row = row.replace("MORE", _MORE).replace("CHILD", _CHILD).replace("PARENT", _PARENT)
    *old, new, sentence = row.split(" => ")
    path = tmp_path / "crane.urdf"
    path.write_text(re.sub(old[0] if old else "(?=</robot>)", new, urdf, count=1))
    with pytest.raises(CraneError, match=sentence) as caught:
        load_crane(path)
    assert str(caught.value).isprintable()
    assert capfd.readouterr() == ("", "")


JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="more"/></joint>'


@pytest.mark.parametrize(
    "part",
    [
        '<link name="{}"/>',
        _MORE + JOINT.format("{}", "fixed", "hook_link"),
        _MORE + JOINT.format("j", "fixed", "{}"),
        _MORE + JOINT.format("j", "{}", "hook_link"),
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
    assert quoted(EVIL).isprintable()
    assert printable(EVIL).isprintable()
    assert quoted("\udcff") == r"'\udcff'"
    assert printable("φ and θ") == "φ and θ"
    with pytest.raises(OutOfRange, match=r"mass is 'a\\nb'; allowed is a number \[kg\]\."):
        number("mass", "a\nb", "kg")


def test_names_of_files_forge_no_rows_and_no_colours_in_tables(
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = ResultTable("Files", [("file", ""), ("l [m]", ".1f")], [(f"{EVIL}|b", 1.0)])
    assert table.shown()[0][0].isprintable()
    last = table.markdown().splitlines()[-1]
    assert last.startswith(r"| a\nerror: all is well")
    assert last.endswith(r"\|b | 1.0 |")
    show(Outcome([table], []))
    out = capsys.readouterr().out
    assert "\x9b" not in out
    assert "\u202e" not in out
    assert not any(line.startswith("error:") for line in out.splitlines())


@pytest.mark.slow
def test_names_in_a_record_forge_no_rows_in_a_recording() -> None:
    run = simulate(crane(), hold_controller(crane()), duration=0.02)
    run = replace(run, parameters={EVIL: f"{EVIL}|x", "dt_s": 5e-4})
    lines = words_of([Run(EVIL, crane(), run)], "t", "").splitlines()
    assert all(line.isprintable() and not line.startswith("error:") for line in lines)
    rows = [line.replace(r"\|", "") for line in lines if line.startswith("|")]
    assert [row.count("|") for row in rows] == [3] * 4


@pytest.mark.slow
def test_cranes_described_in_threads_are_not_mixed_and_standard_error_stays_what_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Xacro expands each of them, also those that another process of this run has expanded.
    monkeypatch.setenv(kept_files.VARIABLE, kept_files.OFF)
    before = sys.stderr

    def described(mass: int) -> bool:
        return f'value="{float(mass)}"' in describe(values={"payload_mass": mass}, visuals=False)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(described, range(1001, 1025)))
    assert sys.stderr is before
