"""The inputs of a lift plan as they lie on the disk, and what has changed of them.

`collect_files` reads the site file, the chart, the file of the crane, and all that the site file
names, for the record of a plan; `input_changes` compares two sets of inputs field by field.
"""

from __future__ import annotations

import hashlib
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cranedyn.data.files import MOST_TEXT, open_file, parse_toml, read_bytes
from cranedyn.errors import DataError, printable
from cranedyn.lifts.judging.chart import CHARTS
from cranedyn.lifts.judging.plan_record import PlanFile, PlanInputs, digest_of
from cranedyn.lifts.planning.site_file import CHART_EXAMPLES, SITE_EXAMPLES, SITES, example_path
from cranedyn.model.crane import Crane

MAX_NAMED_TEXT = 200_000
"""Largest file named by a site whose text is kept in a record [byte]. That is enough for the URDF
of a crane; of a larger one, such as a mesh, the digest alone is kept."""

_DESCRIPTIONS = (".urdf", ".xml", ".mjcf", ".sdf")
"""Endings of descriptions of cranes, which may name meshes."""

_MESH_NAME = re.compile(r"""(?:file(?:name)?\s*=\s*["']|<uri>)\s*([^"'<>]+)""")
"""The name of a file in such a description."""

_SCHEME = re.compile(r"^(?:file://|package://|model://)")
"""What may stand before the path of such a file."""

NOT_ENTERED = "not entered"
"""What a change says of a field that is not there."""


# --- reading them ---------------------------------------------------------------------------------


def collect_files(
    site: str | Path, chart: str | Path | None = None, crane: str | Path | None = None
) -> tuple[PlanFile, ...]:
    """Return the files that a lift is judged with.

    Args:
        site: The site file, or the name of an example.
        chart: The chart of the command line, or the name of an example; None for that of the site.
        crane: The file of the crane of the command line; None for that of the site.

    Raises:
        DataError: If one of them cannot be read.
        UnknownName: If there is no example of that name.
    """
    site_path = example_path(site, SITES, SITE_EXAMPLES, "site")
    site_file = _whole_file("site", site_path, site_path.name)
    files = [site_file]
    if chart is not None:
        files.append(chart_file(chart))
    if crane is not None:
        files.append(_named_file("crane", Path(crane), Path(crane).name))
    files += named_files(site_path, site_file.text or "")
    return tuple(files)


def chart_file(chart: str | Path) -> PlanFile:
    """Return the file of a chart, or of the example chart of that name.

    Raises:
        DataError: If it cannot be read.
        UnknownName: If there is no example of that name.
    """
    path = example_path(chart, CHARTS, CHART_EXAMPLES, "chart")
    return _whole_file("chart", path, path.name)


def named_files(site_path: Path, text: str) -> list[PlanFile]:
    """Return the files that a site file names and that lie in its folder, by their paths relative
    to it, in order; with them the meshes that a description of a crane names.

    Args:
        site_path: The site file.
        text: Its text.

    Raises:
        DataError: If one of them cannot be read.
    """
    folder = Path(os.path.realpath(site_path.parent))
    paths: set[Path] = set()
    for name in _all_texts(parse_toml(text.removeprefix("\ufeff"), site_path)):
        path = _file_within(folder, folder, name)
        if path is not None:
            paths.add(path)
    for description in [path for path in paths if path.suffix in _DESCRIPTIONS]:
        content = read_bytes(description).decode("utf-8", "replace")
        for match in _MESH_NAME.finditer(content):
            mesh = _file_within(folder, description.parent, _SCHEME.sub("", match[1].strip()))
            if mesh is not None:
                paths.add(mesh)
    paths.discard(Path(os.path.realpath(site_path)))
    return [
        _named_file("named", path, path.relative_to(folder).as_posix()) for path in sorted(paths)
    ]


def _all_texts(value: Any) -> Iterator[str]:
    """Yield all texts of a TOML document."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for entry in value.values():
            yield from _all_texts(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from _all_texts(entry)


def _file_within(folder: Path, base: Path, name: str) -> Path | None:
    """Return the regular file of a name, links resolved; None if there is none, or it lies outside
    of a folder.

    Args:
        folder: The folder, links resolved.
        base: The folder that a relative name begins at.
        name: The name.
    """
    if not name.strip() or "\0" in name or len(name) > 1000:
        return None
    path = Path(os.path.realpath(base / name))
    return path if path.is_relative_to(folder) and path.is_file() else None


def _whole_file(role: str, path: Path, name: str) -> PlanFile:
    """Return a file with its whole text.

    Raises:
        DataError: If it cannot be read, is too large, or is no text.
    """
    content = read_bytes(path, MOST_TEXT)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error
    sha256 = hashlib.sha256(content).hexdigest()
    return PlanFile(role, printable(name), sha256, len(content), text)


def _named_file(role: str, path: Path, name: str) -> PlanFile:
    """Return a file with its digest, and its text if it is one of at most `MAX_NAMED_TEXT`.

    Raises:
        DataError: If it cannot be read.
    """
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        text = None
        if size <= MAX_NAMED_TEXT:
            file.seek(0)
            content = file.read(MAX_NAMED_TEXT + 1)
            try:
                text = content.decode("utf-8")
            except UnicodeDecodeError:
                text = None  # a mesh in binary form
    return PlanFile(role, printable(name), sha256, size, text)


def crane_digest(crane: Crane, folder: Path) -> str:
    """Return the SHA-256 of a crane as it was loaded: description, joints, gravity and values.

    Args:
        crane: The crane.
        folder: Folder of its file, whose path is left out of the description, so that the same
            crane in another folder has the same digest.
    """
    record = {}
    for name, value in crane.record.items():
        if isinstance(value, str):
            for shown_folder in {os.path.realpath(folder), str(folder.absolute())}:
                value = value.replace(shown_folder, "")
        record[name] = value
    return digest_of(record)


# --- comparing them -------------------------------------------------------------------------------


def input_changes(before: PlanInputs, after: PlanInputs) -> list[str]:
    """Return what differs between two sets of inputs, a sentence without a full stop each."""
    changes = []
    options_before = asdict(before.options)
    options_after = asdict(after.options)
    for name, value in options_before.items():
        if value != options_after[name]:
            option = "--" + name.replace("_", "-")
            given = _shown_value(value, "not given")
            changes.append(f"{option}: {given} → {_shown_value(options_after[name], 'not given')}")
    changes += file_changes(before.files, after.files)
    if before.crane != after.crane:
        changes.append("the crane as loaded: its description or its values differ")
    return changes + version_changes(before.versions, after.versions)


def version_changes(before: Mapping[str, str], after: Mapping[str, str]) -> list[str]:
    """Return which versions differ, by the names of the programs."""
    changes = []
    for name in sorted(before.keys() | after.keys()):
        old = before.get(name, "none")
        new = after.get(name, "none")
        if old != new:
            changes.append(f"version of {name}: {old} → {new}")
    return changes


def file_changes(before: tuple[PlanFile, ...], after: tuple[PlanFile, ...]) -> list[str]:
    """Return what differs between two sets of files: of site files and charts by table and field,
    of others by their digest. A site file or chart whose values are all the same does not differ,
    whatever its comments and its order.
    """
    old_files = {_key(file): file for file in before}
    new_files = {_key(file): file for file in after}
    changes = []
    for key in [*old_files, *(key for key in new_files if key not in old_files)]:
        old = old_files.get(key)
        new = new_files.get(key)
        if old is None and new is not None:
            changes.append(f"{_called(new)} is new")
        elif new is None and old is not None:
            changes.append(f"{_called(old)} is not there any more")
        elif old is not None and new is not None and old.sha256 != new.sha256:
            changes += _changes_of_file(old, new)
    return changes


def _key(file: PlanFile) -> str:
    """Return by what a file is found again: a site file or a chart may have another name."""
    return file.path if file.role == "named" else f"<{file.role}>"


def _called(file: PlanFile) -> str:
    """Return how a sentence calls a file."""
    roles = {"site": "the site file", "chart": "the chart", "crane": "the crane's file"}
    return f"{roles.get(file.role, 'the file')} {file.path}"


def _changes_of_file(old: PlanFile, new: PlanFile) -> list[str]:
    """Return what differs between two versions of a file."""
    if old.text is not None and new.text is not None and new.path.endswith(".toml"):
        try:
            return toml_changes(old.text, new.text)
        except (ValueError, RecursionError):
            pass  # no TOML: compared as any other file
    return [f"{_called(new)}: SHA-256 {old.sha256[:12]}… → {new.sha256[:12]}…"]


def toml_changes(before: str, after: str) -> list[str]:
    """Return the fields that differ between two TOML texts, as "[load] mass 2500 → 2600".

    Raises:
        ValueError: If one of them is no TOML.
    """
    old = dict(_fields(tomllib.loads(before.removeprefix("\ufeff"))))
    new = dict(_fields(tomllib.loads(after.removeprefix("\ufeff"))))
    changes = []
    for field in [*old, *(field for field in new if field not in old)]:
        was = _shown_value(old.get(field), NOT_ENTERED)
        now = _shown_value(new.get(field), NOT_ENTERED)
        # 8 and 8.0 are one number to a site.
        if old.get(field) != new.get(field):
            changes.append(f"{field} {was} → {now}")
    return changes


def _fields(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a TOML document with their values, by table: "[load] mass", or "[[box]]
    hall, size" for a table that is one of a list.
    """
    for table, value in content.items():
        if isinstance(value, Mapping):
            for field, entered in _leaves(value):
                yield f"[{table}] {field}", entered
        elif isinstance(value, list) and value and all(isinstance(one, Mapping) for one in value):
            for i, entry in enumerate(value, start=1):
                name = entry.get("name", entry.get("count", f"number {i}"))
                for field, entered in _leaves(entry):
                    yield f"[[{table}]] {name}, {field}", entered
        else:
            yield table, value


def _leaves(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a table with their values; those of a table in it as "values.mass"."""
    for field, value in table.items():
        if isinstance(value, Mapping):
            for inner, entered in _leaves(value):
                yield f"{field}.{inner}", entered
        else:
            yield field, value


def _shown_value(value: Any, absent: str) -> str:
    """Return a value of a field as a change shows it, and what to say where there is none."""
    if value is None:
        return absent
    return printable(value)
