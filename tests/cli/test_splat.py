"""`rainsim splat`: the dry capture as a picture and as arrays."""

import numpy as np
import pytest
from click.testing import CliRunner

from rainsim.cli import cli
from rainsim.scene.folder import write_scene
from scenes import tiny_scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "tiny"
    write_scene(path, tiny_scene())
    return path


def run(*arguments):
    return CliRunner().invoke(cli, ["splat", *map(str, arguments)])


def test_picture_and_arrays_of_a_named_camera(folder, tmp_path):
    done = run(folder, "--camera", "view_1", "--width", 80, "--out", tmp_path / "a.png")
    assert done.exit_code == 0, done.output
    from rainsim.io.images import read_image

    assert read_image(tmp_path / "a.png").shape == (60, 80, 3)
    done = run(folder, "--camera", "view_1", "--width", 80, "-o", tmp_path / "a.npz",
               "--depth", "plane", "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    with np.load(tmp_path / "a.npz") as data:
        rgb, alpha, depth, normal = (data[n] for n in ("rgb", "alpha", "depth", "normal"))
    assert rgb.shape == (60, 80, 3) and rgb.dtype == np.float32
    assert alpha.max() > 0.9 and np.isfinite(depth[alpha > 0.5]).all()
    # The ground's normal in the capture frame is its up.
    up = tiny_scene().ground_frame.up
    ground = (alpha > 0.99) & (np.abs(normal @ up) > 0.999)
    assert ground.mean() > 0.2
    assert (normal @ up)[ground].min() > 0


def test_orthographic_from_above_has_one_depth_on_level_ground(folder, tmp_path):
    frame = tiny_scene().ground_frame
    eye = frame.to_capture(np.array([0.5, 0.5, 2.0]))
    foot = frame.to_capture(np.array([0.5, 0.5, 0.0]))
    side = frame.to_capture(np.array([1.0, 0, 0])) - frame.to_capture(np.zeros(3))
    text = [",".join(f"{v:.9f}" for v in p) for p in (eye, foot, side)]
    done = run(folder, "--eye", text[0], "--look-at", text[1], "--up", text[2], "--ortho-height",
               0.4 / 0.6, "--width", 40, "--height", 40, "--depth", "median",
               "-o", tmp_path / "top.npz")  # fmt: skip
    assert done.exit_code == 0, done.output
    with np.load(tmp_path / "top.npz") as data:
        depth = data["depth"] * frame.meters_per_unit
    np.testing.assert_allclose(depth, 2.0, atol=2e-3)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--out", "x.jpg"], "must end in .png or .npz"),
        (["--eye", "0,0,1", "--out", "x.png"], "go together"),
        (["--fov", "50", "--out", "x.png"], "--fov is given without --eye"),
        (["--camera", "nobody", "--out", "x.png"], "nobody"),
        (["--width", "0", "--out", "x.png"], "must be 1 to"),
        (["--out", "nowhere/x.png"], "does not exist"),
        (["--background", "0,0,2", "--out", "x.png"], "from 0 to 1"),
        (["--hit", "--out", "x.png"], "FILE.npz"),
    ],
)
def test_bad_use_is_one_line(folder, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    done = run(folder, *arguments)
    assert done.exit_code == 2
    assert told in done.output and done.output.count("\n") == 1


def test_an_existing_file_is_kept(folder, tmp_path):
    out = tmp_path / "mine.png"
    out.write_bytes(b"precious")
    assert run(folder, "--out", out).exit_code == 2
    assert out.read_bytes() == b"precious"
    assert run(folder, "--out", out, "--overwrite").exit_code == 0
    assert out.read_bytes()[:4] == b"\x89PNG"


def test_background_shows_where_the_splats_do_not_cover(folder, tmp_path):
    for name, color in (("a", "0,0,0"), ("b", "0.25,0.5,1")):
        done = run(folder, "--background", color, "-o", tmp_path / f"{name}.npz")
        assert done.exit_code == 0, done.output
    with np.load(tmp_path / "a.npz") as one, np.load(tmp_path / "b.npz") as two:
        one, two = dict(one), dict(two)
    clear = 1 - one["alpha"]
    assert clear.max() == 1 and clear.min() < 0.01
    np.testing.assert_allclose(
        two["rgb"], one["rgb"] + clear[..., None] * (0.25, 0.5, 1), atol=1e-6
    )
    np.testing.assert_array_equal(two["depth"], one["depth"])


def test_hits_name_splats_of_the_scene(folder, tmp_path):
    done = run(folder, "--camera", "view_0", "--hit", "--depth", "median", "-o", tmp_path / "h.npz")
    assert done.exit_code == 0, done.output
    scene = tiny_scene()
    camera = scene.cameras[0].resized(648, 486)
    with np.load(tmp_path / "h.npz") as data:
        hit, depth, alpha = data["hit"], data["depth"], data["alpha"]
    assert hit.dtype == np.int32 and hit.shape == alpha.shape
    np.testing.assert_array_equal(hit >= 0, np.isfinite(depth))
    assert len(np.unique(hit)) > 500
    z = scene.splats.position @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    np.testing.assert_allclose(z[hit[hit >= 0]], depth[hit >= 0], rtol=1e-5)
