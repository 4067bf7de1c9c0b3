"""Library of machines: numbers of real cranes, each machine with its source.

A file in ``cranedyn/machines`` has the arguments of a crane of this project: those that its source
states, each with its tolerance, and those that no source states, which are assumed.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple

from cranedyn.errors import UnknownName
from cranedyn.model.description import XACRO

_FOLDER = Path(__file__).resolve().parents[1] / "machines"
"""Folder of the files of the library."""


class MachineSpecification(NamedTuple):
    """Numbers of a real crane.

    Attributes:
        name: Name in the library.
        title: Kind of crane, where it stands.
        source: Place where its numbers are published.
        urdf: File of this project whose arguments they are; None for the tower crane.
        values: Arguments of that file by name, those assumed among them.
        margins: Tolerances of what the source states: ± this number. Those of values are under the
            names of the arguments, those of accelerations under the symbols of the drives.
        accelerations: Largest accelerations of the drives [rad/s² or m/s²] by symbol, as
            `cranedyn.dynamics.converters.converters` takes them. Rates are velocity limits of the
            crane.
    """

    name: str
    title: str
    source: str
    urdf: Path | None
    values: dict[str, float]
    margins: dict[str, float]
    accelerations: dict[str, float]

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Sentences for `Crane.assumptions`."""
        stated = [name for name in self.margins if name not in self.accelerations]
        sentence = f"{self.title}: all is assumed but {', '.join(stated)}"
        if self.accelerations:
            sentence += f", and the largest accelerations of {', '.join(self.accelerations)}"
        return (f"{sentence}.",)


def machine_names() -> list[str]:
    """Return the names of the machines of the library."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def read_machine(name: str) -> MachineSpecification:
    """Return a machine of the library.

    Raises:
        UnknownName: If the library has no machine of this name.
    """
    if name not in machine_names():
        raise UnknownName("machine", name, machine_names())
    content = tomllib.loads((_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    path = XACRO.with_name(f"{content['crane']}.urdf.xacro")
    # The file states a value or an acceleration as [number, tolerance ±].
    stated = content["values"]
    accelerations = content.get("accelerations", {})
    values = {key: value for key, (value, _) in stated.items()}
    return MachineSpecification(
        name=name,
        title=content["title"],
        source=content["source"],
        urdf=None if path == XACRO else path,
        values=values | content["assumed"],
        margins={key: margin for key, (_, margin) in (stated | accelerations).items()},
        accelerations={key: value for key, (value, _) in accelerations.items()},
    )
