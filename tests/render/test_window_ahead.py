"""Windows of the ground that are made on a thread while frames of the one before are drawn."""

import subprocess
import sys
import threading
import time

import numba
import pytest

import made_road as path
from rainsim import jit, pipeline
from rainsim.errors import InputError
from rainsim.render import window_ahead

CONFIG, DRIVE = path.CONFIG, path.DRIVE
small, scene, ground, drive = path.small, path.scene, path.ground, path.drive  # fixtures


def sequence_of(scene, ground, config=CONFIG):
    return pipeline.FrameSequence(scene, ground, DRIVE, config)


@pytest.fixture
def made(monkeypatch):
    """The number of the state with which each window began, and the thread that made it."""
    found, original = [], window_ahead.steady_water

    def watched(terrain, config, number, beyond=None):
        found.append((number, threading.current_thread().name, numba.get_num_threads()))
        return original(terrain, config, number, beyond)

    monkeypatch.setattr(window_ahead, "steady_water", watched)
    return found


def test_windows_made_ahead_give_the_bytes_of_windows_made_in_turn(
    scene,
    ground,
    drive,
    made,
    monkeypatch,
):
    monkeypatch.setattr(window_ahead, "may_run_beside", lambda: False)
    alone = {r.index: p.tobytes() for p, r in sequence_of(scene, ground).frames(range(16))}
    assert {name for _, name, _ in made} == {threading.current_thread().name}
    assert len(made) == len(ground.stations)
    monkeypatch.setattr(window_ahead, "may_run_beside", lambda: True)
    made.clear()
    ahead = {r.index: p.tobytes() for p, r in sequence_of(scene, ground).frames(range(16))}
    assert [name for _, name, _ in made] == ["window ahead"] * len(ground.stations)
    assert alone == ahead == drive


def test_the_thread_leaves_half_the_threads_to_the_drawing(scene, ground, made, threads):
    threads(2)
    next(iter(sequence_of(scene, ground).frames([0])))
    assert made[0][1:] == ("window ahead", 1) and numba.get_num_threads() == 2


def test_only_windows_that_frames_are_asked_of_are_made(scene, ground, made):
    sequence, first = sequence_of(scene, ground), ground.stations[1].first
    list(sequence.frames([first, first + 1]))
    assert len(made) == 1
    list(sequence.frames([first + 1, ground.stations[2].first]))
    assert len(made) == 2
    list(sequence.frames([0, 1]))  # back again, with the next one as it was
    assert len(made) == 3


def test_an_error_of_the_thread_comes_up_in_the_frame_that_needs_the_window(
    scene,
    ground,
    monkeypatch,
):
    original, second = window_ahead.steady_water, ground.stations[1]

    def breaks(terrain, config, number, beyond=None):
        if number == second.start(config):
            raise InputError("the chunk is damaged")
        return original(terrain, config, number, beyond)

    monkeypatch.setattr(window_ahead, "steady_water", breaks)
    seen = []
    with pytest.raises(InputError, match="the chunk is damaged"):
        for _, report in sequence_of(scene, ground).frames(range(16)):
            seen.append(report.index)
    assert seen == list(range(second.first))


def test_a_run_that_is_given_up_stops_its_thread_between_two_steps(scene, ground, monkeypatch):
    begun, go_on, original = threading.Event(), threading.Event(), window_ahead.steady_water

    def slow(terrain, config, number, beyond):
        if number == ground.stations[1].start(config):
            assert threading.current_thread().name == "window ahead" and not begun.is_set()
            begun.set()
            go_on.wait(30)
        return original(terrain, config, number, beyond)

    monkeypatch.setattr(window_ahead, "steady_water", slow)
    sequence = sequence_of(scene, ground)
    frames = sequence.frames(range(16))
    next(frames)
    (work,) = window_ahead._threads
    assert work.station == ground.stations[1] and begun.wait(30)
    frames.close()
    threading.Timer(0.2, go_on.set).start()
    sequence._windows.window(ground.stations[0])  # not before the thread has let go of its memory
    assert go_on.is_set() and not work._thread.is_alive()
    assert not window_ahead._threads and work._made is None


def test_another_window_than_the_one_made_ahead_is_made_when_it_is_asked_for(
    scene,
    ground,
    drive,
):
    sequence = sequence_of(scene, ground)
    frames = sequence.frames(range(16))
    next(frames)
    windows = sequence._windows
    last = ground.stations[-1]
    assert windows.window(last).station == last and not windows.is_ahead(ground.stations[1])
    frames.close()
    ((picture, _),) = sequence.frames([2])
    assert picture.tobytes() == drive[2]


def test_threading_layers_that_know_one_thread_make_windows_in_turn(monkeypatch):
    monkeypatch.setattr(jit.numba, "threading_layer", lambda: "workqueue")
    assert not jit.may_run_beside()
    monkeypatch.setattr(jit.numba, "threading_layer", lambda: "omp")
    assert jit.may_run_beside()
    code = "from rainsim import jit; print(jit.may_run_beside())"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"  # no kernel has run: the layer is not known yet


def test_the_end_of_the_program_waits_for_no_more_than_a_call(monkeypatch):
    begun = threading.Event()

    def make(check):
        begun.set()
        for _ in range(3000):
            time.sleep(0.01)

    work = window_ahead._Work(None, make)
    begun.wait(30)
    start = time.monotonic()
    window_ahead._stop_all()
    assert time.monotonic() - start < 5 and not work._thread.is_alive()
    assert not window_ahead._threads
