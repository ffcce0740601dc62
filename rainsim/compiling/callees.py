"""Functions that a kernel calls are compiled for that kernel alone.

numba makes machine code of each function that a kernel calls. But it links into the kernel what
they were before that, and only the kernel's machine code runs. Here no other is made. That takes a
fourth less time, and the kernel's code is the same.

numba optimises these functions as the whole kernel is afterwards, and that twice, the first time
cheaply. Here they get the cheap passes alone, and the kernel the others: another third of the time.
No kernel runs slower for it.

numba compiles a function once more for each set of its callers' flags. Here it does so for flags
that a function takes over from its callers alone, and does not set itself. That saves a tenth of
the time. What an operator makes of numbers it looks up once, and which variables live where a block
of code begins never: another tenth.

numba has no setting for this, so it is tied to the releases that it was tested with; with others
kernels are compiled as numba does it.
"""

import functools
import gc

import numba
from llvmlite.binding import ffi
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.environment import lookup_environment
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.targetconfig import ConfigStack
from numba.core.transforms import canonicalize_cfg
from numba.core.types import Boolean, Number
from numba.core.types.functions import BaseFunction
from numba.core.typing.templates import _OverloadFunctionTemplate

from rainsim.compiling.kernel_cache import KernelCache
from rainsim.compiling.parts import in_parts

IS_TESTED = numba.__version__.startswith("0.68.")

TAKEN_OVER = "nrt", "fastmath", "error_model", "forceinline"  # by a callee

_kernels = []  # that are being compiled, each for the one before


class _Library(JITCodeLibrary):
    """Machine code in the making, of a kernel or of a function that a kernel links."""

    _only_linked = False

    def finalize(self):
        """Optimise and link machine code; code read from disk does not pass through here."""
        self._only_linked = self.name != _kernels[-1].py_func.__qualname__
        super().finalize()

    def _optimize_final_module(self):
        cheap = {"loop_vectorize": False, "slp_vectorize": False, "opt": 0, "cost": "cheap"}
        options = cheap if self._only_linked else {}  # what is linked has had the cheap passes
        passes, builder = self._codegen._module_pass_manager(**options)
        passes.run(self._final_module, builder)

    def _finalize_final_module(self):
        if self._only_linked:
            self._finalize_dynamic_globals()
            self._finalized = True
            return
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:  # of all functions linked in
            environment = lookup_environment(variable.name)
            if environment is not None:
                self._codegen.set_env(variable.name, environment)


def _set_environment(codegen, name, environment):
    """Set a function's environment, if the function has machine code."""
    if codegen._engine.is_symbol_defined(name):
        type(codegen).set_env(codegen, name, environment)


def _implementation(template, args, kws):
    """Return what numba's `_get_impl` does, by the flags of the caller that matter."""
    flags, own = ConfigStack.top_or_none(), template._jit_options
    taken = (name for name in TAKEN_OVER if own.get(name, own.get(f"_{name}")) is None)
    flags = flags and str([getattr(flags, name) for name in taken])
    key = template.context, tuple(args), tuple(kws.items()), flags
    if key not in template._impl_cache:
        return template._build_impl(key, args, kws)
    return template._impl_cache[key]


def _call_type(function, context, args, kws):
    """Return what numba's `get_call_type` does, of an operator of numbers from the first time."""
    of_numbers = all(isinstance(given, (Number, Boolean)) for given in args)
    if not of_numbers or getattr(function.typing_key, "__module__", None) != "_operator":
        return _NUMBAS[BaseFunction](function, context, args, kws)
    found, key = function.__dict__.setdefault("call_types", {}), (context, *args)
    if key not in found:
        found[key] = _NUMBAS[BaseFunction](function, context, args, kws)
    return found[key]


def _find_lifetimes(processor, emit_dels=False, extend_lifetimes=False):
    """Do what numba's `run` does, but for what generators and Python objects alone need."""
    code = processor.func_ir
    if code.is_generator:
        _NUMBAS[PostProcessor](processor, emit_dels, extend_lifetimes)
        return
    code.blocks = canonicalize_cfg(code.blocks)
    code.variable_lifetime, code.generator_info = VariableLifetime(code.blocks), None
    if emit_dels:
        processor._insert_var_dels(extend_lifetimes)


# Methods of numba, and ours in their place.
_OURS = {
    _OverloadFunctionTemplate: ("_get_impl", _implementation),
    BaseFunction: ("get_call_type", _call_type),
    PostProcessor: ("run", _find_lifetimes),
}
_NUMBAS = {owner: getattr(owner, name) for owner, (name, _) in _OURS.items()}


class _Compiling(event.Listener):
    """Puts our code library in numba's place while a kernel is being compiled."""

    def on_start(self, event):
        """Set up the compilation if the event is of a kernel."""
        kernel = event.data["dispatcher"]
        if not isinstance(getattr(kernel, "_cache", None), KernelCache):
            return
        if kernel.by_parts:
            kernel._compiler.py_func = in_parts(kernel.py_func)
        _kernels.append(kernel)
        if len(_kernels) > 1:
            return
        # A compiler makes millions of objects that live until it ends: without the search for
        # cycles among them it takes a tenth less time.
        self._collects = gc.isenabled()
        gc.disable()
        if IS_TESTED:
            codegen = kernel.targetctx.codegen()
            codegen._library_class = _Library
            codegen.set_env = functools.partial(_set_environment, codegen)
            # numba makes an event of each call of LLVM.
            self._told, ffi.lib._lock._cblist = ffi.lib._lock._cblist, []
            for owner, (name, ours) in _OURS.items():
                setattr(owner, name, ours)

    def on_end(self, event):
        """Undo the setting up by `on_start` if the event is of a kernel."""
        kernel = event.data["dispatcher"]
        if not isinstance(getattr(kernel, "_cache", None), KernelCache):
            return
        _kernels.pop()
        if _kernels:
            return
        if self._collects:
            gc.enable()
        if IS_TESTED:
            codegen = kernel.targetctx.codegen()
            del codegen._library_class, codegen.set_env
            ffi.lib._lock._cblist = self._told
            for owner, (name, _) in _OURS.items():
                setattr(owner, name, _NUMBAS[owner])


def watch():
    """From now on compile the functions that kernels call as this module's docstring says."""
    event.register("numba:compile", _Compiling())
