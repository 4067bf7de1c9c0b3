"""Whether a load chart is for the crane as it stands on a site: its boom, counterweight and
outriggers.
"""

from __future__ import annotations

from cranedyn.lifts.judging.chart import Chart
from cranedyn.lifts.planning.site import Site

OUTRIGGER_TOLERANCE = 0.05
"""Length by which outriggers may be nearer to each other than those of the chart [m]: what rounding
to decimetres makes."""

_COUNTERWEIGHT_TOLERANCE = 1.0
"""Largest difference of counterweights that count as the same [kg]: makers round to 100 kg."""


def setup_gap(chart: Chart, falls: int | None, site: Site) -> str:
    """Return why a chart says nothing about the crane of a site, in a sentence; an empty text if it
    does.

    Args:
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        site: The site. What the chart is made for must have been entered there.
    """
    if site.telescope and not chart.booms(falls):
        return (
            f"the boom of this crane telescopes ({site.telescope}), and the chart does not say for "
            "which length of it the loads are; give each [[falls]] its boom."
        )
    if chart.counterweight is not None:
        needed = f"the chart is for a counterweight of {chart.counterweight:g} kg"
        if site.counterweight is None:
            return f"{needed}, and [crane] counterweight of the site is missing."
        if abs(site.counterweight - chart.counterweight) > _COUNTERWEIGHT_TOLERANCE:
            return f"{needed}, and the crane has {site.counterweight:g} kg."
    if chart.outriggers is not None:
        needed = f"the chart is for outriggers {chart.outriggers:g} m apart"
        if site.base is None:
            return f"{needed}, and [base] of the site is missing."
        if site.base.spacing < chart.outriggers - OUTRIGGER_TOLERANCE:
            return f"{needed}, and [base] spacing of the site is {site.base.spacing:g} m."
    return ""
