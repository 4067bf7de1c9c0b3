"""Program that compiles an MJCF file by MuJoCo and prints what a crane needs of it.

    python mjcf_compiler.py FILE MEMORY CPU_TIME MAX_JOINTS

MuJoCo's compiler is written in C++, and a file of a stranger may ask it for any amount of memory or
time. So `cranedyn.model.mjcf` runs it in a process of its own, which limits its memory [byte] and
its processor time [s] first; a model of more joints than MAX_JOINTS is refused. It imports nothing
of this package.

The last line of the output is JSON: {"model": …}, see `describe_model`; {"error": sentence} where
MuJoCo refuses the file or a crane cannot be what it describes; or {"missing": true} where MuJoCo is
not installed.

A ball joint is replaced by two hinges about X and Y of its body before the model is compiled: a
rope does not turn its load, and a crane has one coordinate a joint.
"""

import json
import math
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

RANDOM_STATES = 3
"""Number of random states at which MuJoCo's accelerations are printed, for comparison."""

TEST_RATES = (1.0, -1.0, 3.0)
"""Rates at which the damping of a joint must be proportional to its rate [rad/s or m/s]."""

LINEARITY_TOLERANCE = 1e-9
"""Relative deviation from that proportionality which is round-off."""

MIN_SUPPORT_NORMAL = 0.5
"""Vertical component of the normal of a contact from which on it carries a body."""

LARGEST_OUTPUT = 1_000_000_000
"""Largest file that this process may write [byte]."""

FREE_SLIDE_REACH = 1.0
"""Displacement at which a slide without a range is compared [m]."""


class Refused(Exception):
    """A file that describes what a crane cannot be."""


def limit_resources(memory: int, cpu_time: int) -> None:
    """Limit memory [byte] and processor time [s] of this process, where the system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    for kind, soft, hard in (
        (resource.RLIMIT_AS, memory, memory),
        (resource.RLIMIT_CPU, cpu_time, cpu_time + 1),
        (resource.RLIMIT_CORE, 0, 0),
        (resource.RLIMIT_FSIZE, LARGEST_OUTPUT, LARGEST_OUTPUT),
    ):
        with suppress(ValueError, OSError):  # where a lower limit is set already, or none exists
            resource.setrlimit(kind, (soft, hard))


def read_spec(mujoco: Any, path: Path) -> tuple[Any, list[str]]:
    """Return the specification of a model without sensors, in which hinges have taken the place of
    ball joints, and a note on each of these.

    Raises:
        Refused: If a ball joint is not the last joint of its body, or an actuator acts on it.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    for sensor in list(spec.sensors):
        spec.delete(sensor)  # they do not move anything, and may refer to a ball joint
    balls = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_BALL]
    names = {joint.name for joint in spec.joints}
    notes = []
    for joint in balls:
        label = _label_of_ball(joint, names)
        names |= {f"{label}_x", f"{label}_y"}
        _check_ball(spec, joint, label)
        _replace_ball(mujoco, joint, label)
        notes.append(f"The ball joint {label} turns about X, then Y, not about Z.")
    if balls and spec.keys:
        for key in list(spec.keys):
            spec.delete(key)
        notes.append("Keyframes are left out, since ball joints have other coordinates in them.")
    return spec, notes


def _label_of_ball(joint: Any, names: set[str]) -> str:
    """Return a name for a ball joint, its own or that of its body, with which the names of both
    hinges are new among some names.
    """
    label = joint.name or f"{joint.parent.name or 'ball'}_joint"
    while f"{label}_x" in names or f"{label}_y" in names:
        label += "_"
    return str(label)


def _check_ball(spec: Any, joint: Any, label: str) -> None:
    """Check that hinges can take the place of a ball joint.

    Raises:
        Refused: If an actuator acts on it, or it is not the last joint of its body.
    """
    body = joint.parent
    for actuator in spec.actuators:
        if joint.name and actuator.target == joint.name:
            raise Refused(
                f"the actuator {actuator.name or 'without a name'} acts on the ball joint "
                f"{label}; the drives of a crane move slides and hinges"
            )
    # Without a name the ball could not be told apart from the other joints of its body below.
    if len(body.joints) > 1 and not joint.name:
        raise Refused(
            f"a ball joint of the body {body.name or 'without a name'} has no name; give it one"
        )
    # The second hinge is added behind all joints of the body; it belongs directly behind the first.
    if joint.name != body.joints[-1].name:
        raise Refused(
            f"the ball joint {label} is followed by other joints of its body; give these a "
            "body of their own"
        )


def _replace_ball(mujoco: Any, joint: Any, label: str) -> None:
    """Turn a ball joint into a hinge about X of its body, and add one about Y, both with its
    damping, friction, stiffness, armature and range: MuJoCo counts these about each axis of a ball.
    """
    second = joint.parent.add_joint(
        name=f"{label}_y",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0.0, 1.0, 0.0],
        pos=joint.pos,
        damping=joint.damping,
        armature=joint.armature,
        frictionloss=joint.frictionloss,
        stiffness=joint.stiffness,
        limited=joint.limited,
    )
    # The range of a ball is from 0 to its largest angle, whatever the axis of the rotation.
    reach = float(joint.range[1])
    joint.name = f"{label}_x"
    joint.type = mujoco.mjtJoint.mjJNT_HINGE
    joint.axis = [1.0, 0.0, 0.0]
    joint.range = [-reach, reach]
    second.range = [-reach, reach]


def check_representable(mujoco: Any, model: Any, max_joints: int) -> list[str]:
    """Check that a model is a tree of slides and hinges without other forces; return notes on what
    is left out without changing its motion.

    Raises:
        Refused: If it has bodies, joints or forces that a crane cannot have.
    """
    names = Names(mujoco, model)
    if model.njnt > max_joints:
        raise Refused(f"it has {model.njnt} joints that move; allowed are {max_joints}")
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            body = names.body(int(model.jnt_bodyid[joint]))
            raise Refused(
                f"the body {body} is free and moves in 6 directions; the bodies of a crane hang "
                "on slides, hinges and ball joints"
            )
    _refuse_other_forces(model, names)
    notes = [*_tendons_without_force(model, names), *_constraints_not_active(model, names)]
    for index in range(model.nbody):
        if model.body_mocapid[index] >= 0:
            notes.append(f"The mocap body {names.body(index)} stands still.")
    return notes


def _tendons_without_force(model: Any, names: "Names") -> list[str]:
    """Return a note on each tendon.

    Raises:
        Refused: If one exerts forces.
    """
    notes = []
    for tendon in range(model.ntendon):
        acts = (
            model.tendon_stiffness[tendon] != 0.0
            or model.tendon_stiffnesspoly[tendon].any()
            or model.tendon_damping[tendon] != 0.0
            or model.tendon_dampingpoly[tendon].any()
            or model.tendon_frictionloss[tendon] != 0.0
            or model.tendon_armature[tendon] != 0.0
            or model.tendon_limited[tendon]
        )
        name = names.of("mjOBJ_TENDON", tendon)
        if acts:
            raise Refused(
                f"the tendon {name} exerts forces (stiffness, damping, friction, inertia or a "
                "limit); leave it out, or give its joints what it does"
            )
        notes.append(f"The tendon {name} exerts no force and is left out.")
    return notes


def _constraints_not_active(model: Any, names: "Names") -> list[str]:
    """Return a note on each equality constraint.

    Raises:
        Refused: If one is active.
    """
    notes = []
    for equality in range(model.neq):
        name = names.of("mjOBJ_EQUALITY", equality)
        if model.eq_active0[equality]:
            raise Refused(
                f"the equality constraint {name} couples bodies or joints by a soft constraint, "
                "which a crane here does not have; leave it out (a URDF can let a joint follow "
                "another exactly, by <mimic>)"
            )
        notes.append(f"The equality constraint {name} is not active and is left out.")
    return notes


def _refuse_other_forces(model: Any, names: "Names") -> None:
    """Check that nothing else acts on the bodies.

    Raises:
        Refused: If something does.
    """
    if model.nflex:
        raise Refused("it has deformable bodies (<flex>); a crane has rigid bodies")
    if (model.body_plugin >= 0).any():
        raise Refused("a plugin exerts forces on a body")
    if model.body_gravcomp.any():
        lifted = names.body(int(model.body_gravcomp.nonzero()[0][0]))
        raise Refused(f"the weight of the body {lifted} is compensated (gravcomp); leave it out")
    if model.opt.density != 0.0 or model.opt.viscosity != 0.0:
        raise Refused(
            f"its bodies move in a medium of density {model.opt.density:g} and viscosity "
            f"{model.opt.viscosity:g} (<option>); set both to 0, and give wind to the simulation"
        )
    if (model.jnt_springyield > 0.0).any():
        raise Refused("a spring of a joint yields (springyield); leave it out")


class Names:
    """Names of the parts of a model; parts without a name get one that no other part has."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        self._mujoco = mujoco
        self._model = model
        self._taken = set()
        for i in range(model.nbody):
            self._taken.add(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i))
        for i in range(model.njnt):
            self._taken.add(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i))

    def of(self, kind: str, index: int) -> str:
        """Return the name of a part, or its number."""
        name = self._mujoco.mj_id2name(self._model, getattr(self._mujoco.mjtObj, kind), index)
        return name or f"number {index + 1}"

    def body(self, index: int) -> str:
        """Return the name of a body."""
        name = self._mujoco.mj_id2name(self._model, self._mujoco.mjtObj.mjOBJ_BODY, index)
        return name or self._new(f"body_{index}")

    def geom(self, index: int) -> str:
        """Return a phrase that names a geom, by its body if it has no name."""
        name = self._mujoco.mj_id2name(self._model, self._mujoco.mjtObj.mjOBJ_GEOM, index)
        body = self.body(int(self._model.geom_bodyid[index]))
        return f"{name} of the body {body}" if name else f"a geom of the body {body}"

    def joint(self, index: int) -> str:
        """Return the name of a joint."""
        name = self._mujoco.mj_id2name(self._model, self._mujoco.mjtObj.mjOBJ_JOINT, index)
        return name or self._new(f"{self.body(int(self._model.jnt_bodyid[index]))}_joint_{index}")

    def _new(self, name: str) -> str:
        """Return a name that no body or joint of the file has."""
        while name in self._taken:
            name += "_"
        return name


def damping_of_joints(mujoco: Any, model: Any) -> list[float]:
    """Return the viscous damping of each joint [N m s/rad or N s/m], that of its actuators among
    it, from the change of MuJoCo's passive forces with the rate, all springs at rest.

    Raises:
        Refused: If it is not proportional to the rate, or acts on another joint.
    """
    data = mujoco.MjData(model)
    names = Names(mujoco, model)
    data.qpos[:] = model.qpos_spring
    mujoco.mj_forward(model, data)
    force_at_rest = data.qfrc_passive.copy()
    damping = []
    for joint in range(model.nv):
        slopes = []
        for rate in TEST_RATES:
            data.qvel[:] = 0.0
            data.qvel[joint] = rate
            mujoco.mj_forward(model, data)
            change = data.qfrc_passive - force_at_rest
            slopes.append(-float(change[joint]) / rate)
            change[joint] = 0.0
            if change.any():
                raise Refused(f"the damping of {names.joint(joint)} acts on another joint, too")
        if max(slopes) - min(slopes) > LINEARITY_TOLERANCE * max(map(abs, slopes)):
            raise Refused(
                f"the damping of {names.joint(joint)} is not proportional to its rate; a single "
                "number is allowed"
            )
        damping.append(slopes[0])
    return damping


@dataclass
class ActuatorRange:
    """Range of the effort that the actuators of a joint can exert, their sum.

    Attributes:
        low: Lower end of the range [N m or N], infinite where the file states none.
        high: Upper end likewise.
        kinds: What the actuators are, other than motors.
    """

    low: float = 0.0
    high: float = 0.0
    kinds: list[str] = field(default_factory=list)


def actuation_of_joints(mujoco: Any, model: Any) -> dict[int, ActuatorRange]:
    """Return what drives each joint that an actuator moves, by the index of the joint; nothing
    where the file switches its actuators off.

    Raises:
        Refused: If an actuator acts on something else than one slide or hinge.
    """
    joint_transmissions = (
        int(mujoco.mjtTrn.mjTRN_JOINT),
        int(mujoco.mjtTrn.mjTRN_JOINTINPARENT),
    )
    names = Names(mujoco, model)
    found: dict[int, ActuatorRange] = {}
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        return found
    for actuator in range(model.nactuator):
        # Bit i of `disableactuator` switches off the actuators of group i.
        group = max(int(model.actuator_group[actuator]), 0)
        if model.opt.disableactuator & (1 << group):
            continue
        name = names.of("mjOBJ_ACTUATOR", actuator)
        if int(model.actuator_trntype[actuator]) not in joint_transmissions:
            raise Refused(
                f"the actuator {name} does not act on a joint; the drives of a crane move its "
                "slides and hinges"
            )
        force = _force_range(mujoco, model, actuator)
        gear = float(model.actuator_gear[actuator, 0])
        if gear == 0.0:
            raise Refused(f"the gear of the actuator {name} is 0, so that it moves nothing")
        # A negative gear swaps the ends.
        ends = sorted((force.low * gear, force.high * gear))
        joint = int(model.actuator_trnid[actuator, 0])
        actuation = found.setdefault(joint, ActuatorRange())
        actuation.low += ends[0]
        actuation.high += ends[1]
        kind = force.kind
        if model.actuator_delay[actuator] > 0.0:
            kind = f"an actuator that acts {model.actuator_delay[actuator]:g} s late"
        if kind:
            actuation.kinds.append(kind)
    for joint, actuation in found.items():
        if model.jnt_actfrclimited[joint]:
            low, high = model.jnt_actfrcrange[joint].tolist()
            actuation.low = max(actuation.low, low)
            actuation.high = min(actuation.high, high)
    return found


class ForceRange(NamedTuple):
    """Range of the force of an actuator before its gear.

    Attributes:
        low: Lower end, infinite where the file states none.
        high: Upper end.
        kind: What the actuator is; empty for a plain motor.
    """

    low: float
    high: float
    kind: str


def _force_range(mujoco: Any, model: Any, actuator: int) -> ForceRange:
    """Return the range of the force of an actuator."""
    low = -math.inf
    high = math.inf
    kind = ""
    fixed_gain = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
    no_bias = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    is_motor = fixed_gain and no_bias
    if not is_motor:
        kind = "a servo of its own"
    elif model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_NONE:
        kind = "an actuator with a lag of its own"
    if is_motor:
        # The force of a motor is its gain times its input: see `_input_range`.
        limits = _input_range(mujoco, model, actuator)
        if limits is not None:
            gain = float(model.actuator_gainprm[actuator, 0])
            low, high = sorted((gain * float(limits[0]), gain * float(limits[1])))
    if model.actuator_forcelimited[actuator]:
        smallest, largest = model.actuator_forcerange[actuator].tolist()
        low = max(low, smallest)
        high = min(high, largest)
    return ForceRange(low, high, kind)


def _input_range(mujoco: Any, model: Any, actuator: int) -> Any:
    """Return the range of the number that the gain of an actuator multiplies; None if it has none.

    That is the control, at once or through a filter, whose output stays in the range of its input;
    with other dynamics, such as those of an integrator, it is the activation.
    """
    follows_control = int(model.actuator_dyntype[actuator]) in (
        int(mujoco.mjtDyn.mjDYN_NONE),
        int(mujoco.mjtDyn.mjDYN_FILTER),
        int(mujoco.mjtDyn.mjDYN_FILTEREXACT),
    )
    if follows_control:
        if model.actuator_ctrllimited[actuator]:
            return model.actuator_ctrlrange[int(model.actuator_ctrladr[actuator])]
        return None
    if model.actuator_actlimited[actuator]:
        return model.actuator_actrange[actuator]
    return None


def armature_of_joints(model: Any) -> list[float]:
    """Return the inertia added to that of each joint [kg m² or kg], that of its actuator among
    it.
    """
    armature = model.dof_armature.tolist()
    for joint in range(model.njnt):
        actuator = int(model.jnt_actuatorid[joint])
        if actuator >= 0:
            gear = float(model.actuator_gear[actuator, 0])
            armature[joint] += gear * gear * float(model.actuator_armature[actuator])
    return armature


def limits_joints(mujoco: Any, model: Any) -> bool:
    """Return whether the ranges of joints act, which a flag of the file can switch off."""
    return not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_LIMIT)


def start_of(mujoco: Any, model: Any) -> tuple[list[float], list[str]]:
    """Return the coordinates at which the model starts, and notes on them: the keyframe named home
    or start, else the first; the reference posture if there is none. A coordinate beyond its range
    starts in the middle of it.
    """
    start = model.qpos0.tolist()
    notes = []
    names = Names(mujoco, model)
    if model.nkey:
        key = _starting_key(mujoco, model)
        start = model.key_qpos[key].tolist()
        notes.append(f"The start is the keyframe {names.of('mjOBJ_KEY', key)} of the file.")
    for joint in range(model.njnt):
        low, high = model.jnt_range[joint].tolist()
        is_limited = limits_joints(mujoco, model) and model.jnt_limited[joint]
        if is_limited and not low <= start[joint] <= high:
            middle = (low + high) / 2.0
            notes.append(
                f"{names.joint(joint)} starts at {middle:g}, in the middle of its range, since the "
                f"{start[joint]:g} of the file is beyond it."
            )
            start[joint] = middle
    return start, notes


def _starting_key(mujoco: Any, model: Any) -> int:
    """Return the index of the keyframe named home or start, else of the first one."""
    for key in range(model.nkey):
        if mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_KEY, key) in ("home", "start"):
            return key
    return 0


def check_not_supported_at_start(mujoco: Any, model: Any, start: list[float]) -> list[str]:
    """Check that at the start no moving body rests on a body that is fixed to the world; return
    notes on contacts, which are not simulated.

    Raises:
        Refused: If one does: what carries it there is not simulated, so that it would fall.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = start
    mujoco.mj_forward(model, data)
    names = Names(mujoco, model)
    touching = list[str]()
    for contact in data.contact:
        geoms = [int(geom) for geom in contact.geom]
        moves = [model.body_weldid[model.geom_bodyid[geom]] != 0 for geom in geoms]
        if contact.dist > 0.0 or not any(moves):
            continue
        pair = " and ".join(names.geom(geom) for geom in geoms)
        # The normal points from the first geom to the second, which it pushes that way, and the
        # first one the other way.
        upward = float(contact.frame[2])
        if not moves[1]:
            upward = -upward
        if not all(moves) and upward > MIN_SUPPORT_NORMAL:
            raise Refused(
                f"a body stands on another where the model starts: {pair} touch, and contacts are "
                "not simulated; let it hang free at the start (a keyframe, or ref), or let these "
                "geoms not collide (contype=0 and conaffinity=0)"
            )
        touching.append(pair)
    if touching:
        return [f"Contacts between bodies are not simulated; {touching[0]} touch at the start."]
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    moving = model.body_weldid[model.geom_bodyid] != 0
    if (solid & moving).any() and model.ngeom > 1:
        return ["Contacts between bodies are not simulated; nothing touches at the start."]
    return []


def shapes_of(mujoco: Any, model: Any) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the boxes, spheres, cylinders and capsules of a model, and a note on other shapes."""
    kinds = {
        int(mujoco.mjtGeom.mjGEOM_BOX): "box",
        int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
        int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
        int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    }
    shapes = []
    left_out = 0
    for geom in range(model.ngeom):
        kind = kinds.get(int(model.geom_type[geom]))
        if kind is None:
            if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
                left_out += 1
            continue
        material = int(model.geom_matid[geom])
        colour = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        shapes.append(
            {
                "body": int(model.geom_bodyid[geom]),
                "kind": kind,
                "size": model.geom_size[geom].tolist(),
                "position": model.geom_pos[geom].tolist(),
                "quaternion": model.geom_quat[geom].tolist(),
                "colour": [float(component) for component in colour],
                # MuJoCo's viewer shows groups 0 to 2 unless told otherwise.
                "visible": int(model.geom_group[geom]) <= 2 and float(colour[3]) > 0.0,
                "solid": bool(model.geom_contype[geom] or model.geom_conaffinity[geom]),
            }
        )
    notes = [f"{left_out} shapes are not drawn: meshes, ellipsoids or others."] if left_out else []
    return shapes, notes


def random_state_accelerations(
    mujoco: Any, model: Any, start: list[float]
) -> list[dict[str, list[float]]]:
    """Return random states with efforts on all joints, and the accelerations that MuJoCo computes
    there without actuators, limits, contacts and dry friction.
    """
    import random

    # The same states at each reading of a file.
    draw = random.Random(0)
    data = mujoco.MjData(model)
    flags_of_file = model.opt.disableflags
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    states = []
    for _ in range(RANDOM_STATES):
        for joint in range(model.njnt):
            low, high = model.jnt_range[joint].tolist()
            if not model.jnt_limited[joint]:
                slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
                reach = FREE_SLIDE_REACH if slide else math.pi
                low = start[joint] - reach
                high = start[joint] + reach
            data.qpos[joint] = draw.uniform(low, high)
            data.qvel[joint] = draw.gauss(0.0, 0.5)
            data.qfrc_applied[joint] = draw.gauss(0.0, 1.0) * float(model.dof_M0[joint])
        mujoco.mj_forward(model, data)
        states.append(
            {
                "q": data.qpos.tolist(),
                "v": data.qvel.tolist(),
                "effort": data.qfrc_applied.tolist(),
                "acceleration": data.qacc_smooth.tolist(),
            }
        )
    model.opt.disableflags = flags_of_file
    return states


def describe_model(mujoco: Any, path: Path, max_joints: int = 128) -> dict[str, Any]:
    """Return what a crane needs of an MJCF file: bodies, joints, drives, start, shapes, gravity,
    notes, and accelerations for comparison, in numbers, texts and lists.

    Raises:
        Refused: If a crane cannot be what the file describes.
    """
    spec, notes = read_spec(mujoco, path)
    model = spec.compile()
    notes += check_representable(mujoco, model, max_joints)
    names = Names(mujoco, model)
    start, start_notes = start_of(mujoco, model)
    notes += start_notes
    if int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        notes.append("The file switches its actuators off, so that they drive no joint.")
    notes += check_not_supported_at_start(mujoco, model, start)
    shapes, shape_notes = shapes_of(mujoco, model)
    gravity_is_off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = [0.0, 0.0, 0.0] if gravity_is_off else model.opt.gravity.tolist()
    return {
        "name": spec.modelname,
        "gravity": gravity,
        "bodies": _describe_bodies(mujoco, model, names),
        "joints": _describe_joints(mujoco, model, names, start),
        "shapes": shapes,
        "notes": [*notes, *shape_notes],
        "states": random_state_accelerations(mujoco, model, start),
    }


def _describe_bodies(mujoco: Any, model: Any, names: Names) -> list[dict[str, Any]]:
    """Return name, parent, placement, mass and inertia of each body, the world first."""
    same_frame = mujoco.mjtSameFrame
    bodies = []
    for i in range(model.nbody):
        centre = model.body_ipos[i].tolist()
        principal_axes = model.body_iquat[i].tolist()
        # MuJoCo computes as if what is within 1e-6 of the frame of the body were in it.
        if model.body_sameframe[i] == same_frame.mjSAMEFRAME_BODY:
            centre = [0.0, 0.0, 0.0]
        if model.body_sameframe[i] in (same_frame.mjSAMEFRAME_BODY, same_frame.mjSAMEFRAME_BODYROT):
            principal_axes = [1.0, 0.0, 0.0, 0.0]
        bodies.append(
            {
                "name": names.body(i),
                "parent": int(model.body_parentid[i]),
                "position": model.body_pos[i].tolist(),
                "quaternion": model.body_quat[i].tolist(),
                "mass": float(model.body_mass[i]),
                "centre": centre,
                "principal_axes": principal_axes,
                "moments": model.body_inertia[i].tolist(),
            }
        )
    return bodies


def _describe_joints(
    mujoco: Any, model: Any, names: Names, start: list[float]
) -> list[dict[str, Any]]:
    """Return geometry, range, forces, start and drive of each joint. What a flag of the file
    switches off is left out.
    """
    disabled = int(model.opt.disableflags)
    has_springs = not disabled & int(mujoco.mjtDisableBit.mjDSBL_SPRING)
    has_friction = not disabled & int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
    has_limits = limits_joints(mujoco, model)
    damping = damping_of_joints(mujoco, model)
    armature = armature_of_joints(model)
    actuation = actuation_of_joints(mujoco, model)
    joints = []
    for i in range(model.njnt):
        is_limited = has_limits and model.jnt_limited[i]
        drive = None
        if i in actuation:
            drive = {
                "low": actuation[i].low,
                "high": actuation[i].high,
                "kinds": actuation[i].kinds,
            }
        joints.append(
            {
                "name": names.joint(i),
                "body": int(model.jnt_bodyid[i]),
                "slides": bool(model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE),
                "position": model.jnt_pos[i].tolist(),
                "axis": model.jnt_axis[i].tolist(),
                "reference": float(model.qpos0[i]),
                "range": model.jnt_range[i].tolist() if is_limited else None,
                "damping": damping[i],
                "armature": armature[i],
                "friction": float(model.dof_frictionloss[i]) if has_friction else 0.0,
                "stiffness": float(model.jnt_stiffness[i]) if has_springs else 0.0,
                "slack": float(model.qpos_spring[i]),
                "start": start[i],
                "drive": drive,
            }
        )
    return joints


def main(path: str, memory: str, cpu_time: str, max_joints: str) -> int:
    """Compile a file within limits and print what it describes."""
    limit_resources(int(memory), int(cpu_time))
    try:
        import mujoco
    except ImportError:
        print(json.dumps({"missing": True}))
        return 0
    try:
        reply: dict[str, Any] = {"model": describe_model(mujoco, Path(path), int(max_joints))}
    except Refused as error:
        reply = {"error": str(error)}
    except MemoryError:
        reply = {"error": f"it needs more than {int(memory) / 1e9:g} GB of memory"}
    except (ValueError, mujoco.FatalError) as error:
        reply = {"error": f"MuJoCo refuses it: {error}"}
    print(json.dumps(reply))
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
