"""The harness of all experiments: command line, setup, progress, tables, claims and files.

Begin with `run_experiment`, which runs an experiment from the command line, and with `Outcome`,
what an experiment returns.
"""

from cranedyn.errors import CraneError
from experiments.harness.arguments import add_condition, add_mode, parser
from experiments.harness.outcome import Claim, Outcome, side_by_side
from experiments.harness.progress import ProgressReporter
from experiments.harness.recorded import add_files, add_sources, analyse_files, swept_columns
from experiments.harness.run import run_experiment
from experiments.harness.setup import PlannedRun, Setup, add_setup
from experiments.harness.table import Column, ResultTable, finite_or_none, make_table

__all__ = [
    "Claim",
    "Column",
    "CraneError",
    "Outcome",
    "PlannedRun",
    "ProgressReporter",
    "ResultTable",
    "Setup",
    "add_condition",
    "add_files",
    "add_mode",
    "add_setup",
    "add_sources",
    "analyse_files",
    "finite_or_none",
    "make_table",
    "parser",
    "run_experiment",
    "side_by_side",
    "swept_columns",
]
