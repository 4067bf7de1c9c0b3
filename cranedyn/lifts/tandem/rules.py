"""How much more than its share of a load each of several cranes must be able to lift, as codes of
practice have it.
"""

from __future__ import annotations

from cranedyn.errors import OutOfRange

_ADDITIONAL_CAPACITY = {2: 0.20, 3: 0.33, 4: 0.50}
"""Additional capacity over the calculated share, by the number of cranes; from four on the last."""

SOURCE = (
    "Queensland Mobile Crane Code of Practice, 14.3.2, read on the web; AS 2550.1, 6.28, which it "
    "follows, was read second hand"
)
"""Where the rule was read."""


def required_capacity(share: float, cranes: int = 2) -> float:
    """Return the rated load that a crane needs for its calculated share of a load, in the unit of
    the share: 20 % more of two cranes, 33 % of three, 50 % of four and more. The rule is for cranes
    whose motions are not synchronised.

    Args:
        share: Calculated share of the load.
        cranes: Number of cranes.

    Raises:
        OutOfRange: If there are fewer than two cranes.
    """
    if cranes < 2:
        raise OutOfRange("number of cranes", cranes, "2 or more")
    return share * (1.0 + _ADDITIONAL_CAPACITY[min(cranes, max(_ADDITIONAL_CAPACITY))])
