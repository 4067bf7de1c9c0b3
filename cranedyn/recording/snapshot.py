"""Pictures of a recording, still and moving, by a viewer without a window."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageOps
from rerun.experimental import ViewerClient

from cranedyn.checks import number
from cranedyn.data.files import atomic_write, check_writable, make_folder, with_ending
from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.recording.contents import SCENE, TIMELINE
from cranedyn.recording.process import end, free_port, start
from cranedyn.recording.viewer import check_recording, data_address


class Size(NamedTuple):
    """A size of pictures or parts of them.

    Attributes:
        width: Width [pixels].
        height: Height [pixels].
    """

    width: int
    height: int


_DASHBOARD_BARS = Size(0, 36)
"""Size of the viewer's own bars where it shows the dashboard: one on top."""

_VIEW_BARS = Size(7, 71)
"""Size of the viewer's own bars and frames where it shows a single view."""

_LOAD_SECONDS = 60.0
"""Longest wait for the viewer to load a recording [s]."""

_POLLING_PERIOD = 0.1
"""Time between two looks at whether it has loaded [s]."""

_MAX_PIXELS = 5e8
"""Largest number of pixels of a GIF, all its pictures together: all are in memory at the end."""

_GIF_COLOURS = 128
"""Number of colours of a GIF."""

_SETTLING_PICTURES = 20
"""Largest number of pictures that are taken until two are the same."""

_DRIVER = (
    "It needs a graphics driver with Vulkan; where there is no graphics card, install "
    "Debian's mesa-vulkan-drivers."
)
"""Advice where the viewer fails."""

Progress = Callable[[int], object]
"""Callback with the number of pictures so far."""


def snapshot(
    recording: str | Path,
    times: Sequence[float],
    folder: str | Path,
    *,
    size: tuple[int, int] = (1280, 720),
    dashboard: bool = True,
    progress: Progress | None = None,
) -> list[Path]:
    """Write a PNG for each time, named after the recording and the time.

    Args:
        recording: The ``.rrd`` file.
        times: Times of the pictures [s].
        folder: Folder of the pictures, made with the first of them.
        size: Width and height [pixels], 200 to 4000.
        dashboard: Whether to show the dashboard or the scene alone.
        progress: Called after each picture.

    Returns:
        The pictures.

    Raises:
        OutOfRange: For a time outside of the recording, two times with the same name, or a size
            that is not allowed.
        DataError: If the recording cannot be read or a picture cannot be written.
        CraneError: If there is no viewer, or no driver for it.
    """
    names = [f"{Path(recording).stem}-{t:g}s.png" for t in times]
    if len(set(names)) < len(names):
        raise OutOfRange("times", list(times), "each time once, as far as six digits tell", "s")
    paths = [Path(folder) / name for name in names]
    picture_size = _check_size(size)
    with _pictures(Path(recording), times, picture_size, dashboard) as pictures:
        for i, (path, picture) in enumerate(zip(paths, pictures, strict=True)):
            make_folder(path.parent)
            _write(path, picture, "PNG")
            if progress is not None:
                progress(i + 1)
    return paths


def animate(
    recording: str | Path,
    span: tuple[float, float],
    path: str | Path,
    *,
    fps: float = 10.0,
    size: tuple[int, int] = (640, 480),
    dashboard: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a GIF of a span of time in real time.

    Args:
        recording: The ``.rrd`` file.
        span: First and last time [s].
        path: The ``.gif`` file.
        fps: Pictures per second, 1 to 50. A GIF counts in hundredths of a second: at 30 pictures
            per second some stay for 0.03 s and some for 0.04 s.
        size: Width and height [pixels], 200 to 4000.
        dashboard: Whether to show the dashboard or the scene alone.
        progress: Called after each picture.

    Raises:
        OutOfRange: For a span that is empty or outside of the recording, a rate or a size that is
            not allowed, or too many pictures.
        DataError: If the recording cannot be read or the GIF cannot be written.
        CraneError: If there is no viewer, or no driver for it.
    """
    path = with_ending(path, ".gif")
    picture_size = _check_size(size)
    times, durations = _frame_times(span, fps, picture_size)
    check_writable(path)
    frames: list[Image.Image] = []
    with _pictures(Path(recording), times.tolist(), picture_size, dashboard) as pictures:
        for picture in pictures:
            if not frames:
                frames.append(picture.quantize(_GIF_COLOURS))
            else:
                # All pictures have the colours of the first, without dithering: else what stands
                # still would flicker.
                frames.append(
                    picture.quantize(_GIF_COLOURS, palette=frames[0], dither=Image.Dither.NONE)
                )
            if progress is not None:
                progress(len(frames))
    _write(
        path,
        frames[0],
        "GIF",
        duration=durations,
        save_all=True,
        append_images=frames[1:],
        loop=0,
    )
    return path


def _frame_times(
    span: tuple[float, float], fps: float, size: tuple[int, int]
) -> tuple[np.ndarray, list[int]]:
    """Return the times [s] of the pictures of a GIF and how long each is shown [ms].

    Args:
        span: First and last time [s].
        fps: Pictures per second.
        size: Width and height of a picture [pixels].

    Raises:
        OutOfRange: As `animate`.
    """
    rate = number("pictures per second", fps, "1/s", "1 to 50")
    start = number("start of the span", span[0], "s")
    end = number("end of the span", span[1], "s")
    if not end - start >= (1.0 - 1e-9) / rate:
        allowed = f"{1 / rate:g} s or more from start to end, the time of one picture"
        raise OutOfRange("span", f"{start:g} to {end:g}", allowed, "s")
    width, height = size
    # A float, since the product may overflow to infinity.
    count = np.floor((end - start) * rate + 1e-9) + 1.0
    if count * width * height > _MAX_PIXELS:
        allowed = f"{_MAX_PIXELS // (width * height):.0f} or fewer of {width} x {height} pixels"
        raise OutOfRange("number of pictures", f"{count:.0f}", allowed)
    times = np.linspace(start, end, int(count))
    # A GIF counts in hundredths of a second. The ends of the pictures are rounded to them, and not
    # how long each is shown, so that the errors do not add up.
    ends = np.append(times - start, end - start + 1.0 / rate)
    ends_in_hundredths = np.round(100 * ends)
    durations = 10 * np.diff(ends_in_hundredths).astype(int)
    return times, durations.tolist()


@contextmanager
def _pictures(
    recording: Path, times: Sequence[float], size: Size, dashboard: bool
) -> Iterator[Iterator[Image.Image]]:
    """Open a recording in a viewer without a window and yield its pictures, one by one.

    `ViewerClient.spawn` could start the viewer, too, but has neither a size of the window nor an
    interface to listen on, see also `cranedyn.recording.process`.

    Args:
        recording: The ``.rrd`` file.
        times: Times of the pictures [s].
        size: Size of the pictures.
        dashboard: Whether to show the dashboard or the scene alone.

    Raises:
        OutOfRange: If a time is outside of the recording.
        DataError: If the recording cannot be read.
        CraneError: If there is no viewer, or it fails.
    """
    for t in times:
        number("time of a picture", t, "s")
    path = check_recording(recording)
    port = free_port()
    bars = _DASHBOARD_BARS if dashboard else _VIEW_BARS
    window_size = f"{size.width + bars.width}x{size.height + bars.height}"
    window = ["--headless", "--hide-welcome-screen", "--window-size", window_size]
    renderer = ["--renderer", "vulkan"] if sys.platform == "linux" else []
    process = start(*window, *renderer, "--port", str(port), ports=[port], hint=_DRIVER)
    try:
        client = ViewerClient.connect(data_address(port))
        first, last = _open(client, path)
        for t in times:
            number("time of a picture", t, "s", f"{first:g} to {last:g}")
        view = None if dashboard else _maximise_scene(client)

        def picture(t: float) -> bytes:
            client.set_time(TIMELINE, duration=t, play_state="paused")
            return client.take_screenshot(view)

        _await_steady(lambda: picture(first))
        yield (_crop(picture(t), size, dashboard) for t in times)
    except (RuntimeError, ConnectionError) as error:
        raise CraneError(f"Rerun's viewer failed: {error}. {_DRIVER}") from error
    finally:
        end(process)


def _open(client: ViewerClient, path: Path) -> tuple[float, float]:
    """Open a recording and return its first and last time [s]."""
    client.open(str(path.resolve()))
    deadline = time.monotonic() + _LOAD_SECONDS
    while client.get_state().loading and time.monotonic() < deadline:
        time.sleep(_POLLING_PERIOD)
    for recording in client.get_state().recordings:
        for timeline in recording.timelines:
            start, end = timeline.start, timeline.end
            if timeline.name == TIMELINE and start is not None and end is not None:
                # The viewer counts in nanoseconds.
                return start / 1e9, end / 1e9
    raise DataError(f"{path} holds nothing on the timeline {TIMELINE}.")


def _maximise_scene(client: ViewerClient) -> str:
    """Show the scene alone and return the id of its view."""
    views = [view for view in client.get_state().views if view.view_class == "3D"]
    if not views:
        raise CraneError(
            "The recording has no 3D view to take a picture of; allowed are recordings of cranes, "
            "as experiments and cranedyn.recording.recorder write them."
        )
    # The scene, or the first view of a recording that has none of that name.
    scene = views[0].view_id
    for view in views:
        if view.name == SCENE:
            scene = view.view_id
            break
    layout = client.get_blueprint().blueprint
    layout["/viewport"]["ViewportBlueprint"]["maximized"] = scene
    layout["/time_panel"] = {"TimePanelBlueprint": {"state": "Hidden"}}
    client.set_blueprint(layout, of="recording")
    return scene


def _await_steady(picture: Callable[[], bytes]) -> None:
    """Take pictures until two are the same: the viewer's messages at its start fade slowly."""
    before = b""
    now = picture()
    for _ in range(_SETTLING_PICTURES):
        if now == before:
            return
        before = now
        now = picture()


def _check_size(size: tuple[int, int]) -> Size:
    """Return the size of a picture.

    Raises:
        OutOfRange: If it is not allowed.
    """
    width, height = size
    for name, pixels in (("width", width), ("height", height)):
        number(f"{name} of the picture", pixels, "pixels", "200 to 4000")
    return Size(int(width), int(height))


def _crop(png: bytes, size: Size, dashboard: bool) -> Image.Image:
    """Return a picture in its size, of the dashboard without the viewer's bar on top."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    if dashboard:
        image = image.crop((0, image.height - size.height, image.width, image.height))
    if image.size != size:
        # The viewer's bars have another size on this machine.
        image = ImageOps.fit(image, size)
    return image


def _write(path: Path, picture: Image.Image, kind: str, **options: Any) -> None:
    """Write a picture in a format of PIL, with the options of its ``save``.

    It goes through memory, because PIL leaves a file open when Ctrl-C comes while it writes.
    """
    content = io.BytesIO()
    picture.save(content, kind, **options)
    with atomic_write(path) as draft:
        draft.write_bytes(content.getvalue())
