"""Cranes and robots as compiled code: LLVM makes it in this process, through llvmlite, without a C
compiler.
"""

from cranedyn.errors import CraneError

try:
    import llvmlite as llvmlite
except ModuleNotFoundError as error:
    raise CraneError(
        "The compiled engine needs llvmlite, which is not installed: pip install "
        "'cranedyn[compiled]'."
    ) from error
