"""The code of a batch as PTX, the assembly language of NVIDIA's GPUs: made by LLVM in this process,
one crane a thread. No CUDA toolkit is needed.

What a GPU has no instruction for is not in it: sine and cosine are the polynomials of
`cranedyn.compiled.angles`, as in vectors of the processor.
"""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.compiled.kernel import Recipe, build_module
from cranedyn.compiled.machine import assembly
from cranedyn.compiled.threads import emit_gpu_kernels
from cranedyn.plant.plant import Topology

_TRIPLE, _OLDEST = "nvptx64-nvidia-cuda", "sm_75"
"""The kind of machine, and the oldest that PTX is made for, of 2018; drivers translate it for any
later one."""


def ptx(topology: Topology, constants: Sequence[float | None], recipe: Recipe) -> str:
    """Return PTX with the kernels run and answer, see `cranedyn.compiled.threads.emit_gpu_kernels`.

    Args:
        topology: What the cranes have in common.
        constants: Their numbers, None where each crane has its own.
        recipe: What the code can do; of threads.
    """
    module = build_module(topology, constants, recipe)
    emit_gpu_kernels(module)
    return assembly(module, _TRIPLE, _OLDEST)
