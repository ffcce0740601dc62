"""What wet ground mirrors, on a real GPU: `pytest -m gpu`."""

import numpy as np
import pytest

from rainsim.config.settings import Config, mm_per_hour
from rainsim.numerics.ripmap import ripmap
from rainsim.pipeline import extract_terrain, simulate
from rainsim.render.renderer import Renderer as OnCpu
from scenes import tiny_scene

pytestmark = pytest.mark.gpu


def test_the_ripmap_is_that_of_the_cpu(rng):
    from rainsim.cuda.jit import cuda
    from rainsim.cuda.shading import wet_ground_mirror as twin
    from rainsim.cuda.shading.wet_pass import BLOCK, blocks

    picture, horizon = rng.uniform(0, 1, (196, 416, 3)).astype(np.float32), 3
    atlas = cuda.to_device(np.full((512, 896, 3), np.nan, np.float32))
    for columns in (300, 416):
        size = cuda.to_device(np.array([columns, 196], np.float32))
        grid = blocks(256, 896), BLOCK
        twin.halve_widths[grid](cuda.to_device(picture), size, horizon, atlas)
        twin.halve_heights[grid](atlas)
        found, wanted = atlas.copy_to_host(), ripmap(picture[:, :columns], horizon)
        width = wanted.shape[1] // 2
        for down, across in ((0, 0), (3, 0), (0, 6), (6, 2)):
            top, left, start = (2 * (n - (n >> k)) for n, k in (
                (256, down), (448, across), (width, across)
            ))  # fmt: skip
            here = slice(top, top + (256 >> down))
            wide = width >> across
            np.testing.assert_allclose(
                found[here, left : left + wide], wanted[here, start : start + wide], atol=1e-6
            )


@pytest.mark.parametrize("film", ["auto", "mirror", "environment"])
def test_a_frame_with_its_film_is_that_of_the_cpu(film):
    from rainsim.cuda.render.renderer import Renderer as OnGpu

    scene = tiny_scene()
    camera = scene.cameras[0].resized(320, 240)
    settings = Config().replace(
        rate=mm_per_hour(20.0), past=4e-3, frames=1, width=320, extent=4.0, spacing=0.05,
        drips=False, film=film,
    )  # fmt: skip
    terrain = extract_terrain(scene, settings)
    state = next(iter(simulate(terrain, settings)))
    pictures, notes = [], []
    for renderer in (OnCpu, OnGpu):
        renderer = renderer(scene, terrain, settings, camera)
        notes.append([])
        for _ in range(2):
            picture, report = renderer.draw(camera, state)
            pictures.append(picture.astype(float))
            notes[-1] += [note for note in report.notes if note.startswith("film")]
    error = np.mean((pictures[0] - pictures[2]) ** 2) / 255**2
    assert error < 1e-6  # 60 dB
    np.testing.assert_array_equal(pictures[2], pictures[3])
    assert notes[0] == notes[1] and len(notes[0]) == (film == "auto")
    assert renderer.conductor.ground.film.drawn == (film != "environment")
