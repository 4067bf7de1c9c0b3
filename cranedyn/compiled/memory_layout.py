"""Layout of the memory that compiled loops share with Python.

A *buffer* is an array of doubles for each group of lanes, such as the states of its cranes. It has
*sections* with names: `BufferLayout` says which, and how many numbers each has. A *call* is the
list of what the loop is told about one run of a group, see `SLOT_TYPES`.

Of a crane with n joints and m drives, z counts coordinates and rates together, 2 n.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from cranedyn.compiled.code import DOUBLE, INTEGER, POINTER
from cranedyn.dynamics.contact import Contacts
from cranedyn.dynamics.root_motion import ROOT_NUMBERS
from cranedyn.model.layout import Layout

Sections = dict[str, int]
"""Number of doubles in each section of a buffer, in the order of memory."""


@dataclass(frozen=True)
class BufferLayout:
    """Sections of the buffers of a crane.

    Attributes:
        n: Number of joints.
        m: Number of drives.
        points: Number of points that external forces act on.
        delay_steps: Control periods by which frequency converters delay commands; None for drives
            without converters.
        touching: Number of points of the load that may touch the ground; 0 without ground.
        ledger: Whether rows of the log are those of `simulate`, with its energy ledger.
        controller_states: Number of states of the controller, see
            `cranedyn.controllers.affine.ControllerStates`.
        base: Whether the base moves.
    """

    n: int
    m: int
    points: int
    delay_steps: int | None = None
    touching: int = 0
    ledger: bool = False
    controller_states: int = 0
    base: bool = False

    @classmethod
    def of(
        cls, layout: Layout, delay_steps: int | None = None, contacts: Contacts | None = None
    ) -> BufferLayout:
        """Return the layout of the buffers of a crane, without an energy ledger and without states
        of a controller.
        """
        touching = 0 if contacts is None else len(contacts.points)
        return cls(layout.n, layout.m, len(layout.points), delay_steps, touching)

    @cached_property
    def converters(self) -> Sections:
        """Memory of the frequency converters; empty without them."""
        if self.delay_steps is None:
            return {}
        return {
            "reference": self.m,  # reference rates
            "reference_slope": self.m,  # rates of change of the reference rates
            # Commands on their way to the converters, those of the earliest instant first.
            "delayed_commands": self.delay_steps * self.m,
        }

    @property
    def z(self) -> int:
        """Number of coordinates and rates together."""
        return 2 * self.n

    @cached_property
    def state(self) -> Sections:
        """State of a crane at a control instant, in SI units.

        The first sections are those of every crane, and the others follow where they apply. A fleet
        writes the sections of the converters up to the end of the state when it places a crane:
        only those of the ledger and of the controller, which a fleet does not have, may come after
        them. The states of the controller are the last section, so that a crane is in the same
        place whatever controls it.
        """
        sections = {
            "q": self.n,  # coordinates
            "v": self.n,  # rates
            "integral": self.m,  # integrals of the controller
            "last_command": self.m,  # what the drives follow since the last control instant
            # Work since the start: that of buffers and ground, and that of impacts of the rope.
            "contact_and_impact_work": 2,
        }
        if self.touching:
            sections["anchors"] = 3 * self.touching  # of the points that touch the ground
        sections |= self.converters
        if self.ledger:
            # "Previous" is what the last row of the log had, for sums from row to row.
            sections |= {
                "work": self.m,  # of the drives since the start
                "dissipated": 1,  # energy dissipated since the start
                "previous_position": self.m,  # positions of the drives
                "previous_effort": self.m,  # efforts of the drives from that row on
                "previous_power": 1,  # dissipated power
                "has_previous_row": 1,  # 1 after the first row, else 0
                # 1 after a row with a number that is not finite, or a joint that moves too fast
                "diverged": 1,
                "previous_force": 3 * self.points,  # external forces from that row on
            }
        if self.controller_states:
            sections["controller"] = self.controller_states
        return sections

    @cached_property
    def gain_table(self) -> Sections:
        """Row of the gain table of a controller that is affine in the state."""
        m = self.m
        sections = {"feed_forward": m, "gain": m * self.z, "integral_gain": m, "limit": m}
        k = self.controller_states
        if k:
            # The fields of `ControllerStates` but for the initial states, matrices row by row.
            sections |= {
                "states.a": k * k,
                "states.b": k * self.z,
                "states.c": m * k,
                "states.anti_windup": k * m,
                "states.limit": m,
            }
        return sections

    @cached_property
    def setpoint_table(self) -> Sections:
        """Row of the setpoint table: the state about which the controller acts, and the setpoint of
        the drives.
        """
        return {"setpoint": self.z, "position": self.m}

    @cached_property
    def force(self) -> Sections:
        """Row of external forces on the points of the crane."""
        return {"force": 3 * self.points}

    @cached_property
    def offset(self) -> Sections:
        """Row of offsets that sensors add to coordinates and rates."""
        return {"reading": self.z}

    @cached_property
    def row(self) -> Sections:
        """Row of the log."""
        n = self.n
        m = self.m
        if self.ledger:
            return row_sections(n, m, self.points)
        sections = {
            "q": n,
            "v": n,
            "command": m,  # efforts that the command asks for
            "effort": m,  # efforts from the instant on
            "before": m,  # efforts until the instant
            "energy": 1,
            "contact_and_impact_work": 2,
            "cable_buffer_force": 1,  # force of the buffers at the ends of the cable
        }
        if self.delay_steps is not None:
            sections["saturated"] = 1  # 1 where a command exceeds the largest rate of a converter
        return sections

    @cached_property
    def summary(self) -> Sections:
        """Summary of a run."""
        return {
            "peak": 1,  # square of the largest swing
            "residual": 1,  # square of the largest amplitude of the swing, from an instant on
            "invalid": 1,  # first control instant at which the model does not hold
            "effort": self.m,  # largest efforts of the drives
        }

    @cached_property
    def query(self) -> Sections:
        """Arguments of the function for accelerations: coordinates, rates, a command, external
        forces and, if the base moves, its motion.
        """
        sections = {"q": self.n, "v": self.n, "command": self.m, "force": 3 * self.points}
        if self.base:
            sections["root"] = ROOT_NUMBERS
        return sections


def row_sections(n: int, m: int, points: int) -> Sections:
    """Return the sections of a row of the log of `simulate`.

    Args:
        n: Number of joints.
        m: Number of drives.
        points: Number of points that external forces act on.
    """
    return {
        "setpoint": m,  # positions of the setpoint of the drives
        "q": n,
        "v": n,
        "needed": m,  # efforts that the command asks for
        "effort": m,  # efforts from the instant on
        "effort_before": m,  # efforts until the instant
        "force": 3 * points,  # external forces
        "unused": 1,  # the work of external forces, which the log computes after the run
        "contact_work": 1,  # of buffers and ground since the start
        "impact_work": 1,  # of impacts of the rope since the start
        "cable_buffer_force": 1,  # force of the buffers at the ends of the cable
        "saturated": 1,  # 1 where a command exceeds the largest rate of a converter
        "energy": 1,
        "work": m,  # of the drives since the start
        "dissipated": 1,  # energy dissipated since the start
        "valid": 1,  # 1 where the model holds and the drives can follow
    }


TABLES = ("gain_table", "setpoint_table", "force", "offset")
"""Names of the tables of a loop, whose row for an instant has the sections of that name in
`BufferLayout`. Wherever tables are listed, they are in this order, and the last may be missing."""


def size(sections: Sections) -> int:
    """Return the number of all numbers in the sections."""
    return sum(sections.values())


def slices(sections: Sections) -> dict[str, slice]:
    """Return the slice of each section."""
    places = {}
    first = 0
    for name, length in sections.items():
        places[name] = slice(first, first + length)
        first += length
    return places


ANGLE_REFRESH_STEPS = 16
"""Steps after which sines and cosines are computed afresh. Until then each step rotates them, see
`cranedyn.compiled.angles`, with a rounding error each."""

SLOT_TYPES = {
    # Memory of a group of lanes, and tables.
    "state": POINTER,  # states of the cranes, see `BufferLayout.state`
    "numbers": POINTER,  # crane parameters that differ between the lanes
    "offset": POINTER,  # table of sensor offsets
    "gain_table": POINTER,
    "setpoint_table": POINTER,
    "force": POINTER,  # table of external forces
    "root": POINTER,  # table of the motion of the base
    "root_starts": POINTER,  # first row of each lane's part of it
    "starts": POINTER,  # first row of each lane's part of each table
    "delay": POINTER,  # delay of the sensors of each lane [control periods]
    "readings": POINTER,  # ring of the readings of delayed sensors
    "log": POINTER,  # rows of the log, see `BufferLayout.row`
    "summary": POINTER,  # see `BufferLayout.summary`
    "horizon": POINTER,  # memory of a predictive controller
    "workspace": POINTER,  # path and memory of its optimisations
    # Whole numbers.
    "gain_table_rows": INTEGER,  # rows of the part of a lane, of this and the other tables
    "setpoint_table_rows": INTEGER,
    "force_rows": INTEGER,
    "offset_rows": INTEGER,
    "root_rows": INTEGER,  # rows of the part of a lane
    "reading_count": INTEGER,  # readings stored for delayed sensors
    "first": INTEGER,  # first control instant
    "last": INTEGER,  # control instant after the last
    "end": INTEGER,  # control instant that no steps follow
    "steps": INTEGER,  # physics steps that follow each control instant in this call
    "substeps": INTEGER,  # substeps of a step in which buffers or the ground act
    "force_interval": INTEGER,  # control instants from one row of the forces to the next
    "log_interval": INTEGER,  # control instants from one row of the log to the next
    "residual_from": INTEGER,  # control instant from which swing counts as residual
    "period_steps": INTEGER,  # physics steps of a whole control period
    "done": INTEGER,  # physics steps of the first control period that earlier calls have taken
    "resumed": INTEGER,  # 1 if the control of the first instant has already run, else 0
    "team": INTEGER,  # number of groups whose calls begin here, see `cranedyn.compiled.team`
    # Times.
    "dt": DOUBLE,  # physics step [s]
    "period": DOUBLE,  # control period [s]
}
"""Type of each slot of a call, in the order of memory: what the loop is told about one run of a
group. A slot has eight bytes."""

SLOTS = {name: slot for slot, name in enumerate(SLOT_TYPES)}
"""Index of each slot of a call."""

GROUP_POINTERS = (
    "state",
    "numbers",
    "starts",
    "root_starts",
    "delay",
    "readings",
    "log",
    "summary",
)
"""Slots of a call whose addresses differ between groups, and between the lanes of a group."""
