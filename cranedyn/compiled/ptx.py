"""The code of a batch as PTX, the assembly language of NVIDIA's GPUs: made by LLVM in this process,
one crane a thread. No CUDA toolkit is needed.

What a GPU has no instruction for is not in it: sine and cosine are the polynomials of
`cranedyn.compiled.angles`, as in vectors of the processor.
"""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.compiled.kernel import Recipe, text
from cranedyn.compiled.machine import assembly
from cranedyn.compiled.threads import side_by_side
from cranedyn.plant.plant import Topology

_TRIPLE, _OLDEST = "nvptx64-nvidia-cuda", "sm_75"
"""The kind of machine, and the oldest that PTX is made for, of 2018; drivers translate it for any
later one."""


def ptx(topology: Topology, constants: Sequence[float | None], recipe: Recipe) -> str:
    """Return PTX with the kernels run and answer, see `cranedyn.compiled.threads.side_by_side`.

    Args:
        topology: What the cranes have in common.
        constants: Their numbers, None where each crane has its own.
        recipe: What the code can do; of threads.
    """
    module = text(topology, constants, recipe)
    side_by_side(module)
    return assembly(module, _TRIPLE, _OLDEST)
