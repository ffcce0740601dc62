"""The commands that a newcomer types, on the built-in scene."""

from rainsim.io.images import read_image


def test_warmup_leaves_nothing_behind(rainsim, tmp_path):
    done = rainsim("warmup")
    assert done.code == 0, done.err
    assert done.out == "" and "ready" in done.err
    assert list(tmp_path.iterdir()) == []


def test_run_alone_draws_a_downpour_on_the_bicycle(rainsim, tmp_path):
    small = ["--frames", 1, "--width", 96, "--spacing", 0.1]
    done = rainsim("run", *small)
    assert done.code == 0, done.err
    assert "scale are exact" in done.err and "ground: " in done.err
    assert len(done.err.splitlines()) <= 6, done.err
    picture = read_image(tmp_path / "rainsim-out" / "bicycle-downpour" / "frames" / "00000.png")
    assert picture.shape == (64, 96, 3)
    # Said in full it does the same, and a second run does not overwrite the first.
    again = rainsim("run", "--scene", "bicycle", "--preset", "downpour", *small)
    assert again.code == 2 and "--overwrite" in again.error
