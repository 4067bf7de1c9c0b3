"""MATLAB: the linear crane about its start as matrices with names and units, for its `ss`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.io import savemat

from cranedyn.bridges.linear_system import linear_system
from cranedyn.bridges.target import new_file
from cranedyn.errors import DataError
from cranedyn.interfaces import Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "FILE"
EXAMPLE = "crane.mat"


def to_matlab(file: str | Path, crane: Crane, state: State | None = None, **options: Any) -> Path:
    """Write A, B, C, D, Ts, the names and units of states, inputs and outputs, and the state z0.

    Args:
        file: New file, ending in .mat; MATLAB's `load` opens it.
        crane: The crane.
        state: State to linearise about; None for the start.
        options: As `cranedyn.bridges.control.to_control` takes them.

    Raises:
        DataError: If the ending is not .mat, or the file exists or cannot be written.
        OutOfRange, UnknownName: As `to_control`.
    """
    file, system = Path(file), linear_system(crane, state, **options)
    if file.suffix != ".mat":
        raise DataError(f"Cannot write {file}: the ending of a file for MATLAB must be .mat.")
    units = {joint.symbol: joint.unit for joint in crane.layout.joints}
    units |= {f"{symbol}_dot": f"{unit}/s" for symbol, unit in units.items()}
    per = {"motion": "/s^2", "velocity": "/s"}.get(options.get("drive", "effort"))
    for joint, name in zip(crane.layout.driven, system.inputs, strict=True):
        units[name] = joint.effort_unit if per is None else joint.unit + per
    content: dict[str, Any] = {"A": system.a, "B": system.b, "C": system.c}
    content |= {"D": np.zeros((len(system.c), crane.layout.m)), "Ts": system.period}
    content["z0"] = np.concatenate(crane.start if state is None else state)[:, None]
    for kind in ("states", "inputs", "outputs"):
        names = getattr(system, kind)
        content[kind] = np.array(names, dtype=object)
        known = [units.get(name, units.get(name.rpartition("_")[0], "")) for name in names]
        content[f"{kind.removesuffix('s')}_units"] = np.array(known, dtype=object)
    with new_file(file) as draft, draft.open("wb") as stream:
        savemat(stream, content)
    return file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    text = "kind of the inputs: efforts, accelerations, or rates of frequency converters"
    parser.add_argument("--drive", choices=get_args(Drive), default="effort", help=text)
    text = "of a sampled system [s]; continuous if left out"
    parser.add_argument("--control-period", type=float, metavar="T", help=text)


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    settings = {"drive": options.drive, "control_period": options.control_period}
    return to_matlab(options.target, crane_from_options(options), **settings)
