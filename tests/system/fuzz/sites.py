"""Sites of strangers: meshes, prisms and building models that are nearly flat, of any scale, far
away, or of corners that there are not.
"""

from __future__ import annotations

import importlib
import math
import os
import re
import runpy
import signal
import sys
import tempfile
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import NoReturn
from unittest.mock import patch

import coal
import numpy as np
import trimesh

from cranedyn.errors import CraneError
from cranedyn.planning import bim
from cranedyn.planning.bim import read_ifc
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.lift import crane_of
from cranedyn.planning.site_file import read_site
from cranedyn.planning.solids import Solid, body, box, prism, read_mesh
from tests.system.fuzz.core import Broken, Case, Generator
from tests.system.fuzz.files import Edited, ended

# --- what is done with a site ---------------------------------------------------------------------


@cache
def _meshes() -> dict[str, bytes]:
    """Good meshes in every format that is read."""
    whole = trimesh.creation.box([1.0, 2.0, 1.5])
    angle = trimesh.util.concatenate([whole, trimesh.creation.icosphere(1, 0.4)])
    made = {
        "box.stl": whole.export(file_type="stl"),
        "words.stl": whole.export(file_type="stl_ascii"),
        "angle.ply": angle.export(file_type="ply", encoding="ascii"),
        "bytes.ply": angle.export(file_type="ply"),
        "angle.off": angle.export(file_type="off"),
        "angle.obj": angle.export(file_type="obj"),
    }
    return {
        name: content if isinstance(content, bytes) else content.encode()
        for name, content in made.items()
    }


def furnished(folder: Path) -> None:
    """Put the meshes that sites name into a folder."""
    for name, content in _meshes().items():
        (folder / name).write_bytes(content)


def stood(path: Path) -> None:
    """Have a crane stand on the site of a file, and ask how near it is to all that is there."""
    site = read_site(path)
    crane = crane_of(site)
    asked = Clearance(crane, site)
    for q in (crane.start.q, crane.state(gamma=1.0).q):
        distances = [one.distance for one in asked.distances(q).values()]
        if not np.isfinite(distances).all():
            raise Broken("a site was read of which a distance is not finite", distances)
    for point in (site.start, site.goal):
        if point is not None and math.isnan(room := asked.swing_margin(asked.place(point))):
            raise Broken("a site was read of which a room is not a number", room)


def away(solid: Solid, centre: np.ndarray) -> float:
    """How far from a point a body is [m], as `coal` says it."""
    probe, place = coal.Sphere(1e-3), coal.Transform3s(np.eye(3), centre)
    found = [
        coal.distance(
            shape, coal.Transform3s.Identity(), probe, place, coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        for shape in solid.geometries()
    ]  # fmt: skip
    if not np.isfinite(found).all():
        raise Broken("a body was made whose distance is not finite", found)
    return min(found)


def _mesh(content: bytes, which: int, folder: Path) -> str:
    path = folder / list(_meshes())[which]
    path.write_bytes(content)
    return ended(lambda: measured(path))


def measured(path: Path) -> None:
    """Read a mesh, and have it and its hull measured from some points: a hull is never smaller."""
    vertices, triangles = read_mesh(path)
    hull = body("h", vertices, triangles, as_hull=True)
    size = float(np.abs(hull.vertices).max())
    low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    points = [high + 1.0, (low + high) / 2.0, low - np.array([0.0, 2.0, 0.0])]
    far = [away(hull, point) for point in points]
    try:
        exact = body("e", vertices, triangles)
    except CraneError:  # of those that are not closed only the hull stands
        return
    for point, most in zip(points, far, strict=True):
        if max(most, 0.0) > max(away(exact, point), 0.0) + 1e-4 + 1e-8 * size:
            raise Broken("a hull is farther away than the mesh", (point, most))


# --- shapes ---------------------------------------------------------------------------------------

_SHAPES = ("box", "tetrahedron", "fan", "cloud", "angle", "line", "point", "twice")


@dataclass(frozen=True)
class Shapes:
    """Bodies of few corners, stretched along each axis by any power of ten and put anywhere, with
    some of their numbers or corners replaced; as a mesh of any format, a prism or a box.
    """

    name: str = "file mesh, shapes"
    weight: float = 2.0
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """What it is, how it is stretched, where it is, and what is replaced."""
        near = rng.random() < 0.5
        stretch = [10.0 ** (rng.uniform(-10.0, 9.0) if rng.random() < 0.4 else 0.0)
                   for _ in range(3)]  # fmt: skip
        offset = [rng.choice([0.0, 0.0, 1.0, -1.0]) * 10.0 ** rng.uniform(-3.0, 4.0 if near else 17)
                  for _ in range(3)]  # fmt: skip
        kind = rng.choice(["stl", "ply", "off", "obj", "body", "prism", "zone", "box"])
        numbers = ("nan", "inf", "-inf", "1e300", "1e-300", "0", "1e7", "1e16", "x")
        corners = ("-1", "4", "99", "2147483648", "99999999999999999999", "0", "1.5", "-99")
        parts = [
            (what, rng.random(), rng.choice(numbers if what == "number" else corners))
            for what in rng.choices(["number", "corner"], k=rng.choice([0, 0, 0, 1, 1, 2]))
        ]
        head = kind, rng.choice(_SHAPES), rng.randrange(1000), stretch, offset, rng.random() < 0.5
        return Case(head, parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Make it and measure distances from it."""
        kind, _, _, stretch, offset, as_hull = case.head
        points, triangles = self._made(case)
        if kind in ("stl", "ply", "off", "obj"):
            path = folder / f"a.{kind}"
            path.write_text(_WRITTEN[kind](points, triangles))
            return ended(lambda: measured(path))
        try:
            numbers = np.array([[float(word) for word in point] for point in points])
            corners = np.array([[int(word) for word in one] for one in triangles])
        except ValueError:
            return "no numbers"
        if kind == "body":
            return ended(lambda: _stands(body("b", numbers, corners, as_hull=as_hull)))
        if kind == "box":
            centre, size = offset[:2], [abs(part) for part in stretch]
            return ended(lambda: _stands(box("b", centre, size, offset[2], 0.3)))
        outline, height = numbers[:, :2], abs(float(numbers[0, 2] - numbers[-1, 2]))
        return ended(lambda: _stands(prism("p", outline, offset[2], height, zone=kind == "zone")))

    def shown(self, case: Case) -> str:
        """Its corners and triangles."""
        return f"{case.head} {case.parts}: {self._made(case)}"

    def _made(self, case: Case) -> tuple[list[list[str]], list[list[str]]]:
        """Corners and triangles, as they are written."""
        _, shape, seed, stretch, offset, _ = case.head
        corners, triangles = _shape(shape, np.random.default_rng(seed))
        corners = corners * stretch + offset
        points = [[repr(part) for part in corner] for corner in corners.tolist()]
        faces = [[str(part) for part in one] for one in triangles.tolist()]
        for what, share, new in case.parts:
            table = points if what == "number" else faces
            at = int(share * 3 * len(table))
            table[at // 3][at % 3] = new
        return points, faces


def _shape(shape: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Corners of about 1 m and triangles; what has no body of its own has those of a fan."""
    if shape in ("box", "twice"):
        made = trimesh.creation.box([1.0, 1.0, 1.0])
        corners, triangles = np.array(made.vertices), np.array(made.faces)
        return corners, np.vstack([triangles, triangles]) if shape == "twice" else triangles
    if shape == "tetrahedron":
        corners = np.vstack([np.zeros(3), np.eye(3)])
        return corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    if shape == "angle":
        corners = np.array(
            [[x, y, z] for z in (0, 1) for x, y in [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]]
        )
        top = np.array([[0, 1, 3], [1, 2, 3], [0, 3, 5], [3, 4, 5]])
        sides = [[[i, (i + 1) % 6, i + 6], [(i + 1) % 6, (i + 1) % 6 + 6, i + 6]] for i in range(6)]
        return corners.astype(float), np.vstack([top[:, ::-1], top + 6, *sides])
    count = int(rng.integers(4, 12))
    corners = rng.normal(size=(count, 3))
    if shape in ("fan", "line"):
        corners[:, 2 if shape == "fan" else 1 :] = 0.0
    if shape == "point":
        corners[:] = corners[0]
    return corners, np.array([[0, i, i + 1] for i in range(1, count - 1)])


def _stands(solid: Solid) -> None:
    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    inside, outside = away(solid, (low + high) / 2.0), away(solid, high + 1.0)
    least = min(1.0, outside)
    if outside <= 0.5 * least or inside > outside + np.linalg.norm(high - low):
        raise Broken("a body stands where it is not", (low, high, inside, outside))


def _stl(points: list[list[str]], triangles: list[list[str]]) -> str:
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {' '.join(_corner(points, word))}\n" for word in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles
    ]
    return f"solid a\n{''.join(facets)}endsolid a\n"


def _corner(points: list[list[str]], word: str) -> list[str]:
    """The corner of a number; STL has corners themselves, and so none that there are not."""
    return points[int(float(word)) % len(points)]


def _ply(points: list[list[str]], triangles: list[list[str]]) -> str:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty double x\nproperty double "
        f"y\nproperty double z\nelement face {len(triangles)}\nproperty list uchar int "
        "vertex_indices\nend_header\n"
    )
    return head + _rows("", points) + _rows("3 ", triangles)


def _off(points: list[list[str]], triangles: list[list[str]]) -> str:
    return f"OFF\n{len(points)} {len(triangles)} 0\n{_rows('', points)}{_rows('3 ', triangles)}"


def _obj(points: list[list[str]], triangles: list[list[str]]) -> str:
    from_one = [
        [str(int(word) + 1) if re.fullmatch(r"\d+", word) else word for word in triangle]
        for triangle in triangles
    ]
    return _rows("v ", points) + _rows("f ", from_one)


def _rows(start: str, rows: list[list[str]]) -> str:
    return "".join(f"{start}{' '.join(row)}\n" for row in rows)


_WRITTEN = {"stl": _stl, "ply": _ply, "off": _off, "obj": _obj}


# --- building models ------------------------------------------------------------------------------

_IFC = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('ViewDefinition[DesignTransferView]'),'2;1');
FILE_NAME('/dev/null','2026-01-01T00:00:00+00:00',(''),(''),'','','Nobody');
FILE_SCHEMA(('IFC4'));
ENDSEC;
DATA;
#1=IFCPROJECT('2DRAALP491reUilx2BFbo1',$,'test',$,$,$,$,(#10),#5);
#2=IFCSIUNIT(*,.LENGTHUNIT.,$,.METRE.);
#3=IFCSIUNIT(*,.AREAUNIT.,$,.SQUARE_METRE.);
#4=IFCSIUNIT(*,.PLANEANGLEUNIT.,$,.RADIAN.);
#5=IFCUNITASSIGNMENT((#2,#3,#4));
#6=IFCCARTESIANPOINT((0.,0.,0.));
#7=IFCDIRECTION((0.,0.,1.));
#8=IFCDIRECTION((1.,0.,0.));
#9=IFCAXIS2PLACEMENT3D(#6,#7,#8);
#10=IFCGEOMETRICREPRESENTATIONCONTEXT($,'Model',3,1.E-05,#9,$);
#11=IFCGEOMETRICREPRESENTATIONSUBCONTEXT('Body','Model',*,*,*,*,#10,$,.MODEL_VIEW.,$);
#12=IFCSLAB('0cDKIKrrXB19fWMNyRvx89',$,'deck',$,$,#14,#19,$,$);
#13=IFCCARTESIANPOINT((5.,-4.,3.));
#14=IFCLOCALPLACEMENT($,#15);
#15=IFCAXIS2PLACEMENT3D(#13,#7,#8);
#16=IFCRECTANGLEPROFILEDEF(.AREA.,$,$,10.,8.);
#17=IFCEXTRUDEDAREASOLID(#16,$,#7,0.3);
#18=IFCSHAPEREPRESENTATION(#11,'Body','SweptSolid',(#17));
#19=IFCPRODUCTDEFINITIONSHAPE($,$,(#18));
#20=IFCOPENINGELEMENT('3ADUGZ8jr6Bfk2DWfieAwM',$,'hole',$,$,#14,#29,$,$);
#21=IFCCARTESIANPOINT((0.,0.));
#22=IFCCARTESIANPOINT((2.,0.));
#23=IFCCARTESIANPOINT((2.,2.));
#24=IFCCARTESIANPOINT((0.,2.));
#25=IFCPOLYLINE((#21,#22,#23,#24,#21));
#26=IFCARBITRARYCLOSEDPROFILEDEF(.AREA.,$,#25);
#27=IFCEXTRUDEDAREASOLID(#26,$,#7,2.);
#28=IFCSHAPEREPRESENTATION(#11,'Body','SweptSolid',(#27));
#29=IFCPRODUCTDEFINITIONSHAPE($,$,(#28));
#30=IFCRELVOIDSELEMENT('0Pj5lSwhj9CepJmd1UoSHR',$,$,$,#12,#20);
#31=IFCCOLUMN('0L8pPy3bD9ch9dDwcO5Idp',$,'column',$,$,#14,#35,$,$);
#32=IFCCIRCLEPROFILEDEF(.AREA.,$,$,0.4);
#33=IFCEXTRUDEDAREASOLID(#32,#9,#7,3.);
#34=IFCSHAPEREPRESENTATION(#11,'Body','SweptSolid',(#33));
#35=IFCPRODUCTDEFINITIONSHAPE($,$,(#34));
#36=IFCBUILDINGELEMENTPROXY('1L8pPy3bD9ch9dDwcO5Idp',$,'faces',$,$,#14,#40,$,$);
#37=IFCCARTESIANPOINTLIST3D(((0.,0.,0.),(1.,0.,0.),(0.,1.,0.),(0.,0.,1.)));
#38=IFCTRIANGULATEDFACESET(#37,$,.T.,((1,3,2),(1,2,4),(2,3,4),(3,1,4)),$);
#39=IFCSHAPEREPRESENTATION(#11,'Body','Tessellation',(#38));
#40=IFCPRODUCTDEFINITIONSHAPE($,$,(#39));
ENDSEC;
END-ISO-10303-21;
"""
"""A slab with an opening, a column, and triangles."""


@cache
def _imported() -> None:
    """Import what takes a second, if it is there."""
    with suppress(ModuleNotFoundError):
        importlib.import_module("ifcopenshell.geom")


class _Forked:
    """In the place of the process that reads a building model: a fork of this one, which has
    imported what that needs.
    """

    def __init__(self, words: list[str], **_: object) -> None:
        """Run the program that the words name."""
        self._files = [tempfile.TemporaryFile() for _ in range(2)]
        self.returncode = 0
        _imported()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads that a fork leaves
            self.pid = os.fork()
        if not self.pid:
            _become(words[-2:], [file.fileno() for file in self._files])

    def communicate(self) -> tuple[bytes, bytes]:
        """What it wrote until it ended."""
        _, status = os.waitpid(self.pid, 0)
        self.returncode = os.waitstatus_to_exitcode(status)
        said = []
        for file in self._files:
            with file:
                file.seek(0)
                said.append(file.read())
        return said[0], said[1]


def _become(words: list[str], files: list[int]) -> NoReturn:
    """Be a program with a file for its output and one for its errors."""
    code = 1
    try:
        for stream, file in enumerate(files, start=1):
            os.dup2(file, stream)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        sys.argv = words
        sys.stdout, sys.stderr = (open(stream, "w", closefd=False) for stream in (1, 2))
        runpy.run_path(words[0], run_name="__main__")
        code = 0
    except SystemExit as end:
        print(end.code, file=sys.stderr)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _ifc(content: bytes, which: int, folder: Path) -> str:
    path = folder / "a.ifc"
    path.write_bytes(content)
    with (
        patch.object(bim.subprocess, "Popen", _Forked),
        patch("cranedyn.recording.process.guard"),
        patch("cranedyn.recording.process.end"),
    ):
        return ended(lambda: [away(solid, np.zeros(3)) for solid in read_ifc(path)])


@dataclass(frozen=True)
class Models:
    """Building models with numbers, references and kinds of entities replaced."""

    name: str = "file IFC, entities"
    weight: float = 0.5
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """What is replaced, where, and by what."""
        kinds = ["number", "number", "reference", "reference", "kind", "drop", "word"]
        numbers = ("0.", "-1.", "1E-10", "1E9", "1E300", "1E400", "NAN", "5", "99999999999", "$")
        parts = [
            (rng.choice(kinds), rng.random(), rng.random(), rng.choice(numbers))
            for _ in range(rng.choice([1, 1, 2, 3]))
        ]
        return Case(None, parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Read it and measure a distance from all that it has."""
        return _ifc(self._text(case).encode(), 0, folder)

    def shown(self, case: Case) -> str:
        """Lines that differ."""
        good = _IFC.splitlines()
        return "\n".join(line for line in self._text(case).splitlines() if line not in good)

    def _text(self, case: Case) -> str:
        head, text = _IFC.split("DATA;")
        for what, first, second, new in case.parts:
            pattern = {
                "number": r"(?<=[(,])-?\d+\.?[-+E\d]*(?=[,)])",
                "reference": r"(?<=[(,])#\d+",
                "kind": r"(?<==)IFC\w+",
                "drop": r"(?m)^#.*\n",
                "word": r"'[^']*'|\$|\.\w+\.",
            }[what]
            found = list(re.finditer(pattern, text))
            if not found:
                continue
            one, other = (found[int(share * len(found))] for share in (first, second))
            if what == "drop":
                new = ""
            elif what != "number" and first < 0.9:
                new = other[0]
            text = text[: one.start()] + new + text[one.end() :]
        return f"{head}DATA;{text}"


GENERATORS: list[Generator] = [
    Edited("file mesh, bytes", 1.0, lambda: list(_meshes().values()), _mesh),
    Shapes(),
    Edited("file IFC, bytes", 0.3, lambda: [_IFC.encode()], _ifc),
    Models(),
]
