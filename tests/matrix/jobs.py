"""The jobs of the matrix: each does with a crane what a user would, in a small instance, checks
that something came of it, and raises the error of the library where it does not work.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pinocchio as pin
import pytest

import cranedyn as cd
from cranedyn.controllers import lqr
from cranedyn.controllers.follow import follow
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.linearisation import linear
from cranedyn.export import (
    c_code,
    driving_page,
    fmi,
    gazebo,
    matlab,
    mcap,
    mjcf_file,
    ros2,
    st,
)
from cranedyn.export.browser_crane import swing_period, usual_limits
from cranedyn.export.usual_controllers import rest_at_start, usual_controller
from cranedyn.interfaces import Controller, Drive, EngineName, State
from cranedyn.interop.margins import loop_margins
from cranedyn.lifts.planning.site import CRANE_HEADING, DISTANCE, Site
from cranedyn.model.crane import Crane
from cranedyn.recording import Run, record
from cranedyn.references import hold
from cranedyn.references.shaped import shaped, zv
from cranedyn.references.simple import ramp

PERIOD = 5e-3
"""Control period of all runs [s]."""

DURATION = 0.1
"""Duration of the runs [s]: the cells ask whether something works, not how well."""


def _run(crane: Crane, drive: Drive = "effort", engine: EngineName | None = None) -> cd.Trajectory:
    """Return a run in which the drives hold their positions, by the engine that `simulate` takes
    where none is named.
    """
    if drive == "motion":
        controller: Controller = follow(crane, hold(crane), PERIOD)
    else:
        controller, _ = usual_controller("hold", crane, PERIOD, drive)
    run = cd.simulate(crane, controller, duration=DURATION, drive=drive, engine=engine)
    _check_finite(run)
    return run


def _check_finite(run: cd.Trajectory) -> None:
    assert np.isfinite(run.q).all()
    assert run.t[-1] == pytest.approx(DURATION)


def effort_drives(crane: Crane, folder: Path) -> None:
    _run(crane, "effort")


def motion_drives(crane: Crane, folder: Path) -> None:
    _run(crane, "motion")


def velocity_drives(crane: Crane, folder: Path) -> None:
    _run(crane, "velocity")


def compiled_engine(crane: Crane, folder: Path) -> None:
    _run(crane, engine="compiled")


def pinocchio_engine(crane: Crane, folder: Path) -> None:
    plain = _run(crane, engine="pinocchio")
    compiled = _run(crane, engine="compiled")
    # Round-off of two formulations, as in `tests.helpers.alike_in_both_engines`.
    assert np.abs(plain.q - compiled.q).max() < 1e-9 * np.abs(plain.q).max()


def batch(crane: Crane, folder: Path) -> None:
    controller, _ = usual_controller("hold", crane, PERIOD)
    runs = cd.simulate_batch(crane, [controller, controller], duration=DURATION)
    assert len(runs) == 2


def linear_model(crane: Crane, folder: Path) -> None:
    model = linear(crane, State(crane.rest.q, np.zeros(crane.layout.n)))
    assert np.isfinite(model.a).all()


def stability_margins(crane: Crane, folder: Path) -> None:
    rest = State(crane.resting(crane.start.q), np.zeros(crane.layout.n))
    controller, _ = usual_controller("lqr", crane, PERIOD)
    assert loop_margins(crane, controller, rest, control_period=PERIOD).drives


def ramp_reference(crane: Crane, folder: Path) -> None:
    controller, _ = usual_controller("hold", crane, PERIOD)
    drive = crane.layout.driven[0].symbol
    reference = ramp(crane, hold(crane), drive, 1e-3, rate=0.05, at=0.01)
    _check_finite(cd.simulate(crane, controller, reference, duration=DURATION))


def input_shaper(crane: Crane, folder: Path) -> None:
    controller, _ = usual_controller("hold", crane, PERIOD)
    reference = shaped(hold(crane), zv(), swing_period(crane, crane.start.q))
    _check_finite(cd.simulate(crane, controller, reference, duration=DURATION))


def lqr_control(crane: Crane, folder: Path) -> None:
    controller = lqr(crane, rest_at_start(crane, PERIOD))
    _check_finite(cd.simulate(crane, controller, duration=DURATION))


def predictive_control(crane: Crane, folder: Path) -> None:
    controller, _ = usual_controller("predictive", crane, PERIOD)
    _check_finite(cd.simulate(crane, controller, duration=DURATION))


def least_time(crane: Crane, folder: Path) -> None:
    from cranedyn.lifts.planning.optimal import optimal

    pytest.importorskip("casadi", reason="the extra optimal is not installed")
    limits = usual_limits(converters(crane))
    goal = _moved(crane, 0, 0.01)
    motion = optimal(crane, _moved(crane, 0, 0.0), goal, limits, ramp=0.0, interval=0.5)
    assert motion.arrival > 0.0


def swing_observer(crane: Crane, folder: Path) -> None:
    controller, _ = usual_controller("observer", crane, PERIOD)
    _check_finite(cd.simulate(crane, controller, duration=DURATION))


def learning_environment(crane: Crane, folder: Path) -> None:
    pytest.importorskip("gymnasium", reason="the extra gymnasium is not installed")
    from cranedyn.interop.gymnasium import CraneEnv

    environment = CraneEnv(crane=crane)
    environment.reset(seed=0)
    observation, *_ = environment.step(environment.action_space.sample())
    assert np.isfinite(observation).all()


def recording(crane: Crane, folder: Path) -> None:
    run = _run(crane)
    file = record(folder / "run.rrd", [Run("run", crane, run)], title="A run")
    assert file.stat().st_size > 0


def plot(crane: Crane, folder: Path) -> None:
    cd.plot(crane)
    assert cd.plot(_run(crane)).axes


def export_c(crane: Crane, folder: Path) -> None:
    controller, drive = usual_controller("lqr", crane, PERIOD)
    c_code.export(crane, folder / "c", controller, drive=drive)


def export_st(crane: Crane, folder: Path) -> None:
    controller, drive = usual_controller("lqr", crane, PERIOD)
    st.export(crane, folder / "lqr.st", controller, drive=drive)


def export_fmu(crane: Crane, folder: Path) -> None:
    if not any(map(shutil.which, ("cc", "gcc", "clang"))):
        pytest.skip("no C compiler is installed")
    fmi.export(crane, folder / "crane.fmu")


def export_matlab(crane: Crane, folder: Path) -> None:
    matlab.to_matlab(folder / "crane.mat", crane)


def export_mcap(crane: Crane, folder: Path) -> None:
    for module in ("mcap_ros2", "rosbags"):
        pytest.importorskip(module, reason="the extra mcap is not installed")
    mcap.export(folder / "run.mcap", crane, _run(crane))


def export_mjcf(crane: Crane, folder: Path) -> None:
    mjcf_file.export(folder / "crane.xml", crane)


def export_ros2(crane: Crane, folder: Path) -> None:
    ros2.export(folder / "crane_description", crane)


def export_gazebo(crane: Crane, folder: Path) -> None:
    controller, _ = usual_controller("hold", crane, PERIOD)
    program = gazebo.Program(crane, controller, None, crane.start, DURATION)
    gazebo.export(folder / "gazebo", program)


def drive_page(crane: Crane, folder: Path) -> None:
    # Exercises are planned for half a minute; tests/export/test_page.py plans them.
    with patch("cranedyn.export.driving_page.exercises", lambda *_: []):
        driving_page.export(folder / "crane.html", crane)


def planned_lift(crane: Crane, folder: Path) -> None:
    pytest.importorskip("toppra", reason="the extra planning is not installed")
    from cranedyn.lifts.planning.certificate import certify
    from cranedyn.lifts.planning.lift import plan_lift

    lift = plan_lift(free_site(crane), usual_limits(converters(crane)), crane=crane)
    certificate = certify(lift)
    failed = [check.sentence for check in certificate.checks if not check.holds]
    assert not failed, failed


def lift_report(crane: Crane, folder: Path) -> None:
    pytest.importorskip("toppra", reason="the extra planning is not installed")
    from cranedyn.lifts.judging.analysis import Requirements
    from cranedyn.lifts.judging.judgement import judge

    judgement = judge(
        free_site(crane),
        None,
        Requirements(lifts=0, gusts=0),
        crane=crane,
        limits=usual_limits(converters(crane)),
    )
    assert judgement.report(folder / "lift.html").stat().st_size > 0


JOBS: dict[str, Callable[[Crane, Path], None]] = {
    "drives take efforts": effort_drives,
    "drives take accelerations": motion_drives,
    "drives take rates": velocity_drives,
    "engine compiled": compiled_engine,
    "engine pinocchio": pinocchio_engine,
    "batch": batch,
    "linear model": linear_model,
    "stability margins": stability_margins,
    "ramp": ramp_reference,
    "input shaper": input_shaper,
    "LQR": lqr_control,
    "predictive control": predictive_control,
    "move of least time": least_time,
    "swing observer": swing_observer,
    "learning environment": learning_environment,
    "recording": recording,
    "plot": plot,
    "export c": export_c,
    "export st": export_st,
    "export fmu": export_fmu,
    "export matlab": export_matlab,
    "export mcap": export_mcap,
    "export mjcf": export_mjcf,
    "export ros2": export_ros2,
    "export gazebo": export_gazebo,
    "export page": drive_page,
    "planned lift": planned_lift,
    "lift report": lift_report,
}
"""The jobs by the name that the page has for them."""


def _moved(crane: Crane, drive: int, share: float) -> State:
    """Return a rest at which a drive is off its start by a share of its range, away from the nearer
    end of that.
    """
    joint = int(crane.layout.drives[drive])
    low = crane.model.lowerPositionLimit[joint]
    high = crane.model.upperPositionLimit[joint]
    q = crane.start.q.copy()
    sign = 1.0 if q[joint] < (low + high) / 2.0 else -1.0
    q[joint] += sign * share * (high - low)
    return State(crane.resting(q), np.zeros(crane.layout.n))


def _load_centre(crane: Crane, state: State) -> np.ndarray:
    """Return the centre of the load in the frame of the crane [m], shape (3,)."""
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, state.q)
    return data.oMi[crane.payload.body + 1].act(crane.payload.lever)


def free_site(crane: Crane) -> Site:
    """Return a free site, on which the load goes from the start to where the first drive has moved
    on by a twentieth of its range.

    The distance that is kept suits the size of the crane: a laboratory has less room.
    """
    assert crane.winch is not None
    hoist = int(crane.layout.drives[crane.winch])
    return Site(
        "free",
        solids=(),
        heading=CRANE_HEADING,
        start=_load_centre(crane, _moved(crane, 0, 0.0)),
        goal=_load_centre(crane, _moved(crane, 0, 0.05)),
        distance=min(DISTANCE, 0.03 * float(crane.start.q[hoist])),
    )
