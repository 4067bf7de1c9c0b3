"""Code in which each crane has a thread of its own, with plain doubles, as on a GPU.

The loop of `cranedyn.compiled.kernel` is made for one thread: `RUN_THREAD` runs it, and
`ACCELERATE_THREAD` computes accelerations at one state. This module adds the functions that call
them, and that give each thread the addresses of its own crane:

* `emit_gpu_kernels`: the kernels of a GPU, which run one thread for each crane.
* `emit_lane_loop`: functions with the same names and arguments as those of vector code, which run
  the threads of a group one after another on the processor. The code is compared with Pinocchio
  through them before a GPU is asked for anything, and tests need no GPU.

A group of lanes is a *warp*: the threads that a GPU runs together. Number k of lane i of a group
stands at k `WARP` + i, so that the threads of a warp read and write adjacent numbers in one access.
To find its own numbers, a thread shifts the addresses of its group by its lane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from llvmlite import ir

from cranedyn.compiled.code import INTEGER, POINTER, Code
from cranedyn.compiled.memory_layout import GROUP_POINTERS, SLOT_TYPES, SLOTS

WARP = 32
"""Threads that a GPU runs together; a power of two."""

RUN_THREAD = "run_thread"
"""Name of the function that runs the loop of one thread, given the address of its call."""

ACCELERATE_THREAD = "accelerate_thread"
"""Name of the function that computes the accelerations of one thread."""

_INT32 = ir.IntType(32)


def emit_lane_loop(module: ir.Module) -> None:
    """Add the functions `run` and `accelerate` for the processor to the code of one thread.

    They take the arguments of vector code, for a group of `WARP` lanes, and loop over the lanes.
    """
    code = Code(module, "run", ["call"], 1)
    call_of_group = {}
    for name, slot in SLOTS.items():
        call_of_group[name] = code.load_one(code.argument["call"], slot, SLOT_TYPES[name])
    call_of_thread = _allocate_call(code.builder)
    with code.loop(0, WARP) as lane:
        offsets = dict.fromkeys(GROUP_POINTERS, lane)
        _run_thread(module, code.builder, call_of_thread, call_of_group, offsets)
    code.end()

    code = Code(module, "accelerate", ["query", "numbers", "accelerations"], 1)
    with code.loop(0, WARP) as lane:
        _accelerate_thread(module, code.builder, list(code.argument.values()), lane)
    code.end()


def emit_gpu_kernels(module: ir.Module) -> None:
    """Add the kernels `run` and `accelerate` of a GPU to the code of one thread.

    The arguments of `run` are the slots of a call, with the addresses of the first group; then, for
    each of `GROUP_POINTERS`, the distance from a group to the next [numbers]; and the number of
    threads. `accelerate` runs one warp.
    """
    _emit_run_kernel(module)
    builder, addresses = _begin_kernel(module, "accelerate", [POINTER] * 3)
    _accelerate_thread(module, builder, addresses, _thread_index(module, builder))
    builder.ret_void()

    for function in module.functions:
        # Called functions would keep their numbers in memory. Inlined into a kernel, which alone
        # can be called from outside, they keep them in registers.
        if function.blocks and function.calling_convention != "ptx_kernel":
            function.linkage = "internal"
            function.attributes.add("alwaysinline")


def _emit_run_kernel(module: ir.Module) -> None:
    """Emit the kernel `run`, see `emit_gpu_kernels`."""
    slot_types = [SLOT_TYPES[name] for name in SLOTS]
    stride_types = [INTEGER] * len(GROUP_POINTERS)
    builder, arguments = _begin_kernel(module, "run", [*slot_types, *stride_types, INTEGER])
    call_of_first_group = dict(zip(SLOTS, arguments[: len(SLOTS)], strict=True))
    strides = arguments[len(SLOTS) : -1]
    thread_count = arguments[-1]

    # WARP is a power of two: the upper bits of the index are the group, the lower ones the lane.
    thread = _thread_index(module, builder)
    group = builder.lshr(thread, ir.Constant(INTEGER, WARP.bit_length() - 1))
    lane = builder.and_(thread, ir.Constant(INTEGER, WARP - 1))
    offsets = {}
    for name, stride in zip(GROUP_POINTERS, strides, strict=True):
        offsets[name] = builder.add(builder.mul(group, stride), lane)

    call_of_thread = _allocate_call(builder)
    # A GPU starts whole blocks of threads, the last of which may have more than there are cranes.
    with builder.if_then(builder.icmp_signed("<", thread, thread_count)):
        _run_thread(module, builder, call_of_thread, call_of_first_group, offsets)
    builder.ret_void()


def _begin_kernel(
    module: ir.Module, name: str, argument_types: Sequence[ir.Type]
) -> tuple[ir.IRBuilder, Sequence[ir.Value]]:
    """Begin a function that is called from outside of the GPU; return its builder and arguments."""
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), argument_types), name)
    function.calling_convention = "ptx_kernel"
    return ir.IRBuilder(function.append_basic_block()), function.args


def _thread_index(module: ir.Module, builder: ir.IRBuilder) -> ir.Value:
    """Return the index of a thread among all threads: block index · block size + index in block."""
    block_index = _special_register(module, builder, "ctaid")
    block_size = _special_register(module, builder, "ntid")
    first_of_block = builder.mul(block_index, block_size)
    return builder.add(first_of_block, _special_register(module, builder, "tid"))


def _special_register(module: ir.Module, builder: ir.IRBuilder, name: str) -> ir.Value:
    """Return the first component of a special register of PTX, such as "tid", as a whole number.

    Source: NVIDIA, Parallel Thread Execution ISA, on special registers.
    """
    intrinsic = f"llvm.nvvm.read.ptx.sreg.{name}.x"
    function_type = ir.FunctionType(_INT32, [])
    function = module.globals.get(intrinsic) or ir.Function(module, function_type, intrinsic)
    return builder.zext(builder.call(function, []), INTEGER)


def _allocate_call(builder: ir.IRBuilder) -> ir.Value:
    """Allocate the slots of the call of one thread on the stack, and return their address.

    Once `RUN_THREAD` is inlined, LLVM keeps them in registers.
    """
    return builder.alloca(ir.LiteralStructType([SLOT_TYPES[name] for name in SLOTS]))


def _run_thread(
    module: ir.Module,
    builder: ir.IRBuilder,
    call_of_thread: ir.Value,
    call_of_group: Mapping[str, ir.Value],
    offsets: Mapping[str, ir.Value],
) -> None:
    """Emit the call of `RUN_THREAD` for one thread.

    Args:
        module: Module of the function.
        builder: Builder at the place of the call.
        call_of_thread: Address of the slots that the function reads, which are written here.
        call_of_group: What the slots of its group hold, by name.
        offsets: Distance from the memory of the group to that of the thread [numbers], by the name
            of the slot; slots without one are the same for all threads.
    """
    for name, value in call_of_group.items():
        if name in offsets:
            value = _shift_address(builder, value, offsets[name])
        index = [ir.Constant(_INT32, 0), ir.Constant(_INT32, SLOTS[name])]
        builder.store(value, builder.gep(call_of_thread, index))
    builder.call(module.globals[RUN_THREAD], [call_of_thread])


def _accelerate_thread(
    module: ir.Module, builder: ir.IRBuilder, addresses: Sequence[ir.Value], lane: ir.Value
) -> None:
    """Emit the call of `ACCELERATE_THREAD` for one lane, given the addresses of its group."""
    addresses_of_lane = [_shift_address(builder, address, lane) for address in addresses]
    builder.call(module.globals[ACCELERATE_THREAD], addresses_of_lane)


def _shift_address(builder: ir.IRBuilder, address: ir.Value, numbers: ir.Value) -> ir.Value:
    """Return the address so many numbers of eight bytes further on."""
    return builder.gep(address, [numbers], source_etype=INTEGER)
