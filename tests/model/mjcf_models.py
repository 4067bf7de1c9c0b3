"""Random models in MJCF: trees of slides and hinges that use what the format has in many ways."""

from __future__ import annotations

import random
from dataclasses import dataclass, field


@dataclass
class RandomModel:
    """A random model under construction.

    Attributes:
        draw: Source of random numbers.
        degrees: Whether angles are in degrees, MuJoCo's default.
        names: Names of the joints so far.
        actuators: Texts of the actuators so far.
        count: Number of bodies so far.
    """

    draw: random.Random
    degrees: bool
    names: list[str] = field(default_factory=list)
    actuators: list[str] = field(default_factory=list)
    count: int = 0

    def numbers(self, low: float, high: float, count: int) -> str:
        """Return random numbers as text."""
        return " ".join(f"{self.draw.uniform(low, high):.4g}" for _ in range(count))

    def angle(self, radians: float) -> str:
        """Return an angle in the unit of the file."""
        return f"{radians * 57.29577951308232 if self.degrees else radians:.6g}"

    def maybe(self, text: str, chance: float = 0.5) -> str:
        """Return a text or nothing."""
        return text if self.draw.random() < chance else ""

    def pose(self) -> str:
        """Return attributes that place a body, a frame or a geom."""
        position = f'pos="{self.numbers(-1.0, 1.0, 3)}"'
        turned = self.draw.choice(["", "euler", "quat", "axisangle", "xyaxes", "zaxis"])
        if turned == "euler":
            angles = " ".join(self.angle(self.draw.uniform(-1.5, 1.5)) for _ in range(3))
            return f'{position} euler="{angles}"'
        if turned == "axisangle":
            angle = self.angle(self.draw.uniform(-2.0, 2.0))
            return f'{position} axisangle="{self.numbers(0.2, 1.0, 3)} {angle}"'
        count = {"quat": 4, "xyaxes": 6, "zaxis": 3}.get(turned, 0)
        return f'{position} {turned}="{self.numbers(0.1, 1.0, count)}"' if turned else position

    def joint(self, *, driven: bool) -> str:
        """Return a joint, and add its actuator if it is driven."""
        slide = self.draw.random() < (0.6 if driven else 0.1)
        name = f"j{len(self.names)}"
        self.names.append(name)
        reference = self.maybe(f"{self.draw.uniform(-0.3, 0.3):.4g}", 0.3)
        if slide:
            ends = f"{self.draw.uniform(-5.0, -1.0):.4g} {self.draw.uniform(1.0, 5.0):.4g}"
        else:
            low = self.draw.uniform(-2.5, -0.8)
            high = self.draw.uniform(0.8, 2.5)
            ends = f"{self.angle(low)} {self.angle(high)}"
            reference = reference and self.angle(float(reference))
        attributes = [
            f'name="{name}" type="{"slide" if slide else "hinge"}"',
            f'axis="{self.numbers(-1.0, 1.0, 3)}"',
            self.maybe(f'pos="{self.numbers(-0.5, 0.5, 3)}"'),
            self.maybe(f'range="{ends}"', 0.8),
            f'ref="{reference}"' if reference else "",
            self.maybe(f'damping="{self.draw.uniform(0.0, 3.0):.4g}"'),
            self.maybe(f'armature="{self.draw.uniform(0.0, 2.0):.4g}"', 0.3),
            self.maybe(f'frictionloss="{self.draw.uniform(0.1, 2.0):.4g}"', 0.2),
        ]
        if not driven and self.draw.random() < 0.3:
            attributes.append(f'stiffness="{self.draw.uniform(5.0, 50.0):.4g}"')
            attributes.append(self.maybe(f'springref="{self.angle(0.1)}"'))
        if driven:
            self._add_actuator(name)
        return f"<joint {' '.join(attributes)}/>"

    def _add_actuator(self, joint: str) -> None:
        force = self.draw.uniform(100.0, 900.0)
        kind = self.draw.choice(["motor", "general", "position", "velocity"])
        attributes = [
            f'joint="{joint}"',
            self.maybe(f'gear="{self.draw.uniform(-30.0, 30.0):.4g}"'),
            self.maybe(f'ctrlrange="{-force:.4g} {force * self.draw.choice([1.0, 0.4]):.4g}"'),
            self.maybe(f'forcerange="{-0.7 * force:.4g} {0.7 * force:.4g}"'),
        ]
        if kind == "position":
            attributes.append('kp="50"')
        if kind == "velocity":
            attributes.append('kv="5"')
        self.actuators.append(f"<{kind} {' '.join(attributes)}/>")

    def geom(self) -> str:
        """Return a geom with a mass."""
        mass = self.draw.choice(
            [f'mass="{self.draw.uniform(1.0, 50.0):.4g}"', f'density="{self.numbers(50, 900, 1)}"']
        )
        kind = self.draw.choice(["box", "sphere", "cylinder", "capsule", "ellipsoid", "fromto"])
        group = f'group="{self.draw.randrange(5)}"'
        if kind == "fromto":
            ends = self.numbers(-0.5, 0.5, 6)
            return f'<geom type="capsule" fromto="{ends}" size="0.1" {mass} {group}/>'
        size = self.numbers(0.1, 0.4, 3)
        return f'<geom type="{kind}" size="{size}" {self.pose()} {mass} {group}/>'

    def inertial(self) -> str:
        """Return an inertial element, with a full or a diagonal inertia."""
        mass = self.draw.uniform(2.0, 80.0)
        moments = [mass * self.draw.uniform(0.05, 0.09) for _ in range(3)]
        pose = self.pose()
        if self.draw.random() < 0.5:
            text = " ".join(f"{moment:.5g}" for moment in moments)
            return f'<inertial {pose} mass="{mass:.5g}" diaginertia="{text}"/>'
        off = [0.1 * moments[0] * self.draw.uniform(-1.0, 1.0) for _ in range(3)]
        text = " ".join(f"{number:.5g}" for number in (*moments, *off))
        position = " ".join(pose.split(" ")[:3])
        return f'<inertial {position} mass="{mass:.5g}" fullinertia="{text}"/>'

    def body(self, depth: int, *, driven: bool) -> str:
        """Return a body with what hangs on it."""
        self.count += 1
        name = f"b{self.count}"
        parts = [self.joint(driven=driven) for _ in range(self.draw.choice([1, 1, 1, 2]))]
        if self.draw.random() < 0.4:
            parts.append(self.inertial())
        for _ in range(self.draw.choice([1, 1, 2])):
            parts.append(self.geom())
        if self.draw.random() < 0.3:
            parts.append(f"<frame {self.pose()}>{self.geom()}</frame>")
        if self.draw.random() < 0.2:
            offset = self.numbers(0.1, 0.3, 3)
            euler = " ".join(self.angle(angle) for angle in (0.0, 0.0, 0.4))
            parts.append(
                f'<replicate count="3" offset="{offset}" euler="{euler}">{self.geom()}</replicate>'
            )
        if depth > 1:
            child = self.body(depth - 1, driven=driven and self.draw.random() < 0.5)
            parts.append(f"<frame {self.pose()}>{child}</frame>" if self.maybe("x", 0.3) else child)
        if self.draw.random() < 0.2:  # a body that is welded to this one
            parts.append(f"<body {self.pose()}>{self.geom()}</body>")
        return f'<body name="{name}" {self.pose()}>{"".join(parts)}</body>'


def random_model(seed: int) -> str:
    """Return a random model as the text of an MJCF file, another one for each seed."""
    draw = random.Random(seed)
    model = RandomModel(draw, degrees=draw.random() < 0.5)
    compiler = [
        "" if model.degrees and draw.random() < 0.5 else None,
        model.maybe(f'eulerseq="{draw.choice(["xyz", "zyx", "XYZ", "ZXY", "xZy"])}"'),
        model.maybe('inertiafromgeom="true"', 0.2),
        model.maybe('inertiagrouprange="0 2"', 0.1),
        model.maybe('balanceinertia="true"', 0.1),
    ]
    if compiler[0] is None:
        compiler[0] = f'angle="{"degree" if model.degrees else "radian"}"'
    gravity = draw.choice(["", f'<option gravity="0 0 {-draw.uniform(1.0, 12.0):.4g}"/>'])
    # Nothing collides: some of the random shapes lie in each other.
    default = f'<geom contype="0" conaffinity="0" density="{draw.uniform(100, 900):.4g}"/>'
    damped = f'<joint damping="{draw.uniform(0.0, 2.0):.4g}"/>'
    post = f'<geom type="box" size="0.1 0.1 1" mass="70" {model.pose()}/>'
    tree = model.body(draw.choice([2, 3, 4]), driven=True)
    return (
        f'<mujoco model="m{seed}"><compiler {" ".join(filter(None, compiler))}/>{gravity}'
        f"<default>{default}{model.maybe(damped)}</default>"
        f"<worldbody>{model.maybe(post)}{tree}</worldbody>"
        f"<actuator>{''.join(model.actuators)}</actuator></mujoco>"
    )
