"""Pictures of a recording at chosen times, and moving ones, without a display."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from cranedyn.checks import number
from cranedyn.data.files import atomic_write, check_writable, make_folder
from cranedyn.errors import DataError, OutOfRange
from cranedyn.recording.headless import headless

_MOST_PIXELS = 5e8

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
        folder: Where to; made if it is not there, once it is clear that the pictures can be taken.
        size: Width and height [pixels].
        whole: The dashboard, or the scene alone.
        progress: Told how many pictures are done.

    Raises:
        OutOfRange: For a time outside of the recording, two times of one name, or a size that is
            not allowed.
        DataError: If the recording cannot be read or a picture cannot be written.
        CraneError: If there is no viewer, or no driver for it.
    """
    recording, found = Path(recording), []
    names = [f"{recording.stem}-{t:g}s.png" for t in times]
    if len(set(names)) < len(names):
        raise OutOfRange("times", list(times), "each time once, as far as six digits tell", "s")
    with _pictures(recording, times, size, whole) as pictures:
        for name, picture in zip(names, pictures, strict=True):
            path = make_folder(Path(folder)) / name
            _write(path, picture, "PNG")
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
        fps: Pictures per second. A GIF counts in hundredths of a second, so that at 30 pictures per
            second some stay for 0.03 s and some for 0.04 s; together they take the time of the
            span.
        size: Width and height [pixels].
        whole: The dashboard, or the scene alone.
        progress: Told how many pictures are done.

    Raises:
        OutOfRange: For a span that is empty or outside of the recording, a rate or a size that is
            not allowed, or too many pictures.
        DataError: If the recording cannot be read or the GIF cannot be written.
        CraneError: If there is no viewer, or no driver for it.
    """
    path, times = Path(path), film(span, path, fps=fps, size=size)
    shown = np.diff(np.round(100 * np.append(times - times[0], span[1] - span[0] + 1 / fps)))
    frames: list[Image.Image] = []
    with _pictures(Path(recording), times.tolist(), size, whole) as pictures:
        for picture in pictures:
            frames.append(
                picture.quantize(palette=frames[0], dither=Image.Dither.NONE)
                if frames
                else picture.quantize(128)
            )
            if progress is not None:
                progress(len(frames))
    _write(
        path,
        frames[0],
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=(10 * shown).astype(int).tolist(),
        loop=0,
    )
    return path


def _write(path: Path, picture: Image.Image, kind: str, **more: Any) -> None:
    """Write a picture; given a path itself, the library leaves the file open where Ctrl-C comes
    meanwhile.
    """
    whole = io.BytesIO()
    picture.save(whole, kind, **more)
    with atomic_write(path) as draft:
        draft.write_bytes(whole.getvalue())


def film(
    span: tuple[float, float],
    path: str | Path,
    *,
    fps: float = 10.0,
    size: tuple[int, int] = (640, 480),
) -> np.ndarray:
    """When the pictures of a GIF are taken [s], shape (n,), judged before any is: what `animate` is
    given must make one.

    Raises:
        OutOfRange: For a span that is empty, a rate or a size that is not allowed, or too many
            pictures.
        DataError: If the GIF cannot be written there.
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise DataError(f"Cannot write {path}: the ending must be .gif.")
    rate = number("pictures per second", fps, "1/s", "1 to 50")
    start, end = number("start of the span", span[0], "s"), number("end of the span", span[1], "s")
    if not end - start >= (1.0 - 1e-9) / rate:
        raise OutOfRange(
            "span",
            f"{start:g} to {end:g}",
            f"{1 / rate:g} s or more from start to end, the time of one picture",
            "s",
        )
    count, (width, height) = np.floor((end - start) * rate + 1e-9) + 1.0, _checked(size)
    if count * width * height > _MOST_PIXELS:
        raise OutOfRange(
            "number of pictures",
            f"{count:.0f}",
            f"{_MOST_PIXELS // (width * height):.0f} or fewer of {width} x {height} pixels",
        )
    check_writable(path)
    return np.linspace(start, end, int(count))


@contextmanager
def _pictures(
    recording: Path, times: Sequence[float], size: tuple[int, int], whole: bool
) -> Iterator[Iterator[Image.Image]]:
    width, height = _checked(size)
    asked = [number("time of a picture", t, "s") for t in times]
    with headless(recording, (width, height), whole) as (picture, first, last):
        for t in asked:
            number("time of a picture", t, "s", f"{first:g} to {last:g}")
        yield (_cut(picture(t), (width, height), whole) for t in asked)


def _checked(size: tuple[int, int]) -> tuple[int, int]:
    width, height = (
        int(number(f"{name} of the picture", value, "pixels", "200 to 4000"))
        for name, value in zip(("width", "height"), size, strict=True)
    )
    return width, height


def _cut(png: bytes, size: tuple[int, int], whole: bool) -> Image.Image:
    """The part of a picture that was asked for: of the window its lower part, below the bar of the
    viewer.
    """
    image = Image.open(io.BytesIO(png)).convert("RGB")
    if whole:
        image = image.crop((0, image.height - size[1], image.width, image.height))
    return image if image.size == size else ImageOps.fit(image, size)
