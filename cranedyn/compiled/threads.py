"""One crane a thread, with plain doubles: memory access of the threads of a GPU, and the same code
as a loop over the lanes on the processor.

A group of lanes is a warp: the threads that a GPU runs together read and write adjacent numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from llvmlite import ir

from cranedyn.compiled.code import INTEGER, POINTER, Code
from cranedyn.compiled.memory_layout import CALL, SLOTS

WARP = 32
"""Threads that a GPU runs together."""

THREAD = ("run_one", "answer_one")
"""The functions of one thread: the loop, and accelerations at one state."""

GROUP_POINTERS = ("state", "numbers", "starts", "delay", "readings", "log", "summary")
"""Addresses of a call that differ between groups."""

KINDS = {name: kind for kind, names in CALL.items() for name in names}

_INDEX = ir.IntType(32)


def emit_lane_loop(module: ir.Module) -> None:
    """Add to the code of one thread the functions run and answer, which loop over the lanes of a
    group on the processor.
    """
    code = Code(module, "run", ["call"], 1)
    arguments = {
        name: code.load_one(code.argument["call"], SLOTS[name], KINDS[name]) for name in SLOTS
    }
    room = _allocate_call(code.builder)
    with code.loop(0, WARP) as lane:
        _run_one(module, code.builder, room, arguments, dict.fromkeys(GROUP_POINTERS, lane))
    code.end()
    code = Code(module, "answer", ["given", "numbers", "accelerations"], 1)
    with code.loop(0, WARP) as lane:
        _answer_one(module, code.builder, list(code.argument.values()), lane)
    code.end()


def emit_gpu_kernels(module: ir.Module) -> None:
    """Add to the code of one thread the kernels of a GPU: run, with the slots of a call, the
    distances of groups at the moving addresses [numbers], and the number of threads; and answer,
    for one warp.
    """
    kinds = [*(KINDS[name] for name in SLOTS), *[INTEGER] * len(GROUP_POINTERS), INTEGER]
    builder, arguments = _kernel(module, "run", kinds)
    values = dict(zip(SLOTS, arguments, strict=False))
    strides = arguments[len(SLOTS) : -1]
    threads = arguments[-1]
    thread = _thread(module, builder)
    group = builder.lshr(thread, ir.Constant(INTEGER, WARP.bit_length() - 1))
    lane = builder.and_(thread, ir.Constant(INTEGER, WARP - 1))
    offsets = [builder.add(builder.mul(group, stride), lane) for stride in strides]
    room = _allocate_call(builder)
    with builder.if_then(builder.icmp_signed("<", thread, threads)):
        _run_one(module, builder, room, values, dict(zip(GROUP_POINTERS, offsets, strict=True)))
    builder.ret_void()
    builder, arguments = _kernel(module, "answer", [POINTER] * 3)
    _answer_one(module, builder, arguments, _thread(module, builder))
    builder.ret_void()
    for function in module.functions:
        # Inlined code keeps its numbers in registers, called code in memory.
        if function.blocks and function.calling_convention != "ptx_kernel":
            function.linkage = "internal"
            function.attributes.add("alwaysinline")


def _kernel(
    module: ir.Module, name: str, kinds: Sequence[ir.Type]
) -> tuple[ir.IRBuilder, Sequence[ir.Value]]:
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), kinds), name)
    function.calling_convention = "ptx_kernel"
    return ir.IRBuilder(function.append_basic_block()), function.args


def _thread(module: ir.Module, builder: ir.IRBuilder) -> ir.Value:
    """Return the index of a thread among all threads."""

    def special(name: str) -> ir.Value:
        full = f"llvm.nvvm.read.ptx.sreg.{name}.x"
        kind = ir.FunctionType(_INDEX, [])
        function = module.globals.get(full) or ir.Function(module, kind, full)
        return builder.zext(builder.call(function, []), INTEGER)

    return builder.add(builder.mul(special("ctaid"), special("ntid")), special("tid"))


def _allocate_call(builder: ir.IRBuilder) -> ir.Value:
    """Allocate the arguments of one thread; LLVM keeps them in registers."""
    return builder.alloca(ir.LiteralStructType([KINDS[name] for name in SLOTS]))


def _run_one(
    module: ir.Module,
    builder: ir.IRBuilder,
    room: ir.Value,
    values: Mapping[str, ir.Value],
    offsets: Mapping[str, ir.Value],
) -> None:
    for name, value in values.items():
        mine = _shift_address(builder, value, offsets[name]) if name in offsets else value
        index = [ir.Constant(_INDEX, 0), ir.Constant(_INDEX, SLOTS[name])]
        builder.store(mine, builder.gep(room, index))
    builder.call(module.globals[THREAD[0]], [room])


def _answer_one(
    module: ir.Module, builder: ir.IRBuilder, addresses: Sequence[ir.Value], lane: ir.Value
) -> None:
    mine = [_shift_address(builder, address, lane) for address in addresses]
    builder.call(module.globals[THREAD[1]], mine)


def _shift_address(builder: ir.IRBuilder, address: ir.Value, numbers: ir.Value) -> ir.Value:
    return builder.gep(address, [numbers], source_etype=INTEGER)
