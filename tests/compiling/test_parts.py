"""Loops over `prange` are run by threads, all iterations once, as plain Python would run them."""

import os

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from rainsim import jit
from rainsim.compiling import callees, parts
from rainsim.jit import cpu_kernel, prange

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="there are no kernels to compile"
)


def _in_three_loops(x, pair, shift, x_out, sums_out):
    """Write x times the pair's first, then sums of halves, each loop from the one before."""
    scale, n = pair[0], len(x)
    for i in prange(n):
        value = x[i] * scale
        x_out[i] = value
    while n > 1:
        for i in prange(n // 2):
            value = x_out[2 * i] + x_out[2 * i + 1]
            sums_out[n // 2 + i] = value + shift
        for i in prange(n // 2):
            x_out[i] = sums_out[n // 2 + i]
        n //= 2


@pytest.mark.parametrize("count", [0, 1, 2, 64, 100])
@pytest.mark.parametrize("threads", [1, 2])
def test_all_iterations_of_each_loop_run_once(poisoned, count, threads):
    kernel = cpu_kernel(_in_three_loops)
    x = np.arange(count, dtype=float)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    try:
        found, sums = poisoned(count), np.full(count + 1, np.nan)
        kernel(x, (3.0, 1), 2, found, sums)
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    expected, expected_sums = np.full(count, np.nan), np.full(count + 1, np.nan)
    _in_three_loops(x, (3.0, 1), 2, expected, expected_sums)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(sums, expected_sums)


def test_parts_run_on_several_threads():
    @cpu_kernel
    def who(thread_out):
        for i in prange(len(thread_out)):
            thread_out[i] = numba.get_thread_id()

    found = np.full(1000, -1)
    who(found)
    assert sorted(set(found)) == list(range(jit.get_num_threads()))


def test_a_sum_over_the_iterations_is_refused():
    @cpu_kernel
    def total(x, x_out):
        s = 0.0
        for i in prange(len(x)):
            s += x[i]
        x_out[0] = s

    with pytest.raises(NumbaError, match="'s' is not defined"):
        total(np.ones(5), np.ones(1))


def test_a_kernel_is_taken_apart_when_it_is_compiled_and_not_before(monkeypatch):
    taken = []
    monkeypatch.setattr(callees, "in_parts", lambda f: taken.append(f) or parts.in_parts(f))
    kernel = cpu_kernel(_in_three_loops)
    assert not taken
    kernel(np.ones(4), (1.0, 1), 1, np.ones(4), np.ones(5))
    assert taken == [_in_three_loops] == [kernel.py_func]
    kernel(np.ones(4), (1.0, 1), 1, np.ones(4), np.ones(5))
    assert len(taken) == 1


def test_with_another_numba_its_own_way_is_taken(monkeypatch):
    assert "parallel" not in cpu_kernel(_in_three_loops).targetoptions
    monkeypatch.setattr(callees, "IS_TESTED", False)
    assert jit._kernel(in_threads=True)(_in_three_loops).targetoptions["parallel"]


def test_no_thread_counts_references_to_what_all_read():
    """Where they did, in one place, the light of a capture took a fifth longer with two threads."""

    @cpu_kernel
    def first_of_rows(rows, pair, x_out):
        for i in prange(len(rows)):
            row, other = rows[i], pair[1][i]
            x_out[i] = row[0] + other[0]

    x = np.arange(6.0).reshape(3, 2)
    found = np.full(3, np.nan)
    first_of_rows(x, (1, x), found)
    np.testing.assert_array_equal(found, [0, 4, 8])
    ((code),) = first_of_rows.inspect_llvm().values()
    part = code.partition("define internal void")[2].partition("\n}")[0]
    assert "fadd" in part
    assert "NRT_" not in part
