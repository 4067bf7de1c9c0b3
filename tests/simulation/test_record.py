"""A record names its crane: whoever holds the file of a run can make it again, to the bit."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory, read
from cranedyn.disturbances.wind import constant_force
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.errors import CraneError, DataError
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold, pulse
from cranedyn.references.simple import Pulse, Still
from cranedyn.simulation.run_record import VERSIONS, json_value
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane

INTEGRATORS = {rule.name: rule for rule in (semi_implicit_euler, rk4)}


def replayed(path: Path) -> Trajectory:
    """The run of a file made again from that file alone: its crane, its clocks, its commands and
    forces row by row.
    """
    kept = read(path)
    clock = {name: kept.parameters[f"{name}_s"] for name in ("dt", "control_period")}
    row = iter(range(len(kept)))
    forced = iter(range(len(kept)))
    return simulate(
        load_crane(from_record=path),
        lambda t, state, setpoint: kept.command[next(row)],
        start=kept.state(0),
        duration=float(kept.t[-1] - kept.t[0]),
        disturbance=(lambda t, state: kept.force[next(forced)].reshape(-1, 3))
        if kept.force.any()
        else None,
        integrator=INTEGRATORS[str(kept.parameters["integrator"])],
        **{name: kept.parameters[name] for name in ("drive", "validity", "engine")},  # type: ignore[arg-type]
        **clock,  # type: ignore[arg-type]
    )


CRANES: dict[str, dict[str, Any]] = {
    "tower crane": {"payload_mass": 2345.678901234567, "damp_swing": 0.1 + 0.2},
    "hook and sling": {"hook_mass": 300.0, "payload_ixx": 10.0},
    "rope that stretches, on the moon": {"rope_stiffness": 2e7, "gravity": 1.62},
    "tower that twists": {"tower_twist_stiffness": 2e7},
}


@pytest.mark.slow
@pytest.mark.parametrize("engine", [None, "compiled"])
@pytest.mark.parametrize("values", CRANES.values(), ids=list(CRANES))
def test_a_run_is_made_again_from_its_file_alone_to_the_bit(
    values: dict[str, Any], engine: Any, tmp_path: Path
) -> None:
    made = load_crane(**values)
    start = made.state(phi=0.02, x=12.0)
    path = simulate(
        made,
        hold_controller(made),
        pulse(made, hold(made, start), "x", 0.5, at=0.1, width=0.2),
        start=start,
        duration=0.5,
        engine=engine,
        validity="mark",
        disturbance=constant_force(made, payload=(30.0, 0.0, 0.0)),
    ).write(tmp_path / "run.parquet")
    kept = read(path)
    again = replayed(path)
    fitting = "compiled" if "rope_stiffness" in values else "pinocchio"
    assert kept.parameters["engine"] == (engine or fitting)
    for name in ("q", "v", "effort", "energy", "work", "dissipated", "outside"):
        assert np.array_equal(getattr(kept, name), getattr(again, name)), name


def test_a_run_is_made_again_from_the_gains_and_the_reference_in_its_file(tmp_path: Path) -> None:
    made = load_crane(payload_mass=1500.0)
    start = made.state(phi=0.1, l=10.0)
    path = simulate(
        made,
        hold_controller(made),
        pulse(made, hold(made, start), "x", 0.5, at=1.0, width=3.2),
        start=start,
        duration=2.0,
    ).write(tmp_path / "run.parquet")
    kept = read(path)
    again = load_crane(from_record=path)
    control = kept.record["controller"]
    base = kept.record["reference"]
    assert (control["kind"], base["kind"]) == (
        "cranedyn.controllers.hold.Hold",
        "cranedyn.references.simple.Pulse",
    )
    gains = (np.array(control[name]) for name in ("stiffness", "damping", "feed_forward"))
    still = hold(again, kept.state(0))
    assert isinstance(still, Still)
    reference = Pulse(still, np.array(base["step"]), base["first"], base["last"])
    run = simulate(again, Hold(again, *gains), reference, start=kept.state(0), duration=2.0)
    assert np.array_equal(run.q, kept.q)
    assert np.array_equal(run.effort, kept.effort)


def test_the_record_says_what_there_is_in_numbers_or_by_a_checksum() -> None:
    start = crane().state(x=12.0)
    motion = hanging_reference(crane(), hold(crane(), start), 1.0)
    record = simulate(crane(), lqr(crane(), motion), motion, start=start, duration=0.1).record
    assert record["crane"]["gravity"] == crane().gravity
    assert 'mass value="1000.0"' in record["crane"]["urdf"]
    assert record["controller"]["kind"] == "cranedyn.controllers.tracking.Tracking"
    assert record["controller"]["gain"]["shape"] == [201, 3, 10]
    assert len(record["controller"]["gain"]["sha256"]) == 64
    assert set(record["versions"]) >= {"cranedyn", "pin", "numpy", "python"}
    assert json.loads(json.dumps(record, allow_nan=False)) == record


def test_the_versions_of_a_record_are_those_that_are_installed() -> None:
    found = dict(VERSIONS)
    assert found.pop("python") == platform.python_version()
    assert found == {name: version(name) for name in found}


def test_what_json_does_not_hold_is_written_by_its_name() -> None:
    assert json_value(np.array([1.0, np.inf])) == [1.0, "inf"]
    assert (
        json_value(lambda t: None)
        == f"{__name__}.test_what_json_does_not_hold_is_written_by_its_name.<locals>.<lambda>"
    )
    assert json_value({"a": (1, 2.5)}) == {"a": [1, 2.5]}


@pytest.mark.parametrize(
    "record", ["{}", "[]", '{"crane": 3}', '{"crane": {"urdf": "<robot/>"}}', "{"]
)
def test_a_file_that_names_no_crane_is_a_sentence(record: str, tmp_path: Path) -> None:
    table = simulate(crane(), hold_controller(crane()), duration=0.01).table()
    path = tmp_path / "odd.parquet"
    pyarrow.parquet.write_table(
        table.replace_schema_metadata({"cranedyn": "{}", "cranedyn.record": record}), path
    )
    with pytest.raises(DataError, match=r"does not name its crane|its record is not a JSON object"):
        load_crane(from_record=path)


@pytest.mark.slow
def test_the_looks_of_our_own_crane_are_made_again_unless_they_are_of_another(
    tmp_path: Path,
) -> None:
    made = load_crane(payload_mass=2345.0, pivot_height=29.0)
    run = simulate(made, hold_controller(made), duration=0.01)
    again = load_crane(from_record=read(run.write(tmp_path / "run.parquet")).record)
    assert again.urdf == made.urdf != made.record["urdf"]
    assert again.record == made.record
    for arguments in ({"payload_mass": 1.0}, {"gravity_of": 3.0}, {"payload_mass": -1.0}):
        strange = load_crane(from_record={"crane": {**made.record, "arguments": arguments}})
        assert strange.urdf == made.record["urdf"]
        assert strange.payload_mass == 2345.0
    for arguments in ({"payload_mass": "${1}"}, []):
        with pytest.raises(DataError, match="does not name its crane"):
            load_crane(from_record={"crane": {**made.record, "arguments": arguments}})


def test_a_record_and_arguments_do_not_go_together(tmp_path: Path) -> None:
    path = simulate(crane(), hold_controller(crane()), duration=0.01).write(
        tmp_path / "run.parquet"
    )
    with pytest.raises(CraneError, match="left out: the record describes the whole crane"):
        load_crane(from_record=path, payload_mass=1.0)
