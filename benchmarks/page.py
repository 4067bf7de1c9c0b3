"""The page in Chromium: how soon it is ready, pictures a second, times real time, and what an hour
leaves in memory.
"""

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.conduct import print_tables
from cranedyn.export import driving_page
from cranedyn.model.load import load_crane
from experiments.harness import ResultTable
from tests.export import test_page, test_page_browser

SIZE = (1440, 900)
"""Width and height of the window in which pictures are counted."""

PICTURES_FOR = 10.0
"""Time for which pictures are counted [s]."""


def pictures_per_second(driver: Any, seconds: float) -> float:
    """Return how many pictures a second the page shows while its crane slews.

    Chromium has no graphics processor here, and draws by software.

    Args:
        driver: The browser, with the page in it.
        seconds: Time for which pictures are counted [s].
    """
    driver.set_window_size(*SIZE)
    test_page_browser.press(driver, "ArrowLeft")
    # The page draws in each frame of the animation, as this counts them.
    count = driver.execute_async_script(
        "const [milliseconds, done] = arguments; let first, count = 0; "
        "function next(now) { first ??= now; "
        "if (now - first > milliseconds) { done(count / (now - first)); return; } "
        "count += 1; requestAnimationFrame(next); } requestAnimationFrame(next);",
        1e3 * seconds,
    )
    test_page_browser.press(driver, "ArrowLeft", "keyup")
    return 1e3 * float(count)


def page_table() -> ResultTable:
    """Measure the page of the default crane."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        file = driving_page.export(Path(folder, "crane.html"), load_crane())
        words = "--js-flags=--expose-gc", "--enable-precise-memory-info"
        driver = test_page_browser.open_browser(Path(folder, "profile"), *words)
        try:
            driver.set_script_timeout(600)
            began = time.monotonic()
            driver.get(file.as_uri())
            test_page_browser.wait(driver, "page.state && page.state.t > 0")
            ready = time.monotonic() - began
            pictures = pictures_per_second(driver, PICTURES_FOR)
            rows = []
            data = driver.execute_script("return page.data")
            for name in test_page.ASSISTANCES:
                rounds = 4 * [test_page.request(name, 12000)]
                done = test_page_browser.in_chromium(driver, file, data, *rounds)
                rows.append((name, max(60.0 / once["seconds"] for once in done)))
            used = [
                driver.execute_async_script(
                    "const done = arguments[1]; drive(data, [arguments[0]]).then(() => {"
                    "gc(); done(performance.memory.usedJSHeapSize / 1e6); })",
                    test_page.request("lqr", instants),
                )
                for instants in (12_000, 720_000)
            ]
        finally:
            driver.quit()
    memory = f"{used[0]:.1f} MB after a minute, {used[1]:.1f} MB after an hour"
    note = (
        f"Ready in {ready:.1f} s. {pictures:.0f} pictures a second at {SIZE[0]} × {SIZE[1]}, drawn "
        f"by software. Memory: {memory}."
    )
    return ResultTable("The page", [("assistance", ""), ("times real time", ".0f")], rows, note)


if __name__ == "__main__":
    sys.exit(print_tables("page", __doc__, lambda options: [page_table()], None))
