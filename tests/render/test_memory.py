"""Memory is estimated before it is taken."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from rainsim import backend, cuda, pipeline
from rainsim.compiling import pool
from rainsim.config.settings import Config
from rainsim.errors import ParameterError
from rainsim.render import memory
from scenes import tiny_scene


@pytest.fixture
def free(monkeypatch):
    """Return a function that says how many bytes are free."""
    return lambda size: monkeypatch.setattr(memory, "free_memory", lambda: size)


def test_the_estimate_follows_pixels_cells_and_layers():
    scene = tiny_scene()
    small, large = scene.cameras[0], scene.cameras[0].resized(4000, 2593)
    least = memory.memory_of_frames(scene, small)
    assert 0.3e9 < least < 0.8e9
    assert 2e9 < memory.memory_of_frames(scene, large) - least < 3e9
    assert 1e9 < memory.memory_of_frames(scene, small, cells=4_000_000) - least < 2e9
    assert memory.memory_of_frames(scene, large, layers=24) > memory.memory_of_frames(scene, large)
    names, samples = range(31), SimpleNamespace(samples=2)
    held = [memory.layers_held(names, *more) for more in ((), (1,), (1, samples), (None, samples))]
    assert held == [31, 49, 66, 31]


def test_frames_that_do_not_fit_are_refused_with_a_width_that_fits(free):
    scene, free_bytes = tiny_scene(), 2e9
    camera = scene.cameras[0].resized(8000, 6000)
    free(free_bytes)
    with pytest.raises(
        ParameterError, match=r"8000 x 6000 .* 11.0 GB .* 2.0 GB are free"
    ) as caught:
        memory.require_memory(scene, camera)
    width = int(str(caught.value).partition("--width, ")[2].split()[0])
    fits = camera.resized(width, width * 3 // 4)
    assert 0.95 * free_bytes < memory.memory_of_frames(scene, fits) <= free_bytes
    with pytest.raises(ParameterError, match="GB are free"):  # a library's user is told, too
        next(pipeline.render(scene, _Map(), (), [camera], Config()))
    free(None)
    memory.require_memory(scene, camera)


class _Map:
    class bed:
        size = 100


def test_much_is_said_and_little_is_not(free):
    scene = tiny_scene()
    free(20e9)
    assert memory.memory_notes(scene, scene.cameras[0], 10_000) == []
    (note,) = memory.memory_notes(scene, scene.cameras[0].resized(8000, 6000), 10_000)
    assert "some 11.0 GB of memory, of 20.0 GB" in note


def test_a_gpu_s_own_memory_is_what_counts_on_it(free, monkeypatch):
    scene = tiny_scene()
    camera = scene.cameras[0].resized(8000, 6000)
    free(1e9)  # of the machine: the pictures are not there
    memory.require_memory(scene, camera, 10_000, device_free=80e9)
    (note,) = memory.memory_notes(scene, camera, 10_000, device_free=80e9)
    assert "some 15.5 GB of memory of the GPU, of 80.0 GB" in note
    with pytest.raises(
        ParameterError, match=r"15\.5 GB of memory of the GPU; 4\.0 GB are"
    ) as caught:
        memory.require_memory(scene, camera, 10_000, device_free=4e9)
    width = int(str(caught.value).partition("--width, ")[2].split()[0])
    fits = camera.resized(width, width * 3 // 4)
    assert 3.9e9 < memory.device_memory_of_frames(scene.splats, fits, 10_000) <= 4e9
    asked = []
    monkeypatch.setattr(cuda, "free_memory", lambda: asked.append(1) or 4e9)
    assert backend.free_device_memory("cuda") == 4e9 and asked
    assert backend.free_device_memory("cpu") is None
    with pytest.raises(ParameterError, match="of the GPU"):  # before anything is put on it
        next(pipeline.render(scene, _Map(), (), [camera], Config(), backend="cuda"))


def test_the_memory_of_chunks_is_what_is_lowered_on_a_gpu():
    scene = replace(tiny_scene(), pages=SimpleNamespace(memory=1e9))
    camera = scene.cameras[0].resized(96, 64)
    memory.require_memory(scene, camera, 10_000, device_free=5.3e9)
    with pytest.raises(ParameterError, match=r"5\.1 GB .* give less --memory"):
        memory.require_memory(scene, camera, 10_000, device_free=5e9)


def test_eight_gardens_on_a_gpu_take_what_was_measured():
    """1.4 GB at 1297 x 840 on 1024 x 1024 cells, with the wet-ground mirror 0.2 GB more."""

    class Gardens:
        count = 8 * 493_196
        sh = SimpleNamespace(size=count * 48)

        def __len__(self):
            return self.count

    camera = tiny_scene().cameras[0].resized(1297, 840)
    own = memory.device_memory_of_frames(Gardens(), camera, 1024**2, levels=1.0)
    assert 1.4e9 < own < 2.0e9
    held = 2 * sum(a * b for a, b in ((190, Gardens.count), (2, Gardens.sh.size)))
    assert memory.device_memory_of_frames(Gardens(), camera, 1024**2) > own + held / 2


def test_water_and_dry_pictures_that_do_not_fit_are_refused(free):
    scene = tiny_scene()
    camera = scene.cameras[0].resized(8000, 6000)
    free(1e9)
    with pytest.raises(ParameterError, match=r"a picture of 8000 x 6000 .* takes some 3\.2 GB"):
        memory.require_memory_of_dry(scene.splats, camera)
    with pytest.raises(ParameterError, match=r"some 4\.7 GB of memory; .* --width, \d+ fits"):
        memory.require_memory_of_dry(scene.splats, camera, arrays=True)
    with pytest.raises(ParameterError, match="of the GPU"):
        memory.require_memory_of_dry(scene.splats, camera, device_free=1e9)
    with pytest.raises(ParameterError, match=r"on 9000000 cells takes .* larger --spacing"):
        memory.require_memory_of_water(9_000_000)
    assert memory.require_memory_of_water(1_000_000) == []
    assert memory.require_memory_of_dry(scene.splats, scene.cameras[0]) == []
    free(20e9)
    (note,) = memory.require_memory_of_water(9_000_000)
    assert "some 2.2 GB of memory, of 20.0 GB" in note
    (note,) = memory.require_memory_of_dry(scene.splats, camera, device_free=80e9)
    assert "some 3.2 GB" in note


def test_the_limit_of_a_container_counts(tmp_path, monkeypatch):
    without = pool.free_memory()
    monkeypatch.setattr(pool, "CONTAINER", tmp_path)
    assert abs(pool.free_memory() - without) < 1e9
    (tmp_path / "memory.max").write_text("3000000\n")
    (tmp_path / "memory.current").write_text("2500000\n")
    (tmp_path / "memory.stat").write_text("anon 4\ninactive_file 200000\n")
    assert pool.free_memory() == 700_000
    (tmp_path / "memory.max").write_text("max\n")
    assert pool.free_memory() > 700_000
