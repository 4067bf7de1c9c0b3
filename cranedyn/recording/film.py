"""Films of runs: cranes and their swing over time as an MP4, drawn without a viewer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.transforms import Affine2D

from cranedyn.data.files import atomic_write, with_ending
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.plotting.figures import panels
from cranedyn.plotting.style import distinct_colours
from cranedyn.recording.contents import Run, colours
from cranedyn.recording.lettering import Lettering
from cranedyn.recording.series import joint_label
from cranedyn.recording.shapes import CONTACT, touching_points
from cranedyn.recording.sketch import Outline, Projection

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

_READINGS_PLACE = (0.02, 0.98)
"""Upper left corner of the coordinates as text, as shares of the plot of the swing."""

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
        for i in range(stage.pictures):
            # The encoder takes all four channels: to drop one here would take longer.
            picture = av.VideoFrame.from_numpy_buffer(stage.picture(i), format="rgba")
            container.mux(stream.encode(picture))
            if progress is not None:
                progress(i / RATE)
        # Encoders keep pictures back; without a picture they give all.
        container.mux(stream.encode(None))
    return path


class _FilmedRun:
    """A run with what its pictures need, worked out for all of them at once.

    Attributes:
        run: The run.
        projection: The view of its crane.
        rows: Row of the run that each picture shows, shape (pictures,).
        ropes: Points of the rope in each picture [m], shape (pictures, points, 2).
    """

    def __init__(self, run: Run, angles: _Angles, times: np.ndarray) -> None:
        """Prepare a run.

        Args:
            run: The run.
            angles: From where its crane is seen.
            times: Times of the pictures [s], shape (pictures,).
        """
        self.run = run
        self.projection = Projection(
            run.crane,
            turn=angles.turn,
            rise=angles.rise,
            offset=run.offset,
            heading=run.heading,
            meshes=run.meshes,
        )
        # The last row at or before each time, up to rounding; the first where there is none.
        after = np.searchsorted(run.trajectory.t, times + 1e-9)
        self.rows = np.maximum(after - 1, 0)
        self.ropes = self.projection.ropes(run.trajectory.q[self.rows])

    def loads_at_rest(self) -> np.ndarray:
        """Return where the load would hang in each picture with its drives where they are [m],
        shape (pictures, 2).
        """
        return self.projection.ropes(self._at_rest(self.run.trajectory.q[self.rows]))[:, -1]

    def sampled(self) -> np.ndarray:
        """Return coordinates of about `_EXTENT_ROWS` rows, shape (rows, n)."""
        every = max(1, len(self.run.trajectory) // _EXTENT_ROWS)
        return self.run.trajectory.q[::every]

    def largest_offset(self) -> float:
        """Return how far the load goes from where it hangs at rest, up or across [m]."""
        q = self.sampled()
        loads = self.projection.ropes(q)[:, -1]
        at_rest = self.projection.ropes(self._at_rest(q))[:, -1]
        return float(np.abs(loads - at_rest).max())

    def _at_rest(self, q: np.ndarray) -> np.ndarray:
        """Return coordinates, shape (rows, n), with the swing joints where they hang at the start
        of the crane.
        """
        at_rest = q.copy()
        swings = self.run.crane.swings
        at_rest[:, swings] = self.run.crane.start.q[swings]
        return at_rest


class _Stage:
    """A figure of which only the moving parts are drawn again for each picture.

    The rest is drawn once and kept as an image, the background.

    Attributes:
        pictures: Number of pictures.
    """

    def __init__(self, runs: Sequence[Run], first: float, last: float) -> None:
        """Draw what does not move, and keep it as the background.

        Args:
            runs: The runs.
            first: Time at which the film begins [s].
            last: Time at which it ends [s].
        """
        angles = _SEVERAL_CRANES if len(runs) > 1 else _SINGLE_CRANE
        # A picture that is late by rounding alone still counts.
        self.pictures = math.floor((last - first) * RATE + 1e-6) + 1
        self._times = first + np.arange(self.pictures) / RATE
        self._runs = [_FilmedRun(run, angles, self._times) for run in runs]
        self._loads_at_rest = self._runs[0].loads_at_rest()
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

        name = runs[0].name
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
        self._lettering = Lettering(family="monospace", size=9.0, dots_per_inch=_DOTS_PER_INCH)
        left, above = swing.transAxes.transform(_READINGS_PLACE)
        self._text_left = round(left)
        self._text_top = round(HEIGHT - above)

    def _add_cranes(self) -> None:
        """Add what moves in the scene: cranes, ropes and marks where loads touch.

        What moves is animated: Matplotlib leaves it out of the background.
        """
        self._cranes = PathCollection([], animated=True)
        self._scene.add_collection(self._cranes)
        self._ropes = []
        for colour in colours([filmed.run for filmed in self._runs]):
            (rope,) = self._scene.plot(
                [], [], "o-", c="#404040", mfc=colour, markevery=[-1], animated=True
            )
            self._ropes.append(rope)
        (self._marks,) = self._scene.plot([], [], "^", color=CONTACT, animated=True)
        self._near_crane = PathCollection([], animated=True)
        self._close_up.add_collection(self._near_crane)
        (self._near_rope,) = self._close_up.plot([], [], "-", c="#404040", animated=True)

    def _add_readings(self, first: float) -> None:
        """Add what moves in the plot, a line at the present time, and make room for the readings.

        Args:
            first: Time at which the film begins [s].
        """
        swing = self._swing
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
        run_colours = colours([filmed.run for filmed in self._runs])
        for filmed, colour in zip(self._runs, run_colours, strict=True):
            run = filmed.run
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
        for filmed in self._runs:
            q = filmed.sampled()
            corners += list(filmed.projection.ropes(q).reshape(-1, 2))
            for row in q:
                for outline in filmed.projection.outlines(row):
                    extent = outline.extent
                    corners.append(np.array([extent.left, extent.bottom]))
                    corners.append(np.array([extent.right, extent.top]))
        left, bottom = np.min(corners, axis=0) - _MARGIN
        right, top = np.max(corners, axis=0) + _MARGIN
        self._scene.set(xlim=(left, right), ylim=(bottom, top))

    def _set_close_up_limits(self) -> None:
        """Set the limits of the close-up so that the load stays in it."""
        largest = self._runs[0].largest_offset()
        bottom, top = self._scene.get_ylim()
        reach = min(max(_CLOSE_UP_REACH, 1.3 * largest), _CLOSE_UP_SHARE * (top - bottom))
        self._close_up.set(xlim=(-reach, reach), ylim=(-reach, reach))

    def picture(self, i: int) -> np.ndarray:
        """Return a picture: red, green, blue and opacity, shape (height, width, 4).

        Args:
            i: Its number, from 0 on.
        """
        t = float(self._times[i])
        outlines = []
        lines = [f"t = {t:.2f} s"]
        # An empty array, so that there is something to concatenate where nothing touches.
        marks = [np.zeros((0, 2))]
        for filmed, rope in zip(self._runs, self._ropes, strict=True):
            run = filmed.run
            row = int(filmed.rows[i])
            q = run.trajectory.q[row]
            outlines.append(filmed.projection.outlines(q))
            rope.set_data(*filmed.ropes[i].T)
            touching = touching_points(run.crane, run.trajectory, row)
            marks.append(filmed.projection.points(touching))
            lines.append(f"{run.name}:  " + "  ".join(_readings(run, q)))
        self._set_close_up(i, outlines[0])
        # Cranes hide each other as they stand: the nearest outline is drawn last.
        all_outlines = sorted(itertools.chain(*outlines), key=lambda outline: outline.depth)
        _set_outlines(self._cranes, all_outlines)
        self._marks.set_data(*np.concatenate(marks).T)
        self._cursor.set_xdata([t, t])
        self._canvas.restore_region(self._background)
        for artist in (self._cranes, *self._ropes, self._marks):
            self._scene.draw_artist(artist)
        for artist in (self._near_crane, self._near_rope):
            self._close_up.draw_artist(artist)
        self._swing.draw_artist(self._cursor)
        # A copy, since the canvas keeps its pixels to draw the next picture on them.
        pixels = np.array(self._canvas.buffer_rgba())
        self._lettering.write(pixels, self._text_left, self._text_top, "\n".join(lines))
        return pixels

    def _set_close_up(self, i: int, outlines: Sequence[Outline]) -> None:
        """Set the load of the first run and its rope about where it would hang with its drives
        where they are.

        Args:
            i: Number of the picture.
            outlines: Outlines of the crane.
        """
        middle = self._loads_at_rest[i]
        # Most of a crane is far from its load, and what lies outside would be drawn in vain.
        reach = self._close_up.get_xlim()[1]
        near = [outline for outline in outlines if outline.extent.reaches(middle, reach)]
        _set_outlines(self._near_crane, near)
        to_middle = Affine2D().translate(*-middle)
        self._near_crane.set_transform(to_middle + self._close_up.transData)
        self._near_rope.set_data(*(self._runs[0].ropes[i] - middle).T)


def _set_outlines(collection: PathCollection, outlines: Sequence[Outline]) -> None:
    """Make a collection draw outlines, the last one in front."""
    collection.set_paths([outline.path for outline in outlines])
    # Matplotlib checks the numbers of an array at once, those of a list one by one.
    facecolours = np.array([outline.colour for outline in outlines]).reshape(len(outlines), 4)
    collection.set(facecolor=facecolours)


def _readings(run: Run, q: np.ndarray) -> list[str]:
    """Return the coordinates of a run with their units, for example "φ 1.5°"."""
    readings = []
    for joint, value in zip(run.crane.layout.joints, q, strict=True):
        if joint.kind == "revolute":
            readings.append(f"{joint_label(joint)} {np.degrees(value):.1f}°")
        else:
            readings.append(f"{joint_label(joint)} {value:.2f} m")
    return readings
