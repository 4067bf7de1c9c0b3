"""Compiled functions of numbers, from Python functions for any kind of number.

The function runs once, with values of the code in place of numbers, see
`cranedyn.compiled.instructions`. A loop around what it leaves behind makes it a function of arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.compiled.binding import COLUMN_LANES, ColumnFunction, RowFunction
from cranedyn.compiled.code import INTEGER, POINTER, Code
from cranedyn.compiled.machine import translate
from cranedyn.dynamics.scalars import array


def compile_rows(
    function: Callable[[np.ndarray], Iterable[Any]], width_in: int, width_out: int, shared: int = 0
) -> RowFunction:
    """Return a compiled function that maps each row of an array to a row of results.

    Args:
        function: Function that returns the results for an array of numbers of any kind, see
            `cranedyn.dynamics.scalars`: first the numbers that all rows share, then those of a row.
        width_in: Length of a row.
        width_out: Number of results.
        shared: Number of numbers that all rows share.
    """
    module = ir.Module()
    code = Code(module, "rows", ["inputs", "count", "results", "shared"], 1)
    inputs = code.argument["inputs"]
    outputs = code.argument["results"]
    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        first = code.product(row, width_in)
        numbers = [code.spread(code.argument["shared"], code.integer(i)) for i in range(shared)]
        numbers += [code.spread(inputs, code.plus(first, i)) for i in range(width_in)]
        for i, result in enumerate(function(array(numbers))):
            code.store(result, outputs, code.plus(code.product(row, width_out), i))
    code.end()
    return RowFunction(translate(module), "rows", width_in, width_out, shared)


def compile_columns(
    function: Callable[..., Iterable[Any]], widths: Sequence[int], width_out: int
) -> ColumnFunction:
    """Return a compiled function that maps each column of some arrays to a column of results, and
    rounds as NumPy does.

    Args:
        function: Function that returns the results for a column. Its first argument makes a value
            of the code from a float, such as a divisor: by a float itself the code would not divide
            but multiply by its reciprocal. Its second is an array of the numbers of the column,
            those of the first array before those of the next, see `cranedyn.dynamics.scalars`.
        widths: Number of rows of each array.
        width_out: Number of results.
    """
    module = ir.Module()
    width_in = sum(widths)
    for lanes in COLUMN_LANES:
        code = Code(module, f"columns_{lanes}", ["call"], lanes)
        call = code.argument["call"]
        # A call is the first group of columns, the one after the last, and the address of each row.
        first = code.load_one(call, 0, INTEGER)
        last = code.load_one(call, 1, INTEGER)
        rows = [code.load_one(call, 2 + i, POINTER) for i in range(width_in + width_out)]
        with code.loop(first, last) as group, code.as_written():
            column = code.product(group, lanes)
            numbers = array([code.load(row, column) for row in rows[:width_in]])
            for row, result in zip(rows[width_in:], function(code.value, numbers), strict=True):
                code.store(result, row, column)
        code.end()
    return ColumnFunction(translate(module), [*widths, width_out])
