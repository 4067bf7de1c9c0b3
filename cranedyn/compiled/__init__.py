"""Cranes and robots as compiled code: LLVM makes it in this process, through llvmlite, without a C
compiler.

The equations are those of the room `plant`, which compute with any kind of number. Run once on
numbers that stand for values of the code, they leave behind the instructions of one physics step.

Read in this order:

* How code is made: `instructions` (arithmetic), `code` (loops and conditions), `angles` (sine and
  cosine), `machine` (from LLVM's code to machine code), `rows` (a whole function in few lines).
* The closed loop: `memory_layout` (what it reads and writes), `step` (a physics step), `kernel`
  (control instants and steps) with `team` (groups of lanes that take turns), `verify` (its
  comparison with Pinocchio), `binding` (the call from Python).
* Who runs it: `compiled_engine` with `blocks` and `moving_crane` (a run of `simulate`), `batch`
  with `inputs` and `loop_tables` (many cranes at once), `fleet` (many cranes, one command after the
  other), `threads` and `cuda` (GPUs), `load_filter_code` (a state estimator).
* Code for other programs: `block` (a crane or a controller as a function block), `crane_block`,
  `printing` with `c_text`, `c_routines` and `structured_text` (C and Structured Text), and
  `webassembly` (browsers).
* Rooms of their own: `plant` (the equations of a crane) and `horizon` (predictive control).
"""

from cranedyn.errors import CraneError

try:
    import llvmlite as llvmlite
except ModuleNotFoundError as error:
    raise CraneError(
        "The compiled engine needs llvmlite, which is not installed: pip install "
        "'cranedyn[compiled]'."
    ) from error
