"""The crane of a page: compiled to WebAssembly, with sliders and assistances for its operator.

`kernel_data` has the code of the crane, `variations` its sliders, and `assist_data` what the
assistances of the operator need: shaping, drives that yield to the swing, an LQR, and predictive
control. All of it goes into the JSON of the page, see `driving_page`.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from cranedyn.clocks import whole_periods
from cranedyn.controllers.lqr import effort_weight_of, lqr
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.dynamics.converters import HEADROOM, Converters
from cranedyn.dynamics.equations_of_motion import natural_frequencies
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.errors import DataError
from cranedyn.export.crane_data import linear_law
from cranedyn.interfaces import Controller
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ROLES
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.receding import Receding

PERIOD = 5e-3
"""Control period [s], that of `simulate`."""

DT = 5e-4
"""Physics step [s], that of `simulate`."""

_LAW_DURATION = 30.0
"""Time over which a controller of the user's own must not change [s]: that of tables in exported
blocks."""

YIELDING_DAMPING_RATIO = 0.2
"""Damping ratio that drives which yield to the load give its swing."""

LQR_EFFORT_FACTOR = 100.0
"""Factor on the weight of efforts of `lqr`.

With the weight of `lqr` itself the gains ask for more than the ramps of the drives give, and the
loop oscillates.
"""

_RADII = 6
"""Number of trolley radii in the table of gains."""

_LENGTHS = 8
"""Number of cable lengths in the table of gains."""


@dataclass(frozen=True)
class Slider:
    """A number of the crane that can be changed while it moves.

    Attributes:
        name: Name, by which the page refers to it.
        label: Name for the operator.
        unit: Its unit.
        least: Lower end of its range.
        most: Upper end of its range.
        value: Value at the start.
    """

    name: str
    label: str
    unit: str
    least: float
    most: float
    value: float


def variations(crane: Crane, drives: Converters) -> list[tuple[Slider, Crane, np.ndarray]]:
    """Return the sliders of load, damping and ramps, each with a crane and the parameters of its
    converters where the slider stands one unit above its start.

    The numbers of a crane are affine in each slider, so the page adds their difference per unit,
    times the distance of the slider from its start.
    """
    usual = np.concatenate(drives.response)
    mass = crane.payload_mass
    damping = float(crane.damping[crane.swings].mean()) if len(crane.swings) else 0.0
    # The critical damping of a pendulum is 2 m l² √(g/l) = 2 m √g l^1.5. The slider reaches at
    # least a twentieth of that.
    largest = max(10.0 * damping, 0.1 * math.sqrt(crane.gravity) * mass * _cable(crane) ** 1.5)
    raised = crane.damping.copy()
    raised[crane.swings] += 1.0
    # The unit of this slider is a percent.
    steeper = replace(drives, accelerations=1.01 * drives.accelerations, jerks=1.01 * drives.jerks)
    load = Slider("payload_mass", "load", "kg", 0.25 * mass, 3.0 * mass, mass)
    swing = Slider("damping", "damping of the swing", "N m s/rad", 0.0, largest, damping)
    ramp = Slider("ramp", "acceleration of the drives", "%", 25.0, 200.0, 100.0)
    return [
        (load, _heavier(crane, 1.0 + 1.0 / mass), usual),
        (swing, replace(crane, damping=raised), usual),
        (ramp, crane, np.concatenate(steeper.response)),
    ]


def _heavier(crane: Crane, factor: float) -> Crane:
    """Return a crane whose load has a multiple of its mass and of its moments of inertia."""
    model = crane.model.copy()
    joint = crane.payload.body + 1  # joint 0 of Pinocchio is the world
    load = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(factor * load.mass, load.lever, factor * load.inertia)
    return replace(crane, model=model)


def usual_limits(drives: Converters) -> Limits:
    """Return the limits at full stick: those of the converters, less the reserve of their rates
    (`HEADROOM`).
    """
    return Limits((drives.rates / HEADROOM).tolist(), drives.accelerations.tolist())


def _cable(crane: Crane) -> float:
    """Return the length of the cable at the start [m]; 1 for a crane without hoist."""
    layout = crane.layout
    return float(crane.start.q[layout.role("hoist", "")]) if layout.has("hoist") else 1.0


# --- assistances ----------------------------------------------------------------------------------

# Label and explanation for the operator by the name of the assistance, in the order of the buttons.
_ASSISTANCES = {
    "none": ("Off", "The drives follow the sticks by their ramps."),
    "shaped": ("Shaped", "Half of each command comes half a swing period later (ZV shaper)."),
    "yielding": ("Yielding", "Slew and trolley give way to the load, which damps its swing."),
    "lqr": ("LQR", "Feedback of the whole state holds the load on the motion of the sticks."),
    "predictive": ("Predictive", "An optimisation drives the load to the goal that is clicked."),
    "own": (
        "Own",
        "The controller that this page was written with, about the motion of the sticks.",
    ),
}


def assistances(crane: Crane, *, has_own: bool = False) -> list[dict[str, str]]:
    """Return the assistances that a crane can have, among them a controller of the user's own if
    there is one.
    """
    possible = set(_ASSISTANCES)
    if not has_own:
        possible -= {"own"}
    if not len(crane.swings):
        possible &= {"none", "own"}
    if not is_tower(crane):
        possible -= {"yielding"}
    if crane.springs.any:
        possible -= {"predictive"}
    data = []
    for name, (label, text) in _ASSISTANCES.items():
        if name in possible:
            data.append({"name": name, "label": label, "text": text})
    return data


def is_tower(crane: Crane) -> bool:
    """Return whether a crane has the five joints of a tower crane and no other."""
    return crane.layout.has(*ROLES) and crane.layout.n == len(ROLES)


def assist_data(crane: Crane, drives: Converters) -> dict[str, Any]:
    """Return what our assistances need to know of a crane, for JSON; see also `own_data`."""
    layout = crane.layout
    limits = usual_limits(drives)
    # Time from a command until the drive has the acceleration of its ramp: the lag, the delay, and
    # the time in which the jerk builds up the acceleration.
    response = drives.lags + drives.delay + drives.accelerations / drives.jerks
    hoist = layout.drive_of("hoist")
    lengths = _grid(crane, "hoist", _LENGTHS)
    periods = []
    for length in lengths:
        periods.append(swing_period(crane, _resting_coordinates(crane, hoist=length)))
    data: dict[str, Any] = {
        "rates": list(limits.rates),
        "accelerations": list(limits.accelerations),
        # Twice the response: with the response alone a drive overshoots the end of its range.
        "reaction": (2.0 * response).tolist(),
        "joints": layout.drives.tolist(),
        "hoist": -1 if hoist is None else hoist,
        "swing": {
            "lengths": lengths,
            "periods": periods,
        },
    }
    if is_tower(crane):
        _, x, phi, theta, length = layout.tower("Drives that yield to the swing")
        data["yielding"] = {
            "x": x,
            "phi": phi,
            "theta": theta,
            "l": length,
            "slew": layout.drive_of("slew"),
            "trolley": layout.drive_of("trolley"),
            "ratio": YIELDING_DAMPING_RATIO,
            "gravity": crane.gravity,
        }
    if len(crane.swings):
        data["lqr"] = _lqr_data(crane, drives, lengths)
    return data


def own_data(crane: Crane, drives: Converters, controller: Controller) -> dict[str, Any]:
    """Return a linear controller of the user's own, which acts about the motion that the sticks ask
    for, for JSON. Matrices are written row by row.

    Raises:
        DataError: If it is not linear and the same at all times, acts about a rest of its own, or
            commands no rates.
        OutOfRange: If it is for another control period than that of a page.
    """
    law = linear_law(crane, controller, PERIOD, _LAW_DURATION, "a page")
    name = type(controller).__name__
    if not law.shift.any():
        raise DataError(
            f"{name} holds the crane at a rest of its own, so that the sticks have no effect; a "
            'page takes one that acts about the setpoint of the run: linear_controller(setpoint="'
            'run").'
        )
    if len(law.states) and not np.array_equal(law.states.limit, drives.rates):
        raise DataError(
            f"{name} has other limits than the rates of the usual converters of this crane; a page "
            'takes a controller that commands rates: linear_controller(drive="velocity").'
        )
    return {
        "feedForward": law.feed_forward.tolist(),
        "gain": law.gain.tolist(),
        "setpoint": law.setpoint.tolist(),
        "shift": law.shift.tolist(),
        "start": crane.start.q[crane.layout.drives].tolist(),
        "a": law.states.a.tolist(),
        "b": law.states.b.tolist(),
        "c": law.states.c.tolist(),
        "antiWindup": law.states.anti_windup.tolist(),
        "limits": drives.rates.tolist(),
        "initial": law.states.initial.tolist(),
    }


def _grid(crane: Crane, role: str, count: int) -> list[float]:
    """Return coordinates spread evenly over the range of the joint of a role; [0] if there is none.

    Args:
        crane: The crane.
        role: The role.
        count: Number of coordinates.
    """
    layout = crane.layout
    if not layout.has(role):
        return [0.0]
    joint = layout.role(role, "")
    return np.linspace(crane.lower[joint], crane.upper[joint], count).tolist()


def _resting_coordinates(crane: Crane, **coordinates: float) -> np.ndarray:
    """Return coordinates at which the crane hangs at rest, shape (n,): those of its start but for
    the given ones, by their roles.
    """
    q = crane.start.q.copy()
    for role, value in coordinates.items():
        if crane.layout.has(role):
            q[crane.layout.role(role, "")] = value
    return crane.resting(q)


def swing_period(crane: Crane, q: np.ndarray) -> float:
    """Return the period of the slowest swing with the drives locked [s]; 1 if nothing swings."""
    if not len(crane.swings):
        return 1.0
    frequencies = natural_frequencies(crane, q, crane.layout.passive)
    # A joint without a restoring force has the frequency 0, up to round-off.
    swinging = frequencies[frequencies > 1e-3 * frequencies.max()]
    return float(2.0 * math.pi / swinging.min())


def _lqr_data(crane: Crane, drives: Converters, lengths: Sequence[float]) -> dict[str, Any]:
    """Return gains from the state to the rates of the drives, over trolley radius and cable length.

    Each entry of ``gains`` is a matrix, shape (m, 2 n), row by row; the lengths vary fastest.
    """
    layout = crane.layout
    radii = _grid(crane, "trolley", _RADII)
    weight = LQR_EFFORT_FACTOR * effort_weight_of(crane)
    gains = []
    for radius in radii:
        for length in lengths:
            q = _resting_coordinates(crane, trolley=radius, hoist=length)
            still = np.zeros((1, layout.n))
            motion = Motion(PERIOD, q[None], still, still, layout.drives)
            efforts = lqr(crane, motion, effort_weight=weight)
            rates: Any = as_velocity_command(
                crane, efforts, drive="effort", converters=drives, control_period=PERIOD
            )
            gains.append(rates.gain[-1].ravel().tolist())
    return {
        "x": layout.role("trolley", "") if layout.has("trolley") else -1,
        "l": layout.role("hoist", "") if layout.has("hoist") else -1,
        "radii": radii,
        "lengths": list(lengths),
        "gains": gains,
        "rest": crane.resting(crane.start.q).tolist(),
        "swings": crane.swings.tolist(),
        "rest_slope": crane.rest.slope.tolist(),
    }


# --- code -----------------------------------------------------------------------------------------


def kernel_data(
    crane: Crane, drives: Converters, variants: Sequence[tuple[Slider, Crane, np.ndarray]]
) -> dict[str, Any]:
    """Return the code of a crane as WebAssembly, with the layout of its memory and what each of
    `variations` changes of its numbers.

    The keys are those of `KernelData` in ``kernel.js``, without the state at the start.
    """
    # Imported here, since other exporters do without llvmlite.
    from cranedyn.compiled.kernel import KernelOptions, build_module
    from cranedyn.compiled.memory_layout import SLOTS, size, slices
    from cranedyn.compiled.verify import compile_kernel
    from cranedyn.compiled.webassembly import webassembly

    options = KernelOptions(
        1,
        "velocity",
        semi_implicit_euler,
        delay_steps=drives.delay_steps(DT, PERIOD),
        forces=True,
        log=True,
        summary=True,
    )
    cranes = [crane]
    responses = [np.concatenate(drives.response)]
    for _, changed_crane, response in variants:
        cranes.append(changed_crane)
        responses.append(response)
    # A row of numbers for each crane: first the usual one, then one for each slider.
    kernel, numbers = compile_kernel(cranes, options, np.array(responses))
    source = kernel.source
    buffers = {
        "state": source.sizes.state,
        "gain_table": source.sizes.gain_table,
        "setpoint_table": source.sizes.setpoint_table,
        "force": source.sizes.force,
        "log": source.sizes.row,
        "summary": source.sizes.summary,
    }
    places = {}
    for name, sections in buffers.items():
        parts = slices(sections).items()
        places[name] = {key: [part.start, part.stop] for key, part in parts}
    changes = {}
    for (slider, *_), row in zip(variants, numbers[1:], strict=True):
        changes[slider.name] = (row - numbers[0]).tolist()
    is_predictive = any(entry["name"] == "predictive" for entry in assistances(crane))
    return {
        "horizon": _horizon_data(goal_controller(crane, drives)) if is_predictive else None,
        "module": _packed(webassembly(build_module(source))),
        "slots": SLOTS,
        "sections": places,
        "sizes": {name: size(sections) for name, sections in buffers.items()},
        "numbers": numbers[0].tolist(),
        "variations": changes,
        "drives": crane.layout.drives.tolist(),
        "dt": DT,
        "period": PERIOD,
        "steps": round(PERIOD / DT),
    }


def goal_controller(crane: Crane, drives: Converters) -> Receding:
    """Return the predictive controller of a page, which goes to the goal that is clicked.

    Its horizon is two swing periods in 20 stages: few and long stages are quick to optimise, and as
    good here as more.
    """
    from cranedyn.compiled.horizon.receding import receding

    swing = swing_period(crane, crane.start.q)
    return receding(
        crane,
        usual_limits(drives),
        drive="velocity",
        converters=drives,
        period=whole_periods(swing / 75.0, PERIOD),
        stage=whole_periods(swing / 10.0, PERIOD),
        stages=20,
    )


def _horizon_data(controller: Receding) -> dict[str, Any]:
    """Return code and memory of a predictive controller, and where in its memory the limits of the
    accelerations stand, which the slider of the ramps changes.
    """
    from cranedyn.compiled.horizon.receding import emit_programme
    from cranedyn.compiled.webassembly import webassembly

    programme = controller.programme
    shape = programme.shape(1)
    first = programme.offsets(1).work
    return {
        "module": _packed(webassembly(emit_programme(programme).module)),
        "memory": _packed(controller.memory(1).tobytes()),
        "ratio": programme.ratio,
        "accelerations": [first + shape.offset(name) + shape.states for name in ("low", "high")],
    }


def _packed(data: bytes) -> str:
    """Return bytes compressed by zlib and encoded in base 64, as text for JSON."""
    return base64.b64encode(zlib.compress(data, 9)).decode()
