"""SDF by others: random files, what libsdformat makes of them, and their dynamics by screws.

The dynamics know nothing of link frames: with the axes of all joints in the world at zero, a body
moves by the product of the exponentials of the screws that carry it (Lynch and Park, Modern
Robotics, chapters 4 and 8).
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from tests.objects import made_once

PROBE = Path(__file__).with_name("sdformat_probe.cc")

TYPES_OF_SDFORMAT = {3: "fixed", 2: "continuous", 5: "prismatic", 6: "revolute", 7: "revolute2",
                     9: "universal"}  # fmt: skip
"""Names of the types of joints that are compared, by their numbers in libsdformat 12."""

LIGHT_MASS = 1e-5
"""Mass of the body between two axes of a joint [kg], as the reader says in its notes."""

LIGHT_INERTIA = 1e-9
"""Moment of inertia of that body [kg m²]."""


@cache
def build_probe() -> Path:
    """Compile the program that prints what libsdformat makes of a file, once for all tests; skip
    without libsdformat.
    """
    compiler = shutil.which("g++")
    config = shutil.which("pkg-config")
    if compiler is None or config is None:
        pytest.skip("g++ or pkg-config is not installed: run .ci/sdformat as root")
    flags = subprocess.run(
        [config, "--cflags", "--libs", "sdformat12"], capture_output=True, text=True, check=False
    )
    if flags.returncode:
        pytest.skip("libsdformat is not installed: run .ci/sdformat as root")
    words = [compiler, "-O0", "-std=c++17", str(PROBE), *flags.stdout.split(), "-o"]
    name = f"sdformat_probe_{hashlib.sha256(PROBE.read_bytes()).hexdigest()}"
    return made_once(name, lambda file: subprocess.run([*words, str(file)], check=True))


@dataclass
class Body:
    """A body in the world with all joints at zero.

    Attributes:
        mass: Mass [kg].
        pose: Pose of its principal frame, shape (4, 4).
        inertia: Inertia about its centre in that frame [kg m²], shape (3, 3).
        carriers: Names of the axes that move it, from the ground up.
    """

    mass: float
    pose: np.ndarray
    inertia: np.ndarray
    carriers: list[str] = field(default_factory=list)


@dataclass
class Tree:
    """What moves, as libsdformat says it.

    Attributes:
        bodies: The bodies.
        screws: Screws of the axes in the world, (ω, v) of shape (6,), by name.
        springs: Stiffness, reference and damping of the first axis of each joint, shape (3,).
    """

    bodies: list[Body]
    screws: dict[str, np.ndarray]
    springs: dict[str, np.ndarray]


def read_with_libsdformat(probe: Path, files: Sequence[Path]) -> list[Tree]:
    """Return bodies and axes of files as libsdformat resolves them, all read by one process."""
    run = subprocess.run([probe, *files], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    _, *texts = run.stdout.split("file\n")
    assert len(texts) == len(files)
    return [_tree(text) for text in texts]


def _tree(text: str) -> Tree:
    """Return the bodies and axes that the lines of a file tell."""
    bodies: dict[str, Body] = {}
    parents: dict[str, str] = {}
    axes_above: dict[str, list[str]] = {}
    screws: dict[str, np.ndarray] = {}
    springs: dict[str, np.ndarray] = {}
    extra: list[tuple[str, int, Body]] = []
    for line in text.splitlines():
        kind, name, *words = line.split()
        if kind == "link":
            numbers = [float(word) for word in words]
            xx, yy, zz, xy, xz, yz = numbers[15:]
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            pose = _matrix(numbers[:7]) @ _matrix(numbers[8:15])
            bodies[name] = Body(numbers[7], pose, tensor)
        elif kind == "spring":
            springs[name] = np.array([float(word) for word in words])
        elif kind == "joint":
            joint_type = TYPES_OF_SDFORMAT[int(words[0])]
            parent = words[1]
            child = words[2]
            prefix = name.rpartition("::")[0]
            scope = f"{prefix}::" if prefix else ""
            pose = _matrix([float(word) for word in words[3:10]])
            parents[scope + child] = parent if parent == "world" else scope + parent
            directions = np.array([float(word) for word in words[10:]]).reshape(-1, 3)
            single = len(directions) == 1
            names = [name] if single else [f"{name}_axis", f"{name}_axis2"]
            axes_above[scope + child] = []
            for i, direction in enumerate(directions):
                linear = np.cross(pose[:3, 3], direction)
                turning = joint_type != "prismatic"
                screw = np.hstack([direction, linear] if turning else [0, 0, 0, *direction])
                screws[names[i]] = screw
                axes_above[scope + child].append(names[i])
            if not single and len(directions):
                between = Body(LIGHT_MASS, pose, LIGHT_INERTIA * np.eye(3))
                extra.append((scope + child, 1, between))
    for name, body in bodies.items():
        body.carriers = _carriers(name, parents, axes_above)
    for child, count, body in extra:
        chain = _carriers(child, parents, axes_above)
        body.carriers = chain[: len(chain) - len(axes_above[child]) + count]
    between_axes = [body for _, _, body in extra]
    return Tree([*bodies.values(), *between_axes], screws, springs)


def _carriers(link: str, parents: dict[str, str], axes: dict[str, list[str]]) -> list[str]:
    chain: list[str] = []
    while link in parents:
        chain = axes[link] + chain
        link = parents[link]
    return chain


def _matrix(numbers: list[float]) -> np.ndarray:
    """Return the matrix of a position and a quaternion w, x, y, z."""
    w, x, y, z = numbers[3:]
    matrix = np.eye(4)
    matrix[:3, 3] = numbers[:3]
    cross = skew(np.array([x, y, z]))
    matrix[:3, :3] = np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
    return matrix


def skew(vector: np.ndarray) -> np.ndarray:
    """Return the matrix of the cross product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def dynamics(
    tree: Tree, names: list[str], q: np.ndarray, gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return mass matrix and torques of gravity at coordinates of named axes, others at zero."""
    n = len(names)
    mass_matrix = np.zeros((n, n))
    torque = np.zeros(n)
    for body in tree.bodies:
        turn = np.eye(4)
        jacobian = np.zeros((6, n))
        for name in body.carriers:
            if name not in names:
                continue
            i = names.index(name)
            jacobian[:, i] = _adjoint(turn) @ tree.screws[name]
            twist = np.zeros((4, 4))
            twist[:3, :3] = skew(tree.screws[name][:3])
            twist[:3, 3] = tree.screws[name][3:]
            turn = turn @ expm(twist * q[i])
        pose = turn @ body.pose
        rotation = pose[:3, :3]
        centre = pose[:3, 3]
        angular = jacobian[:3]
        linear = jacobian[3:] - skew(centre) @ angular
        inertia = rotation @ body.inertia @ rotation.T
        mass_matrix += body.mass * linear.T @ linear + angular.T @ inertia @ angular
        torque += body.mass * gravity * linear[2]
    return mass_matrix, torque


def _adjoint(pose: np.ndarray) -> np.ndarray:
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = pose[:3, :3]
    matrix[3:, :3] = skew(pose[:3, 3]) @ pose[:3, :3]
    return matrix


class RandomSdf:
    """A random tree in SDF of a version 1.x, with what that version has to place frames."""

    def __init__(self, seed: int, version: int, *, plain: bool = False) -> None:
        """Draw the file.

        Args:
            seed: Seed.
            version: x of the version 1.x.
            plain: Whether all is written in the default frames, as simple readers need it.
        """
        self.rng = np.random.default_rng(seed)
        self.version = version
        self.plain = plain
        self.counter = 0
        nested = version >= 7 and not plain and self.rng.random() < 0.4
        depth = 2 if nested else 1
        body = self._model("crane", depth, top=True)
        self.text = f'<sdf version="1.{version}">{body}</sdf>'

    def _numbers(self, count: int, size: float = 1.0) -> str:
        return " ".join(repr(float(x)) for x in self.rng.normal(size=count) * size)

    def _pose(self, frames: list[str], *, relative: bool = True) -> str:
        """Return a pose, of any format that the version has, or none."""
        if self.rng.random() < 0.15:
            return ""
        attributes = ""
        if relative and frames and not self.plain and self.version >= 7 and self.rng.random() < 0.5:
            attributes += f' relative_to="{self.rng.choice(frames)}"'
        numbers = f"{self._numbers(3)} {self._numbers(3)}"
        if self.version >= 9 and not self.plain:
            draw = self.rng.random()
            if draw < 0.3:
                attributes += ' degrees="true"'
                numbers = f"{self._numbers(3)} {self._numbers(3, 60.0)}"
            elif draw < 0.6:
                attributes += ' rotation_format="quat_xyzw"'
                quaternion = self.rng.normal(size=4)
                quaternion /= np.linalg.norm(quaternion)
                rotation = " ".join(repr(float(x)) for x in quaternion)
                numbers = f"{self._numbers(3)} {rotation}"
        return f"<pose{attributes}>{numbers}</pose>"

    def _inertial(self) -> str:
        if self.rng.random() < 0.1 and not self.plain:
            return ""
        a, b, c = self.rng.uniform(0.1, 1.0, size=3)  # squares of half axes: a box has these
        tensor = (
            f"<inertia><ixx>{b + c}</ixx><iyy>{a + c}</iyy><izz>{a + b}</izz>"
            "<ixy>0.01</ixy><ixz>-0.02</ixz><iyz>0.015</iyz></inertia>"
        )
        pose = self._pose([], relative=False)
        if self.plain:  # DART ignores the rotation
            pose = f"<pose>{self._numbers(3)} 0 0 0</pose>"
        return f"<inertial>{pose}<mass>{self.rng.uniform(0.5, 5.0)}</mass>{tensor}</inertial>"

    def _axis(self, tag: str, frames: list[str], bounded: bool) -> str:
        attribute = ""
        flag = ""
        if not self.plain and self.rng.random() < 0.5:
            if self.version >= 7:
                attribute = f' expressed_in="{self.rng.choice([*frames, "__model__"])}"'
            elif self.version >= 5:
                flag = "<use_parent_model_frame>1</use_parent_model_frame>"
        limit = "<limit><lower>-2</lower><upper>2.5</upper></limit>" if bounded else ""
        return f"<{tag}><xyz{attribute}>{self._numbers(3)}</xyz>{flag}{limit}</{tag}>"

    def _model(self, name: str, depth: int, top: bool = False) -> str:
        """Return a model whose bodies hang on one tree."""
        frames: list[str] = []
        links: list[str] = []
        parts: list[str] = []
        types = ["revolute", "prismatic", "universal", "fixed", "revolute2"]
        if self.version >= 7:
            types.append("continuous")
        if self.plain:
            types = ["revolute", "prismatic"]
        for i in range(int(self.rng.integers(2, 5))):
            link = f"link{i}"
            parts.append(f'<link name="{link}">{self._pose(frames)}{self._inertial()}</link>')
            frames.append(link)
            child = link
            if self.version >= 7 and not self.plain and self.rng.random() < 0.5:
                frame = f"frame{i}"
                attached = f' attached_to="{link}"'
                parts.append(f'<frame name="{frame}"{attached}>{self._pose(frames)}</frame>')
                frames.append(frame)
                child = frame if self.rng.random() < 0.5 else link
            if i or top:
                parent = "world" if i == 0 else str(self.rng.choice(links))
                kind = str(self.rng.choice(types)) if i else "fixed"
                parts.append(self._joint(f"joint{i}", kind, parent, child, frames))
                frames.append(f"joint{i}")
            links.append(link)
        if depth > 1:
            parts.append(self._model("inner", depth - 1))
            placed = f"inner::{self.rng.choice(['link0', 'link1'])}"
            parts.append(self._joint("bridge", "revolute", str(self.rng.choice(links)),
                                     "inner::link0", [*frames, placed]))  # fmt: skip
        attribute = ""
        if self.version >= 8 and not self.plain and self.rng.random() < 0.5:
            attribute = f' placement_frame="{self.rng.choice(frames)}"'
        return f'<model name="{name}"{attribute}>{self._pose([])}{"".join(parts)}</model>'

    def _joint(self, name: str, kind: str, parent: str, child: str, frames: list[str]) -> str:
        axes = ""
        if kind != "fixed":
            axes += self._axis("axis", frames, bounded=kind == "prismatic")
        if kind in ("universal", "revolute2"):
            axes += self._axis("axis2", frames, bounded=False)
        return (
            f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>'
            f"{self._pose(frames)}{axes}</joint>"
        )
