"""What a run is: the crane, its start, its clocks, and what acts on it, all of it checked.

`make_run_spec` checks the arguments of a user once. An engine, the log and the record of a run read
the result and check nothing again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.checks import ShortRepr, check_choice, number
from cranedyn.clocks import Clocks, clocks
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.disturbances.wind import Wind
from cranedyn.dynamics.converters import Converters, converters_of_run
from cranedyn.dynamics.integrators import Integrator
from cranedyn.errors import OutOfRange, shown
from cranedyn.interfaces import Disturbance, Drive, State, Validity
from cranedyn.model.crane import Crane

if TYPE_CHECKING:
    from cranedyn.dynamics.contact import Contacts, Ground


@dataclass(frozen=True, eq=False, repr=False)
class RunSpec(ShortRepr):
    """A run of a crane with n joints and m drives. Make it with `make_run_spec`, which checks it.

    The controller, the reference and the monitors are no part of it, since they belong to whoever
    commands the crane. A disturbance is: it is a function of time and state that belongs to the
    world. A spec can serve any number of runs.

    Attributes:
        crane: The crane.
        start: State of the crane at the start, read-only arrays of shape (n,).
        t_start: Time at the start [s].
        clocks: Physics step, control period, and how many there are of each.
        drive: How the drives take a command: "effort", "motion" or "velocity".
        converters: Frequency converters of the drives; None unless `drive` is "velocity".
        command_delay: Number of control periods from a command to the response of the drives; 0
            without converters.
        integrator: Rule that steps coordinates and rates.
        validity: What to do where the model ceases to hold: "stop", "buffers" or "mark".
        disturbance: External forces on the points of the crane; None if there are none, or if the
            caller of each step passes them.
        has_forces: Whether external forces act, from the disturbance or from the caller.
        ground: Ground and platforms that the load may touch; None for none.
        contacts: Contacts of the load with the ground; None without ground.
        base: Motion of the base on which the crane stands; None for a crane that stands in the
            world. The ground, too, is that of the base.
    """

    crane: Crane
    start: State
    t_start: float
    clocks: Clocks
    drive: Drive
    converters: Converters | None
    command_delay: int
    integrator: Integrator
    validity: Validity
    disturbance: Disturbance | None
    has_forces: bool
    ground: Ground | None
    contacts: Contacts | None
    base: BaseMotion | None = None

    @property
    def instants(self) -> int:
        """Number of control instants, and thus of rows of the log. Both ends of the run count."""
        return self.clocks.periods + 1

    @property
    def has_buffers(self) -> bool:
        """Whether buffers catch the drives at the ends of their ranges."""
        return self.validity == "buffers"

    @property
    def rope_may_go_slack(self) -> bool:
        """Whether the crane has a rope that stretches or goes slack."""
        return self.crane.springs.rope is not None

    @property
    def position_lead(self) -> float:
        """Time by which coordinates run ahead of rates [s]; it depends on the integrator."""
        return self.integrator.lead * self.clocks.dt

    def time(self, instant: int) -> float:
        """Return the time [s] of a control instant by its index; the start has index 0."""
        # A product, not a sum of periods: rounding errors do not grow with the length of the run.
        return self.t_start + instant * self.clocks.period


def make_run_spec(
    crane: Crane,
    *,
    start: State | None,
    t_start: float,
    duration: float,
    dt: float,
    control_period: float,
    drive: Drive | Converters,
    integrator: Integrator,
    validity: Validity,
    disturbance: Disturbance | None,
    ground: Ground | None,
    has_forces: bool = False,
    base: BaseMotion | None = None,
) -> RunSpec:
    """Check the arguments of a run, fill in what is left open, and return them as a spec.

    The arguments are those of `cranedyn.simulation.simulate.simulate`. In addition `has_forces` is
    True if a caller passes forces to each step.

    Raises:
        OutOfRange: If an argument is out of its range or has no effect; if there is not one
            converter for each drive; if the start is not one finite coordinate and rate for each
            joint; if the motion of the base is not known for the whole run.
    """
    if isinstance(drive, Converters):
        drive_kind: Drive = "velocity"
        converters = converters_of_run(crane, drive_kind, drive)
    else:
        check_choice("drive", drive, Drive)
        drive_kind = drive
        converters = converters_of_run(crane, drive_kind, None)

    check_choice("validity", validity, Validity)
    if validity == "buffers" and drive_kind != "effort":
        # A buffer pushes with a force. A drive that follows its motion exactly would not feel it.
        allowed = "stop or mark, or buffers where the drives take efforts"
        raise OutOfRange("validity", validity, allowed)

    if not isinstance(integrator, Integrator):
        allowed = "an Integrator, such as rk4 of cranedyn.dynamics.integrators"
        raise OutOfRange("integrator", shown(integrator), allowed)

    run_clocks = clocks(duration, dt, control_period)
    command_delay = 0
    if converters is not None:
        command_delay = converters.delay_steps(run_clocks.dt, run_clocks.period)

    first_time = number("time at the start", t_start, "s", "-1e9 to 1e9")
    if base is not None:
        _check_base(base, first_time, first_time + run_clocks.periods * run_clocks.period)
        if type(disturbance) is Wind:
            # The points of the crane move with the base, and the wind blows against both.
            disturbance = replace(disturbance, base=base)

    return RunSpec(
        crane=crane,
        start=crane.layout.as_state("start", crane.start if start is None else start),
        t_start=first_time,
        clocks=run_clocks,
        drive=drive_kind,
        converters=converters,
        command_delay=command_delay,
        integrator=integrator,
        validity=validity,
        disturbance=disturbance,
        has_forces=has_forces or disturbance is not None,
        ground=ground,
        contacts=None if ground is None else ground.contacts(crane),
        base=base,
    )


def _check_base(base: BaseMotion, first: float, last: float) -> None:
    """Check that the motion of a base is known at both ends of a run [s].

    Raises:
        OutOfRange: If it is not, or it is no motion.
    """
    if not isinstance(base, BaseMotion):
        allowed = "a BaseMotion, such as BaseMotion.sines(heave=(1.0, 8.0))"
        raise OutOfRange("base", shown(base), allowed)
    base.at(np.array([first, last]))
