"""Parameters of a measured crane by this project and by MuJoCo's toolbox (mujoco.sysid), side by
side: identified on every other record, predicted on the rest, and the reverse. Without --data on
synthetic records of an independent pendulum.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.conduct import print_tables
from cranedyn.errors import CraneError, DataError
from cranedyn.identification import Model, Prior, Record, identify
from cranedyn.model.description import XACRO
from experiments.harness.outcome import ResultTable
from experiments.measured.pendulum import logged
from experiments.measured.sources import SOURCES

NAMES = ("l_offset", "damp_swing", "delay", "phi_bias")
"""Parameters that both identify."""

MUJOCO = "mujoco.sysid"
"""MuJoCo's toolbox on drives as they were logged."""

MUJOCO_SMOOTHED = "mujoco.sysid, our smooth drives"
"""MuJoCo's toolbox on drives that this project has smoothed."""

OURS = "cranedyn"
"""This project, with a delay of the sensor."""

OURS_WINDOW = "cranedyn, window instead of delay"
"""This project, with a sensor that averages over a window."""

_XML = """<mujoco><option timestep="0.005" integrator="implicitfast" gravity="0 0 -{gravity}"/>
<worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
<inertial mass="1000" pos="0 0 0" diaginertia="1 1 1"/>
<body name="arm"><joint name="phi" type="hinge" axis="0 1 0" damping="{damping}"/>
<inertial mass="1e-6" pos="0 0 0" diaginertia="1e-7 1e-7 1e-7"/>
<body name="load"><inertial mass="{mass}" pos="0 0 -{cable}" diaginertia="1e-4 1e-4 1e-4"/></body>
</body></body></worldbody>
<actuator><position name="x" joint="x" kp="3.6e6" kv="1.2e5"/></actuator>
<sensor><jointpos name="swing" joint="phi"/></sensor></mujoco>"""
"""A heavy trolley that follows its recorded position, so that the load does not move it."""

MIN_SWING = 0.06
"""Swing from its lowest to its highest value from which on a record is used [rad]."""

FIRST_JUDGED = 0.7
"""Time from the beginning of a record to its first judged row [s]."""

LAST_JUDGED = 0.35
"""Time from the last judged row of a record to its end [s]."""


class Logged(NamedTuple):
    """A record as its logger wrote it, and as `Record` cleans it; times count from the first."""

    raw: Mapping[str, np.ndarray]
    clean: Record

    @property
    def judged(self) -> np.ndarray:
        """Whether each clean row counts for the error: none near the ends, where delays shift."""
        t = self.clean.t
        return (t >= FIRST_JUDGED) & (t <= t[-1] - LAST_JUDGED)

    def squares(self, predicted: np.ndarray) -> tuple[float, float]:
        """Return the squares of a prediction's error in the judged rows, and of their variation."""
        swing = self.clean.columns["phi_rad"][self.judged]
        error = float(np.sum((predicted - swing) ** 2))
        variation = float(np.sum((swing - swing.mean()) ** 2))
        return error, variation

    def error(self, predicted: np.ndarray) -> float:
        """Return the RMS error of a prediction of the judged rows over their standard deviation."""
        error, variation = self.squares(predicted)
        return float(np.sqrt(np.divide(error, variation)))


Identified = Callable[[Logged], np.ndarray]
"""Function that predicts the judged rows of a record."""


def ours(prior: Prior, records: Sequence[Logged], sensor: str) -> Identified:
    """Return the prediction by the crane that this project identifies from records."""
    names = [sensor if name == "delay" else name for name in NAMES]
    estimate = identify(Model.of(prior, [record.clean for record in records], names))

    def predict(record: Logged) -> np.ndarray:
        model = Model.of(prior, [record.clean], names)
        values = []
        for parameter in model.parameters:
            # What belongs to a record, such as its first swing, is not known of another record.
            values.append(estimate.value(parameter.name) if parameter.record is None else 0.0)
        predicted = model.predicted(0, np.array(values)[None])[0, 0]
        rows = model.rows(0)
        return np.asarray(predicted[record.judged[rows]])

    return predict


def theirs(prior: Prior, records: Sequence[Logged], *, smooth: bool) -> Identified:
    """Return the prediction by the crane that MuJoCo's toolbox identifies from records."""
    sysid = _toolbox()

    def place(spec: Any, parameter: Any) -> None:
        spec.body("load").pos = [0.0, 0.0, -float(parameter.value[0])]

    def damp(spec: Any, parameter: Any) -> None:
        spec.joint("phi").damping = [float(parameter.value[0]), 0.0, 0.0]

    first = prior.value("damp_swing")
    parameters = sysid.ParameterDict()
    parameters.add(sysid.Parameter("l_offset", 0.0, -0.2, 0.2, modifier=place))
    parameters.add(sysid.Parameter("damp_swing", first, 0.0, 20.0 * first, modifier=damp))
    parameters.add(sysid.Parameter("delay", 0.1, -0.3, 0.3))
    parameters.add(sysid.Parameter("phi_bias", 0.0, -0.3, 0.3))

    def compare(p: Any, predicted: Any, measured: Any, *_: Any, **__: Any) -> tuple[Any, Any, Any]:
        predicted = sysid.apply_resample_and_delay(
            predicted, measured.times, float(p["delay"].value[0])
        )
        predicted = sysid.apply_bias(predicted, "swing", p["phi_bias"])
        return predicted.data - measured.data, predicted, measured

    def residual(logs: Sequence[Logged]) -> Any:
        return sysid.build_residual_fn(
            models_sequences=[_sequences(prior, log, smooth) for log in logs],
            modify_residual=compare,
        )

    # Its solver prints each step.
    with redirect_stdout(StringIO()):
        best, _ = sysid.optimize(parameters, residual(records), verbose=False, x_scale="jac")

    def predict(record: Logged) -> np.ndarray:
        (error,), *_ = residual([record])(best.as_vector(), best)
        return np.ravel(error) + record.clean.columns["phi_rad"][record.judged]

    return predict


def _toolbox() -> Any:
    """Return MuJoCo's toolbox for identification, which is an empty module without its extra.

    Raises:
        CraneError: If it is not installed.
    """
    try:
        toolbox: Any = importlib.import_module("mujoco.sysid")
    except ImportError:
        toolbox = None
    if not hasattr(toolbox, "optimize"):
        raise CraneError("It needs mujoco.sysid: pip install 'mujoco[sysid]'.")
    return toolbox


def _sequences(prior: Prior, log: Logged, smooth: bool) -> Any:
    """Return a record in MuJoCo's form, at rest at first; drives as recorded or as smoothed."""
    import mujoco

    sysid = _toolbox()
    columns = log.clean.columns
    crane = prior.crane
    text = _XML.format(
        gravity=crane.gravity,
        damping=prior.value("damp_swing"),
        mass=crane.payload_mass,
        cable=float(np.mean(columns["l_m"])),
    )
    spec = mujoco.MjSpec.from_string(text)
    model = spec.compile()
    t = log.clean.t if smooth else log.raw["t_s"]
    x = columns["x_m"] if smooth else log.raw["x_m"]
    t = t - t[0]
    start = sysid.create_initial_state(model, np.array([x[0], 0.0]))
    control = sysid.TimeSeries.from_control_names(t, x[:, None], model)
    swing = columns["phi_rad"][log.judged][:, None]
    sensor = sysid.TimeSeries.from_names(log.clean.t[log.judged], swing, model)
    name = log.clean.name
    return sysid.ModelSequences(name, spec, name, start, control, sensor)


def records_of(folder: str | None, count: int) -> tuple[Prior, list[Logged]]:
    """Return a prior and records: of the gantry in a clone, or synthetic ones.

    Raises:
        DataError: If the folder has no clone of the gantry.
    """
    source = SOURCES[0]
    prior = Prior(XACRO.with_name("overhead_crane.urdf.xacro"), source.values)
    if folder is None:
        logs = []
        for i in range(count):
            log = logged(i + 1, travel=0.9, lasts=1.6 + 0.3 * i, delay=0.0, window=0.35)
            logs.append((f"synthetic {i + 1}", log))
    else:
        clone = Path(folder) / source.folder
        if not clone.is_dir():
            raise DataError(f"{folder} has no {source.folder}; get it by: {source.command}")
        logs = []
        for name, log in source.read(clone):
            if np.ptp(log["phi_rad"]) > MIN_SWING:
                logs.append((name, log))
    return prior, [Logged(log, Record.of(prior.crane, log, name=name)) for name, log in logs]


def sysid_table(prior: Prior, logs: Sequence[Logged]) -> ResultTable:
    """Return held-out errors and times of each way to identify, over two folds of the records."""
    _toolbox()
    ways: dict[str, Callable[[Sequence[Logged]], Identified]] = {
        MUJOCO: lambda fold: theirs(prior, fold, smooth=False),
        MUJOCO_SMOOTHED: lambda fold: theirs(prior, fold, smooth=True),
        OURS: lambda fold: ours(prior, fold, "delay"),
        OURS_WINDOW: lambda fold: ours(prior, fold, "window"),
    }
    rows: list[list[float | str | None]] = []
    first: np.ndarray | None = None
    for way, identifier in ways.items():
        squares = []
        taken = 0.0
        for fold, others in ((logs[::2], logs[1::2]), (logs[1::2], logs[::2])):
            begin = time.perf_counter()
            predict = identifier(fold)
            taken += time.perf_counter() - begin
            squares += [log.squares(predict(log)) for log in others]
        error, variation = np.array(squares).T
        shares = 100.0 * np.sqrt(error / variation)
        first = shares if first is None else first
        pooled = 100.0 * float(np.sqrt(error.sum() / variation.sum()))
        below = int(np.sum(shares < first))
        middle = float(np.median(shares))
        rows.append([way, pooled, middle, float(max(shares)), below, taken])
    columns = (
        ("identified by", ""),
        ("held out [%]", ".1f"),
        ("median", ".1f"),
        ("largest", ".1f"),
        ("below the first", "d"),
        ("time [s]", ".1f"),
    )
    note = "RMS error from rest, over the standard deviation; identified on every other record."
    return ResultTable("Held-out records", columns, rows, note)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""

    def measure(options: argparse.Namespace) -> Sequence[ResultTable]:
        prior, logs = records_of(options.data, options.records)
        return [sysid_table(prior, logs)]

    return print_tables(
        "sysid",
        __doc__,
        measure,
        argv,
        data={"metavar": "DIR", "help": "folder with a clone of the gantry's records"},
        records={"type": int, "default": 6, "help": "number of synthetic records (default 6)"},
    )


if __name__ == "__main__":
    sys.exit(main())
