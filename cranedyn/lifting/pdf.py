"""A page on paper: a browser that is there prints it into a PDF."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from cranedyn.data.files import written
from cranedyn.errors import CraneError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""What prints without a window, by their names on the path."""

_WORDS = (
    "--headless=new",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)
_LONGEST = 120.0


class NoBrowser(CraneError):
    """There is no browser that prints, or it did not print: why."""


def print_page(page: Path, pdf: Path) -> Path:
    """Print a page of ours.

    Args:
        page: An HTML file that needs nothing else.
        pdf: Where the PDF goes.

    Raises:
        NoBrowser: If no browser is there, or it makes no PDF within two minutes.
        DataError: If the PDF cannot be written.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NoBrowser(
            f"There is no browser to print {page} with; install Chromium, or print the page from "
            "any browser."
        )
    # A sandbox of its own is refused to whoever is root, as in most containers.
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "page.pdf"
        words = [*_WORDS, *root, f"--user-data-dir={folder}/profile", f"--print-to-pdf={made}"]
        try:
            subprocess.run(
                [browser, *words, page.absolute().as_uri()],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_LONGEST,
                check=True,
            )
            content = made.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            why = type(error).__name__
            raise NoBrowser(f"{browser} did not print {page} ({why}); print it by hand.") from None
    with written(pdf) as draft:
        draft.write_bytes(content)
    return pdf
