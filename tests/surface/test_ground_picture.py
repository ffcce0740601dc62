"""The ground from above: where cameras see it, whatever their exposures, without what stands."""

import numpy as np

import made_ground
from rainsim.surface.ground_picture import ground_picture


def places(picture):
    """Return the middles of the cells that are seen, (n, 2)."""
    row, column = np.nonzero(picture.seen)
    return picture.low + picture.cell * (np.stack([column, row], -1) + 0.5)


def error(picture, light):
    """Return the logarithms (n, 3) by which a picture differs from light, without their mean."""
    off = picture.log[picture.seen] - np.log(light(places(picture)))
    return off - np.median(off, axis=0)


def smooth(place):
    wave = np.stack([np.sin(place[..., 0]), np.cos(place[..., 1]), np.sin(place[..., 0])], -1)
    return 0.2 * np.exp(0.3 * wave)


def test_the_ground_is_laid_where_it_is():
    picture = ground_picture(made_ground.views(smooth))
    assert picture.seen.mean() > 0.5 and picture.cell < 0.1
    assert np.abs(places(picture)).max() < made_ground.HALF + 2 * picture.cell
    assert np.abs(error(picture, smooth)).max() < 0.05


def test_cameras_that_expose_by_themselves_agree():
    off = np.random.default_rng(2).normal(0, 0.12, (8, 3))
    found = error(ground_picture(made_ground.views(smooth, np.clip(off, -0.25, 0.25))), smooth)
    assert np.percentile(np.abs(found), 99) < 0.06


def test_what_one_camera_sees_otherwise_does_not_count():
    views = made_ground.views(smooth)
    views[0].light[60:, 40:120] *= 3  # a reflection
    assert np.percentile(np.abs(error(ground_picture(views), smooth)), 95) < 0.06
    for view in views:
        view.light[60:, 40:120] *= 3
    assert np.percentile(np.abs(error(ground_picture(views), smooth)), 95) > 0.3


def test_a_sheet_that_faces_the_cameras_is_laid_on_the_ground():
    views = made_ground.views(smooth)
    for view in views:
        view.depth[:] *= 1.1
    assert np.percentile(np.abs(error(ground_picture(views), smooth)), 95) < 0.05


def test_what_stands_on_the_ground_is_left_out():
    views = made_ground.views(smooth)
    for view in views:  # the top of a block about the middle
        at = view.depth * (1 - 0.3 / view.eye[2])
        row, column = np.mgrid[: view.depth.shape[0], : view.depth.shape[1]] + 0.5
        ray = np.stack([(column - view.lens[2]) / view.lens[0],
                        (row - view.lens[3]) / view.lens[1], 1 + 0 * row], -1)  # fmt: skip
        with np.errstate(invalid="ignore"):
            top = view.eye + at[..., None] * (ray @ view.matrix[:, :3])
        view.depth[:] = np.where(np.abs(top[..., :2]).max(axis=-1) < 0.6, at, view.depth)
    picture = ground_picture(views)
    assert np.abs(places(picture)).max(axis=1).min() > 0.15
    whole = ground_picture(made_ground.views(smooth))
    assert np.abs(places(whole)).max(axis=1).min() < 0.1


def test_without_ground_there_is_no_picture():
    views = made_ground.views(smooth)
    for view in views:
        view.depth[:] = np.inf
    assert ground_picture(views) is None
    assert ground_picture([]) is None
