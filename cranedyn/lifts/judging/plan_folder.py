"""The documents of lift plans in a folder: which revision is the latest, where the next one goes,
and whether the documents are as their record says.

The first revision is ``lift.html`` with ``lift.json`` beside it, the second one ``lift-r2.html``,
and so on. A revision that somebody has signed is never written over: the next judgement becomes the
next revision. One that nobody has signed is replaced.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from hashlib import file_digest
from html.parser import HTMLParser
from pathlib import Path

from cranedyn.data.files import lock_folder, open_file, read_bytes
from cranedyn.errors import DataError
from cranedyn.lifts.judging.plan_changes import revision_changes
from cranedyn.lifts.judging.plan_record import (
    TIME_COLUMN,
    TIME_MASK,
    PlanMark,
    PlanRecord,
    mask_times,
    read_plan_record,
    sign,
    write_plan_record,
)
from cranedyn.verdict import Check, Verdict

_RECORD_NAME = re.compile(r"lift(?:-r([2-9]|[1-9]\d{1,3}))?\.json")
"""Name of a record, with the number of its revision from the second one on."""

MAX_PAGE = 50_000_000
"""Largest page that is compared with its record [byte]."""


def revision_stem(revision: int) -> str:
    """Return the name of the files of a revision, without their ending."""
    return "lift" if revision == 1 else f"lift-r{revision}"


def record_beside(document: Path) -> Path:
    """Return the record of a document, or of itself: the file of the same name that ends in
    ``.json``.

    Raises:
        DataError: If there is none.
    """
    record = document.with_suffix(".json")
    if not os.path.isfile(record):
        raise DataError(
            f"There is no {record.name} beside {document}; a report of a lift is written with it."
        )
    return record


def latest_record(folder: Path) -> PlanRecord | None:
    """Return the record of the latest revision in a folder; None if there is none.

    Raises:
        DataError: If it cannot be read, or is that of another revision than its name says.
    """
    revisions = []
    if folder.is_dir():
        for entry in os.listdir(folder):
            match = _RECORD_NAME.fullmatch(entry)
            if match is not None:
                revisions.append(int(match[1] or 1))
    if not revisions:
        return None
    path = folder / f"{revision_stem(max(revisions))}.json"
    try:
        record = read_plan_record(path)
    except DataError as error:
        raise DataError(
            f"{str(error).removesuffix('.')}; nothing is written over it, so move it away or give "
            "another folder."
        ) from None
    if record.revision != max(revisions):
        raise DataError(f"{path} is the record of revision {record.revision}; rename it.")
    return record


@dataclass(frozen=True)
class NextRevision:
    """What the next judgement in a folder becomes.

    Attributes:
        number: Number of the revision.
        earlier: Record of the latest revision that is signed, whose changes are counted; None if
            there is none.
        replaced: Record of the revision that is replaced, since nobody has signed it; None if there
            is none.
    """

    number: int
    earlier: PlanRecord | None = None
    replaced: PlanRecord | None = None

    @property
    def stem(self) -> str:
        """The name of its files, without their ending."""
        return revision_stem(self.number)

    def mark(self, record: PlanRecord) -> PlanMark:
        """Return what the pages of a plan of this revision say of its record."""
        name = f"{self.stem}.json"
        if self.earlier is None:
            return PlanMark(record.digest, self.number, name)
        changes = revision_changes(self.earlier, record)
        return PlanMark(record.digest, self.number, name, self.earlier.revision, changes)


def next_revision(folder: Path) -> NextRevision:
    """Return what the next judgement in a folder becomes.

    Raises:
        DataError: If a record in it cannot be read.
    """
    latest = latest_record(folder)
    if latest is None:
        return NextRevision(1)
    if latest.signed:
        return NextRevision(latest.revision + 1, earlier=latest)
    earlier = None
    if latest.revision > 1:
        earlier = read_plan_record(folder / f"{revision_stem(latest.revision - 1)}.json")
    return NextRevision(latest.revision, earlier=earlier, replaced=latest)


def with_documents(record: PlanRecord, documents: list[Path]) -> PlanRecord:
    """Return a record with the digests of documents that lie beside it."""
    digests = {}
    for document in documents:
        with open_file(document) as file:
            digests[document.name] = file_digest(file, "sha256").hexdigest()
    return replace(record, documents=digests)


def sign_plan(file: Path, name: str, role: str) -> PlanRecord:
    """Note in the record of a plan that somebody accepts it, and return the record.

    Args:
        file: A document of the plan, or its record.
        name: Who accepts it.
        role: As what, one of `cranedyn.lifts.judging.plan_record.ROLES`.

    Raises:
        DataError: If the record cannot be read, or a document is not the one of the record.
        CraneError: If the lift is NO GO, the name is not printable, or the plan was signed by it in
            this role.
    """
    path = record_beside(file)
    with lock_folder(path.parent):
        record = read_plan_record(path)
        signed = sign(record, name, role, date.today().isoformat())
        for check in document_checks(record, path.parent):
            if check.verdict is not Verdict.HOLDS:
                raise DataError(
                    f"The plan was not signed: {check.sentence} Judge the lift again, and sign "
                    "that."
                )
        write_plan_record(path, signed)
    return signed


# --- whether documents are as their record says ---------------------------------------------------


def document_checks(record: PlanRecord, folder: Path) -> list[Check]:
    """Return checks that the documents of a record are unchanged, and that its page shows what the
    record holds; of each signature, that it is of this plan.

    Args:
        record: The record.
        folder: Its folder.

    Raises:
        DataError: If a document cannot be read.
    """
    checks = []
    if not record.documents:
        checks.append(Check("The record names no documents.", None))
    for name, digest in record.documents.items():
        checks.append(_unchanged(folder, name, digest))
        if checks[-1].holds and name.endswith(".html"):
            checks.append(_shows_record(record, folder / name))
    for signature in record.signatures:
        as_signed = signature.digest == record.digest
        as_signed = as_signed and dict(signature.documents) == dict(record.documents)
        shown = signature.digest[:12]
        if as_signed:
            sentence = f"{signature.name} accepted this plan on {signature.date} ({shown})."
        else:
            sentence = f"{signature.name} accepted another plan on {signature.date} ({shown})."
        checks.append(Check(sentence, as_signed))
    return checks


def _unchanged(folder: Path, name: str, digest: str) -> Check:
    """Return the check that a document beside a record has a digest."""
    path = folder / name
    if not os.path.lexists(path):
        return Check(f"{name} is not there.", False)
    # A link could name any file of this machine.
    if Path(os.path.realpath(path)).parent != Path(os.path.realpath(folder)):
        return Check(f"{name} is a link to another folder, which is not followed.", False)
    with open_file(path) as file:
        found = file_digest(file, "sha256").hexdigest()
    if found == digest:
        return Check(f"{name} is unchanged.", True)
    return Check(
        f"{name} was changed: its SHA-256 is {found[:12]}…, recorded {digest[:12]}….", False
    )


def _shows_record(record: PlanRecord, page: Path) -> Check:
    """Return the check that a page shows digest, verdict, checks and tables of a record.

    The digest of the record is not over the page. So whoever changes a page and its SHA-256 in the
    record is found here.
    """
    content = _PageContent()
    content.feed(read_bytes(page, MAX_PAGE).decode("utf-8", "replace"))
    text = mask_times(content.text)
    missing = []
    if record.digest not in text:
        missing.append("the digest")
    if content.verdict != record.result.word:
        missing.append(f"the verdict {record.result.word}")
    marked = {(word, mask_times(sentence)) for word, sentence in content.marked}
    for check in record.result.checks:
        word = Verdict(check.verdict).word
        if (word, " ".join(check.sentence.split())) not in marked:
            missing.append(f"the check {check.name}")
    for table in record.result.tables:
        masked = {i for i, header in enumerate(table.columns) if header == TIME_COLUMN}
        shown = {_masked_row(row, masked) for row in content.rows}
        for row in table.rows:
            if _masked_row([" ".join(cell.split()) for cell in row], masked) not in shown:
                missing.append(f"{table.title}, {row[0]}" if row else table.title)
    if not missing:
        return Check(f"{page.name} shows what its record holds.", True)
    more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
    listed = "; ".join(missing[:3])
    return Check(f"{page.name} does not show what its record holds: {listed}{more}.", False)


def _masked_row(row: Sequence[str], masked: set[int]) -> tuple[str, ...]:
    """Return the cells of a row, those of some columns replaced by `TIME_MASK`."""
    return tuple(TIME_MASK if i in masked else cell for i, cell in enumerate(row))


class _PageContent(HTMLParser):
    """Text, rows of tables, and checks of a page.

    Attributes:
        rows: Cells of each row.
        marked: Title of each mark of a verdict, such as "holds", and the text behind it up to the
            end of the entry of a list.
    """

    def __init__(self) -> None:
        """Begin with an empty page."""
        super().__init__(convert_charrefs=True)
        self.rows: list[tuple[str, ...]] = []
        self.marked: list[tuple[str, str]] = []
        self._mark = ""
        self._behind_mark: list[str] = []
        self._in_mark = False
        self._texts: list[str] = []
        self._cells: list[str] = []
        self._cell: list[str] | None = None
        self._hidden = 0
        self._in_verdict = False
        self._verdict: list[str] = []

    @property
    def verdict(self) -> str:
        """The word in the paragraphs of the class "verdict"."""
        return " ".join(" ".join(self._verdict).split())

    @property
    def text(self) -> str:
        """All text with single spaces."""
        return " ".join(" ".join(self._texts).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a row or a cell."""
        if tag in ("style", "script"):
            self._hidden += 1
        elif tag == "tr":
            self._cells = []
        elif tag in ("td", "th"):
            self._cell = []
        elif tag == "p":
            self._in_verdict = "verdict" in _classes(attrs)
        elif tag == "span" and "mark" in _classes(attrs):
            self._mark = dict(attrs).get("title") or ""
            self._behind_mark = []
            self._in_mark = True

    def handle_endtag(self, tag: str) -> None:
        """End a row or a cell."""
        if tag in ("style", "script"):
            self._hidden -= 1
        elif tag == "tr":
            self.rows.append(tuple(self._cells))
        elif tag in ("td", "th") and self._cell is not None:
            self._cells.append(" ".join("".join(self._cell).split()))
            self._cell = None
        elif tag == "p":
            self._in_verdict = False
        elif tag == "span":
            self._in_mark = False
        elif tag == "li" and self._mark:
            self.marked.append((self._mark, " ".join("".join(self._behind_mark).split())))
            self._mark = ""

    def handle_data(self, data: str) -> None:
        """Take a piece of text."""
        if self._hidden:
            return
        self._texts.append(data)
        if self._in_verdict:
            self._verdict.append(data)
        if self._mark and not self._in_mark:
            # The sign itself is no part of the sentence.
            self._behind_mark.append(data)
        if self._cell is not None:
            self._cell.append(data)


def _classes(attrs: list[tuple[str, str | None]]) -> list[str]:
    """Return the classes of an element from its attributes."""
    return (dict(attrs).get("class") or "").split()
