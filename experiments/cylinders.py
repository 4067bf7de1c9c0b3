"""Cylinders and pump of a mobile crane: forces by virtual work, work of a move, and shared oil.

The boom of the mobile crane telescopes and luffs by cylinders. Their lengths and forces are
compared with the distance of their points and with the potential energy of the crane, the work of a
move with that of the drives, and the oil that drives take with what a pump gives.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure

from cranedyn.controllers import follow
from cranedyn.controllers.pump_limited import PumpLimited
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.cylinders import Cylinder, Pump, cylinder_columns, read_cylinders
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.plotting.figures import legend_above, panels
from cranedyn.references import spline
from experiments import harness
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table

ANGLES = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4)
"""Angles of the boom at which forces are compared [rad]."""

ENERGY_STEP = 1e-4
"""Step of a coordinate in the difference of energies [rad or m]: errors of its square are 1e-8 of
the values, those of round-off 1e-9."""

MOVE = 80.0
"""Duration of a move of the boom [s]."""

FLOW = 120e-3 / 60.0
"""Flow of the pump: 120 litres a minute [m³/s]."""

MOTORS = {"slew": 2e-3, "l": 1e-2}
"""Oil of the motors of slew [m³/rad] and winch [m³/m]."""

ASKED = {"slew": 0.1, "luff": 0.02, "telescope": 0.05, "l": 0.3}
"""Rates that an operator asks for, all at once [rad/s or m/s]."""

STARTED = 2.0
"""Time after which the drives follow their commands [s]; their ramps and lags are over."""

PUMPED = 8.0
"""Duration of that run [s]."""


@dataclass(frozen=True)
class BoomForce:
    """Luffing cylinder and telescope at an angle of the boom, at rest.

    Attributes:
        angle: Angle of the boom [rad].
        length: Length of the luffing cylinder [m].
        distance: Distance of its foot and head, from their places in the world [m].
        force: Force of the luffing cylinder [N].
        by_energy: The same, the change of the potential energy over that of the distance [N].
        telescope: Force of the telescope [N].
        telescope_by_energy: The same by the potential energy [N].
    """

    angle: float
    length: float
    distance: float
    force: float
    by_energy: float
    telescope: float
    telescope_by_energy: float


def forces(crane: Crane) -> list[BoomForce]:
    """Return the forces of luffing cylinder and telescope at several angles of the boom, and what
    follows from the potential energy of all bodies.
    """
    luffing, telescope = read_cylinders(crane)
    rows = []
    for angle in ANGLES:
        q = crane.hanging(crane.state(luff=angle).q)
        held = holding_effort(crane, q)
        drives = crane.layout.drives.tolist()
        around = []
        along = []
        for step in (-ENERGY_STEP, ENERGY_STEP):
            turned = crane.hanging(crane.state(luff=angle + step).q)
            around.append((_potential(crane, turned), _distance(crane, luffing, turned)))
            start = float(crane.start.q[telescope.joint])
            extended = crane.hanging(crane.state(luff=angle, telescope=start + step).q)
            along.append(_potential(crane, extended))
        (energy_before, distance_before), (energy_after, distance_after) = around
        rows.append(
            BoomForce(
                angle=angle,
                length=float(luffing.length(angle)),
                distance=_distance(crane, luffing, q),
                force=float(luffing.force(angle, held[drives.index(luffing.joint)])),
                by_energy=(energy_after - energy_before) / (distance_after - distance_before),
                telescope=float(held[drives.index(telescope.joint)]),
                telescope_by_energy=(along[1] - along[0]) / (2.0 * ENERGY_STEP),
            )
        )
    return rows


def _potential(crane: Crane, q: np.ndarray) -> float:
    """Return the potential energy of all bodies [J]."""
    return float(pin.computePotentialEnergy(crane.model, crane.data, q))


def _distance(crane: Crane, cylinder: Cylinder, q: np.ndarray) -> float:
    """Return the distance of foot and head of the luffing cylinder in the world [m], from the
    arguments of the crane's xacro that place them.
    """
    pin.forwardKinematics(crane.model, crane.data, q)
    boom = crane.data.oMi[cylinder.joint + 1]
    head = boom.act(np.array([0.0, -4.2, -0.5]))
    # The foot is 1.5 m ahead of the hinge and 1.2 m below it on the superstructure, which does not
    # slew here.
    foot = boom.translation + np.array([0.0, -1.5, -1.2])
    return float(np.linalg.norm(head - foot))


# --- work of a move -------------------------------------------------------------------------------


@dataclass(frozen=True)
class CylinderWork:
    """Work of a drive in a move.

    Attributes:
        name: Which drive.
        by_cylinder: ∫ F dL of its cylinder [J].
        by_drive: Work of the drive at its joint, as the run counts it [J].
    """

    name: str
    by_cylinder: float
    by_drive: float


def work_of_a_move(setup: Setup, crane: Crane) -> tuple[Trajectory, list[CylinderWork]]:
    """Raise and extend the boom; return the run, and the work of both cylinders and drives."""
    layout = crane.layout
    start = crane.state(luff=0.6, telescope=2.0)
    goal = start.q[layout.drives].copy()
    goal[layout.drive("luff")] = 1.1
    goal[layout.drive("telescope")] = 6.0
    reference = spline(crane, start, [goal], [MOVE])
    run = setup.simulate(
        crane,
        follow(crane, reference, setup.control_period),
        reference,
        start=start,
        duration=MOVE,
        label="raise and extend the boom",
        drive="motion",
    )
    columns = cylinder_columns(crane, run)
    works = []
    for symbol in ("luff", "telescope"):
        # An effort holds from its row to the next one, so that it works along the way between them.
        way = np.diff(columns[f"{symbol}_cylinder_length_m"])
        force = columns[f"{symbol}_cylinder_force_N"]
        between = 0.5 * (force[1:] + force[:-1])
        works.append(CylinderWork(symbol, float(between @ way), float(run[f"W_{symbol}_J"][-1])))
    return run, works


# --- pump -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Oil:
    """Oil that a drive took while all drives moved at once.

    Attributes:
        name: Which drive.
        asked: Rate that was asked for [rad/s or m/s].
        moved: Mean rate [rad/s or m/s].
        volume: Oil that it took [m³], from the lengths of its cylinder or the turns of its motor.
    """

    name: str
    asked: float
    moved: float
    volume: float


def oil_of_a_pump(setup: Setup, crane: Crane) -> tuple[Trajectory, list[Oil], float]:
    """Ask all drives to move at once; return the run, the oil that each took, and for how long."""
    pump = Pump(crane, FLOW, MOTORS)
    layout = crane.layout
    asked = np.array([ASKED[joint.symbol] for joint in layout.driven])
    limited = PumpLimited(pump, lambda t, state, setpoint: asked)
    run = setup.simulate(
        crane,
        limited,
        None,
        start=crane.state(luff=0.6, telescope=1.0, l=10.0),
        duration=PUMPED,
        label="all drives on one pump",
        drive=converters(crane),
    )
    first = int(np.searchsorted(run.t, STARTED))
    lasting = float(run.t[-1] - run.t[first])
    by_joint = {cylinder.joint: cylinder for cylinder in pump.cylinders}
    rows = []
    for drive, joint in enumerate(layout.drives.tolist()):
        symbol = layout.joints[joint].symbol
        began, ended = run.q[[first, -1], joint].tolist()
        cylinder = by_joint.get(joint)
        if cylinder is None:
            volume = MOTORS[symbol] * abs(ended - began)
        else:
            # The oil of a cylinder is what its piston displaces.
            volume = cylinder.area * abs(float(cylinder.length(ended) - cylinder.length(began)))
        rows.append(Oil(symbol, float(asked[drive]), (ended - began) / lasting, volume))
    return run, rows, lasting


# --- tables, claims and pictures ------------------------------------------------------------------


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Compare forces, work and oil."""
    crane = load_crane(XACRO.with_name("mobile_crane.urdf.xacro"), gravity=setup.gravity)
    rows = forces(crane)
    move, works = work_of_a_move(setup, crane)
    run, oil, lasting = oil_of_a_pump(setup, crane)
    return Outcome(
        tables=[_force_table(rows), _work_table(works), _oil_table(oil, lasting)],
        claims=[
            _length_claim(rows),
            _force_claim(rows),
            _work_claim(works),
            _oil_claim(oil, lasting),
            _share_claim(oil),
        ],
        parameters={"flow_l_min": 60e3 * FLOW},
        trajectories={"move": move, "pump": run},
        figures={"cylinders": _figure(crane, rows, move)},
        recording=harness.side_by_side({"move": (crane, move)}),
    )


def _length_claim(rows: Sequence[BoomForce]) -> Claim:
    """Return the claim that the cylinder is as long as its points are apart."""
    worst = max(abs(row.length - row.distance) for row in rows)
    return Claim(
        "The luffing cylinder is as long as its foot and head are apart in the world, within "
        f"1e-9 m (worst {worst:.0e}).",
        worst < 1e-9,
    )


def _force_claim(rows: Sequence[BoomForce]) -> Claim:
    """Return the claim that both forces are those of the potential energy."""
    worst = 0.0
    for row in rows:
        worst = max(worst, abs(row.force / row.by_energy - 1.0))
        worst = max(worst, abs(row.telescope / row.telescope_by_energy - 1.0))
    return Claim(
        "Forces of luffing cylinder and telescope are the change of the potential energy over that "
        f"of their lengths, within 1e-6 (worst {worst:.0e}).",
        worst < 1e-6,
    )


def _work_claim(works: Sequence[CylinderWork]) -> Claim:
    """Return the claim that cylinders do the work of their drives."""
    worst = max(abs(work.by_cylinder / work.by_drive - 1.0) for work in works)
    return Claim(
        "While the boom is raised and extended, both cylinders do the work of their drives, within "
        f"0.1 %, which rows of 5 ms leave (worst {100.0 * worst:.3f} %).",
        worst < 1e-3,
    )


def _oil_claim(oil: Sequence[Oil], lasting: float) -> Claim:
    """Return the claim that drives take the flow of their pump."""
    taken = sum(row.volume for row in oil)
    given = FLOW * lasting
    return Claim(
        f"Drives that ask for more take the flow of their pump: {1e3 * taken:.3f} of "
        f"{1e3 * given:.3f} litres, within 1 %.",
        abs(taken / given - 1.0) < 0.01,
    )


def _share_claim(oil: Sequence[Oil]) -> Claim:
    """Return the claim that all drives get the same share."""
    shares = [row.moved / row.asked for row in oil]
    apart = max(shares) / min(shares) - 1.0
    return Claim(
        "Each of them moves at the same share of what was asked for, within 1 % "
        f"({100.0 * min(shares):.1f} to {100.0 * max(shares):.1f} %).",
        apart < 0.01,
    )


def _force_table(rows: Sequence[BoomForce]) -> ResultTable:
    return make_table(
        "Cylinders at rest, beside points and energies",
        rows,
        ("boom [rad]", "g", lambda row: row.angle),
        ("length [m]", ".4f", lambda row: row.length),
        ("of points [m]", ".4f", lambda row: row.distance),
        ("force [kN]", ".3f", lambda row: row.force / 1e3),
        ("by energy [kN]", ".3f", lambda row: row.by_energy / 1e3),
        ("telescope [kN]", ".3f", lambda row: row.telescope / 1e3),
        ("by energy, telescope [kN]", ".3f", lambda row: row.telescope_by_energy / 1e3),
    )


def _work_table(works: Sequence[CylinderWork]) -> ResultTable:
    return make_table(
        "Work of raising and extending the boom",
        works,
        ("drive", "", lambda work: work.name),
        ("of the cylinder [kJ]", ".2f", lambda work: work.by_cylinder / 1e3),
        ("of the drive [kJ]", ".2f", lambda work: work.by_drive / 1e3),
    )


def _oil_table(oil: Sequence[Oil], lasting: float) -> ResultTable:
    return make_table(
        "Four drives on one pump",
        oil,
        ("drive", "", lambda row: row.name),
        ("asked for [rad/s, m/s]", "g", lambda row: row.asked),
        ("moved at", ".5f", lambda row: row.moved),
        ("oil [l]", ".3f", lambda row: 1e3 * row.volume),
        note=f"In {lasting:.2f} s; the pump gives {60e3 * FLOW:g} l/min.",
    )


def _figure(crane: Crane, rows: Sequence[BoomForce], move: Trajectory) -> Figure:
    figure, (force, pushed) = panels(2, height=2.2, width=7.0)
    degrees = np.degrees([row.angle for row in rows])
    force.plot(degrees, [row.force / 1e3 for row in rows], "o-", label="luffing cylinder")
    force.plot(degrees, [row.telescope / 1e3 for row in rows], "o-", label="telescope")
    force.set(xlabel="boom [°]", ylabel="at rest [kN]")
    legend_above(force, columns=2)
    columns = cylinder_columns(crane, move)
    for symbol in ("luff", "telescope"):
        pushed.plot(move.t[:-1], columns[f"{symbol}_cylinder_force_N"][:-1] / 1e3, label=symbol)
    pushed.set(xlabel="time [s]", ylabel="in a move [kN]")
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("cylinders", __doc__)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
