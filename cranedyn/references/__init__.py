"""Where the drives should be at a time. A reference is a plain callable from time [s] to `Wanted`."""

from cranedyn.references.hold import hold
from cranedyn.references.itinerary import ARTICLE_TOUR, Itinerary, Leg, itinerary
from cranedyn.references.pulse import pulse
from cranedyn.references.ramp import ramp
from cranedyn.references.wanted import Reference, Wanted

__all__ = ["ARTICLE_TOUR", "Itinerary", "Leg", "Reference", "Wanted", "hold", "itinerary", "pulse", "ramp"]
