"""Commented files to begin with: of a site with one crane, of a load chart, of lifts one after the
other, of a load of two cranes, and of the lifts of several cranes.
"""

from __future__ import annotations

from pathlib import Path

from cranedyn.data.files import read_text, write_text
from cranedyn.errors import DataError, UnknownName

_FOLDER = Path(__file__).with_name("templates")

TEMPLATES = {
    "site": "a site with one crane and one lift, for lift and lift_report",
    "chart": "a load chart",
    "chain": "lifts of one crane, one after the other, for lift --chain",
    "tandem": "two cranes that carry one load, for tandem",
    "lifts": "the cranes of a site and the lifts of their shift, for site",
}
"""What each template is, by its name."""


def template_text(name: str) -> str:
    """Return the text of a template of `TEMPLATES`, which loads as it stands.

    Raises:
        UnknownName: If there is no template of that name.
    """
    if name not in TEMPLATES:
        raise UnknownName("template", name, TEMPLATES)
    return read_text(_FOLDER / f"{name}.toml")


def write_file_template(name: str, path: Path) -> None:
    """Write a template of `TEMPLATES` to a new file.

    Raises:
        UnknownName: If there is no template of that name.
        DataError: If the file exists or cannot be written.
    """
    write_new_file(path, template_text(name))


def write_new_file(path: Path, text: str) -> None:
    """Write a text to a new file.

    Raises:
        DataError: If the file exists or cannot be written.
    """
    if path.exists():
        raise DataError(f"Cannot write {path}: it is there already; name another, or remove it.")
    write_text(path, text)
