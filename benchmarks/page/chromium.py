"""The browser that the page is measured and tested in: Debian's, without what it does by itself."""

from __future__ import annotations

from typing import Any

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
]
SIZE = {"width": 1280, "height": 800}


def launched(playwright: Any) -> Any:
    """A browser of `playwright`."""
    return playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
