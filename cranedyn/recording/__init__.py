"""Rerun recordings: a crane in 3D beside plots of all its numbers, in one ``.rrd`` file.

Nothing outside of this package imports Rerun. Begin with `record`:

    from cranedyn.recording import Run, open_viewer, record

    record("run.rrd", [Run("hold", crane, run)], title="A run")
    open_viewer("run.rrd")

- `Run`: a crane and its trajectory, with place, colour, mesh folder and `Scenery` of a site.
- `record`: writes one or several runs, on one timeline and with the layout inside.
- `Live`: streams a run that is under way into a file, a viewer, or both.
- `open_viewer`, `serve`: show a recording in a window, or in a browser on this machine alone.
- `view`: records a run and opens it, in one step.
- `cranedyn.recording.film`: films of runs as MP4, without a viewer.
- `cranedyn.recording.snapshot`: pictures and GIFs without a display.
- `cranedyn.recording.postures`: cranes and bodies that move as given, without a simulated crane.
- `cranedyn.recording.sketch`: a crane from the side, as a matplotlib figure.

Modules, in the order to read them: `contents` (runs and their surroundings), `recorder` (what is
written), `scene` (what moves in 3D; `shapes` reads the looks from the URDF), `series` (tables and
plots), `dashboard` (layout and eyes), `viewer` and `process` (windows, pages and their processes).
"""

from cranedyn.recording.contents import Obstacle, Run, Scenery
from cranedyn.recording.recorder import Live, check_enabled, record
from cranedyn.recording.viewer import Server, check_display, check_port, open_viewer, serve, view

__all__ = [
    "Live",
    "Obstacle",
    "Run",
    "Scenery",
    "Server",
    "check_display",
    "check_enabled",
    "check_port",
    "open_viewer",
    "record",
    "serve",
    "view",
]
