"""The browser of the tests of the page."""

from pathlib import Path

import pytest
from benchmarks.page.chromium import CHROMIUM, launched


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright: the page in a browser")
    if not Path(CHROMIUM).exists():
        pytest.skip(f"left out: no {CHROMIUM} for the tests of the page (apt-get install chromium)")
    with api.sync_playwright() as playwright:
        browser = launched(playwright)
        yield browser
        browser.close()
