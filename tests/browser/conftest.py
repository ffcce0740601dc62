"""A real browser, and `rainsim view` of the tiny scene."""

from pathlib import Path

import pytest

from pages import ARGUMENTS, ROOT, Page, program_of, viewing


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium; without one the tests are skipped, with the reason."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="NO BROWSER TESTS: pip install playwright"
    )
    program = program_of()
    if program is None:
        pytest.skip("NO BROWSER TESTS: install chromium (apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=program, args=ARGUMENTS + ROOT)
        yield found
        found.close()


@pytest.fixture
def server(scene_folder, tmp_path):
    """`rainsim view` of the tiny scene, whose files go to `tmp_path`."""
    tiny = ["--spacing", "0.04", "--extent", "1", "--width", "400", "--camera", "view_0"]
    with viewing(scene_folder, *tiny, "--out", "home", folder=tmp_path) as (process, address):
        yield process, address, Path(tmp_path)


@pytest.fixture
def open_page(browser):
    """Return a function that opens a page at an address."""
    pages = []

    def open_(address, **given):
        pages.append(Page(browser, address, **given))
        return pages[-1]

    yield open_
    for page in pages:
        page.close()
