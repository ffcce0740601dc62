"""What a kernel calls is compiled for it alone: the same numbers, and kernels stay callable."""

import os

import numba
import numpy as np
import pytest
from numba.core.registry import cpu_target

from rainsim.compiling import callees
from rainsim.compiling.kernel_cache import KernelCache
from rainsim.jit import cpu_kernel, device_function, prange, serial_kernel

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="there are no kernels to compile"
)
X = np.linspace(1, 9, 50, dtype=np.float32)
EXPECTED = 0.1 * np.sqrt(X) + np.log(X)


def _made(mark):
    """Return a kernel of a parallel loop and the function that it calls, marked by `mark`."""

    @device_function
    def called_by_kernels(x):
        return np.sqrt(x) * np.float32(0.1) + np.log(x)

    @mark
    def inner(x):
        return called_by_kernels(x)

    @cpu_kernel
    def outer(x, x_out):
        for i in prange(len(x)):
            x_out[i] = inner(x[i]) + called_by_kernels(x[i])

    return outer, inner


def _with_code():
    """Return the functions of this file that have machine code of their own."""
    symbols = cpu_target.target_context.codegen()._engine._defined_symbols
    return {s for s in symbols if "called_by_kernels" in s and "NumbaEnv" not in s}


def test_functions_are_linked_into_their_kernel_and_nowhere_else(poisoned):
    before = _with_code()
    outer, inner = _made(serial_kernel)
    found = poisoned(len(X))
    outer(X, found)
    np.testing.assert_allclose(found, 2 * EXPECTED, rtol=1e-6)
    assert inner(X[3]) == pytest.approx(EXPECTED[3], rel=1e-6)  # a kernel, also where one calls it
    assert _with_code() == before


def test_a_kernel_gets_the_full_passes_and_what_it_calls_the_cheap_ones(
    monkeypatch, poisoned, tmp_path
):
    made, asked = type(cpu_target.target_context.codegen()), []
    whole = made._module_pass_manager

    def passes(codegen, **options):
        asked.append(options.get("opt"))
        return whole(codegen, **options)

    monkeypatch.setattr(made, "_module_pass_manager", passes)

    @device_function
    def called(x):
        return np.sqrt(x) * np.float32(0.1) + np.log(x)

    @cpu_kernel
    def outer(x, x_out):
        for i in prange(len(x)):
            x_out[i] = called(x[i])

    outer._cache = KernelCache(outer.py_func, tmp_path, "")  # empty: it is compiled here
    found = poisoned(len(X))
    outer(X, found)
    np.testing.assert_allclose(found, EXPECTED, rtol=1e-6)
    assert sorted(map(str, asked)) == ["0", "0", "None"]  # called, the body of the loop, the kernel


def test_what_is_no_kernel_is_compiled_as_numba_does_it():
    _made(serial_kernel)[1](X[3])
    before = _with_code()
    codegen = cpu_target.target_context.codegen()
    assert codegen._library_class is type(codegen)._library_class
    assert _made(numba.njit)[1](X[3]) == pytest.approx(EXPECTED[3], rel=1e-6)
    assert _with_code() > before


def test_with_another_numba_kernels_are_compiled_as_it_does(monkeypatch, poisoned):
    monkeypatch.setattr(callees, "IS_TESTED", False)
    before = _with_code()
    found = poisoned(len(X))
    _made(serial_kernel)[0](X, found)
    np.testing.assert_allclose(found, 2 * EXPECTED, rtol=1e-6)
    assert _with_code() > before


def test_operators_make_of_numbers_what_they_make_with_numbas_own_methods(poisoned, tmp_path):
    before = [getattr(owner, name) for owner, (name, _) in callees._OURS.items()]

    @serial_kernel
    def mixed(small, whole, wide, found_out):
        found_out[0] = small + whole
        found_out[1] = small * wide
        found_out[2] = whole / np.int32(4) + (whole > 3) + (whole // 2) % 2
        found_out[3] = np.float32(1) / np.float32(3) + small
        for k in range(4):
            if found_out[k] > 3 and not whole == k:
                found_out[4] = -(found_out[k] ** 2)

    mixed._cache = KernelCache(mixed.py_func, tmp_path, "")
    plain = numba.njit(mixed.py_func)
    given = np.float32(0.1), 7, np.float64(0.3)
    found, expected = poisoned(5, dtype=np.float64), poisoned(5, dtype=np.float64)
    mixed(*given, found)
    assert before == [getattr(owner, name) for owner, (name, _) in callees._OURS.items()]
    plain(*given, expected)
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    types = [
        {str(call.args): str(call.return_type) for call in f.overloads[f.signatures[0]]
         .type_annotation.calltypes.values() if call is not None}
        for f in (mixed, plain)
    ]  # fmt: skip
    assert types[0] == types[1] and len(types[0]) > 5
