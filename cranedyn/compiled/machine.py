"""Machine code: LLVM optimises and translates modules in this process, without a C compiler.

`translate` makes functions that this process can call, and `native_assembly` shows them.
`object_code` and `assembly` translate for other platforms. What `translate` and `object_code` make
is kept for later processes, see `cranedyn.data.kept_files`: under a digest of the text of the
module and of all else that it depends on.
"""

from __future__ import annotations

import ctypes
import sys
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import llvmlite
from llvmlite import binding, ir
from llvmlite.binding.newpassmanagers import NewPassManager

from cranedyn.data.kept_files import digest_of_parts, keep, read_kept


@dataclass(frozen=True, eq=False)
class Machine:
    """Functions in memory, for as long as this object lives; they release the GIL.

    Attributes:
        engine: LLVM's engine, which owns them.
        context: LLVM's context of their constants and types.
    """

    engine: Any
    context: Any
    _known: dict[str, Any] = field(default_factory=dict, init=False)

    def __del__(self) -> None:
        """Free the context after the engine, which still uses it.

        llvmlite by itself frees whichever it meets first. It leaves alone what it does not own:
        `translate` takes the context from it, and here it is given up by hand.
        """
        if not sys.is_finalizing():
            self.engine.close()
            self.context._owned = False
            self.context.close()

    def function(self, name: str, arguments: int) -> Any:
        """Return a function of so many addresses without a result; it trusts them, so that only
        `cranedyn.compiled.binding` may call it.
        """
        if name not in self._known:
            self._known[name] = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * arguments)(
                self.engine.get_function_address(name)
            )
        return self._known[name]


def translate(module: ir.Module, *, inlining: bool = False) -> Machine:
    """Optimise a module for this processor and translate it.

    The memory of the code is freed together with the functions.

    Higher levels of optimisation take a third longer to compile and make straight-line code no
    faster.

    Args:
        module: The code.
        inlining: Whether to inline functions and to look for the best order of instructions. That
            takes longer, and pays for code of many lanes only.
    """
    text = str(module)
    name = digest_of_parts(*_translator(), "this processor", text, str(inlining))
    content = read_kept(name)
    if content is None:
        content = _native_object(text, inlining)
        keep(name, content)
    return _load(content)


@lru_cache(maxsize=1)
def _translator() -> tuple[str, ...]:
    """Return what machine code depends on besides its module: this file, LLVM, and the processor
    with its features, since a folder of kept files may be shared by several machines.
    """
    return (
        Path(__file__).read_text("utf-8"),
        llvmlite.__version__,
        ".".join(str(number) for number in binding.llvm_version_info),
        binding.get_default_triple(),
        binding.get_host_cpu_name(),
        binding.get_host_cpu_features().flatten(),
    )


def _native_object(text: str, inlining: bool) -> bytes:
    """Return the object file of the text of a module, optimised for this processor."""
    target, code = _optimised(text, inlining=inlining)
    code.data_layout = str(target.target_data)
    return target.emit_object(code)


def _load(content: bytes) -> Machine:
    """Return the functions of an object file of this processor, in memory."""
    context = binding.create_context()
    context._owned = True
    # The engine has a module of its own, which stays empty.
    module = binding.parse_assembly("", context)
    engine = binding.create_mcjit_compiler(module, _target(2))
    engine.add_object_file(binding.ObjectFileRef.from_data(content))
    engine.finalize_object()
    return Machine(engine, context)


def native_assembly(module: ir.Module) -> str:
    """Return what `translate` makes of a module of many lanes, in assembly language."""
    target, code = _optimised(str(module), inlining=True)
    return target.emit_assembly(code)


def _optimised(text: str, *, inlining: bool) -> tuple[Any, Any]:
    """Return a target machine of this processor, and the text of a module as optimised code for
    it.
    """
    target = _target(3 if inlining else 2)
    # The global context would keep every constant for ever.
    code = binding.parse_assembly(text, binding.create_context())
    _optimise(code, target, speed_level=1, inlining=inlining)
    return target, code


def object_code(module: ir.Module, triple: str, features: str = "") -> bytes:
    """Translate a module into an object file.

    Args:
        module: The code.
        triple: LLVM's name of the platform, such as "wasm32-unknown-unknown".
        features: LLVM's names of features of its processor, such as "+simd128".
    """
    name = digest_of_parts(*_translator(), "another platform", str(module), triple, features)
    content = read_kept(name)
    if content is None:
        target, code = _cross(module, triple, features=features)
        content = bytes(target.emit_object(code))
        keep(name, content)
    return content


def assembly(module: ir.Module, triple: str, processor: str) -> str:
    """Translate a module into the assembly language of another kind of machine.

    Args:
        module: The code.
        triple: LLVM's name of the platform, such as "nvptx64-nvidia-cuda".
        processor: LLVM's name of the oldest processor to run it, such as "sm_75".
    """
    target, code = _cross(module, triple, processor)
    return target.emit_assembly(code)


def _cross(
    module: ir.Module, triple: str, processor: str = "", features: str = ""
) -> tuple[Any, Any]:
    """Return a target machine of another platform, and the module as optimised code for it."""
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    target = binding.Target.from_triple(triple).create_target_machine(processor, features, opt=3)
    code = binding.parse_assembly(
        _text_for(module, triple, str(target.target_data)), binding.create_context()
    )
    _optimise(code, target)
    return target, code


def _text_for(module: ir.Module, triple: str, data_layout: str) -> str:
    """Return the text of a module for another platform. The module itself remains as it was, so
    that it can still be translated for this processor.
    """
    own_triple = module.triple
    own_data_layout = module.data_layout
    module.triple = triple
    module.data_layout = data_layout
    try:
        return str(module)
    finally:
        module.triple = own_triple
        module.data_layout = own_data_layout


def _optimise(code: Any, target: Any, speed_level: int = 2, *, inlining: bool = True) -> None:
    """Optimise code in place.

    Args:
        code: Module of LLVM.
        target: Machine for which it is.
        speed_level: How hard to optimise, 0 to 3.
        inlining: Whether to optimise the module as a whole, with inlining, or each function for
            itself.
    """
    options = binding.create_pipeline_tuning_options(speed_level=speed_level)
    passes = binding.create_pass_builder(target, options)
    manager = passes.getModulePassManager() if inlining else passes.getFunctionPassManager()
    bodies = [function for function in code.functions if not function.is_declaration]
    try:
        for part in [code] if inlining else bodies:
            manager.run(part, passes)
    finally:
        # An empty method of llvmlite's ObjectRef hides this one, and half a megabyte would stay
        # behind for each module.
        NewPassManager._dispose(manager)
        manager.detach()


def _target(level: int) -> Any:
    """Return a target machine for this processor of a level from 0 to 3, for one engine to own."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=level,
        jit=True,
    )
