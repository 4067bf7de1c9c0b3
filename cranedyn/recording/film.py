"""Films of runs: cranes and their swing over time as an MP4, drawn without a viewer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection

from cranedyn.data.files import atomic_write, with_ending
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import distinct_colours
from cranedyn.recording.contents import Run, colours
from cranedyn.recording.series import joint_label
from cranedyn.recording.shapes import CONTACT, touching_points
from cranedyn.recording.sketch import Projection

WIDTH = 1280
"""Width of a film [pixels]."""

HEIGHT = 720
"""Height of a film [pixels]."""

RATE = 30
"""Pictures per second of a film."""

_DOTS_PER_INCH = 100
"""Resolution of the figure, which scales its text."""

_MARGIN = 2.0
"""Distance of the cranes from the edges of the scene [m]."""

_CLOSE_UP_REACH = 3.0
"""How far a close-up reaches to each side of the load [m]; farther where it swings farther."""

_CLOSE_UP_SHARE = 0.25
"""Largest reach of the close-up over the height of the scene, for small cranes."""

_SWING_STYLES = ("-", "--", ":", "-.")
"""Line styles of the angles that swing, in their order."""

_EXTENT_ROWS = 30
"""Number of rows of a run, about, that show how far a crane goes; to draw all would take long."""


class _Angles(NamedTuple):
    """From where cranes are seen, see `Projection`.

    Attributes:
        turn: Angle towards the tip of the jib [rad].
        rise: Angle above the ground [rad].
    """

    turn: float
    rise: float


_SINGLE_CRANE = _Angles(math.radians(20.0), 0.0)
"""From where a single crane is seen: level, since from above a level jib would seem to droop."""

_SEVERAL_CRANES = _Angles(math.radians(50.0), math.radians(12.0))
"""From where several cranes are seen. They stand beside each other, and would hide each other from
square to their jibs."""


def check_film(path: str | Path) -> Path:
    """Return the path of a film if one can be written there.

    Raises:
        DataError: If the ending is not .mp4.
        CraneError: If the extra film is not installed.
    """
    path = with_ending(path, ".mp4")
    try:
        import av  # noqa: F401
    except ImportError as error:
        message = "Films need the extra film; install it with: pip install 'cranedyn[film]'"
        raise CraneError(message) from error
    return path


def film(
    path: str | Path, runs: Sequence[Run], *, progress: Callable[[float], object] | None = None
) -> Path:
    """Write runs as a film in real time: the cranes beside their swing, with numbers.

    Args:
        path: The ``.mp4`` file.
        runs: One or several, on one clock.
        progress: Called after each picture with its time in the film [s].

    Raises:
        OutOfRange: If there is no run, or one has no rows.
        DataError: If the file cannot be written.
        CraneError: If the extra film is not installed.
    """
    path = check_film(path)
    if not runs or not all(len(run.trajectory) for run in runs):
        raise OutOfRange("rows of each run", [len(run.trajectory) for run in runs], ">= 1")
    import av

    first = min(float(run.trajectory.t[0]) for run in runs)
    last = max(float(run.trajectory.t[-1]) for run in runs)
    with atomic_write(path) as draft, av.open(str(draft), "w", format="mp4") as container:
        stream: Any = container.add_stream("libx264", rate=Fraction(RATE))
        stream.options = {"preset": "veryfast"}
        stream.width = WIDTH
        stream.height = HEIGHT
        stream.pix_fmt = "yuv420p"
        stage = _Stage(runs, first, last)
        # A picture that is late by rounding alone still counts.
        last_picture = math.floor((last - first) * RATE + 1e-6)
        for i in range(last_picture + 1):
            pixels = stage.picture(first + i / RATE)
            picture = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            container.mux(stream.encode(picture))
            if progress is not None:
                progress(i / RATE)
        # Encoders keep pictures back; without a picture they give all.
        container.mux(stream.encode(None))
    return path


class _Stage:
    """A figure of which only the moving parts are drawn again for each picture.

    The rest is drawn once and kept as an image, the background.
    """

    def __init__(self, runs: Sequence[Run], first: float, last: float) -> None:
        """Draw what does not move, and keep it as the background.

        Args:
            runs: The runs.
            first: Time at which the film begins [s].
            last: Time at which it ends [s].
        """
        angles = _SEVERAL_CRANES if len(runs) > 1 else _SINGLE_CRANE
        self._runs = []
        for run in runs:
            projection = Projection(
                run.crane,
                turn=angles.turn,
                rise=angles.rise,
                offset=run.offset,
                heading=run.heading,
                meshes=run.meshes,
            )
            self._runs.append((run, projection))
        figure, axes = panels(
            2,
            2,
            width=WIDTH / _DOTS_PER_INCH,
            height=HEIGHT / _DOTS_PER_INCH / 2.0,
            width_ratios=[5, 4],
        )
        # The scene takes both rows on the left, the close-up is below the swing on the right.
        grid = axes[0].get_gridspec()
        assert grid is not None  # the panels stand on a grid
        axes[0].remove()
        axes[2].remove()
        scene = figure.add_subplot(grid[:, 0])
        swing = axes[1]
        self._close_up = axes[3]
        figure.set_dpi(_DOTS_PER_INCH)
        self._scene = scene
        self._swing = swing
        self._plot_swings()
        # The axis of a run of one row has no end to set.
        end = last if last > first else None
        swing.set(xlabel="t [s]", ylabel="swing [°]", xlim=(first, end))
        figure.legend(*swing.get_legend_handles_labels(), loc="outside lower right", ncols=2)
        scene.set(aspect="equal", xlabel="[m]", ylabel="[m]")

        name = self._runs[0][0].name
        title = "the load" if len(runs) == 1 else f"the load of {name}"
        self._close_up.set(aspect="equal", xlabel="[m]")
        self._close_up.set_title(f"{title}, from where it hangs at rest", fontsize=10.0)

        self._add_cranes()
        self._add_readings(first)
        self._canvas = FigureCanvasAgg(figure)
        self._set_scene_limits()
        self._set_close_up_limits()
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def _add_cranes(self) -> None:
        """Add what moves in the scene: cranes, ropes and marks where loads touch.

        What moves is animated: Matplotlib leaves it out of the background.
        """
        self._cranes = PolyCollection([], animated=True)
        self._scene.add_collection(self._cranes)
        self._ropes = []
        for colour in colours([run for run, _ in self._runs]):
            (rope,) = self._scene.plot(
                [], [], "o-", c="#404040", mfc=colour, markevery=[-1], animated=True
            )
            self._ropes.append(rope)
        (self._marks,) = self._scene.plot([], [], "^", color=CONTACT, animated=True)
        self._near_crane = PolyCollection([], animated=True)
        self._close_up.add_collection(self._near_crane)
        (self._near_rope,) = self._close_up.plot([], [], "-", c="#404040", animated=True)

    def _add_readings(self, first: float) -> None:
        """Add what moves in the plot: the coordinates as text, and a line at the present time.

        Args:
            first: Time at which the film begins [s].
        """
        swing = self._swing
        self._text = swing.text(
            0.02,
            0.98,
            "",
            transform=swing.transAxes,
            family="monospace",
            size=9,
            animated=True,
            va="top",
        )
        # Room for the text above the curves, a line for each run; the cursor ends below it.
        low, high = swing.get_ylim()
        room = 0.15 + 0.05 * len(self._runs)
        swing.set_ylim(low, high + room * (high - low))
        self._cursor = swing.axvline(
            first, ymax=1.0 / (1.0 + room), color="#404040", lw=1.0, animated=True
        )

    def _plot_swings(self) -> None:
        """Plot the angles of the joints that swing: those of a single run in a colour each, those
        of several runs in the colours of the runs and a line style each.
        """
        several = len(self._runs) > 1
        run_colours = colours([run for run, _ in self._runs])
        for (run, _), colour in zip(self._runs, run_colours, strict=True):
            layout = run.crane.layout
            coordinate_colours = distinct_colours(layout.symbols)
            swings = [j for j in layout.joints if not j.driven and j.kind == "revolute"]
            for i, joint in enumerate(swings):
                label = joint_label(joint)
                self._swing.plot(
                    run.trajectory.t,
                    np.degrees(run.trajectory.coordinates(joint.symbol)),
                    color=colour if several else coordinate_colours[joint.symbol],
                    linestyle=_SWING_STYLES[i % len(_SWING_STYLES)],
                    label=f"{label} · {run.name}" if several else label,
                )

    def _set_scene_limits(self) -> None:
        """Set the limits of the scene so that the cranes stay in it."""
        corners = []
        for run, projection in self._runs:
            every = max(1, len(run.trajectory) // _EXTENT_ROWS)
            for q in run.trajectory.q[::every]:
                points = [outline.corners for outline in projection.outlines(q)]
                points.append(projection.rope(q))
                all_points = np.concatenate(points)
                corners.append(all_points.min(axis=0))
                corners.append(all_points.max(axis=0))
        left, bottom = np.min(corners, axis=0) - _MARGIN
        right, top = np.max(corners, axis=0) + _MARGIN
        self._scene.set(xlim=(left, right), ylim=(bottom, top))

    def _set_close_up_limits(self) -> None:
        """Set the limits of the close-up so that the load stays in it."""
        run, projection = self._runs[0]
        every = max(1, len(run.trajectory) // _EXTENT_ROWS)
        largest = 0.0
        for q in run.trajectory.q[::every]:
            offset = projection.rope(q)[-1] - projection.rope(_at_rest(run, q))[-1]
            largest = max(largest, float(np.abs(offset).max()))
        bottom, top = self._scene.get_ylim()
        reach = min(max(_CLOSE_UP_REACH, 1.3 * largest), _CLOSE_UP_SHARE * (top - bottom))
        self._close_up.set(xlim=(-reach, reach), ylim=(-reach, reach))

    def picture(self, t: float) -> np.ndarray:
        """Return the picture at a time [s], red, green, blue, shape (height, width, 3)."""
        outlines = []
        lines = [f"t = {t:.2f} s"]
        # An empty array, so that there is something to concatenate where nothing touches.
        marks = [np.zeros((0, 2))]
        for (run, projection), rope in zip(self._runs, self._ropes, strict=True):
            row = _row_at(run, t)
            q = run.trajectory.q[row]
            outlines += projection.outlines(q)
            rope.set_data(*projection.rope(q).T)
            marks.append(projection.points(touching_points(run.crane, run.trajectory, row)))
            lines.append(f"{run.name}:  " + "  ".join(_readings(run, q)))
        self._set_close_up(t)
        # Cranes hide each other as they stand: the nearest outline is drawn last.
        outlines.sort(key=lambda outline: outline.depth)
        self._cranes.set_verts([outline.corners for outline in outlines])
        self._cranes.set(facecolor=[outline.colour for outline in outlines])
        self._marks.set_data(*np.concatenate(marks).T)
        self._cursor.set_xdata([t, t])
        self._text.set_text("\n".join(lines))
        self._canvas.restore_region(self._background)
        for artist in (self._cranes, *self._ropes, self._marks):
            self._scene.draw_artist(artist)
        for artist in (self._near_crane, self._near_rope):
            self._close_up.draw_artist(artist)
        for artist in (self._cursor, self._text):
            self._swing.draw_artist(artist)
        return np.ascontiguousarray(np.asarray(self._canvas.buffer_rgba())[..., :3])

    def _set_close_up(self, t: float) -> None:
        """Set the load of the first run and its rope about where it would hang with its drives
        where they are.
        """
        run, projection = self._runs[0]
        q = run.trajectory.q[_row_at(run, t)]
        middle = projection.rope(_at_rest(run, q))[-1]
        # Most of a crane is far from its load, and what lies outside would be drawn in vain.
        reach = self._close_up.get_xlim()[1]
        outlines = []
        for outline in projection.outlines(q):
            if outline.extent.reaches(middle, reach):
                outlines.append(outline)
        self._near_crane.set_verts([outline.corners - middle for outline in outlines])
        self._near_crane.set(facecolor=[outline.colour for outline in outlines])
        self._near_rope.set_data(*(projection.rope(q) - middle).T)


def _at_rest(run: Run, q: np.ndarray) -> np.ndarray:
    """Return coordinates with the swing joints where they hang at the start of the crane."""
    at_rest = q.copy()
    swings = run.crane.swings
    at_rest[swings] = run.crane.start.q[swings]
    return at_rest


def _row_at(run: Run, t: float) -> int:
    """Return the last row of a run at or before a time [s], up to rounding."""
    return max(0, int(np.searchsorted(run.trajectory.t, t + 1e-9)) - 1)


def _readings(run: Run, q: np.ndarray) -> list[str]:
    """Return the coordinates of a run with their units, for example "φ 1.5°"."""
    readings = []
    for joint, value in zip(run.crane.layout.joints, q, strict=True):
        if joint.kind == "revolute":
            readings.append(f"{joint_label(joint)} {np.degrees(value):.1f}°")
        else:
            readings.append(f"{joint_label(joint)} {value:.2f} m")
    return readings
