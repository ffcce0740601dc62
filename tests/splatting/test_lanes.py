"""Which blocks of pixels a splat can reach, and how threads share out the rows of a picture."""

import numpy as np
import pytest

from rainsim.jit import TAKERS, none_taken, prange, serial_kernel, set_threads, take_next
from rainsim.jit import cpu_kernel as parallel
from rainsim.splatting.lanes import meets_blocks
from rainsim.splatting.project import (
    EIGHTH,
    HALF_LOG2E,
    MIN_ALPHA_LOG2,
    R_CONIC,
    R_LEVEL,
    R_REACH,
    R_U,
    R_V,
    RECORD,
    SLACK,
)


@serial_kernel
def blocks_met(record, bits_out):
    for n in range(len(record)):
        bits_out[n] = meets_blocks(record, n, np.float32(2), np.float32(2))


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
    record = np.zeros((count, RECORD), np.float32)
    record[:, R_U], record[:, R_V] = rng.uniform(-20, 36, (2, count))
    record[:, R_CONIC] = HALF_LOG2E * inverse[:, 0, 0]
    record[:, R_CONIC + 1] = HALF_LOG2E * 2 * inverse[:, 0, 1]
    record[:, R_CONIC + 2] = HALF_LOG2E * inverse[:, 1, 1]
    level = np.log2(rng.uniform(0.01, 1, count)).astype(np.float32)
    record[:, R_LEVEL] = EIGHTH * level
    record[:, R_REACH] = SLACK * EIGHTH * (level - MIN_ALPHA_LOG2)
    return record


def test_no_block_is_left_out_in_which_a_splat_shows_and_few_others_are_taken(rng):
    record = records(rng, 20_000)
    bits = np.empty(len(record), np.int64)
    blocks_met(record, bits)
    met = bits[:, None] >> np.arange(16) & 1
    place = np.arange(16) + 0.5
    x, y = np.meshgrid(place, place)
    r = record.astype(np.float64)[:, :, None, None]
    dx, dy = x - r[:, R_U], y - r[:, R_V]
    a, b, c = r[:, R_CONIC], r[:, R_CONIC + 1], r[:, R_CONIC + 2]
    shows = 8 * (r[:, R_LEVEL] - (a * dx + b * dy) * dx - c * dy * dy) >= MIN_ALPHA_LOG2
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
