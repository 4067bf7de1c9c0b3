"""The plan of a judged lift as files: a page, a PDF where a browser prints one, drawings, and the
record.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from cranedyn.data.files import lock_folder, write_text
from cranedyn.lifts.judging.drawings import DrawingTooLarge, NoDxf, write_drawings
from cranedyn.lifts.judging.judged_inputs import SHIPPED_CHART
from cranedyn.lifts.judging.judgement import Judgement
from cranedyn.lifts.judging.plan_folder import next_revision, with_documents
from cranedyn.lifts.judging.plan_inputs import chart_file, collect_files, crane_digest
from cranedyn.lifts.judging.plan_record import (
    PlanFile,
    PlanInputs,
    PlanOptions,
    PlanRecord,
    write_plan_record,
)
from cranedyn.lifts.judging.report_page import NoBrowser, print_pdf
from cranedyn.lifts.planning.site_file import SITE_EXAMPLES, SITES, example_path

PACKAGES = ("cranedyn", "pin", "numpy", "scipy", "toppra")
"""Packages whose versions a record names: those that plan and simulate a lift."""


@dataclass(frozen=True)
class PlanSource:
    """What a plan is judged with, read before it is judged.

    Attributes:
        options: What is given beside the files.
        files: The files.
        folder: Folder of the site file.
    """

    options: PlanOptions
    files: tuple[PlanFile, ...]
    folder: Path

    @classmethod
    def of(
        cls,
        options: PlanOptions,
        site: str | Path,
        chart: str | Path | None = None,
        crane: str | Path | None = None,
    ) -> PlanSource:
        """Read the files of a plan, see `cranedyn.lifts.judging.plan_inputs.collect_files`.

        Raises:
            DataError: If one of them cannot be read.
            UnknownName: If there is no example of that name.
        """
        folder = example_path(site, SITES, SITE_EXAMPLES, "site").parent
        return cls(options, collect_files(site, chart, crane), folder)

    def inputs(self, judgement: Judgement) -> PlanInputs:
        """Return the inputs of a judgement by this source, with the chart and the crane that it was
        made with.
        """
        files = self.files
        if self.options.chart is None:
            shipped = shipped_chart(judgement)
            if shipped is not None:
                files = (*files, chart_file(shipped))
        versions = {"python": platform.python_version()}
        for package in PACKAGES:
            versions[package] = metadata.version(package)
        crane = crane_digest(judgement.analysis.crane, self.folder)
        return PlanInputs(self.options, files, crane, versions)


def shipped_chart(judgement: Judgement) -> str | None:
    """Return the name of the example chart that a lift was judged by without an option for it; None
    if there was no chart, or that of a file beside the site.
    """
    analysis = judgement.analysis
    if analysis.chart is None or isinstance(analysis.site.chart, Path):
        return None
    return analysis.site.chart or SHIPPED_CHART


class WrittenPlan(NamedTuple):
    """The files of a plan.

    Attributes:
        record: Its record.
        path: File of the record.
        page: Its page.
        pdf: Its PDF; None if there is none.
        why_no_pdf: Why there is none.
        drawings: Plan and elevation as DXF; empty if they could not be written.
        why_no_drawings: Why they could not.
    """

    record: PlanRecord
    path: Path
    page: Path
    pdf: Path | None
    why_no_pdf: str = ""
    drawings: Sequence[Path] = ()
    why_no_drawings: str = ""


def write_plan(
    judgement: Judgement, folder: Path, command_line: str, source: PlanSource
) -> WrittenPlan:
    """Write page, PDF, drawings and record of a judged lift into a folder, as its next revision.

    The record is written last: if the writing is cut off, the documents are not those of the
    record that lies beside them, which `cranedyn verify` says.

    Args:
        judgement: The judged lift.
        folder: The folder.
        command_line: The command that makes the numbers again; empty if there is none.
        source: What it was judged with.

    Raises:
        DataError: If a file cannot be written, or a record in the folder cannot be read.
    """
    with lock_folder(folder):
        revision = next_revision(folder)
        record = PlanRecord(revision.number, source.inputs(judgement), judgement.result)
        page = folder / f"{revision.stem}.html"
        pdf = folder / f"{revision.stem}.pdf"
        path = folder / f"{revision.stem}.json"
        # Those of an earlier judgement would be taken for documents of this one. A record is a file
        # that anybody may have written, so that only names that are written here are removed.
        if revision.replaced is not None:
            for name in revision.replaced.documents:
                if name.startswith((f"{revision.stem}.", f"{revision.stem}_")):
                    (folder / name).unlink(missing_ok=True)
        write_text(page, judgement.html(command_line, revision.mark(record)))
        documents = [page]
        why_no_pdf = ""
        try:
            documents.append(print_pdf(page, pdf))
        except NoBrowser as error:
            why_no_pdf = str(error)
        drawings: list[Path] = []
        why_no_drawings = ""
        try:
            drawings = write_drawings(judgement.scene, folder, revision.stem)
        except (NoDxf, DrawingTooLarge) as error:
            why_no_drawings = str(error)
        record = with_documents(record, [*documents, *drawings])
        write_plan_record(path, record)
    return WrittenPlan(
        record, path, page, None if why_no_pdf else pdf, why_no_pdf, drawings, why_no_drawings
    )
