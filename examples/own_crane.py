"""A crane of one's own: other numbers by argument, or a URDF file that somebody changed by hand."""

from pathlib import Path

import cranedyn as cd
from cranedyn.model.description import arguments, describe

for name in ("payload_mass", "hoist_init", "damp_swing"):
    print(
        f"{name:14} {arguments()[name].default:>8} {arguments()[name].unit:10} "
        f"{arguments()[name].meaning}"
    )

longer = cd.load_crane(payload_mass=1500, trolley_max=30.0, hoist_init=20.0)
print(longer)

text = describe(values={"payload_mass": 3000})
Path("mine.urdf").write_text(text, encoding="utf-8")
mine = cd.load_crane("mine.urdf")
print(f"mine.urdf carries {mine.payload_mass:g} kg")
cd.plot(mine).savefig("mine.png")
