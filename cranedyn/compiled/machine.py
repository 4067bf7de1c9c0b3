"""From code to functions of this machine: LLVM optimises and translates, in this process, without a C compiler."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

from llvmlite import binding, ir


@dataclass(frozen=True, eq=False)
class Machine:
    """Functions in memory, for as long as this object lives. They let other Python threads run meanwhile.

    Attributes:
        engine: What holds them.
    """

    engine: Any

    def function(self, name: str, arguments: int) -> Any:
        """A function of so many addresses without a result."""
        return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * arguments)(self.engine.get_function_address(name))


def translated(module: ir.Module) -> Machine:
    """Optimise a module for the processor that this runs on, and translate it."""
    code, target = binding.parse_assembly(str(module)), _target()
    passes = binding.create_pass_builder(target, binding.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(code, passes)
    engine = binding.create_mcjit_compiler(code, target)
    engine.finalize_object()
    return Machine(engine)


@cache
def _initialised() -> Any:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple()


def _target() -> Any:
    """What code is made for; each engine takes one over."""
    return _initialised().create_target_machine(
        cpu=binding.get_host_cpu_name(), features=binding.get_host_cpu_features().flatten(), opt=3, jit=True
    )
