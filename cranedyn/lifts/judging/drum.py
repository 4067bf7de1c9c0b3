"""The drum of a hoist: how far the rope fills it, how it turns, and what torque it takes.

A rope of the diameter d winds up in layers, with the pitch d. Each layer lies in the grooves
between the turns of the one below, so that its axis is d √3/2 farther out and its turns are shifted
by d/2.
Radius, torque and speed of the drum change from layer to layer by this step. Where the rope crosses
over the turns below it, it lies up to d farther out; this is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number, whole
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import OutOfRange
from cranedyn.lifts.judging.chart import Reeving
from cranedyn.model.crane import Crane


class _Layers(NamedTuple):
    """The layers of a drum.

    Attributes:
        radii: Radius of the axis of the rope in each layer [m], shape (layers,).
        angles: Angle of the drum at which each layer begins and the last one ends [rad], shape
            (layers + 1,).
        lengths: Length that is wound there [m], of the same shape.
    """

    radii: np.ndarray
    angles: np.ndarray
    lengths: np.ndarray


@dataclass(frozen=True)
class Drum:
    """A drum with its rope.

    Attributes:
        radius: Radius of the bare drum [m].
        width: Its width between the flanges [m].
        rope_diameter: Diameter of the rope [m].
        layers: Number of layers that it holds.
        inertia: Moment of inertia of the drum about its axis with all that turns with it, a motor
            of the inertia J behind a gear of the ratio i counted as J i² [kg m²]. That of the rope
            that is wound up counts as far as it is contained in it.

    Raises:
        OutOfRange: If a number is out of its range, or not a single turn fits on the width.
    """

    radius: float
    width: float
    rope_diameter: float
    layers: int = 1
    inertia: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        number("radius of the drum", self.radius, "m", "> 0")
        number("width of the drum", self.width, "m", "> 0")
        number("diameter of the rope", self.rope_diameter, "m", "> 0")
        whole("layers of the drum", self.layers, 1)
        number("inertia of the drum", self.inertia, "kg m²", ">= 0")
        if self.turns(0) < 1:
            allowed = f">= {self.rope_diameter:g}, the diameter of its rope"
            raise OutOfRange("width of the drum", self.width, allowed, "m")

    def turns(self, layer: int) -> int:
        """Return the number of turns of a layer; the first layer is 0."""
        # Every second layer is shifted by half a diameter, and may so have one turn less.
        shift = 0.5 * (layer % 2)
        # A width that is a multiple of the diameter must not lose a turn by round-off.
        return math.floor(self.width / self.rope_diameter * (1.0 + 1e-12) - shift)

    def layer_radius(self, layer: int) -> float:
        """Return the radius of the axis of the rope in a layer [m]; the first layer is 0."""
        step = self.rope_diameter * math.sqrt(3.0) / 2.0
        return self.radius + 0.5 * self.rope_diameter + layer * step

    @property
    def capacity(self) -> float:
        """Length of the rope that fills all layers [m]."""
        return float(self._layers.lengths[-1])

    @cached_property
    def _layers(self) -> _Layers:
        """The layers, from the first."""
        layers = range(self.layers)
        radii = np.array([self.layer_radius(layer) for layer in layers])
        turned = 2.0 * math.pi * np.array([self.turns(layer) for layer in layers])
        return _Layers(
            radii=radii,
            angles=np.concatenate([[0.0], np.cumsum(turned)]),
            lengths=np.concatenate([[0.0], np.cumsum(turned * radii)]),
        )

    def angle(self, wound: np.ndarray) -> np.ndarray:
        """Return the angle by which the drum has turned since it was empty [rad], from the lengths
        wound up [m], of the same shape.

        Raises:
            OutOfRange: If a length is below 0 or beyond the capacity.
        """
        return np.interp(self._checked(wound), self._layers.lengths, self._layers.angles)

    def radius_at(self, wound: np.ndarray) -> np.ndarray:
        """Return the radius of the axis of the rope where it runs onto the drum [m], from the
        lengths wound up [m], of the same shape.

        Raises:
            OutOfRange: If a length is below 0 or beyond the capacity.
        """
        layer = np.searchsorted(self._layers.lengths, self._checked(wound), side="right") - 1
        return self._layers.radii[np.clip(layer, 0, self.layers - 1)]

    def _checked(self, wound: np.ndarray) -> np.ndarray:
        """Return lengths as an array, checked."""
        meaning = f"which fills its {self.layers} layers"
        return _up_to("rope wound on the drum", wound, self.capacity, meaning)


@dataclass(frozen=True)
class Winch:
    """A drum, the reeving between it and the hook, and the length of the rope.

    Attributes:
        drum: The drum.
        reeving: The reeving.
        rope_length: Length of the rope on the drum with the hook at the pivot, at the cable length
            0 [m], without the dead turns that always stay on it.

    Raises:
        OutOfRange: If the length is not positive, or the drum cannot take it.
    """

    drum: Drum
    reeving: Reeving
    rope_length: float

    def __post_init__(self) -> None:
        """Check the length."""
        number("length of the rope", self.rope_length, "m", "> 0")
        if self.rope_length > self.drum.capacity:
            allowed = f"up to {self.drum.capacity:g}, the capacity of the drum"
            raise OutOfRange("length of the rope", self.rope_length, allowed, "m")

    def wound(self, length: np.ndarray) -> np.ndarray:
        """Return the lengths that are wound up [m] at cable lengths [m], of the same shape.

        Each metre of cable takes a metre of rope for each fall.

        Raises:
            OutOfRange: If a cable length is below 0, or the rope is too short for it.
        """
        longest = self.rope_length / self.reeving.falls
        lengths = _up_to("cable length", length, longest, "at which the drum is empty")
        return self.rope_length - self.reeving.falls * lengths

    def mass_at_hook(self, length: float) -> float:
        """Return the equivalent mass of the drum at the hook at a cable length [kg]: the argument
        `drum_inertia`, a mass, of a crane whose rope stretches.

        The drum turns by n v/r where the hook moves at v on n falls: m = J (n/r)².

        Raises:
            OutOfRange: If the rope is too short for the cable length.
        """
        radius = float(self.drum.radius_at(self.wound(np.array(length))))
        return self.drum.inertia * (self.reeving.falls / radius) ** 2

    def columns(self, crane: Crane, run: Trajectory) -> dict[str, np.ndarray]:
        """Return what the winch does in each row of a run: the pull of the line [N], the length
        wound up [m], the angle since the drum was empty [rad] and its rate [rad/s], hoisting
        positive, the radius of the layer [m], and the torque on the drum [N m].

        The torque holds the pull of the line and accelerates the inertia of the drum. The pull has
        the losses of the sheaves of the reeving; a `friction_hoist` of the crane, which stands for
        them in the run, does not count once more. Where the radius changes from a layer to the
        next, the rate jumps; the impulse of that jump is left out.

        Raises:
            MissingRole: If the crane has no hoist.
            OutOfRange: If the rope is too short for a row of the run.
            CraneError: As `cranedyn.lifts.judging.loads.loads`.
        """
        hoist = crane.layout.role("hoist", "The winch")
        line = self.reeving.columns(crane, run)["line_N"]
        wound = self.wound(run.q[:, hoist])
        radius = self.drum.radius_at(wound)
        falls = self.reeving.falls
        acceleration = -falls * np.gradient(run.v[:, hoist], run.t) / radius
        return {
            "line_N": line,
            "wound_m": wound,
            "drum_rad": self.drum.angle(wound),
            "drum_rad_s": -falls * run.v[:, hoist] / radius,
            "layer_m": radius,
            "drum_Nm": line * radius + self.drum.inertia * acceleration,
        }


def _up_to(name: str, values: np.ndarray, largest: float, meaning: str) -> np.ndarray:
    """Return lengths [m] as an array if all are from 0 to a largest one.

    Args:
        name: Name of the lengths for the error message.
        values: The lengths, of any shape.
        largest: The largest length that is allowed.
        meaning: What that is, as the error message says it.

    Raises:
        OutOfRange: If one is outside; the message names the first.
    """
    lengths = np.asarray(values, dtype=float)
    # Written so that NaN is refused, too.
    outside = ~((lengths >= 0.0) & (lengths <= largest))
    if outside.any():
        raise OutOfRange(name, float(lengths[outside][0]), f"0 to {largest:g}, {meaning}", "m")
    return lengths
