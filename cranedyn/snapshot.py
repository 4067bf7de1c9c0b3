"""Pictures of a recording at chosen times, and moving ones, without a display."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from cranedyn.errors import DataError, OutOfRange, number
from cranedyn.files import written
from cranedyn.recording.headless import headless

Progress = Callable[[int], object]
"""Told after each picture how many are done."""


def snapshot(
    recording: str | Path,
    times: Sequence[float],
    folder: str | Path,
    *,
    size: tuple[int, int] = (1280, 720),
    whole: bool = True,
    progress: Progress | None = None,
) -> list[Path]:
    """Write one PNG for each time, named after the recording and the time.

    Args:
        recording: The ``.rrd`` file.
        times: When [s].
        folder: Where to; it must exist.
        size: Width and height [pixels].
        whole: The dashboard, or the scene alone.
        progress: Told how many pictures are done.

    Raises:
        OutOfRange: For a time outside of the recording or a size that is not allowed.
        DataError: If the recording cannot be read or a picture cannot be written.
        CraneError: If there is no viewer, or no driver for it.
    """
    recording, found = Path(recording), []
    with _pictures(recording, times, size, whole) as pictures:
        for t, picture in zip(times, pictures, strict=True):
            path = Path(folder, f"{recording.stem}-{t:g}s.png")
            with written(path) as draft:
                picture.save(draft, "PNG")
            found.append(path)
            if progress is not None:
                progress(len(found))
    return found


def animate(
    recording: str | Path,
    span: tuple[float, float],
    path: str | Path,
    *,
    fps: float = 10.0,
    size: tuple[int, int] = (640, 480),
    whole: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a GIF of a span of time at the speed at which it happened.

    Args:
        recording: The ``.rrd`` file.
        span: From when to when [s].
        path: The ``.gif`` file.
        fps: Pictures per second; a GIF counts in hundredths of a second.
        size: Width and height [pixels].
        whole: The dashboard, or the scene alone.
        progress: Told how many pictures are done.

    Raises:
        OutOfRange: For a span that is empty or outside of the recording, a rate or a size that is not allowed.
        DataError: If the recording cannot be read or the GIF cannot be written.
        CraneError: If there is no viewer, or no driver for it.
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise DataError(f"Cannot write {path}: the ending must be .gif.")
    rate = number("pictures per second", fps, "1/s", "1 to 50")
    start, end = number("start of the span", span[0], "s"), number("end of the span", span[1], "s")
    if not start < end:
        raise OutOfRange("span", f"{start:g} to {end:g}", "a start before its end", "s")
    times = np.arange(start, end, 1 / rate).tolist()
    frames: list[Image.Image] = []
    with _pictures(Path(recording), [*times, end], size, whole) as pictures:
        for picture in pictures:
            frames.append(picture.quantize(palette=frames[0], dither=Image.Dither.NONE) if frames else picture.quantize(128))
            if progress is not None:
                progress(len(frames))
    with written(path) as draft:
        frames[0].save(draft, "GIF", save_all=True, append_images=frames[1:], duration=10 * round(100 / rate), loop=0)
    return path


@contextmanager
def _pictures(recording: Path, times: Sequence[float], size: tuple[int, int], whole: bool) -> Iterator[Iterator[Image.Image]]:
    width, height = (
        int(number(f"{name} of the picture", value, "pixels", "200 to 4000")) for name, value in zip(("width", "height"), size, strict=True)
    )
    asked = [number("time of a picture", t, "s") for t in times]
    with headless(recording, (width, height), whole) as (picture, first, last):
        for t in asked:
            number("time of a picture", t, "s", f"{first:g} to {last:g}")
        yield (_cut(picture(t), (width, height), whole) for t in asked)


def _cut(png: bytes, size: tuple[int, int], whole: bool) -> Image.Image:
    """The part of a picture that was asked for: of the window its lower part, below the bar of the viewer."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    if whole:
        image = image.crop((0, image.height - size[1], image.width, image.height))
    return image if image.size == size else ImageOps.fit(image, size)
