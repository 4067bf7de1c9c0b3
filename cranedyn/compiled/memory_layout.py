"""Layout of the memory that compiled loops share with Python."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

from cranedyn.compiled.code import DOUBLE, INTEGER, POINTER
from cranedyn.dynamics.contact import Contacts
from cranedyn.model.layout import Layout

Sections = dict[str, int]
"""Number of doubles in each section of a buffer, in the order of memory."""


@dataclass(frozen=True)
class BufferLayout:
    """Numbers in each section of a buffer.

    Attributes:
        n: Number of joints.
        m: Number of drives.
        points: Number of points that external forces act on.
        delay_steps: Control periods by which frequency converters delay commands; None for drives
            without converters.
        touching: Points of the load that may touch the ground; 0 without ground.
        ledger: Whether rows of the log are those of `simulate`, with its energy ledger.
    """

    n: int
    m: int
    points: int
    delay_steps: int | None = None
    touching: int = 0
    ledger: bool = False

    @classmethod
    def of(
        cls, layout: Layout, delay_steps: int | None = None, contacts: Contacts | None = None
    ) -> BufferLayout:
        """Return the layout of the buffers of a crane."""
        touching = 0 if contacts is None else len(contacts.points)
        return cls(layout.n, layout.m, len(layout.points), delay_steps, touching)

    @cached_property
    def converters(self) -> Sections:
        """Memory of the frequency converters: reference rates, their rates of change, and delayed
        commands.
        """
        if self.delay_steps is None:
            return {}
        return {"reference": self.m, "rising": self.m, "unheard": self.delay_steps * self.m}

    @property
    def z(self) -> int:
        """Number of coordinates and rates together."""
        return 2 * self.n

    @cached_property
    def state(self) -> Sections:
        """State of a crane at a control instant, in SI units.

        The first sections are those of every crane, and the others follow where they apply. At a
        fleet's start, the sections of the converters are written up to the end of the state: only
        those of the ledger, which a fleet has not, may come after them.
        """
        sections = {
            "q": self.n,  # coordinates
            "v": self.n,  # rates
            "integral": self.m,  # integrals of the controller
            "last_command": self.m,
            "contacts": 2,  # work of buffers and ground, and of impacts of the rope
        }
        if self.touching:
            sections["anchors"] = 3 * self.touching  # of the points that touch the ground
        sections |= self.converters
        if self.ledger:
            sections |= {
                "work": self.m,  # of the drives so far
                "dissipated": 1,  # energy so far
                "reached": self.m,  # positions of the drives at the last row
                "acted": self.m,  # their efforts from the last row on
                "power": 1,  # dissipated at the last row
                "again": 1,  # 1 after the first row, else 0
                "broken": 1,  # 1 after a row with a number that is not finite or a joint too fast
                "pushed": 3 * self.points,  # external forces from the last row on
            }
        return sections

    @cached_property
    def gain_table(self) -> Sections:
        """Row of the gain table of a controller that is affine in the state."""
        m = self.m
        return {"feed_forward": m, "gain": m * self.z, "integral_gain": m, "limit": m}

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
        """Row of the log; cut is 1 where the command exceeds the largest rate of a converter."""
        n, m = self.n, self.m
        if self.ledger:
            return row_sections(n, m, self.points)
        sections = {"q": n, "v": n, "command": m, "effort": m, "before": m}
        sections |= {"energy": 1, "contacts": 2, "stop_force": 1}
        return sections if self.delay_steps is None else sections | {"cut": 1}

    @cached_property
    def summary(self) -> Sections:
        """Summary of a run.

        Squares of the largest swing and of the largest amplitude from a row on, the first row at
        which the model does not hold, and the largest efforts.
        """
        return {"peak": 1, "residual": 1, "invalid": 1, "effort": self.m}

    @cached_property
    def query(self) -> Sections:
        """Arguments of the function for accelerations: coordinates, rates, a command, external
        forces.
        """
        return {"q": self.n, "v": self.n, "command": self.m, "force": 3 * self.points}


def row_sections(n: int, m: int, points: int) -> Sections:
    """Return the sections of a row of the log of `simulate`, for numbers of joints, drives and
    points of a crane.
    """
    return {
        "setpoint": m,  # positions of the setpoint of the drives
        "q": n,
        "v": n,
        "needed": m,  # efforts that the command asks for
        "effort": m,  # efforts from the instant on
        "effort_before": m,  # efforts until the instant
        "force": 3 * points,  # external forces
        # A number that is not used, the work of buffers and ground and that of impacts, and the
        # force of the buffers at the ends of the cable.
        "outside": 4,
        "saturated": 1,  # 1 where a command is beyond the largest rate of a converter
        "energy": 1,
        "work": m,  # of the drives so far
        "dissipated": 1,  # energy so far
        "valid": 1,  # 1 where the model holds and the drives can follow
    }


def size(sections: Sections) -> int:
    """Return the number of all numbers in the sections."""
    return sum(sections.values())


def slices(sections: Sections) -> dict[str, slice]:
    """Return the slice of each section."""
    ends = zip(sections, accumulate(sections.values()), strict=True)
    return {name: slice(end - sections[name], end) for name, end in ends}


TURNS = 16
"""Steps after which sines and cosines are computed afresh; until then each step rotates them, with
a rounding error each."""

CALL = {
    POINTER: (
        "state",
        "numbers",
        "offset",
        "gain_table",
        "setpoint_table",
        "force",
        "starts",
        "delay",
        "readings",
        "log",
        "summary",
        "horizon",
        "workspace",
    ),
    INTEGER: (
        "gain_table_rows",
        "setpoint_table_rows",
        "force_rows",
        "offset_rows",
        "reading_count",
        "first",
        "last",
        "end",
        "steps",
        "substeps",
        "force_interval",
        "log_interval",
        "residual_from",
        "resumed",
    ),
    DOUBLE: ("dt", "period"),
}
"""Arguments of the loop by type, eight bytes each.

Addresses point to the memory of a group of lanes, to the tables, to the first row [rows] of each
lane's tables, to the sensor delay [control periods] of each lane and its stored readings, and to
the memory and the workspace of a predictive controller.

Whole numbers are the rows of the tables, the number of stored readings, the first control instant
and the one after the last, the instant that no steps follow, steps in a period, substeps of a step
where buffers act, instants between rows of the forces and of the log, the instant from which swing
is residual, and resumed: 1 if the control of the first instant has already run, else 0. Times are
in seconds."""

SLOTS = {name: slot for slot, name in enumerate(name for names in CALL.values() for name in names)}
