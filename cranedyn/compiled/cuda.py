"""Compiled loops on an NVIDIA GPU, one crane a thread, through the functions of the driver.

LLVM makes PTX, the assembly language of NVIDIA's GPUs, in this process, without a CUDA toolkit.
Sine and cosine are the polynomials of `cranedyn.compiled.angles`, as on the processor.

The arrays are those that `cranedyn.compiled.binding` has checked; they are copied to the GPU and
back. Accelerations by the code on the GPU are compared with Pinocchio before it is used.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from cranedyn.compiled.kernel import Kernel, KernelSource, build_module
from cranedyn.compiled.machine import assembly
from cranedyn.compiled.memory_layout import GROUP_POINTERS, size
from cranedyn.compiled.threads import WARP, emit_gpu_kernels
from cranedyn.compiled.verify import verify_cranes
from cranedyn.errors import CraneError

if TYPE_CHECKING:
    from cranedyn.compiled.binding import BoundKernel
    from cranedyn.compiled.plant.cranes import Cranes
    from cranedyn.model.crane import Crane

_TRIPLE = "nvptx64-nvidia-cuda"
"""Platform for which LLVM writes PTX."""

_OLDEST_GPU = "sm_75"
"""Oldest GPU generation for which code is made, of 2018; drivers translate it for any later one."""

_BLOCK_SIZE = 128
"""Threads of a block, which a GPU starts together."""

_MAX_STEPS_PER_LAUNCH = 1_000_000_000
"""Steps of all cranes together in one launch, after which Python handles Ctrl-C: a second or two on
a small GPU."""

_LOADING = threading.Lock()
"""Held while code is loaded into the GPU and compared, so that threads do it only once."""


def ptx(source: KernelSource) -> str:
    """Return PTX with the kernels `run` and `accelerate`, see
    `cranedyn.compiled.threads.emit_gpu_kernels`.

    Args:
        source: What the code is made from; its options are those of threads.
    """
    module = build_module(source)
    emit_gpu_kernels(module)
    return assembly(module, _TRIPLE, _OLDEST_GPU)


def check_available() -> None:
    """Check that there is a GPU.

    Raises:
        CraneError: If there is none, or no driver, or no `cuda-bindings`.
    """
    _driver()


def run(
    loop: BoundKernel,
    code: Kernel,
    cranes: Sequence[Crane] | Cranes,
    varied: np.ndarray,
    converters: np.ndarray | None = None,
) -> None:
    """Run a loop over all its groups of lanes on the first GPU.

    Args:
        loop: The loop, with code for threads.
        code: Code of the loop.
        cranes: Distinct cranes of the code.
        varied: Their varied numbers, shape (n, m).
        converters: Parameters of their converters, see `cranedyn.compiled.verify.compile_kernel`.

    Raises:
        CraneError: If there is no GPU, see `check_available`, or too little memory on it.
        ModelError: If the code on the GPU does not agree with Pinocchio.
    """
    with _context():
        with _LOADING:
            module = _module(code.source)
            verify_cranes(cranes, code, varied, module.verified, converters, module.accelerations)
        threads = len(loop) * WARP
        with _Memory() as memory:
            for call in loop.device_calls(memory.upload, GROUP_POINTERS, _MAX_STEPS_PER_LAUNCH):
                module.start("run", np.append(call, threads), threads)
            memory.download()


@cache
def _driver() -> Any:
    """Return NVIDIA's driver, initialised.

    Raises:
        CraneError: If there are none, or there is no GPU.
    """
    try:
        from cuda.bindings import driver
    except ModuleNotFoundError:
        raise CraneError(
            "Running on a GPU needs cuda-bindings, which is not installed: pip install "
            "'cranedyn[cuda]'."
        ) from None
    try:
        (status,) = driver.cuInit(0)
    except Exception as error:  # cuda-bindings has kinds of its own where there is no driver
        raise CraneError(
            "Running on a GPU needs NVIDIA's driver, which is not on this machine."
        ) from error
    if status != driver.CUresult.CUDA_SUCCESS:
        raise CraneError(f"There is no GPU that CUDA can use here: {status.name}.")
    return driver


def _call(name: str, *arguments: Any) -> Any:
    """Call a function of the driver and return its result.

    Raises:
        CraneError: If the function fails.
    """
    driver = _driver()
    status, *values = getattr(driver, name)(*arguments)
    if status != driver.CUresult.CUDA_SUCCESS:
        raise CraneError(f"The GPU refused {name}: {status.name}.")
    return values[0] if values else None


@contextmanager
def _context() -> Iterator[None]:
    """Use the first GPU with the primary context of this process."""
    _call("cuCtxPushCurrent", _primary())
    try:
        yield
    finally:
        _call("cuCtxPopCurrent")


@cache
def _primary() -> Any:
    """Return the primary context of the first GPU, which is kept until the process ends."""
    return _call("cuDevicePrimaryCtxRetain", _call("cuDeviceGet", 0))


class _Memory:
    """Arrays in the memory of the GPU, freed at the end."""

    def __init__(self) -> None:
        self._kept: list[tuple[Any, np.ndarray, bool]] = []

    def __enter__(self) -> _Memory:
        return self

    def __exit__(self, *error: object) -> None:
        for address, *_ in self._kept:
            _call("cuMemFree", address)

    def upload(self, array: np.ndarray, written: bool) -> int:
        """Copy an array to the GPU and return its address there; see `BoundKernel.device_calls`."""
        address = _call("cuMemAlloc", max(array.nbytes, 1))
        self._kept.append((address, array, written))
        _call("cuMemcpyHtoD", address, array, array.nbytes)
        return int(address)

    def download(self) -> None:
        """Copy the arrays that the code wrote to back from the GPU."""
        for address, array, written in self._kept:
            if written:
                _call("cuMemcpyDtoH", array, address, array.nbytes)


class _Module:
    """Kernels of a loop, loaded into the GPU.

    Attributes:
        verified: Varied numbers of the cranes for which it was compared with Pinocchio.
    """

    def __init__(self, text: str) -> None:
        self._module = _call("cuModuleLoadData", text.encode() + b"\0")
        self._functions = {
            name: _call("cuModuleGetFunction", self._module, name.encode())
            for name in ("run", "accelerate")
        }
        self.verified: set[bytes] = set()

    def start(self, name: str, arguments: np.ndarray, threads: int) -> None:
        """Run a kernel with arguments of eight bytes each, to its end."""
        parameters = tuple(arguments.tolist()), (ctypes.c_int64,) * len(arguments)
        block_count = -(-threads // _BLOCK_SIZE)  # rounded up
        block_size = min(threads, _BLOCK_SIZE)
        function = self._functions[name]
        # Blocks and threads in three dimensions, shared memory [byte], and the stream.
        grid = (block_count, 1, 1)
        block = (block_size, 1, 1)
        _call("cuLaunchKernel", function, *grid, *block, 0, 0, parameters, 0)
        _call("cuCtxSynchronize")

    def accelerations(self, code: Kernel, query: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return accelerations on the GPU, see `cranedyn.compiled.binding.kernel_accelerations`."""
        sizes = code.source.sizes
        result = np.empty((code.source.sizes.n, WARP))
        assert query.shape == (size(sizes.query), WARP) and len(numbers) == code.source.varied
        with _Memory() as memory:
            addresses = [memory.upload(query, False), memory.upload(numbers, False)]
            self.start("accelerate", np.array([*addresses, memory.upload(result, True)]), WARP)
            memory.download()
        return result


@lru_cache(maxsize=256)
def _module(source: KernelSource) -> _Module:
    """Return the kernels of a loop, loaded once."""
    return _Module(ptx(source))
