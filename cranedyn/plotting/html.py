"""Pages as HTML that needs no other file, made from templates, and the parts that they share.

A page is a Jinja template, a file of whole HTML beside the module that fills it. Every value that
is put into one is escaped, so a name of a crane, a site or a file is data whatever it contains.
What is HTML already, such as the style sheet, is a `markupsafe.Markup`.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from cranedyn.plotting.figures import svg
from cranedyn.verdict import Check, Verdict
from cranedyn.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMAGE_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}
"""Media types of figures by file ending, drawings first."""

STYLE = Markup(Path(__file__).with_name("page.css").read_text(encoding="utf-8"))
"""Style sheet of a page of results."""

_SHARED_TEMPLATES = Path(__file__).with_name("templates")
"""Folder of the templates that others extend or import: ``document.html`` and ``parts.html``."""


@dataclass(frozen=True)
class Mark:
    """How a verdict is shown on a page.

    Attributes:
        style: Class of its elements in the style sheet.
        sign: The character that stands for it.
    """

    style: str
    sign: str


MARKS = {
    Verdict.HOLDS: Mark("held", "✔"),
    Verdict.FAILS: Mark("fails", "✘"),
    Verdict.NOT_JUDGED: Mark("open", "–"),
}
"""How each verdict is shown."""


@dataclass(frozen=True)
class PageTable:
    """A table of a page.

    Attributes:
        title: Caption.
        columns: Header of each column, and whether it is text, which may be folded.
        rows: Cells.
        note: Text below the table; empty for none.
    """

    title: str
    columns: Sequence[tuple[str, bool]]
    rows: Sequence[Sequence[str]]
    note: str = ""

    @property
    def letters(self) -> int:
        """Width that the table needs [characters]: text is folded between words only."""
        # A column is as wide as its longest word, with a space on both sides.
        width = 2 * len(self.columns)
        for i, (header, is_text) in enumerate(self.columns):
            words = header.split()
            for row in self.rows:
                if is_text:
                    words += row[i].split()
                else:
                    words.append(row[i])
            width += max((len(word) for word in words), default=1)
        return width


@dataclass(frozen=True)
class PageFigure:
    """A figure of a page.

    Attributes:
        address: Data URL of the image, see `image_address`.
        caption: What it shows.
    """

    address: str
    caption: str

    @classmethod
    def of(cls, figure: Figure, caption: str) -> PageFigure:
        """Return a figure of Matplotlib as a drawing."""
        return cls(svg_address(figure), caption)


def render(template: Path, **values: Any) -> str:
    """Return a page.

    Args:
        template: File of the template. It may extend ``document.html``, import ``parts.html``, and
            include files of its own folder.
        values: What the template names, beside `marks`, `style`, `version` and `date`.

    Raises:
        jinja2.UndefinedError: If the template names a value that is not given.
    """
    page = _environment(template.parent).get_template(template.name).render(values)
    # The blank lines between the macros above the page.
    return page.lstrip()


def mark_html(verdict: Verdict) -> str:
    """Return the sign of a verdict as HTML."""
    parts: Any = _environment(_SHARED_TEMPLATES).get_template("parts.html").module
    return str(parts.mark(verdict))


def worst_first(checks: Sequence[Check]) -> list[Check]:
    """Return checks in their order, but first those that fail, then those that were not judged."""
    order = [Verdict.FAILS, Verdict.NOT_JUDGED, Verdict.HOLDS]
    return sorted(checks, key=lambda check: order.index(check.verdict))


def _environment(folder: Path) -> Environment:
    """Return what renders the templates of a folder: values are escaped, and each must be given."""
    environment = Environment(
        loader=FileSystemLoader([folder, _SHARED_TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    today = date.today()
    environment.globals.update(
        marks=MARKS,
        style=STYLE,
        version=__version__,
        date=f"{today.day} {today:%B %Y}",
    )
    return environment


def image_address(content: bytes, ending: str) -> str:
    """Return a data URL of an image whose file would have an ending of `IMAGE_TYPES`."""
    return f"data:{IMAGE_TYPES[ending]};base64,{base64.b64encode(content).decode('ascii')}"


def svg_address(figure: Figure) -> str:
    """Return a figure as a data URL; the same figure gives the same text."""
    return image_address(svg(figure), ".svg")
