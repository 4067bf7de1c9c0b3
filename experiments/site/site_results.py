"""Tables and claims of the shifts and attacks on sites."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cranedyn.lifts.sites.adversaries import CHANNEL, Attack
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.plan import SitePlan
from cranedyn.lifts.sites.promise import site_assumptions
from cranedyn.lifts.sites.site_simulation import SiteExtremes
from experiments.harness import Claim, Column, ResultTable, make_table
from experiments.site.shifts import PROTECTIONS, Shift

MIN_LISTED = 8
"""Number of lifts on the lists of a site from which on lost time is judged."""


def _attack_of_shift(shift: Shift) -> Attack:
    """Return the result of a shift in the terms of an attack, with its protection as the kind."""
    run = shift.run
    contacts = np.array([len(run.contacts)])
    least = np.array([run.least_distance])
    extremes = SiteExtremes(contacts, least, run.swing, run.outside)
    return Attack.of(run.site, shift.protection, run.t[-1], extremes)


def shift_tables(shifts: Sequence[Shift]) -> list[ResultTable]:
    """Return a table of the shifts of all sites together, and one of each shift."""

    def total(value: Callable[[Shift], float]) -> Callable[[Sequence[Shift]], float]:
        return lambda group: sum(value(shift) for shift in group)

    def minutes(value: Callable[[SitePlan], float]) -> Callable[[Sequence[Shift]], float | None]:
        """Return the sum of a time of plans [s] in minutes; None where there is none."""
        return lambda group: sum(value(x.plan) for x in group if x.plan) / 60.0 or None

    columns: list[Column] = [
        ("protection", "", lambda group: group[0].protection),
        ("contacts", "d", total(lambda x: len(x.run.contacts))),
        ("distance [m]", ".2f", lambda group: max(0.0, min(x.run.least_distance for x in group))),
        ("on the list", "d", total(lambda x: sum(x.listed))),
        ("of these done", "d", total(lambda x: x.done)),
        ("all lifts", "d", total(lambda x: sum(len(one.finished) for one in x.operators))),
        ("plan [min]", ".1f", minutes(lambda plan: plan.duration)),
        ("least [min]", ".1f", minutes(lambda plan: plan.least)),
        ("in a deadlock [min]", ".1f", total(lambda x: CYCLE * len(x.run.deadlocks) / 60.0)),
        ("crane-minutes", ".0f", total(lambda x: x.crane_minutes)),
    ]
    site: Column = ("site", "", lambda group: group[0].site)

    by_protection = [[x for x in shifts if x.protection == kind] for kind in PROTECTIONS]
    note = """The list: what a crane lifts without protection; zones leave lifts out, do later ones.
Operators raise each load first; plans only where that is quicker."""

    refusals = []
    for shift in shifts:
        if shift.plan:
            refusals += [f"{shift.site}: {text}" for text in shift.plan.refusals]
    return [
        make_table("Shifts of random lifts", by_protection, *columns, note=note),
        make_table("By site", [[x] for x in shifts], site, *columns, note="\n".join(refusals)),
    ]


def attack_table(attacks: Sequence[Attack]) -> ResultTable:
    """Return a row for each site and kind of adversaries."""
    return make_table(
        "Adversaries",
        attacks,
        ("site", "", lambda attack: attack.site),
        ("adversaries", "", lambda attack: attack.kind),
        ("contacts", "d", lambda attack: attack.contacts),
        ("beyond required distance [m]", ".2f", lambda attack: attack.least),
        ("swing / largest", ".2f", lambda attack: attack.swing),
        ("95 %: in 10⁶ crane-minutes", ".3g", lambda attack: attack.most_contacts),
        ("crane-minutes", ".0f", lambda attack: attack.crane_minutes),
        note=f"Messages take {CHANNEL.latency:g} s, {100.0 * CHANNEL.loss:g} % are lost.",
    )


def assumption_table(shifts: Sequence[Shift]) -> ResultTable:
    """Return a row for each assumption on which the promises of a site rest."""
    rows = []
    for shift in shifts:
        # The assumptions are those of the site: once is enough.
        if shift.protection == PROTECTIONS[0]:
            site = shift.run.site
            rows += [(site.name, assumption) for assumption in site_assumptions(site)]
    return make_table(
        "Assumptions",
        rows,
        ("site", "", lambda row: row[0]),
        ("the promise rests on", "", lambda row: row[1].name),
        ("assumed", "", lambda row: row[1].value),
        ("from", "", lambda row: row[1].origin.value),
        note="Supervised cranes do not meet as long as all of it holds. Enter what is a default.",
    )


def site_claims(
    shifts: Sequence[Shift], attacks: Sequence[Attack], times: np.ndarray, ours: bool
) -> list[Claim]:
    """Return what the experiment shows.

    Args:
        shifts: All shifts.
        attacks: All attacks.
        times: Time of each cycle of a supervisor for eight cranes [s], shape (cycles,).
        ours: Whether all sites are examples. On other sites supervision may be worth less: it is
            not judged there.
    """
    unprotected = [shift for shift in shifts if shift.protection == "none"]
    zoned = [shift for shift in shifts if shift.protection == "zones"]
    supervised = [shift for shift in shifts if shift.protection == "supervisor"]
    planned = [shift for shift in shifts if shift.protection == "plan"]
    judged = ours and min(sum(shift.listed) for shift in shifts) >= MIN_LISTED
    slowest_plan = max(shift.planning for shift in planned)
    return [
        *_supervision_claims(supervised, attacks),
        _unprotected_claim(unprotected),
        _lost_time_claim(supervised, zoned, judged),
        _plan_claim(planned),
        _done_claim(planned, supervised, judged),
        _real_shapes_claim(shifts),
        Claim(
            f"Plans take less than 2 s a lift ({slowest_plan:.2f} s, slowest site).",
            slowest_plan < 2.0,
        ),
        Claim(
            f"For eight cranes the supervisor needs less than a tenth of its cycle of "
            f"{1e3 * CYCLE:g} ms ({1e3 * times.max():.1f} ms at most, "
            f"{1e3 * np.median(times):.1f} ms in the median; the least of three passes).",
            bool(times.max() < CYCLE / 10.0),
        ),
    ]


def _supervision_claims(supervised: Sequence[Shift], attacks: Sequence[Attack]) -> list[Claim]:
    """Return the claims on contacts, distance, swing and boxes of supervised cranes."""
    runs = Attack.all_of([*attacks, *(_attack_of_shift(shift) for shift in supervised)])
    minutes = runs.crane_minutes
    # A Poisson process that gives no event with a probability of 5 % expects -ln 0.05 = 3.0.
    return [
        Claim(
            f"Supervised cranes do not touch in {minutes:.0f} crane-minutes: at 95 % fewer than "
            f"{3.0 / minutes:.2g} contacts a crane-minute, {3e6 / minutes:.0f} in 10⁶.",
            runs.contacts == 0,
        ),
        Claim(
            f"They keep the required distance, ropes their largest swing ({100.0 * runs.swing:.0f} "
            "% of it), drives their boxes.",
            runs.least >= 0.0 and runs.swing <= 1.0 and runs.outside <= 0.0,
        ),
    ]


def _unprotected_claim(unprotected: Sequence[Shift]) -> Claim:
    """Return the claim that contacts are seen where cranes are not protected.

    It is not judged where nothing touches: then it shows nothing of how contacts are counted.
    """
    touches = sum(len(shift.run.contacts) for shift in unprotected)
    overlaps = sum(shift.real.overlaps for shift in unprotected)
    uncounted = sum(shift.real.uncounted for shift in unprotected)
    return Claim(
        f"Without protection they touch (contacts: {touches}): a contact was counted before "
        f"each of {overlaps} instants in which real shapes overlap.",
        (touches > 0 and not uncounted) if touches or overlaps else None,
    )


def _lost_time_claim(supervised: Sequence[Shift], zoned: Sequence[Shift], judged: bool) -> Claim:
    """Return the claim that supervision loses less time than static zones."""
    lost = [(shift.lost, zone.lost) for shift, zone in zip(supervised, zoned, strict=True)]
    return Claim(
        "Supervised cranes leave less than half of the lifts undone that static zones do: "
        f"{', '.join(f'{share:.0f} of {zones:.0f} %' for share, zones in lost)}.",
        all(share < zones / 2.0 for share, zones in lost) if judged else None,
    )


def _plan_claim(planned: Sequence[Shift]) -> Claim:
    """Return the claim that planned cranes keep apart without a supervisor."""
    plans = Attack.all_of([_attack_of_shift(shift) for shift in planned])
    proven = all(shift.plan.holds for shift in planned if shift.plan)
    return Claim(
        f"Planned cranes are proven apart, do not touch in {plans.crane_minutes:.0f} crane-"
        "minutes without a supervisor, keep distance and swing "
        f"({100.0 * plans.swing:.0f} % of it).",
        proven and plans.contacts == 0 and plans.least >= 0.0 and plans.swing <= 1.0,
    )


def _done_claim(planned: Sequence[Shift], supervised: Sequence[Shift], judged: bool) -> Claim:
    """Return the claim that plans do as many lifts as operators under the supervisor."""
    done = [(shift.done, bound.done) for shift, bound in zip(planned, supervised, strict=True)]
    return Claim(
        "Plans do at least as many lifts of the lists as operators under the supervisor: "
        f"{', '.join(f'{mine} and {theirs}' for mine, theirs in done)}.",
        all(mine >= theirs for mine, theirs in done) if judged else None,
    )


def _real_shapes_claim(shifts: Sequence[Shift]) -> Claim:
    """Return the claim that real shapes keep the distance, too, and lie in their capsules."""
    kept = [shift for shift in shifts if shift.protection in ("supervisor", "plan")]
    beyond = min(shift.real.least - shift.run.site.distance for shift in kept)
    instants = sum(shift.real.instants for shift in shifts)
    excess = max(shift.real.excess for shift in shifts)
    return Claim(
        f"Measured by real shapes and not by capsules, supervised and planned cranes keep the "
        f"required distance, too ({beyond:.2f} m beyond it at least), and in all {instants} "
        f"instants shapes are no nearer than capsules say (by {-excess:.2f} m at least).",
        beyond >= 0.0 and excess <= 0.0,
    )
