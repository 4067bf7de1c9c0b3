"""An open benchmark of crane control: the same tasks for every controller, open to all.

A task is data: a crane, a goal, bounds, and what may differ from what a controller is told. An
entry gets what sensors measure and commands rates of the drives; it runs in a process of its own
and never sees the crane that moves. Results are a file that everybody can compute again.

Begin with `entry`, which says what an entry is, then `task` and `evaluate`. `entry_source` finds
the file of an entry, `entry_process` is the process in which it runs, `sensors` what it measures;
`baselines` are entries to compare with. `result` is the file of results, `score` its table,
`comparison` two of them side by side, `validity` whether a ranking depends on seeds, engine or
step, `limits` the least time of a move. The command is `benchmark_command`.
"""

from cranedyn.benchmark.entry import Briefing, Declined
from cranedyn.benchmark.sensors import SensorReading

__all__ = ["Briefing", "Declined", "SensorReading"]
