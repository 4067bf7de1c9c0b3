"""Tables, claims and the figure of lift-off and set-down."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cranedyn.lifts.judging.factors import HOISTING
from cranedyn.plotting.figures import COLOURS, legend_above, panels
from cranedyn.plotting.style import run_colour
from experiments.harness import Claim, ResultTable, make_table
from experiments.liftoff.box_runs import LiftOff, OffLead, SetDown, Slide

ADIABATIC_ERROR = 0.02
"""Relative error of the law that a swing grows as l^(-3/4) on a rope that shortens slowly.

It is of the order of the speed over l ω.
"""


def pick_up_table(picked: Sequence[LiftOff]) -> ResultTable:
    """Return a row for each lift-off by a hoist of a class."""
    return make_table(
        "Lift-off by hoisting and drive class",
        picked,
        ("class", "", lambda p: p.hoisting),
        ("drive", "", lambda p: p.drive),
        ("v_h [m/s]", ".2f", lambda p: p.speed),
        ("T/W", ".4f", lambda p: p.simulated),
        ("1 + β2 v_h", ".4f", lambda p: p.closed),
        ("allowed", ".0e", lambda p: p.allowed),
        ("φ2", ".3f", lambda p: p.standard),
        note="The hoist turns at v_h, the rope gets taut, the box leaves hard ground. Allowed: by "
        "the sink of the ground and the strain of the rope. φ2 = φ2,min + β2 v_h, EN 1991-3 and "
        "13001-2 read second hand. HD5 lifts off without speed.",
    )


def lift_off_figure(picked: Sequence[LiftOff]) -> Figure:
    """Draw φ2 and simulated tensions over the speed of lift-off, a colour a class."""
    figure, (ax,) = panels(width=7.0, height=3.6)
    speeds = np.array([0.0, max(p.speed for p in picked)])
    for i, hoisting in enumerate(dict.fromkeys(p.hoisting for p in picked)):
        slope, intercept = HOISTING[hoisting]
        drawn = [p for p in picked if p.hoisting == hoisting]
        colour = run_colour(i)
        ax.plot(speeds, intercept + slope * speeds, color=colour, label=f"φ2, {hoisting}")
        ax.plot(speeds, 1.0 + slope * speeds, color=colour, linestyle=":")
        ax.plot([p.speed for p in drawn], [p.simulated for p in drawn], "o", color=colour)
    ax.plot([], [], ":", color=COLOURS["setpoint"], label="1 + β2 v")
    ax.plot([], [], "o", color=COLOURS["setpoint"], label="simulated")
    ax.set(xlabel="hoisting speed at lift-off [m/s]", ylabel="tension over weight")
    legend_above(ax)
    return figure


def off_lead_table(leaning: Sequence[OffLead]) -> ResultTable:
    """Return a row for each lift-off by a rope that leans."""
    return make_table(
        "Lift-off by a rope that leans",
        leaning,
        ("friction", ".1f", lambda o: o.friction),
        ("offset [m]", ".1f", lambda o: o.offset),
        ("v_h [m/s]", ".2f", lambda o: o.speed),
        ("off-lead [°]", ".2f", lambda o: math.degrees(o.lead)),
        ("slid [m]", ".2f>0.01", lambda o: o.slid),
        ("swing [°]", ".2f", lambda o: math.degrees(o.swing)),
        ("swing/off-lead", ".2f", lambda o: o.swing / o.lead),
        note="Off-lead: as the rope gets taut. Swing: largest in 20 s, as on a rope of the length "
        "at lift-off.",
    )


def slide_table(slides: Sequence[Slide]) -> ResultTable:
    """Return a row for each box that slides to rest."""
    return make_table(
        "A box that slides to rest",
        slides,
        ("friction", ".1f", lambda s: s.friction),
        ("v [m/s]", ".1f", lambda s: s.speed),
        ("slid [m]", ".4f", lambda s: s.slid),
        ("v²/(2 μ g)", ".4f", lambda s: s.closed),
        ("allowed", ".0e", lambda s: s.allowed),
        note="On the ground below a slack rope. Allowed: by the strain of contacts that stick and "
        "the pitch of the box.",
    )


def set_down_table(down: Sequence[SetDown]) -> ResultTable:
    """Return a row for each set-down."""
    return make_table(
        "Set-down",
        down,
        ("v [m/s]", ".2f", lambda d: d.speed),
        ("T/W at most", ".3f", lambda d: d.pull),
        ("ground/W at most", ".2f", lambda d: d.push),
        ("slack after [s]", ".2f", lambda d: d.slack_after),
        ("in the air again [s]", ".2f", lambda d: d.rebounds),
    )


def pick_up_claims(picked: Sequence[LiftOff]) -> list[Claim]:
    """Return the claims on the tension at lift-off: its closed form, and the factor φ2."""
    worst = max(picked, key=lambda p: abs(p.simulated - p.closed) / p.allowed)
    near = min(picked, key=lambda p: p.standard - p.simulated)
    return [
        Claim(
            f"A box that leaves the ground loads the rope by 1 + β2 v_h in {len(picked)} cases; "
            f"worst: {worst.hoisting} {worst.drive}, {worst.simulated:.4f} beside "
            f"{worst.closed:.4f}, {worst.allowed:.0e} allowed.",
            all(abs(p.simulated - p.closed) <= p.allowed for p in picked),
        ),
        Claim(
            f"φ2 covers each of them; nearest: {near.hoisting} {near.drive}, {near.simulated:.3f} "
            f"of {near.standard:.3f}.",
            near.simulated <= near.standard,
        ),
    ]


def slide_claim(slides: Sequence[Slide]) -> Claim:
    """Return the claim on the distance that a box slides."""
    worst = max(slides, key=lambda s: abs(s.slid - s.closed) / s.allowed)
    return Claim(
        f"A box that slides rests after v²/(2 μ g) in {len(slides)} cases; worst: {worst.slid:.4f} "
        f"m beside {worst.closed:.4f} m, {worst.allowed:.0e} m allowed.",
        all(abs(s.slid - s.closed) <= s.allowed for s in slides),
    )


def other_claims(worst: OffLead, down: Sequence[SetDown]) -> list[Claim]:
    """Return the claims on the swing after lift-off and on set-down.

    Args:
        worst: The lift off-lead with the largest swing over the angle by which its rope leaned.
        down: All set-downs.
    """
    hard = max(down, key=lambda d: d.pull)
    return [
        Claim(
            "After lift-off the load swings no farther than the rope leaned; worst: "
            f"{worst.swing / worst.lead:.3f} of it, {1.0 + ADIABATIC_ERROR:g} allowed.",
            worst.swing <= (1.0 + ADIABATIC_ERROR) * worst.lead,
        ),
        Claim(
            f"A set-down loads the rope by no more than the weight: {hard.pull:.4f} at most; it "
            "goes slack in each case and the box stays down.",
            hard.pull <= 1.001
            and all(math.isfinite(d.slack_after) and d.rebounds == 0.0 for d in down),
        ),
    ]
