"""The page against its stored screens: controls and picture, within a tolerance."""

import numpy as np
import pytest
import screens

pytestmark = pytest.mark.slow
OTHER_FONT = "* {font-family: 'DejaVu Serif Condensed', 'Liberation Serif', serif !important}"
NO_CONTROLS = ".mantine-Paper-root {display: none !important}"


def near(away):
    return away[0] <= screens.MOST[0] and away[1] <= screens.MOST[1]


@pytest.mark.parametrize("name", screens.SCREENS)
def test_the_page_looks_as_its_stored_screen(server, open_page, name):
    page = open_page(server[1])
    page.settle(400)
    found, stored = screens.taken(page, name), screens.stored(name)
    away = screens.apart(found, stored)
    assert near(away), away
    others = {other: screens.apart(found, screens.stored(other)) for other in screens.SCREENS}
    del others[name]
    assert not any(map(near, others.values())), others
    if name != "rain":
        return

    page.page.add_style_tag(content=OTHER_FONT)  # of another machine: still the same page
    font = screens.apart(page.when_still(lambda: screens.small(page.screen())), stored)
    assert near(font), font

    before = page.pixels()  # another picture, with the same controls
    page.type_into("brightness", 1.6)
    page.wait_until(lambda: page.differs(before))
    page.settle(400)
    wrong = screens.apart(page.when_still(lambda: screens.small(page.screen())), stored)
    assert wrong[0] > 2 * screens.MOST[0]

    page.open_folder("More: light")  # first controls that should not be there, then none
    folder = screens.apart(page.when_still(lambda: screens.small(page.screen())), stored)
    page.page.add_style_tag(content=NO_CONTROLS)
    gone = screens.apart(page.when_still(lambda: screens.small(page.screen())), stored)
    assert folder[1] > screens.MOST[1] < gone[1] / 2


def test_a_shifted_or_empty_picture_is_far_from_the_stored_one():
    stored = screens.stored("rain")
    assert screens.apart(stored, stored) == (0.0, 0.0)
    shifted = np.roll(stored, (6, 12), axis=(0, 1))
    assert screens.apart(shifted, stored)[0] > screens.MOST[0]
    assert screens.apart(np.full_like(stored, 40), stored)[0] > 3 * screens.MOST[0]
