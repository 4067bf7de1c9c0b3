"""Print a report as PDF by a browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from cranedyn.data.files import atomic_write
from cranedyn.errors import CraneError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Browsers that print without a window, by their names on the path."""

_OPTIONS = (
    "--headless=new",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)
_TIMEOUT = 120.0
"""Time that a browser may take [s]."""


class NoBrowser(CraneError):
    """No browser is installed, or it made no PDF."""


def print_pdf(page: Path, pdf: Path) -> Path:
    """Print an HTML page as PDF.

    Args:
        page: An HTML file that needs no other file.
        pdf: The file to write.

    Raises:
        NoBrowser: If no browser is installed, or it makes no PDF within two minutes.
        DataError: If the PDF cannot be written.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise NoBrowser(
            f"There is no browser to print {page} with; install Chromium, or print the page from "
            "any browser."
        )
    # Browsers refuse their sandbox to root, as in most containers.
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as folder:
        printed = Path(folder) / "page.pdf"
        options = [*_OPTIONS, *root, f"--user-data-dir={folder}/profile"]
        try:
            subprocess.run(
                [browser, *options, f"--print-to-pdf={printed}", page.absolute().as_uri()],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_TIMEOUT,
                check=True,
            )
            content = printed.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            why = type(error).__name__
            raise NoBrowser(f"{browser} did not print {page} ({why}); print it by hand.") from None
    with atomic_write(pdf) as draft:
        draft.write_bytes(content)
    return pdf
