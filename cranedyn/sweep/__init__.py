"""Sweeps: run one study on many cases, keep every result, and resume after any interruption.

A *study* is a function at the top of a module. It gets the parameters of some cases and returns
their results, columns of one length by name. A *design* is the table of cases. A *sweep* runs the
study chunk by chunk, on the cores of this machine or on a Dask cluster, and writes one Parquet file
per chunk into a folder.

    design = cross(grid(strategy=["spline", "flat"]), sample(1024, seed=1, l_m=(5.0, 25.0)))
    progress = sweep(study, design, "out/periods")
    table = results("out/periods")

Public names:
    grid, sample, cross: Designs: every combination of values; points that fill a box (Sobol or
        Latin hypercube); the product of two designs. `Design` takes any columns.
    sweep: Runs a study on a design, or resumes; returns a `Progress`.
    results: Reads a finished sweep as a table.
    cranedyn.sweep.cluster.tls: Certificates for a Dask cluster of several machines.

A case that raises, returns a number that is not finite, kills its process or takes too long has
the reason in the column `error`; the other cases keep their results. Chunk files carry checksums;
the folder records the design and the source files, and refuses to mix them with others.

Modules, in the order to read them: `design`; `running`, the sweep; `study`, the computation of a
chunk; `pool`, the chunks that are being computed; `workers` and `cluster`, the processes that
compute them; `folder`, the files.
"""

from cranedyn.sweep.design import Design, cross, grid, sample
from cranedyn.sweep.folder import results
from cranedyn.sweep.running import Progress, sweep
from cranedyn.sweep.study import Study

__all__ = ["Design", "Progress", "Study", "cross", "grid", "results", "sample", "sweep"]
