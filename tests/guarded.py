"""Public calls of compiled code with every array of NumPy's between pages that nobody may touch.

``python -m tests.guarded --cases 10000 --seed 1`` tries as many calls, right and wrong ones, and
prints how they ended and a digest of what came out. A read or a write beside an array ends the
process by SIGSEGV. ``--plain`` leaves the arrays where they are, for a run under
``MALLOC_PERTURB_`` and ``MALLOC_CHECK_``, or valgrind.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import binding

_ALLOCATOR = """
declare ptr @mmap(ptr, i64, i32, i32, i32, i64)
declare i32 @mprotect(ptr, i64, i32)
declare i32 @munmap(ptr, i64)
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
@at_front = internal global i64 0

define internal ptr @filled(i64 %given, i8 %with) {
  %least = call i64 @llvm.umax.i64(i64 %given, i64 1)
  %more = add i64 %least, 4095
  %pages = and i64 %more, -4096
  %whole = add i64 %pages, 12288
  %base = call ptr @mmap(ptr null, i64 %whole, i32 0, i32 34, i32 -1, i64 0)
  %e = call i32 @mprotect(ptr %base, i64 4096, i32 3)
  store i64 %least, ptr %base
  %first = getelementptr i8, ptr %base, i64 8192
  %f = call i32 @mprotect(ptr %first, i64 %pages, i32 3)
  %before = load i64, ptr @at_front
  %now = sub i64 1, %before
  store i64 %now, ptr @at_front
  %room = sub i64 %pages, %least
  %aside = mul i64 %room, %now
  %place = getelementptr i8, ptr %first, i64 %aside
  call void @llvm.memset.p0.i64(ptr %place, i8 %with, i64 %least, i1 false)
  ret ptr %place
}
declare i64 @llvm.umax.i64(i64, i64)
declare i64 @llvm.umin.i64(i64, i64)

define internal ptr @base_of(ptr %place) {
  %at = ptrtoint ptr %place to i64
  %first = and i64 %at, -4096
  %base = sub i64 %first, 8192
  %found = inttoptr i64 %base to ptr
  ret ptr %found
}

define ptr @guarded_malloc(ptr %context, i64 %size) {
  %place = call ptr @filled(i64 %size, i8 165)
  ret ptr %place
}

define ptr @guarded_calloc(ptr %context, i64 %count, i64 %each) {
  %size = mul i64 %count, %each
  %place = call ptr @filled(i64 %size, i8 0)
  ret ptr %place
}

define void @guarded_free(ptr %context, ptr %place, i64 %size) {
  %none = icmp eq ptr %place, null
  br i1 %none, label %done, label %some
some:
  %base = call ptr @base_of(ptr %place)
  %held = load i64, ptr %base
  %more = add i64 %held, 4095
  %pages = and i64 %more, -4096
  %whole = add i64 %pages, 12288
  %e = call i32 @munmap(ptr %base, i64 %whole)
  br label %done
done:
  ret void
}

define ptr @guarded_realloc(ptr %context, ptr %old, i64 %size) {
  %place = call ptr @filled(i64 %size, i8 165)
  %none = icmp eq ptr %old, null
  br i1 %none, label %done, label %some
some:
  %base = call ptr @base_of(ptr %old)
  %held = load i64, ptr %base
  %common = call i64 @llvm.umin.i64(i64 %held, i64 %size)
  call void @llvm.memcpy.p0.p0.i64(ptr %place, ptr %old, i64 %common, i1 false)
  call void @guarded_free(ptr null, ptr %old, i64 %held)
  br label %done
done:
  ret ptr %place
}
"""
"""Memory of pages of its own for each piece, which by turns ends and begins where a page without
access does; its length stands in a page before. What nobody has written yet is filled with a byte
that makes no sensible number."""

_SET_HANDLER = 304
"""Place of PyDataMem_SetHandler in NumPy's table of functions, part of its binary interface (NEP
49)."""


class _Handler(ctypes.Structure):
    """NumPy's PyDataMem_Handler."""

    _fields_ = (
        ("name", ctypes.c_char * 127),
        ("version", ctypes.c_uint8),
        ("context", ctypes.c_void_p),
        *((name, ctypes.c_void_p) for name in ("malloc", "calloc", "realloc", "free")),
    )


_ALIVE: list[Any] = []


def guard() -> None:
    """Have NumPy put every array that is made from now on between guard pages."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(_ALLOCATOR), target)
    engine.finalize_object()
    strategies = (
        engine.get_function_address(f"guarded_{name}")
        for name in ("malloc", "calloc", "realloc", "free")
    )
    handler = _Handler(b"guarded", 1, None, *strategies)
    python = ctypes.pythonapi
    python.PyCapsule_New.restype, python.PyCapsule_New.argtypes = (
        ctypes.py_object,
        [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p],
    )
    python.PyCapsule_GetPointer.restype, python.PyCapsule_GetPointer.argtypes = (
        ctypes.c_void_p,
        [ctypes.py_object, ctypes.c_char_p],
    )
    name, table = b"mem_handler", np._core._multiarray_umath._ARRAY_API  # type: ignore[attr-defined]
    functions = ctypes.cast(
        python.PyCapsule_GetPointer(table, None), ctypes.POINTER(ctypes.c_void_p)
    )
    capsule = python.PyCapsule_New(ctypes.addressof(handler), name, None)
    set_handler = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(functions[_SET_HANDLER])
    _ALIVE.extend((name, engine, handler, capsule, set_handler(capsule)))


Call = Callable[[], Any]


def calls(rng: np.random.Generator) -> Call:
    """One call of something public that runs compiled code; the same for the same generator."""
    kind = rng.choice(["batch", "batch", "batch", "simulate", "simulate", "rows", "fleet"])
    return {"batch": _batch, "simulate": _run, "rows": _rows, "fleet": _fleet}[kind](rng)


def _wrong(rng: np.random.Generator, array: np.ndarray) -> Any:
    """Something that is not quite the array."""
    strategies: list[Callable[[], Any]] = [
        lambda: array[..., :-1],
        lambda: array[:0],
        lambda: np.concatenate([array, array[-1:]]) if array.ndim else array,
        lambda: np.repeat(array, 50, axis=0),
        lambda: array[None],
        lambda: array.ravel()[:1],
        lambda: array.astype(np.float32),
        lambda: array.astype(">f8"),
        lambda: np.asfortranarray(array),
        lambda: np.repeat(array, 2, axis=-1)[..., ::2],
        lambda: array.astype(int),
        lambda: array.astype(complex),
        lambda: array.tolist(),
        lambda: np.full_like(array, rng.choice([np.nan, np.inf, 1e300])),
    ]
    return strategies[int(rng.integers(len(strategies)))]()


def _maybe(rng: np.random.Generator, array: np.ndarray, often: float) -> Any:
    return _wrong(rng, array) if rng.random() < often else array


class _Odd:
    """A controller whose common form may be wrong, as its generator says, and differently at each
    call.
    """

    def __init__(self, brake: Any, rng: np.random.Generator, often: float) -> None:
        self._brake, self._rng, self._often = brake, rng, often

    def __call__(self, t: float, state: Any, setpoint: Any) -> Any:
        return self._brake(t, state, setpoint)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Any:
        from cranedyn.controllers.affine import Affine

        form = self._brake.affine(times, positions)
        return Affine(
            *(
                _maybe(self._rng, getattr(form, name), self._often)
                for name in Affine.__dataclass_fields__
            )
        )


class _Elsewhere:
    """A reference whose table may be wrong."""

    def __init__(self, still: Any, rng: np.random.Generator, often: float) -> None:
        self._still, self._rng, self._often = still, rng, often

    def __call__(self, t: float) -> Any:
        return self._still(t)

    def at(self, times: np.ndarray) -> Any:
        from cranedyn.interfaces import Setpoint

        return Setpoint(
            *(_maybe(self._rng, np.array(part), self._often) for part in self._still.at(times))
        )


def _common(rng: np.random.Generator) -> tuple[Any, dict[str, Any], Callable[[], Any], Any]:
    from cranedyn.controllers import hold_controller
    from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
    from cranedyn.model.load import load_crane
    from cranedyn.references import hold

    if not _CRANES:
        _CRANES.extend(
            [
                [load_crane(**more), load_crane(payload_mass=700.0, **more)]
                for more in ({}, {"hook_mass": 200.0})
            ]
        )
    cranes, period = _CRANES[rng.random() < 0.2], 1e-2
    crane = cranes[0]
    buffers = bool(rng.random() < 0.2)
    how: dict[str, Any] = {
        "control_period": period,
        "dt": period if buffers else 1e-3,
        "integrator": rk4 if buffers else semi_implicit_euler,
        "duration": period * int(rng.integers(1, 40)),
    }
    often = float(rng.choice([0.0, 0.02, 0.2]))
    brake, still = hold_controller(crane), hold(crane)

    def controller() -> Any:
        return _Odd(brake, rng, often) if rng.random() < 0.7 else brake

    reference = None if rng.random() < 0.3 else _Elsewhere(still, rng, often)
    return cranes, how | {"buffers": buffers, "often": often}, controller, reference


_CRANES: list[list[Any]] = []
"""Two of five joints, and two of seven with a hook."""

_ROBOTS: dict[int, Any] = {}


def _batch(rng: np.random.Generator) -> Call:
    from cranedyn.compiled.batch import simulate_batch
    from cranedyn.interfaces import State

    cranes, how, controller, reference = _common(rng)
    often, n = how.pop("often"), int(rng.integers(1, 20))
    joints, points = cranes[0].layout.n, len(cranes[0].points)
    q = np.tile(cranes[0].start.q, (n, 1)) + rng.uniform(-0.1, 0.1, (n, joints))
    how["start"] = State(_maybe(rng, q, often), _maybe(rng, np.zeros((n, joints)), often))
    if rng.random() < 0.3:
        how["force"] = _maybe(rng, rng.normal(size=(n, int(rng.integers(1, 9)), 3 * points)), often)
        noise = np.zeros((n, 2 * joints) if rng.random() < 0.5 else (n, 3, 2 * joints))
        how["sensor_offset"] = _maybe(rng, noise, often)
        how["sensor_delay"] = rng.integers(0, 9, n).tolist()
    else:
        how["record"] = int(rng.choice([0, 1, 3, 10**30]))
    one = rng.random() < 0.5
    controllers, several = (
        (controller(), cranes[0])
        if one
        else ([controller() for _ in range(n)], [cranes[i % 2] for i in range(n)])
    )
    return lambda: simulate_batch(
        several, controllers, reference, **how, threads=int(rng.integers(1, 4))
    )


def _run(rng: np.random.Generator) -> Call:
    from cranedyn.simulation.simulate import simulate

    (crane, _), how, controller, reference = _common(rng)
    buffers = how.pop("buffers"), how.pop("often")
    how |= {
        "validity": "buffers" if buffers[0] else "mark",
        "start": crane.state(phi=0.1),
        "engine": "compiled",
    }
    one = controller()
    if rng.random() < 0.3:
        return lambda: simulate(crane, lambda t, state, setpoint: one(t, state, setpoint), **how)
    return lambda: simulate(crane, one, reference, **how)


def _rows(rng: np.random.Generator) -> Call:
    from cranedyn.compiled.model import compile_forward_dynamics

    crane = _common(rng)[0][0]
    joints, n = crane.layout.n, int(rng.integers(0, 30))
    if joints not in _ROBOTS:
        _ROBOTS[joints] = compile_forward_dynamics(crane.model)
    parts = [_maybe(rng, rng.normal(size=(n, joints)), 0.2) for _ in range(3)]
    return lambda: _ROBOTS[joints](*parts)


def _fleet(rng: np.random.Generator) -> Call:
    from cranedyn.compiled.fleet import Fleet
    from cranedyn.interfaces import State

    cranes = _common(rng)[0]
    joints, drives, points = cranes[0].layout.n, cranes[0].layout.m, len(cranes[0].points)
    n, often, forces = (
        int(rng.integers(1, 40)),
        float(rng.choice([0.0, 0.1])),
        bool(rng.random() < 0.5),
    )
    drive = str(rng.choice(["motion", "effort"]))
    which = rng.choice(n, int(rng.integers(0, n + 1)), replace=False)
    q, v = np.tile(cranes[0].start.q, (len(which), 1)), np.zeros((len(which), joints))
    start = State(_maybe(rng, q, often), _maybe(rng, v, often))
    kinds, given = rng.integers(0, 2, len(which)), rng.normal(size=(drives, n))
    chosen, kinds, command = (
        _maybe(rng, which, often),
        _maybe(rng, kinds, often),
        _maybe(rng, given, often),
    )
    force, part = (
        _maybe(rng, np.zeros((len(which), 3 * points)), often),
        int(rng.integers(-1, 3)) if rng.random() < often else 0,
    )

    def call() -> np.ndarray:
        fleet = Fleet(cranes, n, control_period=1e-2, drive=drive, forces=forces, threads=2)
        fleet.place(chosen, start, kinds)
        if forces or rng.random() < often:
            fleet.push(chosen, force)
        fleet.advance(
            part,
            command[:, fleet.chunks[0]]
            if isinstance(command, np.ndarray) and command.ndim > 1
            else command,
        )
        return fleet.step(command).copy()

    return call


def _numbers(found: Any) -> list[np.ndarray]:
    if isinstance(found, np.ndarray):
        return [found]
    parts = [value for value in vars(found).values() if isinstance(value, np.ndarray | tuple)]
    return [np.asarray(part) for part in parts]


def main() -> None:
    """Try, count and print."""
    from cranedyn.errors import CraneError

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=10000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true")
    given = parser.parse_args()
    if not given.plain:
        guard()
    ended: Counter[str] = Counter()
    digest = hashlib.sha256()
    np.seterr(all="ignore")
    for case in range(given.cases):
        rng = np.random.default_rng([given.seed, case])
        try:
            found = calls(rng)()
        except CraneError as error:
            ended[type(error).__name__] += 1
            digest.update(str(error).encode())
        else:
            ended["ran"] += 1
            for part in _numbers(found):
                digest.update(np.ascontiguousarray(part).tobytes())
    print(
        f"{given.cases} calls: "
        f"{', '.join(f'{name} {count}' for name, count in sorted(ended.items()))}"
    )
    print(digest.hexdigest())


if __name__ == "__main__":
    main()
