"""Call compiled code with every NumPy array between guard pages: ``python -m tests.guard_pages``.

``--cases 10000 --seed 1`` makes as many valid and invalid calls, and prints the number of each
outcome and a digest of the results. A read or a write beside an array ends the process by SIGSEGV.
``--plain`` uses no guard pages, for a run under ``MALLOC_PERTURB_`` and ``MALLOC_CHECK_``, or
valgrind.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
from collections import Counter
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from llvmlite import binding

from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.fleet import Fleet
from cranedyn.controllers import hold_controller
from cranedyn.controllers.affine import Affine
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.errors import CraneError
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.simulation.simulate import simulate

# --- guard pages ----------------------------------------------------------------------------------

_ALLOCATOR = """
declare ptr @mmap(ptr, i64, i32, i32, i32, i64)
declare i32 @mprotect(ptr, i64, i32)
declare i32 @munmap(ptr, i64)
declare i64 @llvm.umax.i64(i64, i64)
declare i64 @llvm.umin.i64(i64, i64)
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
@at_end = internal global i64 0

define internal ptr @allocate(i64 %size, i8 %byte) {
  %length = call i64 @llvm.umax.i64(i64 %size, i64 1)
  %padded = add i64 %length, 4095
  %pages = and i64 %padded, -4096
  %total = add i64 %pages, 12288
  %base = call ptr @mmap(ptr null, i64 %total, i32 0, i32 34, i32 -1, i64 0)
  %first = getelementptr i8, ptr %base, i64 8192
  %e = call i32 @mprotect(ptr %base, i64 4096, i32 3)
  %f = call i32 @mprotect(ptr %first, i64 %pages, i32 3)
  store i64 %length, ptr %base
  %previous = load i64, ptr @at_end
  %flag = sub i64 1, %previous
  store i64 %flag, ptr @at_end
  %slack = sub i64 %pages, %length
  %offset = mul i64 %slack, %flag
  %data = getelementptr i8, ptr %first, i64 %offset
  call void @llvm.memset.p0.i64(ptr %data, i8 %byte, i64 %length, i1 false)
  ret ptr %data
}

define internal ptr @base_of(ptr %data) {
  %page = call ptr @llvm.ptrmask.p0.i64(ptr %data, i64 -4096)
  %base = getelementptr i8, ptr %page, i64 -8192
  ret ptr %base
}
declare ptr @llvm.ptrmask.p0.i64(ptr, i64)

define ptr @guarded_malloc(ptr %context, i64 %size) {
  %data = call ptr @allocate(i64 %size, i8 165)
  ret ptr %data
}

define ptr @guarded_calloc(ptr %context, i64 %count, i64 %item_size) {
  %size = mul i64 %count, %item_size
  %data = call ptr @allocate(i64 %size, i8 0)
  ret ptr %data
}

define ptr @guarded_realloc(ptr %context, ptr %old, i64 %size) {
  %data = call ptr @allocate(i64 %size, i8 165)
  %base = call ptr @base_of(ptr %old)
  %old_length = load i64, ptr %base
  %common = call i64 @llvm.umin.i64(i64 %old_length, i64 %size)
  call void @llvm.memcpy.p0.p0.i64(ptr %data, ptr %old, i64 %common, i1 false)
  call void @guarded_free(ptr null, ptr %old, i64 %old_length)
  ret ptr %data
}

define void @guarded_free(ptr %context, ptr %data, i64 %size) {
  %is_null = icmp eq ptr %data, null
  br i1 %is_null, label %done, label %is_array
is_array:
  %base = call ptr @base_of(ptr %data)
  %old_length = load i64, ptr %base
  %padded = add i64 %old_length, 4095
  %pages = and i64 %padded, -4096
  %total = add i64 %pages, 12288
  %e = call i32 @munmap(ptr %base, i64 %total)
  br label %done
done:
  ret void
}
"""
"""An allocator that gives each array its own pages. By turns the array begins after a page without
access or ends before one. A page in front holds its length. Its bytes are filled with a value that
makes no sensible number. Native code, because NumPy frees arrays while an exception is pending.
"""

_SET_HANDLER = 304
"""Index of PyDataMem_SetHandler in NumPy's table of functions, a constant of its ABI (NEP 49)."""


class _Handler(ctypes.Structure):
    """NumPy's PyDataMem_Handler."""

    _fields_ = (
        ("name", ctypes.c_char * 127),
        ("version", ctypes.c_uint8),
        *((name, ctypes.c_void_p) for name in ("context", "malloc", "calloc", "realloc", "free")),
    )


_ALIVE: list[Any] = []
"""References that keep the allocator alive."""


def guard() -> None:
    """Make NumPy allocate arrays between guard pages from now on."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(_ALLOCATOR), target)
    engine.finalize_object()
    names = (f"guarded_{name}" for name in ("malloc", "calloc", "realloc", "free"))
    handler = _Handler(b"guarded", 1, None, *map(engine.get_function_address, names))
    python = ctypes.pythonapi
    name = b"mem_handler"
    python.PyCapsule_New.restype = ctypes.py_object
    python.PyCapsule_New.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    python.PyCapsule_GetPointer.restype = ctypes.c_void_p
    python.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    table = python.PyCapsule_GetPointer(np._core._multiarray_umath._ARRAY_API, None)  # type: ignore[attr-defined]
    address = ctypes.cast(table, ctypes.POINTER(ctypes.c_void_p))[_SET_HANDLER]
    set_handler = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(address)
    capsule = python.PyCapsule_New(ctypes.addressof(handler), name, None)
    _ALIVE.extend((name, engine, handler, capsule, set_handler(capsule)))


# --- calls ----------------------------------------------------------------------------------------


class _Draw:
    """Random arguments of a call, a share of which is invalid."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.share = float(rng.choice([0.0, 0.02, 0.2]))
        self.cranes = _cranes()[rng.random() < 0.2]
        self.rough = bool(rng.random() < 0.2)

    def maybe(self, array: np.ndarray) -> Any:
        """Return an array, or seldom an invalid variant of it."""
        if self.rng.random() >= self.share:
            return array
        variants: list[Callable[[], Any]] = [
            lambda: array[..., :-1],
            lambda: array[:0],
            lambda: np.repeat(array, 50, axis=0),
            lambda: array[None],
            lambda: array.ravel()[:1],
            lambda: array.astype(np.float32),
            lambda: array.astype(">f8"),
            lambda: np.asfortranarray(array),
            lambda: np.repeat(array, 2, axis=-1)[..., ::2],
            lambda: array.astype(complex),
            lambda: array.tolist(),
            lambda: np.full_like(array, self.rng.choice([np.nan, np.inf, 1e300])),
        ]
        return variants[int(self.rng.integers(len(variants)))]()

    def controller(self) -> Any:
        """Return a hold controller, whose gain table may be invalid."""
        controller = hold_controller(self.cranes[0])
        return _Corrupted(controller, self) if self.rng.random() < 0.7 else controller

    def reference(self) -> Any:
        """Return None, or a constant reference whose table may be invalid."""
        return None if self.rng.random() < 0.3 else _Corrupted(hold(self.cranes[0]), self)

    def clock(self) -> dict[str, Any]:
        """Return steps and duration."""
        return {
            "control_period": 1e-2,
            "dt": 1e-2 if self.rough else 1e-3,
            "integrator": rk4 if self.rough else semi_implicit_euler,
            "duration": 1e-2 * int(self.rng.integers(1, 40)),
        }


class _Corrupted:
    """A controller or reference whose table may be invalid, differently at each call."""

    def __init__(self, valid: Any, draw: _Draw) -> None:
        self._valid = valid
        self._draw = draw

    def __call__(self, *arguments: Any) -> Any:
        return self._valid(*arguments)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine:
        form = self._valid.affine(times, positions)
        arrays = (getattr(form, name) for name in Affine.__dataclass_fields__)
        return Affine(*map(self._draw.maybe, arrays))

    def at(self, times: np.ndarray) -> Setpoint:
        return Setpoint(*(self._draw.maybe(np.array(array)) for array in self._valid.at(times)))


@cache
def _cranes() -> list[list[Crane]]:
    """Return two cranes of five joints, and two of seven with a hook."""
    return [
        [load_crane(**values), load_crane(payload_mass=700.0, **values)]
        for values in ({}, {"hook_mass": 200.0})
    ]


def _batch(draw: _Draw) -> Any:
    rng = draw.rng
    cranes = draw.cranes
    n = int(draw.rng.integers(1, 20))
    joints = cranes[0].layout.n
    points = len(cranes[0].points)
    q = np.tile(cranes[0].start.q, (n, 1)) + rng.uniform(-0.1, 0.1, (n, joints))
    options = draw.clock() | {"start": State(draw.maybe(q), draw.maybe(np.zeros((n, joints))))}
    if rng.random() < 0.3:
        options["force"] = draw.maybe(rng.normal(size=(n, int(rng.integers(1, 9)), 3 * points)))
        options["sensor_offset"] = draw.maybe(np.zeros((n, 3, 2 * joints)))
        options["sensor_delay"] = rng.integers(0, 9, n).tolist()
    else:
        options["record"] = int(rng.choice([0, 1, 3, 10**30]))
    controllers = [draw.controller() for _ in range(n)]
    uniform = rng.random() < 0.5
    plant = (cranes[0], controllers[0]) if uniform else ([*cranes, *cranes * n][:n], controllers)
    reference = draw.reference()
    threads = int(rng.integers(1, 4))
    return simulate_batch(*plant, reference, buffers=draw.rough, threads=threads, **options)


def _run(draw: _Draw) -> Any:
    crane = draw.cranes[0]
    controller = draw.controller()
    options = {"validity": "buffers" if draw.rough else "mark", "start": crane.state(phi=0.1)}
    plain_function = draw.rng.random() < 0.3
    function = (lambda *arguments: controller(*arguments)) if plain_function else controller
    reference = None if plain_function else draw.reference()
    return simulate(crane, function, reference, engine="compiled", **options, **draw.clock())


def _fleet(draw: _Draw) -> np.ndarray:
    rng = draw.rng
    crane = draw.cranes[0]
    n = int(draw.rng.integers(1, 40))
    indices = rng.choice(n, int(rng.integers(0, n + 1)), replace=False)
    q = np.tile(crane.start.q, (len(indices), 1))
    v = np.zeros((len(indices), crane.layout.n))
    forces = bool(rng.random() < 0.5)
    drive = str(rng.choice(["motion", "effort"]))
    fleet = Fleet(draw.cranes, n, control_period=1e-2, drive=drive, forces=forces, threads=2)
    drawn = draw.maybe(indices)
    kinds = draw.maybe(rng.integers(0, 2, len(indices)))
    fleet.place(drawn, State(draw.maybe(q), draw.maybe(v)), kinds)
    if forces or rng.random() < draw.share:
        fleet.push(drawn, draw.maybe(np.zeros((len(indices), 3 * len(crane.points)))))
    chunk = int(rng.integers(-1, 3)) if rng.random() < draw.share else 0
    fleet.advance(chunk, draw.maybe(rng.normal(size=(crane.layout.m, n))[:, fleet.chunks[0]]))
    return fleet.step(draw.maybe(rng.normal(size=(crane.layout.m, n)))).copy()


_CALLS = [_batch, _batch, _batch, _run, _run, _fleet]


def _arrays(result: Any) -> list[np.ndarray]:
    values = [result] if isinstance(result, np.ndarray) else vars(result).values()
    return [np.asarray(value) for value in values if isinstance(value, np.ndarray | tuple)]


def main() -> None:
    """Make the calls and print the outcomes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=10000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true")
    options = parser.parse_args()
    if not options.plain:
        guard()
    outcomes: Counter[str] = Counter()
    digest = hashlib.sha256()
    np.seterr(all="ignore")
    for case in range(options.cases):
        rng = np.random.default_rng([options.seed, case])
        try:
            result = _CALLS[int(rng.integers(len(_CALLS)))](_Draw(rng))
        except CraneError as error:
            outcomes[type(error).__name__] += 1
            digest.update(str(error).encode())
        else:
            outcomes["ran"] += 1
            for array in _arrays(result):
                digest.update(np.ascontiguousarray(array).tobytes())
    counts = ", ".join(f"{name} {count}" for name, count in sorted(outcomes.items()))
    print(f"{options.cases} calls: {counts}\n{digest.hexdigest()}")


if __name__ == "__main__":
    main()
