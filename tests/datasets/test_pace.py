"""How fast a drive is, and views that are placed by a speed."""

from dataclasses import replace

import numpy as np
import pytest
from test_datasets import CAMERA

from rainsim.datasets.pace import (
    FASTEST,
    check_pace,
    film_note,
    pace_note,
    pace_of,
    placed_by_speed,
)
from rainsim.errors import ParameterError
from rainsim.render.shutter import moved


def path_along(places, turns=None):
    """Cameras at places along x [m], turned about z [rad]."""
    turns = np.zeros(len(places)) if turns is None else turns
    return [moved(CAMERA, np.array([x, 0, 0]), np.array([0, 0, a]))
            for x, a in zip(places, turns, strict=True)]  # fmt: skip


def test_the_pace_is_the_paths_length_over_its_time():
    # Half a metre 20 times a second: 10 m/s, 36 km/h.
    length, mean, speeds = pace_of(path_along(0.5 * np.arange(9)), 20)
    assert (length, mean) == pytest.approx((4, 36)) and speeds == pytest.approx(36)
    note = pace_note(path_along(0.5 * np.arange(9)), 20, assumed=False)
    assert note == "drive: 9 views along 4 m at 20/s: 36 km/h"
    uneven = pace_note(path_along([0, 1, 4]), 5, assumed=True)
    assert "36 km/h, 18 to 54 from view to view by the ASSUMED scale" in uneven
    assert pace_note(path_along([0]), 5, assumed=False) == "drive: one view, which stands still"


def test_a_drive_that_no_car_drives_is_refused():
    limit = FASTEST / 3.6 / 10  # m from view to view at 10 views/s
    check_pace(path_along([0, 0.99 * limit]), 10, assumed=False)
    check_pace(path_along([0]), 10, assumed=False)
    with pytest.raises(ParameterError, match="--fps 10, and 131 from view 0 to 1; it must be at"):
        check_pace(path_along([0, 1.01 * limit]), 10, assumed=False)
    # One jump is enough, however slow the rest is; an assumed scale is named as what may be wrong.
    with pytest.raises(ParameterError, match=r"from view 2 to 3; .*--meters-per-unit") as caught:
        check_pace(path_along([0, 0.1, 0.2, 9]), 10, assumed=True)
    assert "\n" not in str(caught.value)
    assert film_note(path_along([0, 9]), 10, False).endswith("cars drive 130 at most: lower --fps")
    assert "WARNING" not in film_note(path_along([0, 1]), 10, False)


def test_views_placed_by_their_speed():
    path = path_along([0, 0.3, 2.0, 2.0, 5.0], [0, 0, 0.34, 0.34, 0.04])  # stands still for a while
    views = placed_by_speed(path, 36, 10)  # every metre
    np.testing.assert_allclose([v.position - CAMERA.position for v in views],
                               [(x, 0, 0) for x in range(6)], atol=1e-9)  # fmt: skip
    assert pace_of(views, 10)[2] == pytest.approx(36)
    turned = [moved(CAMERA, np.zeros(3), np.array([0, 0, a])).camera_from_world[:3, :3]
              for a in (0, 0.14, 0.34, 0.24, 0.14, 0.04)]  # fmt: skip
    np.testing.assert_allclose([v.camera_from_world[:3, :3] for v in views], turned, atol=1e-9)
    assert [v.name for v in views[:2]] == ["drive_00000", "drive_00001"]
    assert len(placed_by_speed(path, 36, 10, most=2)) == 2
    zoomed = [CAMERA, replace(path[2], fx=3 * CAMERA.fx)]
    assert [v.fx for v in placed_by_speed(zoomed, 36, 10)] == pytest.approx([35, 70, 105])


@pytest.mark.parametrize(("speed", "fps", "most", "text"), [
    (float("nan"), 10, None, "--drive-speed is nan km/h; it must be from 1 to 200"),
    (201, 10, None, "it must be from 1 to 200"),
    (36, 10, 7, r"places views 1 m apart; the path of 5 m has room for 6, and must for 7"),
    (36, 1, None, "has room for 1, and must for 2"),
    (1, 9999, None, "make 179983 views; there must be at most 100000"),
])  # fmt: skip
def test_speeds_that_cannot_be_driven_are_named(speed, fps, most, text):
    with pytest.raises(ParameterError, match=text):
        placed_by_speed(path_along([0, 5.0]), speed, fps, most)
