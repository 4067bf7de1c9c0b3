"""What stands where in the memory that compiled loops share with Python."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

from cranedyn.compiled.code import DOUBLE, INTEGER, POINTER
from cranedyn.model.layout import Layout

Sections = dict[str, int]
"""How many numbers each part has, by its name, in order."""


@dataclass(frozen=True)
class BufferLayout:
    """How many numbers each part has, for a crane with n joints, m drives and some points that
    forces act on; frequency converters hear commands so many control periods late, None for drives
    without.
    """

    n: int
    m: int
    points: int
    delay_steps: int | None = None

    @classmethod
    def of(cls, layout: Layout, delay_steps: int | None = None) -> BufferLayout:
        """Those of a crane."""
        return cls(layout.n, layout.m, len(layout.points), delay_steps)

    @property
    def converters(self) -> Sections:
        """What frequency converters remember: reference rates, how fast they change, commands that
        are not yet heard.
        """
        if self.delay_steps is None:
            return {}
        return {"reference": self.m, "rising": self.m, "unheard": self.delay_steps * self.m}

    @property
    def z(self) -> int:
        """Coordinates and rates together."""
        return 2 * self.n

    @property
    def state(self) -> Sections:
        """What a crane is at a control instant: coordinates, rates, integrals of the controller,
        the last command, work of the buffers, what frequency converters remember.
        """
        found = {"q": self.n, "v": self.n, "integral": self.m, "last_command": self.m, "buffers": 1}
        return found | self.converters

    @property
    def gain_table(self) -> Sections:
        """One row of a controller that is affine in the state."""
        return {
            "feed_forward": self.m,
            "gain": self.m * self.z,
            "integral_gain": self.m,
            "limit": self.m,
        }

    @property
    def setpoint_table(self) -> Sections:
        """One row of what it is about: coordinates and rates, and the setpoint of the drives."""
        return {"setpoint": self.z, "position": self.m}

    @property
    def force(self) -> Sections:
        """One row of outside forces, on the points of the crane."""
        return {"force": 3 * self.points}

    @property
    def offset(self) -> Sections:
        """One row of what sensors add to coordinates and rates."""
        return {"reading": self.z}

    @property
    def row(self) -> Sections:
        """One row of the log; cut is 1 where a converter was told more than its largest rate."""
        found = {
            "q": self.n,
            "v": self.n,
            "command": self.m,
            "effort": self.m,
            "before": self.m,
            "energy": 1,
            "buffers": 1,
            "stop_force": 1,
        }
        return found if self.delay_steps is None else found | {"cut": 1}

    @property
    def summary(self) -> Sections:
        """What is kept of a whole run.

        Squares of the largest swing and of the largest amplitude from a row on, the first row at
        which the model does not hold, and the largest efforts.
        """
        return {"peak": 1, "residual": 1, "invalid": 1, "effort": self.m}

    @property
    def query(self) -> Sections:
        """What accelerations are asked for with: coordinates, rates, a command, outside forces."""
        return {"q": self.n, "v": self.n, "command": self.m, "force": 3 * self.points}


def size(sections: Sections) -> int:
    """How many numbers all parts have."""
    return sum(sections.values())


def slices(sections: Sections) -> dict[str, slice]:
    """Where each part stands."""
    ends = accumulate(sections.values())
    return {
        name: slice(end - count, end)
        for (name, count), end in zip(sections.items(), ends, strict=True)
    }


TURNS = 16
"""Steps over which sines and cosines are carried along by turning them; each adds a rounding."""

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
    ),
    INTEGER: (
        "gain_table_rows",
        "setpoint_table_rows",
        "force_rows",
        "offset_rows",
        "remembered",
        "first",
        "last",
        "end",
        "steps",
        "substeps",
        "every",
        "after",
        "resumed",
    ),
    DOUBLE: ("dt", "period"),
}
"""What a call of the loop gives, eight bytes each. Addresses: memory of a group of lanes, tables,
where each lane's tables start [rows], by how many control periods each lane's sensors are late and
the readings that they keep for it, memory of a predictive controller.
Whole numbers: rows of the tables; how many readings are kept; control instants from the
first up to, but without, the last, of which that at the end is not followed by steps; steps in a
period; small steps in a step where buffers act; instants for a row of the log; instant from which a
swing is residual; 1 where the first instant was begun before and goes on with steps, else 0. Times
[s]."""

SLOTS = {name: slot for slot, name in enumerate(name for names in CALL.values() for name in names)}
