"""Code of a batch as PTX, the assembly language of NVIDIA's GPUs, one crane a thread.

LLVM generates it in this process, without a CUDA toolkit. Sine and cosine are the polynomials of
`cranedyn.compiled.angles`, as on the processor.
"""

from __future__ import annotations

from collections.abc import Sequence

from cranedyn.compiled.kernel import Recipe, build_module
from cranedyn.compiled.machine import assembly
from cranedyn.compiled.threads import emit_gpu_kernels
from cranedyn.plant.plant import Topology

_TRIPLE, _OLDEST = "nvptx64-nvidia-cuda", "sm_75"
"""Platform, and oldest GPU generation, of 2018; drivers translate PTX for any later one."""


def ptx(topology: Topology, constants: Sequence[float | None], recipe: Recipe) -> str:
    """Return PTX with the kernels run and answer, see `cranedyn.compiled.threads.emit_gpu_kernels`.

    Args:
        topology: Topology of the cranes.
        constants: Their numbers, None where each crane has its own.
        recipe: Features of the code; threads is True.
    """
    module = build_module(topology, constants, recipe)
    emit_gpu_kernels(module)
    return assembly(module, _TRIPLE, _OLDEST)
