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


CRANE_KINDS = {"site": ("tower", "mobile", "overhead"), "chart": ("tower", "mobile")}
"""Kinds of cranes for which there is a template, by its name; the first is the default."""

_CRANE_BEGINS = "# --- the crane: "
"""Beginning of the part of a site that differs between kinds of cranes."""

_CRANE_ENDS = "[ground]\n"
"""What follows that part."""

_LIFTS = {
    "mobile": ("[6.0, -14.0, 3.0]", "[13.0, 9.0, 3.0]"),
    "overhead": ("[8.0, -6.0, 2.0]", "[30.0, -8.0, 2.0]"),
}
"""Examples of `from` and `to` by the kind of crane: centres of a load that hangs, since lift-off
and set-down of these cranes are not simulated."""

_IN_A_HALL = {
    "centre = [18.0, 1.0]": "centre = [18.0, -14.0]",
    "[[14.0, -22.0], [20.0, -22.0], [20.0, -16.0], [14.0, -16.0]]": (
        "[[14.0, -30.0], [20.0, -30.0], [20.0, -24.0], [14.0, -24.0]]"
    ),
}
"""Where obstacles of the template are in a hall: off the rails of its crane."""

_STANDING_START = (
    "[6.0, -14.0]            # where the load stands; with a third number its centre hangs there"
)
"""How `from` of a tower crane ends in the template."""


def template_text(name: str, kind: str | None = None) -> str:
    """Return the text of a template of `TEMPLATES`, which loads as it stands.

    Args:
        name: Its name.
        kind: Kind of the crane, one of `CRANE_KINDS`; None for the first.

    Raises:
        UnknownName: If there is no template of that name, or none for that kind of crane.
    """
    if name not in TEMPLATES:
        raise UnknownName("template", name, TEMPLATES)
    text = read_text(_FOLDER / f"{name}.toml")
    if kind is None:
        return text
    kinds = CRANE_KINDS.get(name, ())
    if kind not in kinds:
        raise UnknownName(f"kind of crane for a template of {name}", kind, kinds)
    if kind == kinds[0]:
        return text
    if name == "chart":
        return read_text(_FOLDER / f"chart_{kind}.toml")
    before, rest = text.split(_CRANE_BEGINS)
    after = rest[rest.index(_CRANE_ENDS) :]
    start, goal = _LIFTS[kind]
    before = before.replace('["[jib] mass", "[counter_jib] centre"]', '["[load] mass"]')
    after = after.replace(
        _STANDING_START,
        f"{start}       # where the centre of the load hangs; with two numbers it stands there",
    )
    after = after.replace("# to = [13.0, 9.0]\n", f"# to = {goal}\n")
    if kind == "overhead":
        for found, between_the_rails in _IN_A_HALL.items():
            after = after.replace(found, between_the_rails)
    return before + read_text(_FOLDER / f"crane_{kind}.toml") + after


def write_file_template(name: str, path: Path, kind: str | None = None) -> None:
    """Write a template of `TEMPLATES` to a new file.

    Args:
        name: Its name.
        path: The file.
        kind: Kind of the crane, see `template_text`.

    Raises:
        UnknownName: If there is no template of that name, or none for that kind of crane.
        DataError: If the file exists or cannot be written.
    """
    write_new_file(path, template_text(name, kind))


def write_new_file(path: Path, text: str) -> None:
    """Write a text to a new file.

    Raises:
        DataError: If the file exists or cannot be written.
    """
    if path.exists():
        raise DataError(f"Cannot write {path}: it is there already; name another, or remove it.")
    write_text(path, text)
