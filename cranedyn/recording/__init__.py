"""What a run looks like: Rerun recordings with a finished dashboard. Nothing outside of this folder
imports Rerun.
"""

from cranedyn.recording.live import Live
from cranedyn.recording.record import check_enabled, record
from cranedyn.recording.run import Run
from cranedyn.recording.viewer import Server, check_display, check_port, open_viewer, serve

__all__ = [
    "Live",
    "Run",
    "Server",
    "check_display",
    "check_enabled",
    "check_port",
    "open_viewer",
    "record",
    "serve",
]
