"""Descriptions: xacro files with checked arguments, expanded to a plain URDF without comments.

Expansions of the files of this project are kept for later processes, see
`cranedyn.data.kept_files`.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TypedDict
from xml.dom import Node, minidom

from cranedyn.checks import number
from cranedyn.command import interrupted
from cranedyn.data.files import read_text
from cranedyn.data.kept_files import digest_of_parts, keep, read_kept
from cranedyn.errors import CraneError, ModelError, UnknownName, quoted
from cranedyn.model.urdf import parse_urdf

_PACKAGE = Path(__file__).resolve().parents[1]
XACRO = next(
    folder / "urdf" / "tower_crane.urdf.xacro"
    for folder in (_PACKAGE, _PACKAGE.parent)
    if (folder / "urdf").is_dir()
)
"""Tower crane of this project: inside the package once installed, beside it in a checkout."""


class CraneValues(TypedDict, total=False):
    """Numbers of the tower crane of this project, each an argument of its xacro file.

    ``cranedyn describe --list`` lists them with default, range and meaning. The
    comment behind each is its unit.
    """

    payload_mass: float  # kg
    payload_inertia: float  # kg m^2
    payload_ixx: float  # kg m^2
    payload_iyy: float  # kg m^2
    payload_izz: float  # kg m^2

    hook_mass: float  # kg
    hook_inertia: float  # kg m^2
    sling_length: float  # m
    damp_sling: float  # N m s/rad
    lug_height: float  # m

    rope_stiffness: float  # N
    falls: float
    rope_damping: float  # N s/m
    fall_spacing: float  # m
    damp_yaw: float  # N m s/rad
    drum_inertia: float  # kg
    rope_mass: float  # kg/m
    rope_bodies: float
    rope_mass_length: float  # m
    damp_rope: float  # N m s/rad
    tower_twist_stiffness: float  # N m/rad
    slew_drive_inertia: float  # kg m^2
    tower_bend_stiffness: float  # N m/rad
    jib_bend_stiffness: float  # N m/rad
    jib_inertia: float  # kg m^2

    mast_height: float  # m
    pivot_height: float  # m
    total_height: float  # m
    counter_jib: float  # m
    mast_width: float  # m
    foot_width: float  # m
    upper_mass: float  # kg
    slewing_inertia: float  # kg m^2
    trolley_mass: float  # kg
    trolley_inertia: float  # kg m^2
    dummy_mass: float  # kg
    dummy_inertia: float  # kg m^2

    damp_slew: float  # N m s/rad
    damp_trolley: float  # N s/m
    damp_swing: float  # N m s/rad
    damp_hoist: float  # N s/m
    friction_hoist: float  # N

    slew_limit: float  # rad
    trolley_min: float  # m
    trolley_max: float  # m
    swing_limit: float  # rad
    hoist_min: float  # m
    hoist_max: float  # m
    slew_effort: float  # N m
    trolley_effort: float  # N
    swing_effort: float  # N m
    hoist_effort: float  # N
    slew_velocity: float  # rad/s
    trolley_velocity: float  # m/s
    swing_velocity: float  # rad/s
    hoist_velocity: float  # m/s

    slew_init: float  # rad
    trolley_init: float  # m
    hoist_init: float  # m


_XACRO_LOCK = threading.Lock()
"""Held while a file is expanded: xacro keeps the current file in a variable of its module."""

_SEARCHED_LEVELS = 4
"""Number of folders above that of a file that are searched for ROS packages: those of one workspace
stand side by side."""

_DOCUMENTED = re.compile(
    r"\[(?P<unit>[^\]]*)\] (?P<allowed>any|> 0|>= 0|>= 0 or inf|a whole number >= 1): "
    r"(?P<meaning>.+)"
)
"""The comment behind an argument of a xacro file of this project."""


@dataclass(frozen=True)
class Argument:
    """Argument of a xacro file.

    Attributes:
        default: Default value, as written in the file.
        unit: Unit; empty for a pure number, and if the file documents none.
        allowed: Allowed range: ``"any"``, ``"> 0"``, ``">= 0"``, ``">= 0 or inf"`` or ``"a whole
            number >= 1"``. Empty if the file documents none: then any text is allowed.
        meaning: Meaning, as documented in the file; empty if it is not.
    """

    default: str
    unit: str = ""
    allowed: str = ""
    meaning: str = ""


def arguments(path: str | Path = XACRO) -> dict[str, Argument]:
    """Return the arguments that a xacro file declares, by name.

    Unit, range and meaning are in the comment behind each argument.

    Raises:
        DataError: If the file cannot be read.
        ModelError: If it is not XML.
    """
    table = {}
    for element in _parse(path).getElementsByTagName("xacro:arg"):
        match = _DOCUMENTED.fullmatch(_comment_behind(element))
        documented = match.groupdict() if match else {}
        table[element.getAttribute("name")] = Argument(
            element.getAttribute("default"), **documented
        )
    return table


def _comment_behind(element: minidom.Element) -> str:
    """Return the comment behind an element on the same line, "" if there is none."""
    node = element.nextSibling
    while node is not None and node.nodeType == Node.TEXT_NODE and "\n" not in node.data:
        node = node.nextSibling
    return node.data.strip() if node is not None and node.nodeType == Node.COMMENT_NODE else ""


def describe(
    path: str | Path = XACRO,
    values: Mapping[str, object] | None = None,
    *,
    visuals: bool = True,
    packages: Mapping[str, str | Path] | None = None,
) -> str:
    """Expand a xacro file into a plain URDF without comments.

    A xacro file is a program: its ``${}`` are Python expressions, and it can read other files.
    Expand only files that you would also run; otherwise use a plain URDF.

    Args:
        path: The xacro file.
        values: Values of its arguments by name, numbers or text.
        visuals: False omits the visuals of this project's cranes, which is much faster; other files
            are not affected.
        packages: Folders of ROS packages by name, for ``$(find NAME)``; others are looked for, see
            `package_folder`.

    Raises:
        UnknownName: If the file declares no argument of a name (xacro itself would ignore it).
        OutOfRange: If a value is not a number in the range that the file documents.
        DataError: If the file cannot be read.
        ModelError: If the file cannot be expanded.
    """
    bundled = Path(path).parent == XACRO.parent and Path(path).is_file()
    # Another file is parsed also without values: `_parse` refuses what xacro should not be given.
    declared = {} if bundled and not values else arguments(path)
    mappings = {"visuals": "false"} if bundled and not visuals else {}
    for name, value in (values or {}).items():
        if name not in declared:
            raise UnknownName("argument", name, declared)
        argument = declared[name]
        if argument.allowed:
            mappings[name] = repr(number(name, value, argument.unit, argument.allowed))
        else:
            mappings[name] = str(value)
    settings = tuple(mappings.items())
    if not bundled:
        return _expand(str(path), settings, packages)
    files = [file.stat() for file in sorted(XACRO.parent.glob("*.xacro"))]
    versions = tuple((file.st_mtime_ns, file.st_size) for file in files)
    return _expand_cached(str(path), settings, versions)


@lru_cache(maxsize=64)
def _expand_cached(
    path: str, mappings: tuple[tuple[str, str], ...], versions: tuple[tuple[int, int], ...]
) -> str:
    """Return the expansion of a file of this project, see `_expand`.

    Times and sizes of the files are an argument, so that an expansion is not reused once one of
    them has changed.
    """
    sources = {file.name: read_text(file) for file in sorted(XACRO.parent.glob("*.xacro"))}
    if not _read_only_each_other(sources):
        return _expand(path, mappings)
    name = digest_of_parts(
        *_expander(),
        Path(path).name,
        repr(sorted(mappings)),
        *[part for source in sources.items() for part in source],
    )
    kept = read_kept(name)
    if kept is not None:
        return kept.decode()
    expansion = _expand(path, mappings)
    keep(name, expansion.encode())
    return expansion


@lru_cache(maxsize=1)
def _expander() -> tuple[str, ...]:
    """Return what an expansion depends on besides the xacro files and the values of their
    arguments: this file, xacro, and Python, whose expressions they contain.
    """
    texts = [Path(__file__).read_text("utf-8"), sys.version]
    spec = find_spec("xacro")  # which does not import it
    for folder in (spec and spec.submodule_search_locations) or ():
        texts += [file.read_text("utf-8") for file in sorted(Path(folder).glob("*.py"))]
    return tuple(texts)


_SUBSTITUTION = re.compile(r"\$\((?!arg\s)")
"""A substitution of xacro other than an argument: it may read the environment or other folders."""

_INCLUDE = re.compile(r"<xacro:include\b(?P<attributes>[^>]*)>")
"""An element that includes another file."""

_INCLUDED_NAME = re.compile(r"""\s+filename=["'](?P<name>[\w.]+)["']\s*/?""")
"""The attributes of such an element that name one file without a folder, and nothing else."""


def _read_only_each_other(sources: Mapping[str, str]) -> bool:
    """Return whether the expansion of some xacro files depends on these files and on the values of
    their arguments only: not on the environment, nor on files elsewhere.

    So it is with those of this project. Somebody may have changed them.

    Args:
        sources: Texts by the names of the files.
    """
    for text in sources.values():
        if _SUBSTITUTION.search(text) or "load_yaml" in text:
            return False
        for include in _INCLUDE.finditer(text):
            named = _INCLUDED_NAME.fullmatch(include["attributes"])
            if named is None or named["name"] not in sources:
                return False
    return True


def _expand(
    path: str,
    mappings: tuple[tuple[str, str], ...],
    packages: Mapping[str, str | Path] | None = None,
) -> str:
    """Return the expansion of a xacro file.

    Args:
        path: The file.
        mappings: Names and values of its arguments.
        packages: Folders of ROS packages by name.
    """
    # The import takes a while, and where the expansion was kept, nobody needs it.
    import xacro

    missing: list[ModelError] = []

    def find(name: str) -> str:
        """Return the folder of a package for xacro."""
        try:
            return str(package_folder(name, path, packages))
        except ModelError as error:
            # Xacro wraps it in errors of its own, whose text repeats it and names its class.
            missing.append(error)
            raise

    try:
        with _XACRO_LOCK, contextlib.redirect_stderr(io.StringIO()), _packages_found_by(find):
            # Xacro keeps one text node in its module and inserts it into documents. It is renewed
            # here: an interrupted expansion may have left it broken, so that every later one would
            # fail.
            xacro._empty_text_node = minidom.Document().createTextNode("\n\n")
            document = xacro.process_file(path, mappings=dict(mappings))
        _strip_comments(document)
        lines = document.toprettyxml(indent="  ").splitlines()
        return "\n".join(line for line in lines if line.strip()) + "\n"
    except ModelError:
        raise
    except Exception as error:
        # Xacro wraps a KeyboardInterrupt in an error of its own.
        if interrupted(error):
            raise KeyboardInterrupt from None
        if missing:
            raise missing[0] from None
        raise ModelError(
            f"{path} cannot be expanded: {str(error) or type(error).__name__}."
        ) from error


@contextlib.contextmanager
def _packages_found_by(find: Callable[[str], str]) -> Iterator[None]:
    """Let xacro take the folder of a ROS package from a function; otherwise it asks ROS."""
    from xacro import substitution_args

    asking_ros = substitution_args._eval_find
    try:
        substitution_args._eval_find = find
        yield
    finally:
        substitution_args._eval_find = asking_ros


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
        f"{source} needs the ROS package {quoted(name)}, which was not found; name its folder by "
        f"packages={{{name!r}: folder}}, or --package {name}=FOLDER."
    )


def _candidates(name: str, source: Path) -> Iterator[Path]:
    """Yield folders in which a ROS package may be, see `package_folder`."""
    above = source.parents[: _SEARCHED_LEVELS + 1]
    yield from above
    for folder in above[1:]:
        for pattern in ("*/package.xml", "*/*/package.xml"):
            yield from sorted(path.parent for path in folder.glob(pattern))
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / name
    for root in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if root:
            yield Path(root)
            yield Path(root) / name


def _package_name(folder: Path) -> str:
    """Return the name in a ``package.xml``, "" if it cannot be read."""
    path = folder / "package.xml"
    try:
        return (parse_urdf(read_text(path), path).findtext("name") or "").strip()
    except CraneError:
        return ""


def _parse(path: str | Path) -> minidom.Document:
    """Return a xacro file with its comments."""
    text = read_text(path)
    parse_urdf(text, path)  # refuses document types and great depth, which minidom does not
    return minidom.parseString(text)


def _strip_comments(node: minidom.Node) -> None:
    """Remove all comments below a node."""
    for child in list(node.childNodes):
        if child.nodeType == Node.COMMENT_NODE:
            node.removeChild(child)  # type: ignore[misc]
        else:
            _strip_comments(child)
