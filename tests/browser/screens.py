"""Screens of the page: how they are taken, made small and compared.

`python tests/browser/screens.py` takes them anew, after a change that is meant to change them, and
prints how far each is from the one before. `python tests/browser/screens.py book` takes the
pictures of the page in docs/view.md, of the built-in bicycle.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from rainsim.io.images import read_image, write_png

FOLDER = Path(__file__).parent / "screens"
TINY = ("--spacing", "0.04", "--extent", "1", "--width", "400", "--camera", "view_0")
BOOK_SIZE = 1000, 760  # px of the page in the book
BLOCK = 4  # px of the page that a pixel of a stored screen is the mean of
COARSE = 4  # px of a stored screen that are compared by their mean: letters do not matter
PANEL = 660  # px from the left, where the controls begin
# Mean difference of coarse pixels (0 to 255) that is allowed: of the picture, and of the controls,
# whose letters are those of the machine.
MOST = 3.0, 7.0
# Notes that depend on the machine's graphics.
QUIET = '[class*="Notifications"], [class*="notification"] {display: none !important}'
STEADY = f"""{QUIET}
  * {{caret-color: transparent !important; transition: none !important; animation: none !important}}
"""  # and what blinks


def show_rain(page):
    """The page as it opens."""


def show_classes(page):
    """Classes, and a point that was read."""
    page.choose("show", "classes")
    page.open_folder("Settings")  # it closes
    page.open_folder("Ground")
    page.page.mouse.click(350, 380)
    page.wait_until(lambda: page.says("ground at"))


def show_home(page):
    """What is taken home, with keyframes in the scene."""
    page.open_folder("Settings")
    page.open_folder("Time")
    page.open_folder("Take home")
    page.press("add a keyframe")
    page.wait_until(lambda: page.says("keyframes: 1"))


def show_read_point(page):
    """Classes, with the folder of the ground alone open, and a point that was read."""
    page.choose("show", "classes")
    for name in ("Settings", "Time", "Ground"):
        page.open_folder(name)
    page.page.mouse.click(240, 640)
    page.wait_until(lambda: page.says("ground at"))


SCREENS = {"rain": show_rain, "classes": show_classes, "home": show_home}


def taken(page, name):
    """Bring a page to a screen and return it small, ndarray of shape (h, w, 3), uint8."""
    page.page.add_style_tag(content=STEADY)
    SCREENS[name](page)
    page.settle(400)
    return page.when_still(lambda: small(page.screen()))


def small(screen):
    """Return the means of blocks of a screen."""
    return np.rint(means(screen, BLOCK)).astype(np.uint8)


def means(picture, block):
    """Return the means of blocks of block x block pixels; what is left at the edges is cut off."""
    height, width = (n // block * block for n in picture.shape[:2])
    cut = picture[:height, :width].astype(np.float64)
    return cut.reshape(height // block, block, width // block, block, 3).mean(axis=(1, 3))


def apart(one, other):
    """Return how far two small screens are apart: their pictures, and their controls."""
    assert one.shape == other.shape
    away = np.abs(means(one, COARSE) - means(other, COARSE)).mean(axis=2)
    panel = PANEL // (BLOCK * COARSE)
    return float(away[:, :panel].mean()), float(away[:, panel:].mean())


def stored(name):
    """Return a stored screen."""
    return read_image(FOLDER / f"{name}.png")


def book():
    """Take the pictures of docs/view.md, in the size of the page."""
    from playwright.sync_api import sync_playwright

    from pages import ARGUMENTS, ROOT, Page, program_of, viewing

    docs, width = FOLDER.parents[2] / "docs", BOOK_SIZE[0]
    with sync_playwright() as driver, tempfile.TemporaryDirectory() as work:
        browser = driver.chromium.launch(executable_path=program_of(), args=ARGUMENTS + ROOT)
        given = ("bicycle", "--preset", "moderate", "--width", width)
        with viewing(*given, folder=work) as (_, address):
            page = Page(browser, address, BOOK_SIZE)
            page.page.add_style_tag(content=QUIET)
            for name, show in (("page", show_rain), ("page_classes", show_read_point)):
                show(page)
                page.settle(width, seconds=300.0)
                page.page.screenshot(path=docs / f"{name}.jpg", type="jpeg", quality=85)
        browser.close()


def main():
    """Take all screens and store them."""
    from playwright.sync_api import sync_playwright

    from pages import ARGUMENTS, ROOT, Page, program_of, viewing
    from rainsim.scene.folder import write_scene
    from scenes import tiny_scene

    with sync_playwright() as driver, tempfile.TemporaryDirectory() as work:
        browser = driver.chromium.launch(executable_path=program_of(), args=ARGUMENTS + ROOT)
        write_scene(Path(work) / "tiny", tiny_scene())
        for name in SCREENS:
            with viewing(Path(work) / "tiny", *TINY, folder=work) as (_, address):
                page = Page(browser, address)
                page.settle(400)
                found = taken(page, name)
                page.close()
            path = FOLDER / f"{name}.png"
            away = apart(found, stored(name)) if path.is_file() else None
            write_png(path, found)
            print(name, found.shape, "new" if away is None else away)
        browser.close()


if __name__ == "__main__":
    sys.path.insert(0, str(FOLDER.parent.parent))
    book() if sys.argv[1:] == ["book"] else main()
