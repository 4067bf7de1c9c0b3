"""Whether a plan of a lift is still what it was: its documents, its inputs, and its result.

`verify` returns checks, of which each holds, fails, or is not judged. A check that was asked for
and could not be made is not judged: that a file is missing is no proof of its content.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cranedyn.data.files import digest
from cranedyn.errors import CraneError, DataError, quoted
from cranedyn.lifts.judging.judgement import Judgement
from cranedyn.lifts.judging.plan_changes import result_changes
from cranedyn.lifts.judging.plan_folder import document_checks, record_beside
from cranedyn.lifts.judging.plan_inputs import (
    chart_file,
    collect_files,
    file_changes,
    version_changes,
)
from cranedyn.lifts.judging.plan_record import (
    DigestMismatch,
    PlanFile,
    PlanOptions,
    PlanRecord,
    read_plan_record,
)
from cranedyn.lifts.judging.plan_writing import PlanSource
from cranedyn.lifts.planning.site_file import CHART_EXAMPLES, SITE_EXAMPLES, SITES, example_path
from cranedyn.verdict import Check

MAX_CHANGES = 20
"""Most differences that are told one by one."""


FOLDERS_ABOVE = 3
"""Number of folders above that of a plan in which a file is looked for to be proposed: a report is
written to out/lift_report, two below the site file."""


class JudgePlan(Protocol):
    """A function that judges a lift as a plan records it."""

    def __call__(
        self,
        options: PlanOptions,
        *,
        site: str | Path,
        chart: str | Path | None = None,
        crane: str | Path | None = None,
    ) -> Judgement:
        """Judge the lift of a site with options, a chart and a crane, None for those of the
        site.
        """


@dataclass(frozen=True)
class NamedFiles:
    """Files that whoever verifies a plan names.

    Nothing else outside of the folder of the plan is read, since a record may come from anybody.

    Attributes:
        site: The site file; None for the one beside the plan, or the example.
        chart: The chart; None for the one beside the plan, or the example.
        crane: The file of the crane. It is never taken from beside the plan, since a .xacro file
            runs code.
    """

    site: Path | None = None
    chart: Path | None = None
    crane: Path | None = None


def verify(
    document: Path,
    judge_plan: JudgePlan,
    named: NamedFiles,
    *,
    compare_disk: bool = True,
    recompute: bool = True,
) -> list[Check]:
    """Return checks of a plan: its documents, its inputs on the disk, and its result.

    Args:
        document: A document of the plan, or its record.
        judge_plan: Function that judges a lift.
        named: The files that the caller names.
        compare_disk: Whether to compare the recorded inputs with the files on the disk.
        recompute: Whether to judge the recorded inputs again.

    Raises:
        DataError: If there is no record, or it is not what a record must be.
    """
    path = record_beside(document)
    try:
        record = read_plan_record(path)
    except DigestMismatch as error:
        return [Check(str(error), False)]
    folder = path.parent
    checks = [Check(f"{path.name} has the digest that it states, {record.digest}.", True)]
    if document.name != path.name and document.name not in record.documents:
        checks.append(Check(f"{document.name} is no document of {path.name}.", False))
    checks += document_checks(record, folder)
    disk = _find_on_disk(record, folder, named)
    if compare_disk:
        checks += _disk_checks(record, disk)
    if recompute:
        checks += _recomputed_checks(record, disk, judge_plan)
    return checks


# --- the inputs on the disk -----------------------------------------------------------------------


@dataclass(frozen=True)
class _OnDisk:
    """Where the inputs of a plan lie now.

    Attributes:
        site: The site file, or the name of an example; None if it was not found.
        chart: The chart of an option, or the name of an example; None if there is no such option,
            or it was not found.
        crane: The file of the crane of an option, likewise.
        missing: How to name what was not found, in sentences.
    """

    site: str | Path | None
    chart: str | Path | None
    crane: str | Path | None
    missing: tuple[str, ...]


def _find_on_disk(record: PlanRecord, folder: Path, named: NamedFiles) -> _OnDisk:
    """Return where the inputs of a plan lie.

    Raises:
        DataError: If a file is named that the plan was made without.
    """
    options = record.inputs.options
    missing = []

    def find(
        role: str, given: Path | None, recorded: str | None, examples: Sequence[str]
    ) -> str | Path | None:
        """Return the file of a role: the one that was named, an example, or one in the folder."""
        if recorded is None:
            if given is not None:
                raise DataError(f"The plan was made without --{role}; leave it out.")
            return None
        if given is not None:
            return given
        if recorded in examples:
            return recorded
        if role == "crane":
            missing.append(f"name {quoted(recorded)} by --crane if you trust it")
            return None
        beside = folder / recorded
        is_there = Path(os.path.realpath(beside)).parent == Path(os.path.realpath(folder))
        if is_there and beside.is_file() and Path(recorded).name == recorded:
            return beside
        above = _found_above(folder, recorded)
        such_as = "" if above is None else f", such as --{role} {above}"
        missing.append(
            f"{quoted(recorded)} does not lie beside the plan; name it by --{role}{such_as}"
        )
        return None

    site = find("site", named.site, options.site, SITE_EXAMPLES)
    chart = find("chart", named.chart, options.chart, CHART_EXAMPLES)
    crane = find("crane", named.crane, options.crane, ())
    return _OnDisk(site, chart, crane, tuple(missing))


def _found_above(folder: Path, name: str) -> Path | None:
    """Return the path of a file of a plain name in one of the folders above that of a plan, to be
    named by whoever verifies it: nothing there is read unasked. None if there is none.
    """
    if Path(name).name != name:
        return None
    for above in list(folder.absolute().parents)[:FOLDERS_ABOVE]:
        if (above / name).is_file():
            return Path(os.path.relpath(above / name))
    return None


def _disk_checks(record: PlanRecord, disk: _OnDisk) -> list[Check]:
    """Return checks that the files on the disk are those that were judged."""
    if disk.site is None or disk.missing:
        return [
            Check(
                f"The inputs on the disk were not compared: {'; '.join(disk.missing)}, or leave "
                "this out by --recorded.",
                None,
            )
        ]
    try:
        files = collect_files(disk.site, disk.chart, disk.crane)
    except CraneError as error:
        return [Check(f"The inputs on the disk cannot be read: {error}", False)]
    options = record.inputs.options
    recorded_chart = record.inputs.file("chart")
    if options.chart is None and recorded_chart is not None:
        # The site names an example chart, or the crane of the package has its own.
        name = Path(recorded_chart.path).stem
        if name in CHART_EXAMPLES:
            files = (*files, chart_file(name))
    changes = file_changes(record.inputs.files, files)
    if not changes:
        return [Check("The inputs on the disk have the values that were judged.", True)]
    return _change_checks("Input on the disk", changes)


def _change_checks(what: str, changes: Sequence[str]) -> list[Check]:
    """Return a check that fails for each change, up to `MAX_CHANGES` of them."""
    checks = []
    for change in changes[:MAX_CHANGES]:
        # Sentences of checks have their full stop already.
        checks.append(Check(f"{what}: {change.removesuffix('.')}.", False))
    if len(changes) > MAX_CHANGES:
        checks.append(Check(f"{what}: {len(changes) - MAX_CHANGES} more differ.", False))
    return checks


# --- the result -----------------------------------------------------------------------------------


def _recomputed_checks(record: PlanRecord, disk: _OnDisk, judge_plan: JudgePlan) -> list[Check]:
    """Return checks that the recorded inputs, judged again, give the recorded result."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(os.path.realpath(name))
        try:
            missing = _lay_out(record, disk, folder)
        except OSError as error:
            return [Check(f"The files of the plan cannot be laid out: {error.strerror}.", None)]
        if missing:
            needed = ", ".join(missing)
            return [
                Check(
                    f"The lift was not judged again: the plan has the digest alone of {needed}, "
                    "and no file of that content was found; name the site by --site.",
                    None,
                )
            ]
        crane = _same_crane_file(record, disk)
        if record.inputs.options.crane is not None and crane is None:
            return [
                Check(
                    "The lift was not judged again: name the file of the crane that it was judged "
                    "with by --crane.",
                    None,
                )
            ]
        site = folder / "site" / _site_name(record)
        chart = None
        if record.inputs.options.chart is not None:
            chart_of_plan = record.inputs.file("chart")
            if chart_of_plan is None:
                return [Check("The plan names a chart and does not hold it.", False)]
            chart = folder / "chart" / chart_of_plan.path
        try:
            source = PlanSource.of(record.inputs.options, site, chart, crane)
            judgement = judge_plan(record.inputs.options, site=site, chart=chart, crane=crane)
            inputs = source.inputs(judgement)
        except CraneError as error:
            # What is not installed is an error of no kind of its own; it says nothing of the plan.
            decided = None if type(error) is CraneError else False
            return [Check(f"The lift could not be judged again: {error}", decided)]
    versions = version_changes(record.inputs.versions, inputs.versions)
    note = f" ({'; '.join(versions)})" if versions else ""
    # Files differ if the chart of the package is another one by now, or the record is forged.
    changes = file_changes(record.inputs.files, inputs.files)
    changes += result_changes(record.result, judgement.result)
    if inputs.crane != record.inputs.crane:
        changes.insert(0, "the crane as loaded has another description or other values")
    if not changes:
        return [
            Check(
                f"Judged again: {judgement.word}, with the same {len(record.result.checks)} checks "
                f"and {len(record.result.tables)} tables{note}.",
                True,
            )
        ]
    return _change_checks(f"Judged again{note}", changes)


def _site_name(record: PlanRecord) -> str:
    """Return the name of the site file, by which a site is called that has no name in it."""
    file = record.inputs.file("site")
    assert file is not None  # see `plan_record.read_plan_record`
    return file.path


def _lay_out(record: PlanRecord, disk: _OnDisk, folder: Path) -> list[str]:
    """Write the files of a plan into a folder of its own, so that they are read as those of a site
    are. Of files whose text is not recorded, those of the same digest are taken from the disk.

    Returns:
        The files that were not found.
    """
    site_folder = folder / "site"
    missing = []
    for file in record.inputs.files:
        if file.role == "crane":
            continue  # it is read where it was named, since it may need files beside it
        target = (site_folder if file.role != "chart" else folder / "chart") / file.path
        target.parent.mkdir(parents=True, exist_ok=True)
        if file.text is not None:
            target.write_bytes(file.text.encode("utf-8"))
            continue
        found = _same_file(file, disk)
        if found is None:
            missing.append(f"{file.path} ({file.sha256[:12]}…)")
        else:
            shutil.copyfile(found, target)
    return missing


def _same_file(file: PlanFile, disk: _OnDisk) -> Path | None:
    """Return the file on the disk that has the path and the digest of a recorded one; None if there
    is none.
    """
    if disk.site is None:
        return None
    base = Path(os.path.realpath(example_path(disk.site, SITES, SITE_EXAMPLES, "site").parent))
    path = Path(os.path.realpath(base / file.path))
    if not path.is_relative_to(base) or not path.is_file():
        return None
    return path if _has_digest(path, file.sha256) else None


def _same_crane_file(record: PlanRecord, disk: _OnDisk) -> Path | None:
    """Return the named file of the crane if it is the recorded one; None otherwise."""
    recorded = record.inputs.file("crane")
    if recorded is None or disk.crane is None:
        return None
    path = Path(disk.crane)
    return path if path.is_file() and _has_digest(path, recorded.sha256) else None


def _has_digest(path: Path, sha256: str) -> bool:
    """Return whether a file has a SHA-256."""
    return digest(path) == sha256
