"""A hook of MkDocs: what a search finds first.

Pages for readers stand before the reference, whose many docstrings hold every word of the field.
"""

from typing import Any

REFERENCE_BOOST = 0.1
"""Weight of a page of the reference in a search, where that of another page is 1."""


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Give pages of the API, and those in another language, less weight in a search."""
    path = page.file.src_uri
    if path.startswith("api/") or path == "README.ja.md":
        page.meta["search"] = {"boost": REFERENCE_BOOST}
    return markdown
