"""Write docs/results/matrix.md from cells.toml: `python -m tests.matrix.page`."""

from __future__ import annotations

from tests.helpers import ROOT
from tests.matrix.cells import read_cells
from tests.matrix.cranes import CRANES
from tests.matrix.jobs import JOBS

PAGE = ROOT / "docs" / "results" / "matrix.md"

BEGIN = """# Which crane does what

This page shows which of {cranes} cranes goes through which of {jobs} jobs, and where one does not,
why and what to do instead.

```
python -m pytest tests/matrix -m "long or not long"
```

The command lets each crane do each job in a small instance, and fails where a cell of the table, or
the sentence with which cranedyn refuses, is another one. It runs in a clone of the repository after
`pip install '.[test]'`. `python -m tests.matrix.page` writes the page from the table of the test,
`tests/matrix/cells.toml`.

## The cranes

| name | crane |
| --- | --- |
| tower | the tower crane of this project |
| hook | the same with a hook block and a load slung below it |
| elastic rope | the same on a rope that stretches |
| two falls | the same on two parallel falls |
| heavy rope | the same on a rope with mass |
| luffing, overhead | the luffing and the overhead crane of this project |
| mobile | the mobile crane of this project, with a boom of sections that extend together |
| wall | a wall crane, `examples/wall_crane.urdf` |
| INTECO | a laboratory crane of the [library](measured.md), `machine="inteco_3dcrane"` |
| gantry | a gantry crane without any declared drive, `examples/cranes/gantry.urdf` |
| knuckle boom | a ship's crane of five drives, `examples/cranes/knuckle_boom.urdf` |
| portal | a portal crane of four drives, `examples/portal_crane.urdf` |
| MJCF | a pillar jib crane in MuJoCo's format, `examples/cranes/jib_crane.xml` |

## The matrix

"yes" says that the job works, and a number is that of the reason below the table.

"""

END = """
## Where to go next

* [From your crane's file to everything](../howto/foreign_cranes.md): four of these cranes from
  their file to a planned lift, a controller in C, a learning environment and a page.
* [Other cranes](cranes.md): how exactly cranes of other joints are simulated.
"""


def page_text() -> str:
    """Return the page."""
    expected = read_cells()
    numbers = {reason: i for i, reason in enumerate(expected.reasons, start=1)}
    lines = [
        f"| job | {' | '.join(CRANES)} |",
        f"| --- |{' :-: |' * len(CRANES)}",
    ]
    for job in JOBS:
        cells = []
        for crane in CRANES:
            refusal = expected.refusals.get((crane, job))
            cells.append("yes" if refusal is None else f"({numbers[refusal.reason]})")
        lines.append(f"| {job} | {' | '.join(cells)} |")
    reasons = [f"{numbers[name]}. {text.strip()}" for name, text in expected.reasons.items()]
    begin = BEGIN.format(cranes=len(CRANES), jobs=len(JOBS))
    return begin + "\n".join(lines) + "\n\n" + "\n".join(reasons) + "\n" + END


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
