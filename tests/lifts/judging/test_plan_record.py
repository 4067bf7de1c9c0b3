"""The record of a lift plan: what it proves, what it refuses, and that a signed one is kept."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cranedyn import __main__ as front
from cranedyn.errors import CraneError, DataError
from cranedyn.lifts.judging import verify_plan
from cranedyn.lifts.judging.plan_changes import key_changes, result_changes, same_text
from cranedyn.lifts.judging.plan_folder import (
    document_checks,
    next_revision,
    sign_plan,
    with_documents,
)
from cranedyn.lifts.judging.plan_inputs import collect_files, toml_changes
from cranedyn.lifts.judging.plan_record import (
    DigestMismatch,
    PlanFile,
    PlanInputs,
    PlanOptions,
    PlanRecord,
    PlanResult,
    RecordedCheck,
    RecordedTable,
    canonical_json,
    mask_times,
    read_plan_record,
    recorded_checks,
    recorded_table,
    sign,
    write_plan_record,
)
from cranedyn.lifts.judging.verify_plan import NamedFiles, verify
from cranedyn.verdict import Check, Verdict, overall
from tests.next_commands import check_next_commands

SITE = """name = "yard"
[ground]
height = 0.0
[load]
mass = 2500.0
[[mesh]]
name = "hall"
file = "hall.stl"
"""

RESULT = PlanResult(
    "GO",
    (RecordedCheck("nearest", "holds", "Least is 1.43 m at t = * s."),),
    (
        recorded_table("In numbers", ["", "this lift"], [["least distance", "1.43 m"]]),
        recorded_table("Loads", ["largest", "value", "at [s]"], [["rope [kN]", "10.31", "4.2"]]),
    ),
)


def page(record: PlanRecord, cell: str = "1.43 m") -> str:
    """A page that shows a record, and a time that the record masks."""
    return (
        f'<p class="verdict held">{record.result.word}</p><ul><li><span class="mark held" '
        f'title="holds">✔</span>Least is 1.43 m at t = 8.5 s.</li></ul><table><tr><td>least '
        f"distance</td><td>{cell}</td></tr><tr><td>rope [kN]</td><td>10.31</td><td>4.2</td></tr>"
        f"</table><code>{record.digest}</code>"
    )


def plan(folder: Path) -> PlanRecord:
    """A site with a mesh, and a plan of it, written into the folder beside them."""
    (folder / "yard.toml").write_text(SITE)
    (folder / "hall.stl").write_bytes(b"\xff\x00 a mesh")
    inputs = PlanInputs(
        PlanOptions("yard.toml", lifts=20, gusts=1),
        collect_files(folder / "yard.toml"),
        "0" * 64,
        {"numpy": "2"},
    )
    record = PlanRecord(1, inputs, RESULT)
    (folder / "lift.html").write_text(page(record))
    record = with_documents(record, [folder / "lift.html"])
    write_plan_record(folder / "lift.json", record)
    return record


def judged_as(result: PlanResult) -> Any:
    """A function that judges any lift with a result."""
    judgement = SimpleNamespace(result=result, word=result.word)
    return lambda options, **files: judgement


@pytest.fixture(autouse=True)
def same_crane(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inputs of what was not really judged: those of the record, with its crane."""

    def inputs(self: Any, judgement: Any) -> PlanInputs:
        return PlanInputs(self.options, self.files, "0" * 64, {"numpy": "2"})

    monkeypatch.setattr(verify_plan.PlanSource, "inputs", inputs)


def verified(folder: Path, result: PlanResult = RESULT, **options: Any) -> list[Check]:
    return verify(folder / "lift.html", judged_as(result), NamedFiles(), **options)


def failed(checks: list[Check]) -> list[str]:
    return [check.sentence for check in checks if check.verdict is Verdict.FAILS]


def test_a_record_is_read_as_it_was_written_and_its_digest_is_that_of_inputs_and_result(
    tmp_path: Path,
) -> None:
    record = plan(tmp_path)
    assert read_plan_record(tmp_path / "lift.json") == record
    content = json.loads((tmp_path / "lift.json").read_text())
    # By hand, with nothing of the module but the form that its docstring states.
    canonical = json.dumps(
        {"inputs": content["inputs"], "result": content["result"]},
        sort_keys=True,
        separators=(",", ":"),
        ensure_ascii=False,
    )
    assert content["digest"] == hashlib.sha256(canonical.encode()).hexdigest()
    files = {file["path"]: file for file in content["inputs"]["files"]}
    assert files["yard.toml"]["text"] == SITE
    mesh = hashlib.sha256((tmp_path / "hall.stl").read_bytes()).hexdigest()
    assert files["hall.stl"]["sha256"] == mesh and files["hall.stl"]["text"] is None


def test_a_plan_that_nobody_touched_is_the_same(tmp_path: Path) -> None:
    plan(tmp_path)
    assert overall(verified(tmp_path)) is Verdict.HOLDS


def test_each_change_of_inputs_is_told_by_table_and_field(tmp_path: Path) -> None:
    plan(tmp_path)
    (tmp_path / "yard.toml").write_text("# only a comment\n" + SITE)
    assert failed(verified(tmp_path, recompute=False)) == []
    (tmp_path / "yard.toml").write_text(SITE.replace("2500", "2600"))
    (tmp_path / "hall.stl").write_bytes(b"\xff\x00 another mesh")
    checks = verified(tmp_path)
    told = " ".join(failed(checks))
    assert "[load] mass 2500.0 → 2600.0" in told and "hall.stl: SHA-256" in told
    # The recorded site needs the mesh as it was, of which the plan has the digest alone.
    assert checks[-1].verdict is Verdict.NOT_JUDGED and "hall.stl" in checks[-1].sentence
    (tmp_path / "yard.toml").unlink()
    asked = verified(tmp_path, recompute=False)[-1]
    assert asked.verdict is Verdict.NOT_JUDGED and "name it by --site" in asked.sentence


def test_toml_is_compared_by_names_of_tables() -> None:
    before = 'a = 1\n[wind]\ngust = 8.0\n[[box]]\nname = "hut"\nbase = 0\n[crane]\nvalues = {m = 1}'
    after = (
        '[[box]]\nname = "hut"\nbase = 1\n[crane]\nvalues = {m = 2}\n[wind]\ngust = 8\nswing = 5'
    )
    assert toml_changes(before, after) == [
        "a 1 → not entered",
        "[[box]] hut, base 0 → 1",
        "[crane] values.m 1 → 2",
        "[wind] swing not entered → 5",
    ]


def test_a_changed_document_is_told_even_if_its_digest_was_changed_with_it(tmp_path: Path) -> None:
    record = plan(tmp_path)
    (tmp_path / "lift.html").write_text(page(record, cell="9.43 m"))
    assert "lift.html was changed" in failed(document_checks(record, tmp_path))[0]
    forged = with_documents(record, [tmp_path / "lift.html"])
    assert failed(document_checks(forged, tmp_path)) == [
        "lift.html does not show what its record holds: In numbers, least distance."
    ]
    (tmp_path / "lift.html").write_text(page(record).replace('"holds"', '"FAILS"'))
    forged = with_documents(record, [tmp_path / "lift.html"])
    assert "the check nearest" in failed(document_checks(forged, tmp_path))[0]
    (tmp_path / "lift.html").write_text(page(record).replace(">GO<", ">NO GO<"))
    forged = with_documents(record, [tmp_path / "lift.html"])
    assert "the verdict GO" in failed(document_checks(forged, tmp_path))[0]


def test_a_document_that_is_a_link_to_another_folder_is_not_followed(tmp_path: Path) -> None:
    folder = tmp_path / "plan"
    folder.mkdir()
    record = plan(folder)
    (folder / "lift.html").rename(tmp_path / "elsewhere.html")
    (folder / "lift.html").symlink_to(tmp_path / "elsewhere.html")
    assert "is a link" in failed(document_checks(record, folder))[0]


def test_a_result_that_comes_out_otherwise_is_told_by_check_and_number(tmp_path: Path) -> None:
    plan(tmp_path)
    rounded = replace(
        RESULT,
        tables=(
            recorded_table("In numbers", ["", "this lift"], [["least distance", "1.44 m"]]),
            recorded_table("Loads", ["largest", "value", "at [s]"], [["rope [kN]", "10.30", "9"]]),
        ),
    )
    # One in the last digit is rounding, and the time of an extreme is not compared.
    assert overall(verified(tmp_path, rounded)) is Verdict.HOLDS
    other = replace(
        RESULT,
        word="NO GO",
        checks=(RecordedCheck("nearest", "fails", "Least is 0.43 m at t = * s."),),
        tables=(
            RESULT.tables[0],
            recorded_table("Loads", ["largest", "value", "at [s]"], [["rope [kN]", "10.33", "9"]]),
        ),
    )
    told = failed(verified(tmp_path, other))
    assert [sentence.removeprefix("Judged again: ") for sentence in told] == [
        "verdict: GO → NO GO.",
        "check nearest: holds → fails: Least is 0.43 m at t = * s.",
        "Loads, rope [kN], value: 10.31 → 10.33.",
    ]
    assert key_changes(RESULT, other) == result_changes(RESULT, other)[:2]


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("127 kN at least", "128 kN at least", True),
        ("127 kN at least", "129 kN at least", False),
        ("Of 400 lifts 3 come near", "Of 400 lifts 4 come near", False),
        ("0.0045 mrad", "0.0046 mrad", True),
        ("1.43 m, load and stack", "1.43 m, load and hut", False),
        ("16.84 %", "16.85 %", True),
        ("8 m/s", "8.0 m/s", True),
        ("φ2 of HC2, HD4", "φ2 of HC3, HD4", False),
        ("-0.1 m", "0.1 m", False),
    ],
)
def test_numbers_are_compared_as_they_are_rounded_and_counts_exactly(
    first: str, second: str, same: bool
) -> None:
    assert same_text(first, second) is same


def test_checks_have_names_that_their_numbers_do_not_change() -> None:
    checks = [
        Check("Nothing comes nearer than 0.5 m: at t = 8.5 s.", True),
        Check("Slewing: the jib turns freely.", True),
        Check("Slewing: it leaves the angles.", False),
        Check("A number of 12.", None, "perturbed_lifts"),
    ]
    recorded = recorded_checks(checks)
    names = [check.name for check in recorded]
    assert names == ["nothing comes nearer than", "slewing", "slewing #2", "perturbed_lifts"]
    assert recorded[0].sentence == "Nothing comes nearer than 0.5 m: at t = * s."
    assert mask_times("cut-out at 12.3 s; 33 s in all") == "cut-out at * s; 33 s in all"


def test_no_two_checks_of_a_record_have_one_name() -> None:
    """A check whose own name is that of a second one of another name."""
    checks = [Check("A.", True, name) for name in ("x", "x #2", "x", "x", "x #3")]
    names = [check.name for check in recorded_checks(checks)]
    assert names == ["x", "x #2", "x #3", "x #4", "x #3 #2"]


@pytest.mark.parametrize(
    ("name", "words"),
    [("A" * 201, "The name has 201 letters; allowed are 200"), ("  ", "The name")],
)
def test_a_name_that_is_too_long_or_empty_signs_nothing(name: str, words: str) -> None:
    result = PlanResult("GO", (), ())
    record = PlanRecord(1, PlanInputs(PlanOptions("site.toml"), (), "0" * 64, {}), result)
    with pytest.raises(CraneError, match=words):
        sign(record, name, "prepared", "2026-11-28")
    assert sign(record, "A" * 200, "prepared", "2026-11-28").signed


HOSTILE = [
    ("{", "it is no JSON"),
    ("[" * 100_000, "it is no JSON"),
    ('{"digest": NaN}', "it is no JSON"),
    ("[]", "it is no table"),
    (("format", "cranedyn lift plan 9"), "its format is"),
    (("revision", 0), "revision is 0"),
    (("revision", True), "revision is True"),
    (("digest", "abc"), "64 hexadecimal digits"),
    (("documents", {"../lift.html": "0" * 64}), "allowed is a name alone"),
    (("documents", {"/etc/passwd": "0" * 64}), "allowed is a name alone"),
    (("inputs.files.0.path", "../yard.toml"), "allowed is a name alone"),
    (("inputs.files.1.path", "a/../../hall.stl"), "a path within the folder"),
    (("inputs.files.1.path", "C:\\hall.stl"), "a path within the folder"),
    (("inputs.files.1.path", "yard.toml"), "in the place of another one"),
    (("inputs.files.1.path", "yard.toml/hall.stl"), "in the place of another one"),
    (("inputs.files.0.text", "other"), "has not the digest beside it"),
    (("inputs.files.0.role", "named"), "there is no site file"),
    (("inputs.options.lifts", 10**12), "lifts is 1000000000000"),
    (("inputs.options.wind", "8; rm"), "allowed is a number"),
    (("inputs.options.values", {"payload_mass": "__import__('os')"}), "a number or a word"),
    (("inputs.options.values", {"a b": 1.0}), "allowed is a name"),
    (("inputs.options.extra", 1), "which is not known"),
    (("inputs.options.site", "a\nb"), "allowed is a printable text"),
    (("result.checks.0.verdict", "perhaps"), "a verdict is perhaps"),
    (("result.checks.0.verdict", []), "a verdict is '[]'"),
    (("result.tables.0.rows.0", ["one cell"]), "another number of cells"),
]


@pytest.mark.parametrize(("change", "sentence"), HOSTILE)
def test_a_hostile_record_is_refused_in_a_sentence(
    change: Any, sentence: str, tmp_path: Path
) -> None:
    plan(tmp_path)
    file = tmp_path / "lift.json"
    if isinstance(change, str):
        file.write_text(change)
    else:
        where, value = change
        content = json.loads(file.read_text())
        *path, last = [int(key) if key.isdecimal() else key for key in where.split(".")]
        inner = content
        for key in path:
            inner = inner[key]
        inner[last] = value
        file.write_text(json.dumps(content))
    with pytest.raises(DataError) as refused:
        read_plan_record(file)
    assert sentence in str(refused.value) and not isinstance(refused.value, DigestMismatch)


def test_a_record_whose_content_was_changed_is_different_and_not_only_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan(tmp_path)
    file = tmp_path / "lift.json"
    file.write_text(file.read_text().replace("1.43", "9.43"))
    assert front.main(["verify", str(file), "--quick"]) == 1
    shown = capsys.readouterr().out
    assert "lift.json was changed" in shown and "Different." in shown


def test_the_command_says_what_it_left_out_and_ends_by_the_worst_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan(tmp_path)
    assert front.main(["verify", str(tmp_path / "lift.html"), "--quick"]) == 0
    shown = capsys.readouterr().out
    with monkeypatch.context() as patch:
        check_next_commands(shown, patch)
    assert "Left out: whether the lift, judged again" in shown and "\nSame.\n" in shown
    (tmp_path / "yard.toml").unlink()
    assert front.main(["verify", str(tmp_path / "lift.html"), "--quick"]) == 2
    assert front.main(["verify", str(tmp_path / "lift.html"), "--quick", "--recorded"]) == 0
    assert front.main(["verify", str(tmp_path / "lift.html"), "--chart", "x.toml"]) == 2
    assert "made without --chart" in capsys.readouterr().err
    assert front.main(["verify", str(tmp_path / "other.pdf")]) == 2


def test_a_signed_plan_is_followed_by_a_revision_and_an_unsigned_one_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert next_revision(tmp_path).number == 1
    first = plan(tmp_path)
    again = next_revision(tmp_path)
    assert (again.number, again.earlier, again.replaced) == (1, None, first)
    words = ["sign", str(tmp_path / "lift.json"), "--by", "A. Planner", "--role", "approved"]
    assert front.main(words) == 0
    shown = capsys.readouterr().out
    assert "no cryptographic signature" in shown
    with monkeypatch.context() as patch:
        check_next_commands(shown, patch)
    signed = read_plan_record(tmp_path / "lift.json")
    assert signed.digest == first.digest and signed.signatures[0].digest == first.digest
    assert overall(verified(tmp_path)) is Verdict.HOLDS
    following = next_revision(tmp_path)
    assert (following.number, following.stem) == (2, "lift-r2") and following.earlier == signed
    heavier = replace(RESULT, word="NO GO")
    options = replace(first.inputs.options, wind=9.0)
    second = PlanRecord(2, replace(first.inputs, options=options), heavier)
    mark = following.mark(second)
    assert mark.since == 1
    assert mark.changes == ["--wind: not given → 9.0", "verdict: GO → NO GO"]
    write_plan_record(tmp_path / "lift-r2.json", second)
    third = next_revision(tmp_path)
    assert (third.number, third.earlier, third.replaced) == (2, signed, second)
    words = ["sign", str(tmp_path / "lift-r2.json"), "--by", "A. Planner"]
    assert front.main(words) == 2
    assert "a lift that is NO GO is not" in capsys.readouterr().err
    (tmp_path / "lift-r2.json").write_text("{")
    with pytest.raises(DataError, match="nothing is written over it"):
        next_revision(tmp_path)


def test_only_a_plan_whose_documents_are_its_own_is_signed_and_once_by_each(
    tmp_path: Path,
) -> None:
    record = plan(tmp_path)
    (tmp_path / "lift.html").write_text("another page")
    with pytest.raises(DataError, match=r"not signed: lift\.html was changed"):
        sign_plan(tmp_path / "lift.json", "A. Planner", "prepared")
    (tmp_path / "lift.html").write_text(page(record))
    sign_plan(tmp_path / "lift.html", "A. Planner", "prepared")
    sign_plan(tmp_path / "lift.html", "A. Planner", "approved")
    with pytest.raises(CraneError, match="already"):
        sign_plan(tmp_path / "lift.html", "A. Planner", "approved")
    with pytest.raises(CraneError, match="printable"):
        sign_plan(tmp_path / "lift.html", "A\nB", "approved")


def test_a_signature_of_another_plan_fails(tmp_path: Path) -> None:
    plan(tmp_path)
    signed = sign_plan(tmp_path / "lift.json", "A. Planner", "prepared")
    forged = replace(signed, result=replace(RESULT, word="NO GO"))
    assert "accepted another plan" in failed(document_checks(forged, tmp_path))[-1]


def test_nothing_outside_of_the_folder_is_read_unless_it_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "plan"
    folder.mkdir()
    record = plan(folder)
    (folder / "yard.toml").rename(tmp_path / "yard.toml")
    (folder / "yard.toml").symlink_to(tmp_path / "yard.toml")
    checks = verified(folder, recompute=False)
    assert checks[-1].verdict is Verdict.NOT_JUDGED
    # A site names files of its own folder only.
    outside = SITE.replace("hall.stl", "../hall.stl")
    (tmp_path / "hall.stl").write_bytes(b"a mesh")
    (folder / "site.toml").write_text(outside)
    assert [file.path for file in collect_files(folder / "site.toml")] == ["site.toml"]
    assert record.inputs.files[1].path == "hall.stl"


def test_a_site_file_above_the_folder_of_a_plan_is_proposed_and_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out" / "plan"
    folder.mkdir(parents=True)
    plan(folder)
    monkeypatch.chdir(folder)
    (folder / "yard.toml").rename(tmp_path / "yard.toml")
    check = verified(folder, recompute=False)[-1]
    assert check.verdict is Verdict.NOT_JUDGED
    assert "name it by --site, such as --site ../../yard.toml" in check.sentence
    (tmp_path / "yard.toml").rename(tmp_path.parent / f"{tmp_path.name}.toml")
    assert "such as" not in verified(folder, recompute=False)[-1].sentence


def test_a_crane_beside_a_plan_is_not_loaded_unless_it_is_named(tmp_path: Path) -> None:
    """A .xacro file runs code, and a stranger may have put it there."""
    record = plan(tmp_path)
    (tmp_path / "crane.xacro").write_text("<robot/>")
    files = collect_files(tmp_path / "yard.toml", crane=tmp_path / "crane.xacro")
    options = replace(record.inputs.options, crane="crane.xacro")
    inputs = replace(record.inputs, options=options, files=files)
    record = PlanRecord(1, inputs, RESULT)
    (tmp_path / "lift.html").write_text(page(record))
    write_plan_record(tmp_path / "lift.json", with_documents(record, [tmp_path / "lift.html"]))
    loaded = []

    def judge(options: PlanOptions, **given: Any) -> Any:
        loaded.append(given["crane"])
        return SimpleNamespace(result=RESULT, word="GO")

    checks = verify(tmp_path / "lift.html", judge, NamedFiles())
    assert loaded == [] and overall(checks) is Verdict.NOT_JUDGED
    named = NamedFiles(crane=tmp_path / "crane.xacro")
    assert overall(verify(tmp_path / "lift.html", judge, named)) is Verdict.HOLDS
    assert loaded == [tmp_path / "crane.xacro"]
    (tmp_path / "crane.xacro").write_text("<robot name='other'/>")
    assert overall(verify(tmp_path / "lift.html", judge, named)) is Verdict.FAILS
    assert len(loaded) == 1


def test_canonical_json_has_no_number_that_is_not_finite() -> None:
    with pytest.raises(ValueError):
        canonical_json({"a": float("nan")})
    assert canonical_json({"b": 0.1, "a": "φ"}) == '{"a":"φ","b":0.1}'
    table = RecordedTable("t", ("at [s]",), (("*",),))
    assert recorded_table("t", ["at [s]"], [["3.1"]]) == table
    file = PlanFile("site", "a.toml", "0" * 64, 0)
    assert file.text is None


def test_a_record_has_plain_spaces_where_a_page_has_such_as_do_not_break() -> None:
    table = recorded_table("t", ["time [s]"], [["0\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}26"]])
    assert table.rows == (("0 to 26",),)
