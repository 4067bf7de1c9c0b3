"""Many cases of one study: designed, run on local cores or a Dask cluster, kept as Parquet, resumed
after any interruption.
"""

from cranedyn.sweep.chunk import Study
from cranedyn.sweep.design import Design, cross, grid, sampled
from cranedyn.sweep.run import Progress, sweep
from cranedyn.sweep.store import results

__all__ = ["Design", "Progress", "Study", "cross", "grid", "results", "sampled", "sweep"]
