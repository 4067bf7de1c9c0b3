"""The record of a lift plan: what was judged, what came of it, and which files show it.

A report of a lift is written with a record beside it, a JSON document of the same name. It holds
the inputs, the result, the SHA-256 of each document, and a digest over inputs and result that the
documents carry. This module is the only one that writes and reads it.

The digest is the SHA-256 of the canonical form of inputs and result, see `canonical_json`. It shows
that the record is as it was when somebody noted the digest elsewhere, such as on paper. It is no
signature: whoever changes the record can compute another digest.

A record is a file of strangers. `read_plan_record` takes nothing of it for granted: sizes, types,
names and paths are checked, and what it holds is data that is shown or judged again, never run.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from cranedyn.data.files import parse_json, read_bytes, write_text
from cranedyn.errors import CraneError, DataError, quoted
from cranedyn.verdict import Check, Verdict

FORMAT = "cranedyn lift plan 1"
"""What the first field of a record says: its format and the version of that."""

SHORT_DIGEST = 12
"""Number of digits of a digest that stand on the foot of each page: 48 bit, so that two plans that
lie on one desk do not share them by chance."""

MAX_RECORD = 20_000_000
"""Largest record that is read [byte]: the texts of a site and a chart, of at most 5 MB each, and as
much again for the tables and for what JSON writes in place of quotes and line ends."""

MAX_LIFTS = 1_000_000
"""Most perturbed lifts that are judged because a record asks for them: lifts whose load, cable,
wind and sensors differ from the plan."""

MAX_GUSTS = 10_000
"""Most gusts that are judged because a record asks for them."""

MAX_SIGNATURES = 100
"""Most signatures of a record."""

MAX_NAME = 200
"""Most letters of a name that signs."""

ROLES = ("prepared", "approved")
"""As what somebody may sign a plan."""

NO_GO = "NO GO"
"""Word of a lift that breaks a limit, whose plan is not signed."""

FILE_ROLES = ("site", "chart", "crane", "named")
"""What a file is to a plan: the site file, the load chart, the crane of the command line, or a file
that the site file names."""

DOCUMENT_ENDINGS = (".html", ".pdf", ".svg", ".dxf")
"""Endings that the documents of a plan may have."""

TIME_MASK = "*"
"""What a record has in place of a time at which an extreme is reached."""

_TIME = re.compile(r"\bat (t = )?-?\d+(?:\.\d+)? s\b")
"""A time in the sentence of a check. Where a quantity is nearly level, round-off decides at which
instant it is largest, so that another processor may find another one; the value itself it finds
alike."""

TIME_COLUMN = "at [s]"
"""Header of the columns of such times in tables."""

_SHA256 = re.compile(r"[0-9a-f]{64}")

_NAME = re.compile(r"[A-Za-z_]\w{0,99}", re.ASCII)
"""Name of a number of a crane."""

_PLAIN_VALUE = re.compile(r"[\w.+-]{1,100}", re.ASCII)
"""Value of such a number as text."""

_NUMBER_OR_SIGN = re.compile(r"[^A-Za-z ]")
"""What ends the words from which the name of a check is made."""


# --- what a record holds --------------------------------------------------------------------------


@dataclass(frozen=True)
class PlanOptions:
    """What a lift is judged with beside its files, as it was given on the command line.

    Attributes:
        site: Name of the site file, or of an example site.
        chart: Name of the chart file, or of an example chart; None for that of the site.
        crane: Name of the file of the crane; None for that of the site.
        load: Mass of all that hangs [kg]; None for that of the site.
        falls: Number of falls; None for that of the site.
        hoisting: Hoisting class of the crane, HC1 to HC4 of EN 13001-2.
        drive: Class of its hoist drive, HD1 to HD5 of the same.
        wind: Gust to bear [m/s]; None for that of the site.
        swing: Largest angle of the rope in gusts [degrees]; None for that of the site.
        risk: Largest probability that a perturbed lift comes nearer to an obstacle than the site
            allows [%]; None for that of the site.
        lifts: Number of perturbed lifts, see `MAX_LIFTS`.
        gusts: Number of gusts that are drawn at the wind limit.
        gravity: Gravity [m/s²].
        dt: Physics step [s].
        control_period: Control period [s].
        engine: Engine of the simulation, see `cranedyn.simulation.simulate.simulate`.
        values: Numbers of the crane by name.
    """

    site: str
    chart: str | None = None
    crane: str | None = None
    load: float | None = None
    falls: int | None = None
    hoisting: str = "HC2"
    drive: str = "HD4"
    wind: float | None = None
    swing: float | None = None
    risk: float | None = None
    lifts: int = 10_000
    gusts: int = 32
    gravity: float = 9.80665
    dt: float = 5e-4
    control_period: float = 5e-3
    engine: str = "compiled"
    values: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class PlanFile:
    """A file that a plan was judged with.

    Attributes:
        role: One of `FILE_ROLES`.
        path: Its path, of a file that the site names relative to the folder of the site, else its
            name alone.
        sha256: Its SHA-256.
        size: Its size [byte].
        text: Its whole text; None if it is too large or no text, so that only the digest is known.
    """

    role: str
    path: str
    sha256: str
    size: int
    text: str | None = None


@dataclass(frozen=True)
class PlanInputs:
    """What a lift was judged with.

    Attributes:
        options: What was given beside the files.
        files: The files.
        crane: SHA-256 of the crane as it was loaded: its description and its values.
        versions: Versions by name of Python, of cranedyn, and of the packages that plan and
            simulate.
    """

    options: PlanOptions
    files: tuple[PlanFile, ...]
    crane: str
    versions: Mapping[str, str]

    def file(self, role: str) -> PlanFile | None:
        """Return the file of a role that one file has; None if there is none."""
        return next((file for file in self.files if file.role == role), None)


@dataclass(frozen=True)
class RecordedCheck:
    """A check as a record holds it.

    Attributes:
        name: Its name, which is the same in each plan.
        verdict: "holds", "fails" or "not judged".
        sentence: Its sentence; the times of extremes are replaced by `TIME_MASK`.
    """

    name: str
    verdict: str
    sentence: str


@dataclass(frozen=True)
class RecordedTable:
    """A table as the report prints it; the times of extremes are replaced by `TIME_MASK`.

    Attributes:
        title: Its title.
        columns: Headers of its columns.
        rows: Its cells.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class PlanResult:
    """What came of a judgement, rounded as the report prints it.

    Attributes:
        word: GO, NO GO or NOT COMPLETE.
        checks: All checks.
        tables: All tables; the first one has the numbers that decide.
    """

    word: str
    checks: tuple[RecordedCheck, ...]
    tables: tuple[RecordedTable, ...]


@dataclass(frozen=True)
class Signature:
    """A note that somebody accepts a plan; it is no cryptographic signature.

    Attributes:
        name: Who.
        role: As what, one of `ROLES`.
        date: When, as ISO 8601.
        digest: Digest of the plan that was accepted.
        documents: SHA-256 of the documents that were accepted, by name.
    """

    name: str
    role: str
    date: str
    digest: str
    documents: Mapping[str, str]


@dataclass(frozen=True)
class PlanRecord:
    """The record of a lift plan.

    Attributes:
        revision: Number of the revision, from 1. It is not part of the digest: the same lift,
            judged again, is the same plan.
        inputs: What was judged.
        result: What came of it.
        documents: SHA-256 of the documents that show it, by name.
        signatures: Who accepted it.
    """

    revision: int
    inputs: PlanInputs
    result: PlanResult
    documents: Mapping[str, str] = field(default_factory=dict)
    signatures: tuple[Signature, ...] = ()

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical form of inputs and result."""
        return plan_digest(self.inputs, self.result)

    @property
    def short_digest(self) -> str:
        """The first digits of the digest, as they stand on the foot of each page."""
        return self.digest[:SHORT_DIGEST]

    @property
    def signed(self) -> bool:
        """Whether somebody has signed it."""
        return bool(self.signatures)


class PlanMark(NamedTuple):
    """What the pages of a plan say of its record.

    Attributes:
        digest: The digest of the plan.
        revision: Number of its revision.
        record: Name of the record's file.
        since: Number of the revision that `changes` are counted from; None for a first one.
        changes: What has changed since that, in sentences.
    """

    digest: str
    revision: int
    record: str
    since: int | None = None
    changes: Sequence[str] = ()

    @property
    def short(self) -> str:
        """The first digits of the digest."""
        return self.digest[:SHORT_DIGEST]


# --- what a judgement becomes in a record ---------------------------------------------------------


def recorded_checks(checks: Sequence[Check]) -> tuple[RecordedCheck, ...]:
    """Return checks as a record holds them. A check without a name is called by the words with
    which its sentence begins; the second one of a name gets "#2", or the next number that no check
    is called by.
    """
    taken: set[str] = set()
    recorded = []
    for check in checks:
        called = check.name or _first_words(check.sentence)
        name = called
        number = 1
        while name in taken:
            number += 1
            name = f"{called} #{number}"
        taken.add(name)
        recorded.append(RecordedCheck(name, check.verdict.value, mask_times(check.sentence)))
    return tuple(recorded)


def _first_words(sentence: str) -> str:
    """Return the words of a sentence before its first number or punctuation mark."""
    words = _NUMBER_OR_SIGN.split(sentence, maxsplit=1)[0].split()
    return " ".join(words).lower() or "check"


def mask_times(sentence: str) -> str:
    """Return a sentence whose times of extremes are replaced by `TIME_MASK`."""
    return _TIME.sub(lambda match: f"at {match[1] or ''}{TIME_MASK} s", sentence)


def recorded_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> RecordedTable:
    """Return a table as a record holds it, from its headers and its printed cells.

    Spaces at which a page does not break its lines are plain ones in the record.
    """
    masked_rows = []
    for row in rows:
        masked = []
        for header, cell in zip(columns, row, strict=True):
            masked.append(TIME_MASK if header == TIME_COLUMN else " ".join(cell.split()))
        masked_rows.append(tuple(masked))
    return RecordedTable(title, tuple(columns), tuple(masked_rows))


# --- digest and canonical form --------------------------------------------------------------------


def canonical_json(value: Any) -> str:
    """Return a value as JSON in the one form of which digests are made: keys sorted, no spaces, no
    escapes of letters, floats in the fewest digits that give them back.

    Raises:
        ValueError: If a number is not finite.
    """
    return json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )


def digest_of(value: Any) -> str:
    """Return the SHA-256 of the canonical form of a value."""
    # Names of files that are no UTF-8 hold lone surrogates, which UTF-8 alone does not encode.
    return hashlib.sha256(canonical_json(value).encode("utf-8", "surrogatepass")).hexdigest()


def plan_digest(inputs: PlanInputs, result: PlanResult) -> str:
    """Return the digest of a plan."""
    return digest_of({"inputs": asdict(inputs), "result": asdict(result)})


# --- writing --------------------------------------------------------------------------------------


def write_plan_record(path: Path, record: PlanRecord) -> None:
    """Write a record.

    Raises:
        DataError: If it cannot be written.
    """
    content = {
        "format": FORMAT,
        "digest": record.digest,
        "revision": record.revision,
        "inputs": asdict(record.inputs),
        "result": asdict(record.result),
        "documents": dict(record.documents),
        "signatures": [asdict(signature) for signature in record.signatures],
    }
    write_text(path, canonical_json(content) + "\n")


# --- reading --------------------------------------------------------------------------------------


def read_plan_record(path: Path) -> PlanRecord:
    """Read a record, and check all that it holds.

    Raises:
        DataError: If it cannot be read or is no record.
        DigestMismatch: If its digest is not that of its content.
    """
    try:
        content = parse_json(read_bytes(path, MAX_RECORD))
    except (ValueError, RecursionError) as error:
        raise DataError(f"Cannot read {path}: it is no JSON, or not of a lift plan.") from error
    try:
        record = _record_of(content)
    except _Refused as refused:
        raise DataError(f"Cannot read {path} as the record of a lift plan: {refused}.") from None
    stated = content["digest"]
    if stated != record.digest:
        raise DigestMismatch(
            f"{path} was changed: it states the digest {stated[:SHORT_DIGEST]}, and its content "
            f"has {record.short_digest}."
        )
    return record


class DigestMismatch(DataError):
    """The content of a record has another digest than it states: somebody has changed it."""


# The bounds below are far above what a plan has. They keep the file of a stranger from taking
# memory and time. A signature may be of another digest than the record's: that it is not of this
# plan, which `cranedyn.lifts.judging.plan_folder.document_checks` says, is no fault of the file.


class _Refused(Exception):
    """Something in a record is not what it must be; the text says what, without a full stop."""


def _record_of(content: Any) -> PlanRecord:
    """Return a record from the content of its file."""
    names = ("format", "digest", "revision", "inputs", "result", "documents", "signatures")
    top = _table("it", content, names)
    if top["format"] != FORMAT:
        raise _Refused(f"its format is {quoted(top['format'])}; known is {quoted(FORMAT)}")
    _sha256("digest", top["digest"])
    signatures = _list("signatures", top["signatures"], MAX_SIGNATURES)
    return PlanRecord(
        revision=_whole("revision", top["revision"], 1, 10_000),
        inputs=_inputs_of(top["inputs"]),
        result=_result_of(top["result"]),
        documents=_documents_of("documents", top["documents"]),
        signatures=tuple(_signature_of(entry) for entry in signatures),
    )


def _inputs_of(content: Any) -> PlanInputs:
    """Return the inputs of a record."""
    table = _table("inputs", content, ("options", "files", "crane", "versions"))
    files = tuple(_file_of(entry) for entry in _list("files", table["files"], 2000))
    _check_distinct(files)
    versions = _texts("versions", table["versions"])
    _sha256("crane", table["crane"])
    options = _options_of(table["options"])
    if not any(file.role == "site" for file in files):
        raise _Refused("files: there is no site file")
    return PlanInputs(options, files, table["crane"], versions)


def _check_distinct(files: Sequence[PlanFile]) -> None:
    """Refuse files of which one would take the place of another, or of a folder of another."""
    roles = Counter(file.role for file in files if file.role != "named")
    if any(count > 1 for count in roles.values()):
        raise _Refused("files: one role is listed twice")
    # These lie in one folder, that of the site.
    paths = [PurePosixPath(file.path) for file in files if file.role in ("site", "named")]
    times = Counter(paths)
    for path in paths:
        if times[path] > 1 or any(folder in times for folder in path.parents):
            raise _Refused(f"files: {quoted(str(path))} would lie in the place of another one")


def _options_of(content: Any) -> PlanOptions:
    """Return the options of a record."""
    table = _table("options", content, tuple(PlanOptions.__dataclass_fields__))
    for name in ("site", "hoisting", "drive", "engine"):
        _text(name, table[name])
    for name in ("chart", "crane"):
        if table[name] is not None:
            _text(name, table[name])
    for name in ("load", "wind", "swing", "risk"):
        if table[name] is not None:
            _number(name, table[name])
    for name in ("gravity", "dt", "control_period"):
        _number(name, table[name])
    if table["falls"] is not None:
        _whole("falls", table["falls"], 1, 1000)
    _whole("lifts", table["lifts"], 0, MAX_LIFTS)
    _whole("gusts", table["gusts"], 0, MAX_GUSTS)
    _check_crane_values(table["values"])
    return PlanOptions(**table)


def _check_crane_values(values: Any) -> None:
    """Refuse what is no table of numbers, or words, of a crane."""
    if not isinstance(values, dict) or len(values) > 1000:
        raise _Refused("values is no table of numbers of the crane")
    for name, value in values.items():
        if not _NAME.fullmatch(name):
            raise _Refused(f"a number of the crane is called {quoted(name)}; allowed is a name")
        if not isinstance(value, str):
            _number(name, value)
        elif not _PLAIN_VALUE.fullmatch(value):
            # What describes a crane may be a program that computes with its arguments.
            raise _Refused(f"{name} of the crane is {quoted(value)}; allowed is a number or a word")


def _file_of(content: Any) -> PlanFile:
    """Return a file of a record, whose text must have the digest that stands beside it."""
    table = _table("files", content, tuple(PlanFile.__dataclass_fields__))
    role = table["role"]
    if role not in FILE_ROLES:
        raise _Refused(f"the role of a file is {quoted(role)}; known are {', '.join(FILE_ROLES)}")
    path = _text("path", table["path"])
    _check_relative(path, alone=role != "named")
    _sha256("sha256", table["sha256"])
    size = _whole("size", table["size"], 0, 10**15)
    text = table["text"]
    if text is not None:
        if not isinstance(text, str):
            raise _Refused(f"the text of {quoted(path)} is no text")
        content_bytes = text.encode("utf-8", "surrogatepass")
        if hashlib.sha256(content_bytes).hexdigest() != table["sha256"]:
            raise _Refused(f"the text of {quoted(path)} has not the digest beside it")
        if len(content_bytes) != size:
            raise _Refused(f"the text of {quoted(path)} has not the size beside it")
    return PlanFile(role, path, table["sha256"], size, text)


def _check_relative(path: str, *, alone: bool) -> None:
    """Refuse a path that leaves its folder, or, where it must be a name alone, has folders."""
    parts = PurePosixPath(path).parts
    leaves = path.startswith(("/", "~")) or ".." in parts or "\\" in path or ":" in path
    if not parts or leaves or len(path) > 300 or (alone and len(parts) > 1):
        allowed = "a name alone" if alone else "a path within the folder of the site"
        raise _Refused(f"a file is called {quoted(path)}; allowed is {allowed}")


def _result_of(content: Any) -> PlanResult:
    """Return the result of a record."""
    table = _table("result", content, ("word", "checks", "tables"))
    # A list, in which also what cannot be hashed is looked for without an error.
    verdicts = [verdict.value for verdict in Verdict]
    checks = []
    for entry in _list("checks", table["checks"], 1000):
        fields = _table("checks", entry, ("name", "verdict", "sentence"))
        if fields["verdict"] not in verdicts:
            raise _Refused(f"a verdict is {quoted(fields['verdict'])}")
        name = _text("name", fields["name"])
        sentence = _text("sentence", fields["sentence"])
        checks.append(RecordedCheck(name, fields["verdict"], sentence))
    if len({check.name for check in checks}) < len(checks):
        raise _Refused("two checks have one name")
    tables = tuple(_table_of(entry) for entry in _list("tables", table["tables"], 100))
    return PlanResult(_text("word", table["word"]), tuple(checks), tables)


def _table_of(content: Any) -> RecordedTable:
    """Return a table of a record."""
    fields = _table("tables", content, ("title", "columns", "rows"))
    columns = []
    for header in _list("columns", fields["columns"], 100):
        columns.append(_text("column", header, empty=True))
    rows = []
    for entry in _list("rows", fields["rows"], 10_000):
        cells = _list("a row", entry, 100)
        if len(cells) != len(columns):
            raise _Refused("a row of a table has another number of cells than columns")
        rows.append(tuple(_text("cell", cell, empty=True) for cell in cells))
    return RecordedTable(_text("title", fields["title"]), tuple(columns), tuple(rows))


def _signature_of(content: Any) -> Signature:
    """Return a signature of a record."""
    fields = _table("signatures", content, tuple(Signature.__dataclass_fields__))
    if fields["role"] not in ROLES:
        raise _Refused(f"somebody signed as {quoted(fields['role'])}")
    return Signature(
        name=_text("name", fields["name"]),
        role=fields["role"],
        date=_text("date", fields["date"]),
        digest=_sha256("digest", fields["digest"]),
        documents=_documents_of("documents", fields["documents"]),
    )


def _documents_of(name: str, content: Any) -> dict[str, str]:
    """Return the digests of documents by name. They lie beside the record."""
    documents = _texts(name, content)
    for document, digest in documents.items():
        path = Path(document)
        if path.name != document or path.suffix not in DOCUMENT_ENDINGS:
            endings = ", ".join(DOCUMENT_ENDINGS)
            raise _Refused(
                f"a document is called {quoted(document)}; allowed is a name alone that ends in "
                f"{endings}"
            )
        _sha256(document, digest)
    return documents


def _table(name: str, content: Any, fields: Sequence[str]) -> dict[str, Any]:
    """Return a table that has exactly some fields."""
    if not isinstance(content, dict):
        raise _Refused(f"{name} is no table")
    missing = [field for field in fields if field not in content]
    unknown = [key for key in content if key not in fields]
    if missing:
        raise _Refused(f"{name} lacks {missing[0]}")
    if unknown:
        raise _Refused(f"{name} has a field {quoted(unknown[0])}, which is not known")
    return content


def _list(name: str, content: Any, most: int) -> list[Any]:
    """Return a list of at most so many entries."""
    if not isinstance(content, list) or len(content) > most:
        raise _Refused(f"{name} is no list of at most {most}")
    return content


def _texts(name: str, content: Any) -> dict[str, str]:
    """Return a table of printable texts."""
    if not isinstance(content, dict) or len(content) > 100:
        raise _Refused(f"{name} is no table of texts")
    for key, value in content.items():
        _text(name, key)
        _text(key, value)
    return content


def _text(name: str, value: Any, *, empty: bool = False) -> str:
    """Return a printable text of at most 10,000 characters."""
    if not isinstance(value, str) or len(value) > 10_000 or not value.isprintable():
        raise _Refused(f"{name} is {quoted(value)}; allowed is a printable text")
    if not value and not empty:
        raise _Refused(f"{name} is empty")
    return value


def _number(name: str, value: Any) -> float:
    """Return a number; the parser has refused those that are not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _Refused(f"{name} is {quoted(value)}; allowed is a number")
    return value


def _whole(name: str, value: Any, low: int, high: int) -> int:
    """Return a whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise _Refused(f"{name} is {quoted(value)}; allowed is a whole number from {low} to {high}")
    return value


def _sha256(name: str, value: Any) -> str:
    """Return 64 hexadecimal digits."""
    if not isinstance(value, str) or not _SHA256.fullmatch(value):
        raise _Refused(f"{name} is {quoted(value)}; allowed are 64 hexadecimal digits")
    return value


# --- signing --------------------------------------------------------------------------------------


def sign(record: PlanRecord, name: str, role: str, date: str) -> PlanRecord:
    """Return a record with one more signature.

    Raises:
        CraneError: If the lift is NO GO, the name is not printable or empty, has signed in this
            role already, or there are too many signatures.
    """
    if record.result.word == NO_GO:
        raise CraneError("The plan was not signed: a lift that is NO GO is not.")
    name = name.strip()
    if not name or not name.isprintable():
        raise CraneError(f"The name is {quoted(name)}; allowed is a printable text.")
    if len(name) > MAX_NAME:
        raise CraneError(f"The name has {len(name)} letters; allowed are {MAX_NAME}.")
    if len(record.signatures) >= MAX_SIGNATURES:
        raise CraneError(f"The plan has {MAX_SIGNATURES} signatures already, which is the most.")
    for earlier in record.signatures:
        if (earlier.name, earlier.role) == (name, role):
            raise CraneError(f"{name} has signed this plan as {role} already.")
    signature = Signature(name, role, date, record.digest, dict(record.documents))
    return replace(record, signatures=(*record.signatures, signature))
