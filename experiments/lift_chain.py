"""Lifts of one crane, one after the other, for ``cranedyn run lift --chain FILE``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.command import command_line
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.errors import DataError
from cranedyn.lifts.planning.lift_chain import (
    CertifiedChain,
    ChainMove,
    certify_chain,
    plan_chain,
    read_chain,
)
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.verdict import Verdict, overall
from experiments import harness
from experiments.scenarios.moves import LIMITS


class _Row(NamedTuple):
    """A move in the table.

    Attributes:
        move: The move.
        begin: When it begins [s].
        pull: Largest pull of the rope [N].
        verdict: Verdict of its checks.
    """

    move: ChainMove
    begin: float
    pull: float
    verdict: Verdict


def chain_outcome(
    options: argparse.Namespace, setup: harness.Setup
) -> tuple[harness.Outcome, CertifiedChain]:
    """Plan, simulate and check a chain of lifts; return it, too.

    Raises:
        DataError: If there is not one site.
    """
    files = options.site or ["open_yard"]
    if len(files) != 1:
        raise DataError(f"A chain is lifted on one site; {len(files)} are given.")
    site = read_site(files[0])
    chain = plan_chain(
        site,
        read_chain(options.chain),
        site.limits or LIMITS,
        gravity=setup.gravity,
        period=setup.control_period,
        values=setup.values,
    )
    certified = certify_chain(chain, dt=setup.dt)
    checks = certified.all_checks
    complete = harness.Claim(
        f"{site.name}: the chain is certified, all {len(checks)} checks hold.",
        overall(checks) is Verdict.HOLDS,
    )
    outcome = harness.Outcome(
        tables=[_move_table(certified), _change_table(certified)],
        claims=[*checks, complete],
        parameters={
            "lifts": len(chain.sizes),
            "duration_s": chain.duration,
            "hook_kg": chain.hook.mass,
            "hook_m": list(chain.hook.size),
        },
        trajectories={"chain": certified.run.trajectory},
        next_commands=[command_line("cranedyn", "view", options.recording)],
    )
    return outcome, certified


def write_recording(certified: CertifiedChain, file: Path, code: int) -> int:
    """Write the recording of a chain, and return the exit code of the experiment."""
    from cranedyn.lifts.planning.chain_recording import record_chain  # Rerun takes long to import

    file = record_chain(file, certified, title=certified.chain.site.name)
    print(f"In 3D: {file}.")
    return code


def _move_table(certified: CertifiedChain) -> harness.ResultTable:
    chain = certified.chain
    rows = []
    for move, begin, piece, checks in zip(
        chain.moves, chain.begins, certified.run.stages, certified.checks, strict=True
    ):
        forces = JointForces.of(move.lift.crane)
        pull = float(np.max(forces.tension(piece.q.T, piece.v.T)))
        rows.append(_Row(move, begin, pull, overall(checks)))
    return harness.make_table(
        "Moves of the chain",
        rows,
        ("move", "", lambda r: r.move.name),
        ("hangs [kg]", ".0f", lambda r: r.move.lift.crane.payload_mass),
        ("begins [s]", ".1f", lambda r: r.begin),
        ("lasts [s]", ".1f", lambda r: r.move.duration),
        ("largest pull [kN]", ".2f", lambda r: r.pull / 1e3),
        ("verdict", "", lambda r: r.verdict.word),
        note=f"The hook of {chain.hook.mass:g} kg, "
        f"{' by '.join(f'{side:.2f}' for side in chain.hook.size)} m, comes and goes without a "
        "load. All moves are one run.",
    )


def _change_table(certified: CertifiedChain) -> harness.ResultTable:
    rows = []
    for move, piece, change in zip(
        certified.chain.moves[1:], certified.run.stages[1:], certified.run.changes, strict=True
    ):
        rows.append((move, float(piece.t[0]), change))
    return harness.make_table(
        "Loads that are attached and released",
        rows,
        ("before the move", "", lambda r: r[0].name),
        ("at [s]", ".1f", lambda r: r[1]),
        ("mass [kg]", "+.0f", lambda r: r[2].mass),
        ("energy brought [kJ]", "+.3f", lambda r: r[2].brought / 1e3),
        ("lost [J]", ".3f", lambda r: r[2].lost),
    )
