"""A viewer without a window, to take pictures with."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient

from cranedyn.errors import CraneError, DataError
from cranedyn.recording.process import HOST, await_ready, end, ended, free, free_port, start
from cranedyn.recording.run import SCENE, TIMELINE
from cranedyn.recording.viewer import check

_BARS = {True: (0, 36), False: (7, 71)}
"""What the viewer's own bars and frames take of width and height of its window [pixels], for the
dashboard and for a single view."""

_PATIENCE = 60.0

_DRIVER = (
    "It needs a graphics driver with Vulkan; where there is no graphics card, install "
    "Debian's mesa-vulkan-drivers."
)


@contextmanager
def headless(
    path: str | Path, size: tuple[int, int], whole: bool
) -> Iterator[tuple[Callable[[float], bytes], float, float]]:
    """A viewer without a window, for as long as the context lasts.

    Args:
        path: The recording.
        size: Width and height of the part of the window that counts [pixels].
        whole: Whether pictures show the dashboard, with the viewer's own bar on top, or the scene
            alone.

    Yields:
        A function from time [s] to the picture then as PNG, and the first and the last time of the
        recording [s].

    Raises:
        DataError: If there is no recording there, or one without simulated time.
        CraneError: If the viewer cannot be started, or fails.
    """
    path = check(path)
    port = free_port()
    window = f"{size[0] + _BARS[whole][0]}x{size[1] + _BARS[whole][1]}"
    renderer = ("--renderer", "vulkan") if sys.platform == "linux" else ()
    process = start(
        "--headless",
        "--bind",
        HOST,
        "--port",
        str(port),
        *renderer,
        "--window-size",
        window,
        "--hide-welcome-screen",
    )
    try:
        await_ready(process, lambda: not free(port), _DRIVER)
        client = ViewerClient.connect(f"rerun+http://{HOST}:{port}/proxy")
        first, last = _opened(client, path)
        view = None if whole else _maximise_scene(client)

        def picture(t: float) -> bytes:
            client.set_time(TIMELINE, duration=t, play_state="paused")
            return client.take_screenshot(view)

        _settle(lambda: picture(first))
        yield picture, first, last
    except (RuntimeError, ConnectionError) as error:
        raise CraneError(
            f"Rerun's viewer failed. {_DRIVER if ended(process) else error}"
        ) from error
    finally:
        end(process)


def _opened(client: ViewerClient, path: Path) -> tuple[float, float]:
    """Open a recording; its first and last time [s]."""
    client.open(str(path.resolve()))
    waited = 0.0
    while client.get_state().loading and waited < _PATIENCE:
        time.sleep(0.1)
        waited += 0.1
    for recording in client.get_state().recordings:
        for timeline in recording.timelines:
            if (
                timeline.name == TIMELINE
                and timeline.start is not None
                and timeline.end is not None
            ):
                return timeline.start / 1e9, timeline.end / 1e9
    raise DataError(f"{path} holds nothing on the timeline {TIMELINE}.")


def _maximise_scene(client: ViewerClient) -> str:
    views = [view for view in client.get_state().views if view.view_class == "3D"]
    scene = next(
        (view.view_id for view in sorted(views, key=lambda view: view.name != SCENE)), None
    )
    if scene is None:
        raise CraneError("The recording shows no scene.")
    layout = client.get_blueprint().blueprint
    layout["/viewport"]["ViewportBlueprint"]["maximized"] = scene
    layout["/time_panel"] = {"TimePanelBlueprint": {"state": "Hidden"}}
    client.set_blueprint(layout, of="recording")
    return scene


def _settle(picture: Callable[[], bytes]) -> None:
    """Take pictures until two are the same: messages of the viewer's own start fade from the first
    ones.
    """
    before, now = b"", picture()
    for _ in range(20):
        if now == before:
            return
        before, now = now, picture()
