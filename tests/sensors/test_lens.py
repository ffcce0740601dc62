"""Distortion: rays there and back, OpenCV's own numbers, labels warped as their kind demands."""

from dataclasses import replace

import numpy as np
import pytest

import made_formats as made
from made_captures import ring
from rainsim.errors import InputError, ParameterError
from rainsim.io.files import write_json
from rainsim.render import labels
from rainsim.render.labels import NO_FLOW, OUTSIDE, SEEN
from rainsim.render.shutter import moved
from rainsim.scene.types import Camera
from rainsim.scene.view import pixel_rays, slopes
from rainsim.sensors.lens import BEYOND, WIDEST, Lens, lens_of, lens_warp
from rainsim.sensors.lens_files import lens_named

CAMERA = Camera(120, 80, 90.0, 92.0, 61.0, 38.0, np.eye(4), "a")
LENSES = [
    Lens("opencv", (-0.28, 0.09, 0.001, -0.0015)),
    Lens("opencv", (0.15, 0.02, -0.001, 0.002, 0.01)),
    Lens("fisheye", (0.03, -0.01, 0.004, -0.001)),
    Lens("division", (-0.2,)),
    Lens("division", (0.15,)),
    Lens("eucm", (0.6, 1.1)),
]
IDS = ["barrel", "pincushion", "fisheye", "division", "division in", "unified"]
# Pixels of pycolmap 4.2.1 (COLMAP's own library), and the rays that it gives for them.
COLMAP_RAYS = {
    ("DIVISION", 13, (300.0, 310.0, 320.0, 240.0, -0.2)): [
        [-1.23074539957, -0.765671101115],
        [0.0, 0.0],
        [0.691360274722, 0.631888423133],
    ],
    ("SIMPLE_FISHEYE", 14, (300.0, 320.0, 240.0)): [
        [-1.692524204476, -1.088051274306],
        [0.0, 0.0],
        [0.78746755476, 0.743719357274],
    ],
    ("EUCM", 16, (300.0, 310.0, 320.0, 240.0, 0.6, 1.1)): [
        [-1.635894145058, -1.017722163976],
        [0.0, 0.0],
        [0.775793346867, 0.709058435308],
    ],
}


@pytest.mark.parametrize("lens", LENSES, ids=IDS)
def test_rays_come_back(lens, rng):
    x, y = rng.uniform(-0.7, 0.7, (2, 500))
    u, v = lens.undistort(*lens.distort(x, y))
    np.testing.assert_allclose([u, v], [x, y], atol=1e-8)
    assert lens.distort(0.0, 0.0) == (0, 0)


@pytest.mark.parametrize("camera", COLMAP_RAYS, ids=lambda camera: camera[0])
def test_rays_are_those_of_colmap(tmp_path, camera):
    values = camera[2]
    made.colmap_binary(tmp_path, ring(count=2), camera)
    fy = values[1] if len(values) > 3 else values[0]
    pixels = np.array([[40.0, 60.0], [320.0, 240.0], [500.0, 410.0]])
    found = lens_named(str(tmp_path)).undistort(
        (pixels[:, 0] - 320) / values[0], (pixels[:, 1] - 240) / fy
    )
    np.testing.assert_allclose(np.transpose(found), COLMAP_RAYS[camera], atol=1e-9)


@pytest.mark.parametrize("lens", LENSES[:3], ids=IDS[:3])
def test_as_opencv_distorts(lens, rng):
    cv2 = pytest.importorskip("cv2")
    points = np.column_stack([*rng.uniform(-0.6, 0.6, (2, 50)), np.ones(50)])
    matrix, zero = np.eye(3), np.zeros(3)
    values = np.array(lens.values)
    if lens.model == "fisheye":
        expected, _ = cv2.fisheye.projectPoints(points[None], zero, zero, matrix, values)
    else:
        expected, _ = cv2.projectPoints(points, zero, zero, matrix, values)
    found = np.column_stack(lens.distort(points[:, 0], points[:, 1]))
    np.testing.assert_allclose(found, expected.reshape(-1, 2), atol=1e-9)


def test_a_lens_that_folds_the_picture_is_refused():
    with pytest.raises(ParameterError, match="belong to no ray of the lens opencv"):
        lens_warp(CAMERA, Lens("opencv", (-1.5, 0, 0, 0)))
    with pytest.raises(ParameterError, match=r"sees 8\d degrees off its axis|no ray"):
        lens_warp(replace(CAMERA, fx=42.0, fy=42.0), Lens("fisheye", (0, 0, 0, 0)))


def test_texts_of_lenses():
    assert lens_of("opencv:-0.2,0.05,0,0") == Lens("opencv", (-0.2, 0.05, 0.0, 0.0))
    for text, message in (
        ("opencv", "must be opencv:k1,k2"), ("opencv:1,2", "must be 4 or 5 finite"),
        ("fisheye:1,2,3,4,5", "must be 4 finite"), ("sphere:1,2,3,4", "must be one of opencv"),
        ("opencv:1,2,3,nan", "finite"),
    ):  # fmt: skip
        with pytest.raises(ParameterError, match=message):
            lens_of(text)


COLMAP = {
    "SIMPLE_PINHOLE": (0, (50.0, 32.0, 24.0), None),
    "SIMPLE_RADIAL": (2, (50.0, 32.0, 24.0, 0.1), Lens("opencv", (0.1, 0.0, 0.0, 0.0))),
    "RADIAL": (3, (50.0, 32.0, 24.0, 0.1, 0.2), Lens("opencv", (0.1, 0.2, 0.0, 0.0))),
    "OPENCV": (4, (50.0, 51.0, 32.0, 24.0, 0.1, 0.2, 0.3, 0.4),
               Lens("opencv", (0.1, 0.2, 0.3, 0.4))),
    "OPENCV_FISHEYE": (5, (50.0, 51.0, 32.0, 24.0, 0.0, 0.0, 0.0, 0.0),
                       Lens("fisheye", (0.0,) * 4)),
    "FULL_OPENCV": (6, (50.0, 51.0, 32.0, 24.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0),
                    Lens("opencv", (0.1, 0.2, 0.3, 0.4, 0.5))),
}  # fmt: skip


@pytest.mark.parametrize("model", COLMAP)
@pytest.mark.parametrize("write", [made.colmap_binary, made.colmap_text])
def test_lenses_of_colmap_models(tmp_path, model, write):
    number, values, lens = COLMAP[model]
    write(tmp_path, ring(count=2), (model, number, values))
    assert lens_named(str(tmp_path)) == lens


def test_lenses_of_transforms(tmp_path):
    path = tmp_path / "transforms.json"
    for data, lens in (
        ({"k1": 0.1, "p2": 0.2, "frames": [{}, {}]}, Lens("opencv", (0.1, 0, 0, 0.2, 0))),
        ({"camera_model": "OPENCV_FISHEYE", "frames": [{"k4": 0.1}]},
         Lens("fisheye", (0, 0, 0, 0.1))),
        ({"frames": [{"w": 3}]}, None),
    ):  # fmt: skip
        write_json(path, data)
        assert lens_named(str(path)) == lens
    write_json(path, {"frames": [{"k1": 0.1}, {"k1": 0.2}]})
    with pytest.raises(InputError, match="cameras of 2 lenses; all must be of one"):
        lens_named(str(path))
    write_json(path, {"frames": [{}, {"k1": "0.1"}]})
    with pytest.raises(InputError, match=r"frame 1: k1 is '0\.1'; it must be a number"):
        lens_named(str(path))
    write_json(path, [1])
    with pytest.raises(InputError, match="must be a transforms"):
        lens_named(str(path))
    with pytest.raises(InputError, match="holds no COLMAP model"):
        lens_named(str(tmp_path))
    with pytest.raises(ParameterError, match="or name a transforms"):
        lens_named("nothing.json")
    made.colmap_text(tmp_path, ring(count=2), ("FOV", 7, (50.0, 51.0, 32.0, 24.0, 0.9)))
    with pytest.raises(InputError, match="cameras of the model FOV"):
        lens_named(str(tmp_path))


def plane(camera, tilt=0.3):
    """The depth of the plane z = 4 + tilt x, and a pattern on it, as a pinhole camera sees them."""
    rays = pixel_rays(camera) @ camera.camera_from_world[:3, :3]
    eye = camera.position
    way = (4 + tilt * eye[0] - eye[2]) / (rays[..., 2] - tilt * rays[..., 0])
    place = eye + way[..., None] * rays
    squares = (np.floor(place[..., 0] * 2) + np.floor(place[..., 1] * 2)).astype(int) % 2
    return way.astype(np.float32), squares.astype(np.uint16)


def rays_through(lens, camera, u, v):
    x, y = lens.undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


@pytest.mark.parametrize("lens", LENSES, ids=IDS)
def test_labels_stay_on_their_things(lens):
    """Each pixel of a distorted picture has depth and id of what its own ray meets."""
    warp = lens_warp(CAMERA, lens)
    depth, ids = plane(warp.wide)
    found, seen = warp.nearest(depth), warp.nearest(ids)
    v, u = np.mgrid[:80, :120] + 0.5
    rays = rays_through(lens, CAMERA, u, v)
    expected = 4 / (1 - 0.3 * rays[..., 0])
    slope = np.abs(np.gradient(expected)).max()
    assert np.abs(found - expected).max() < 0.75 * slope + 1e-3  # half a pixel of the wide one
    place = rays * expected[..., None]
    squares = (np.floor(place[..., 0] * 2) + np.floor(place[..., 1] * 2)).astype(int) % 2
    assert set(np.unique(seen)) == {0, 1} and (seen == squares).mean() > 0.95
    shown = np.repeat((ids * 200).astype(np.uint8)[..., None], 3, axis=2)
    colors = warp.colors(shown)
    assert np.abs(colors[..., 0].astype(int) - squares * 200).mean() < 12


@pytest.mark.parametrize("lens", LENSES, ids=IDS)
def test_flow_leads_from_distorted_to_distorted_place(lens):
    warp = lens_warp(CAMERA, lens)
    after = moved(warp.wide, np.array([0.1, -0.05, 0.15]), np.array([0.01, 0.02, -0.03]))
    (here, _), (there, _) = plane(warp.wide), plane(after)
    flow, mask = warp.flow(*labels.flow_of(here, warp.wide, after, there))
    v, u = np.mgrid[:80, :120] + 0.5
    rays = rays_through(lens, CAMERA, u, v)
    place = rays * (4 / (1 - 0.3 * rays[..., 0]))[..., None]
    x, y, z = np.moveaxis(place @ after.camera_from_world[:3, :3].T
                          + after.camera_from_world[:3, 3], -1, 0)  # fmt: skip
    a, b = lens.distort(x / z, y / z)
    expected = np.stack([a * 90 + 61 - u, b * 92 + 38 - v], axis=-1)
    seen = mask == SEEN
    assert seen.mean() > 0.6 and (mask == OUTSIDE).any()
    off = np.linalg.norm(flow - expected, axis=-1)[seen]
    assert off.max() < 0.02 and np.median(off) < 2e-3  # the plane is one surface
    nearest = warp.nearest(labels.flow_of(here, warp.wide, after, there)[0])
    assert np.median(np.linalg.norm(flow - nearest, axis=-1)[seen]) > 0.01


def test_flow_of_two_surfaces_is_of_one_of_them():
    """Across an edge nothing is interpolated: a mean of two motions is the motion of nothing."""
    warp = lens_warp(CAMERA, LENSES[0])
    flow = np.zeros((warp.wide.height, warp.wide.width, 2), np.float32)
    flow[:, warp.wide.width // 2 :, 0] = 8.0
    mask = np.full(flow.shape[:2], SEEN, np.uint16)
    found, _ = warp.flow(flow, mask)
    still = np.abs(found).max(-1) < 1e-3
    u = warp.u + warp.nearest(flow)[..., 0]  # by the lens alone
    x, y = slopes(warp.wide, u, warp.v)
    moved_by = CAMERA.fx * LENSES[0].distort(x, y)[0] + CAMERA.cx - 0.5 - np.arange(120)
    np.testing.assert_allclose(found[..., 0], moved_by, atol=1e-3)
    assert 0.4 < still.mean() < 0.6


def test_no_flow_leads_past_the_lens():
    """Where the polynomial leads back a ray has no place; it must not come back as a flow of 0."""
    lens = Lens("opencv", (-0.3, 0.0, 0.0, 0.0))
    assert lens.reach == pytest.approx(1 / 0.9**0.5)
    assert Lens("fisheye", (0.1, 0.0, 0.0, 0.0)).reach == pytest.approx(WIDEST)
    assert Lens("fisheye", (-0.5, 0.0, 0.0, 0.0)).reach == pytest.approx(np.tan((1 / 1.5) ** 0.5))
    warp = lens_warp(replace(CAMERA, fx=107.0, fy=107.0), lens)
    assert warp.farthest < lens.reach < BEYOND * warp.farthest
    shift = np.zeros((warp.wide.height, warp.wide.width, 2), np.float32)
    shift[..., 0] = 60.0
    flow, mask = warp.flow(shift, np.full(shift.shape[:2], OUTSIDE, np.uint16))
    x, _ = slopes(warp.wide, warp.u + 60.0, warp.v)
    past = np.hypot(x, slopes(warp.wide, warp.u, warp.v)[1]) > lens.reach
    assert 0.03 < past.mean() < 0.6
    assert (mask[past] == NO_FLOW).all() and not flow[past].any()
    assert (mask[~past] == OUTSIDE).all() and np.abs(flow[~past]).max() > 20


@pytest.mark.parametrize("lens", [*LENSES[1:3], Lens("opencv", (0.0, 0.1, 0.0, 0.0))])
def test_flow_leads_only_so_far_out_of_the_picture(lens):
    """A polynomial that never turns back is not trusted far outside the picture, nearby it is."""
    assert lens.reach == pytest.approx(WIDEST)
    warp = lens_warp(CAMERA, lens)
    rays = slopes(warp.wide, warp.u, warp.v)
    assert warp.farthest == pytest.approx(np.hypot(*rays).max())
    row, column = np.mgrid[: warp.wide.height, : warp.wide.width] + 0.5
    y = slopes(warp.wide, column, row)[1]
    shift = np.zeros((*y.shape, 2), np.float32)
    for share, known in ((BEYOND - 0.02, True), (BEYOND + 0.02, False)):
        # All go to the right, to one distance off the axis.
        x = np.sqrt((share * warp.farthest) ** 2 - y**2)
        shift[..., 0] = x * warp.wide.fx + warp.wide.cx - column
        flow, mask = warp.flow(shift, np.full(shift.shape[:2], OUTSIDE, np.uint16))
        assert (mask == (OUTSIDE if known else NO_FLOW)).all()
        assert (np.abs(flow[..., 0]).min() > 5) == known and flow.any() == known
    inside, mask = warp.flow(np.zeros_like(shift), np.full(shift.shape[:2], SEEN, np.uint16))
    assert (mask == SEEN).all() and np.abs(inside).max() < 1e-3
