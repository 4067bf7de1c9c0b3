"""Folders of ROS packages, for ``$(find NAME)`` in xacro, found without ROS."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from cranedyn.data.files import read_text
from cranedyn.errors import CraneError, ModelError, quoted
from cranedyn.model.urdf import parse_urdf

_LEVELS = 4
"""Count of folders above a file that are searched: packages of one workspace stand side by side."""


def package_folder(
    name: str, source: str | Path, packages: Mapping[str, str | Path] | None = None
) -> Path:
    """Return the folder of a ROS package.

    Looked for in this order: the folders given, the ``package.xml`` above the file and beside its
    package, AMENT_PREFIX_PATH (ROS 2), ROS_PACKAGE_PATH (ROS 1).

    Args:
        name: Name of the package.
        source: File that names the package.
        packages: Folders of packages by name.

    Raises:
        ModelError: If the package is not found.
    """
    if packages and name in packages:
        return Path(packages[name]).resolve()
    for folder in _candidates(name, Path(source).resolve()):
        if (folder / "package.xml").is_file() and _package_name(folder) == name:
            return folder
    raise ModelError(
        f"{source} needs the ROS package {quoted(name)}, which is not above the file; name its "
        f"folder by packages={{{name!r}: folder}}, or --package {name}=FOLDER."
    )


def _candidates(name: str, source: Path) -> Iterator[Path]:
    above = source.parents[: _LEVELS + 1]
    yield from above
    for folder in above[1:]:
        for pattern in ("*/package.xml", "*/*/package.xml"):
            yield from sorted(path.parent for path in folder.glob(pattern))
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / name
    for root in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if root:
            yield from (Path(root), Path(root) / name)


def _package_name(folder: Path) -> str:
    """Return the name in a ``package.xml``, "" if it cannot be read."""
    path = folder / "package.xml"
    try:
        return (parse_urdf(read_text(path), path).findtext("name") or "").strip()
    except CraneError:
        return ""
