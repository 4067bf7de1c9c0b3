"""How every experiment runs: arguments, setup, progress, outcome, files."""

from cranedyn.command import FAILED, INTERRUPTED, REFUSED
from cranedyn.errors import CraneError
from experiments.harness.arguments import add_mode, parser
from experiments.harness.conduct import conduct
from experiments.harness.outcome import MARKS, Claim, Outcome, Table
from experiments.harness.setup import (
    ProgressReporter,
    Setup,
    add_files,
    add_setup,
    analysing,
    recorded,
)

__all__ = [
    "FAILED",
    "INTERRUPTED",
    "MARKS",
    "REFUSED",
    "Claim",
    "CraneError",
    "Outcome",
    "ProgressReporter",
    "Setup",
    "Table",
    "add_files",
    "add_mode",
    "add_setup",
    "analysing",
    "conduct",
    "parser",
    "recorded",
]
