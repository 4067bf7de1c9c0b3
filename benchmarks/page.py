"""The page in Chromium: how soon it is ready, times real time, what an hour leaves in memory."""

import sys
import tempfile
import time
from pathlib import Path

from benchmarks.conduct import print_tables
from cranedyn.export import driving_page
from cranedyn.model.load import load_crane
from experiments.harness import ResultTable
from tests.export import test_page, test_page_browser


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
    note = f"Ready in {ready:.1f} s. Memory: {memory}."
    return ResultTable("The page", [("assistance", ""), ("times real time", ".0f")], rows, note)


if __name__ == "__main__":
    sys.exit(print_tables("page", __doc__, lambda options: [page_table()], None))
