"""Compiled functions of numbers, from a text for any kind of number."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.code import INTEGER, Code
from cranedyn.compiled.machine import translate
from cranedyn.dynamics.scalars import array


def compile_rows(
    function: Callable[[np.ndarray], Iterable[Any]], width_in: int, width_out: int, shared: int = 0
) -> RowFunction:
    """Return a function of rows of numbers, compiled.

    Args:
        function: Returns the results for an array of numbers of any kind, see
            `cranedyn.dynamics.scalars`.
        width_in: Length of its array without numbers that rows share.
        width_out: Number of its results.
        shared: Number of these, which stand before those of a row.
    """
    module = ir.Module()
    code = Code(module, "rows", ["given", "count", "answers", "shared"], 1)
    given, answers = code.argument["given"], code.argument["answers"]
    with code.loop(0, code.load_one(code.argument["count"], 0, INTEGER)) as row:
        first = code.product(row, width_in)
        numbers = [code.spread(code.argument["shared"], code.integer(i)) for i in range(shared)]
        numbers += [code.spread(given, code.plus(first, i)) for i in range(width_in)]
        for i, result in enumerate(function(array(numbers))):
            code.store(result, answers, code.plus(code.product(row, width_out), i))
    code.end()
    return RowFunction(translate(module), "rows", width_in, width_out, shared)
