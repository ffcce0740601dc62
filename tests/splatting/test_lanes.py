"""Which blocks of pixels a splat can reach, and how threads share out the rows of a picture."""

import subprocess
import sys

import numpy as np
import pytest

from rainsim import jit
from rainsim.jit import TAKERS, none_taken, prange, serial_kernel, set_threads, take_next
from rainsim.jit import cpu_kernel as parallel
from rainsim.splatting import lanes, project


@serial_kernel
def blocks_met(record, bits_out):
    for n in range(len(record)):
        bits_out[n] = lanes.meets_blocks(record, n, np.float32(2), np.float32(2))


@serial_kernel
def blended(record, chosen, half, drop, state):
    x, n = np.float32(0.5), len(chosen)
    if half and drop:
        return lanes.blend_lanes(record, chosen, 0, n, state, 0, x, x, 1, 1)
    if half:
        return lanes.blend_lanes(record, chosen, 0, n, state, 0, x, x, 1, 0)
    if drop:
        return lanes.blend_lanes(record, chosen, 0, n, state, 0, x, x, 0, 1)
    return lanes.blend_lanes(record, chosen, 0, n, state, 0, x, x, 0, 0)


@parallel
def take_all(count_out):
    taken = none_taken()
    for _ in prange(TAKERS):
        n = take_next(taken)
        while n < len(count_out):
            count_out[n] += 1
            n = take_next(taken)


def records(rng, count):
    """Return records of ellipses in and about the tile of which the first pixel is (0, 0)."""
    long, thin = np.exp(rng.uniform(-0.5, 3.5, count)), np.exp(rng.uniform(-0.5, 1, count))
    angle = rng.uniform(0, np.pi, count)
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1)
    turn = turn.reshape(-1, 2, 2)
    spread = np.stack([long, np.minimum(long, thin)], -1)[:, None, :] ** 2
    covariance = (turn * spread) @ turn.transpose(0, 2, 1) + 0.3 * np.eye(2)
    inverse = np.linalg.inv(covariance)
    record = np.zeros((count, project.RECORD), np.float32)
    record[:, project.R_U], record[:, project.R_V] = rng.uniform(-20, 36, (2, count))
    record[:, project.R_CONIC] = project.HALF_LOG2E * inverse[:, 0, 0]
    record[:, project.R_CONIC + 1] = project.HALF_LOG2E * 2 * inverse[:, 0, 1]
    record[:, project.R_CONIC + 2] = project.HALF_LOG2E * inverse[:, 1, 1]
    level = np.log2(rng.uniform(0.01, 1, count)).astype(np.float32)
    record[:, project.R_LEVEL] = project.EIGHTH * level
    record[:, project.R_REACH] = project.SLACK * project.EIGHTH * (level - project.MIN_ALPHA_LOG2)
    return record


def test_no_block_is_left_out_in_which_a_splat_shows_and_few_others_are_taken(rng):
    record = records(rng, 20_000)
    bits = np.empty(len(record), np.int64)
    blocks_met(record, bits)
    met = bits[:, None] >> np.arange(16) & 1
    place = np.arange(16) + 0.5
    x, y = np.meshgrid(place, place)
    r = record.astype(np.float64)[:, :, None, None]
    dx, dy = x - r[:, project.R_U], y - r[:, project.R_V]
    a, b, c = r[:, project.R_CONIC], r[:, project.R_CONIC + 1], r[:, project.R_CONIC + 2]
    shows = (
        8 * (r[:, project.R_LEVEL] - (a * dx + b * dy) * dx - c * dy * dy) >= project.MIN_ALPHA_LOG2
    )
    shows = shows.reshape(-1, 4, 4, 4, 4).any(axis=(2, 4)).reshape(-1, 16)
    assert shows.any(axis=1).mean() > 0.3
    assert met[shows].all()
    assert (met[~shows] == 1).sum() < 0.1 * shows.sum()


@pytest.mark.parametrize("threads", [1, 2])
def test_each_part_is_taken_once(threads):
    before = set_threads(None)
    set_threads(threads)
    try:
        count = np.zeros(10_007, np.int64)
        take_all(count)
    finally:
        set_threads(before)
    assert (count == 1).all()


@pytest.mark.parametrize("drop", [False, True])
@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("count", [0, 8, 60])
def test_a_block_is_blended_as_plain_numbers_are(rng, half, drop, count):
    record = records(rng, 99)
    record[:, [project.R_U, project.R_V]] = rng.uniform(-1, 5, (99, 2))
    record[:, project.R_COLOR : project.R_COLOR + lanes.CHANNELS - 1] = rng.uniform(
        0, 1, (99, lanes.CHANNELS - 1)
    )
    chosen = rng.integers(0, 99, count).astype(np.uint32)
    state = np.zeros((lanes.CHANNELS, lanes.LANES), np.float32)
    state[0] = 1
    more = blended(record, chosen, half, drop, state.reshape(-1))
    wanted, mark = np.zeros((lanes.CHANNELS, lanes.LANES)), np.zeros(lanes.LANES, np.uint32)
    wanted[0] = 1
    x, y = np.arange(lanes.LANES) % 4 + 0.5, np.arange(lanes.LANES) // 4 + 0.5
    for k in chosen:
        r = record[k].astype(np.float64)
        dx, dy, (a, b, c) = (
            x - r[project.R_U],
            y - r[project.R_V],
            r[project.R_CONIC : project.R_CONIC + 3],
        )
        power = 8 * (r[project.R_LEVEL] - (a * dx + b * dy) * dx - c * dy * dy)
        alpha = np.where(power >= project.MIN_ALPHA_LOG2, np.minimum(2**power, lanes.MAX_ALPHA), 0)
        before = wanted[0].copy()
        clear = before * (1 - alpha)
        mark[(before > 0.5) & (clear <= 0.5)] = k + 1
        ends = drop & (clear <= lanes.LAST_LIGHT)
        wanted[1:] += (
            np.where(ends, 0, before - clear)
            * r[project.R_COLOR : project.R_COLOR + lanes.CHANNELS - 1, None]
        )
        wanted[0] = np.where(ends, -abs(before), clear)
    if half:
        assert (state[lanes.DEPTH_ROW].view(np.uint32) == mark).all() and mark.any() == (count > 0)
        state[lanes.DEPTH_ROW] = wanted[lanes.DEPTH_ROW]
    np.testing.assert_allclose(state, wanted, rtol=1e-4, atol=2e-5)
    assert more == (wanted[0] > 1e-4).any()
    assert (wanted[0] < 0).any() == (drop and count == 60)


def test_kernels_do_not_run_beside_each_other_in_layers_that_know_one_thread(monkeypatch):
    monkeypatch.setattr(jit.numba, "threading_layer", lambda: "workqueue")
    assert not jit.may_run_beside()
    monkeypatch.setattr(jit.numba, "threading_layer", lambda: "omp")
    assert jit.may_run_beside()
    code = "from rainsim import jit; print(jit.may_run_beside())"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"  # no kernel has run: the layer is not known yet
