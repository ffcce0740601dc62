"""A kernel's loops over `prange` are run by numba's threads, a part of the iterations each.

numba's own way, `parallel=True`, looks for more than such loops, types their bodies twice and makes
a ufunc of each, which takes a fifth of the time of compiling. Here a loop becomes a function of its
first and last iteration and of what it reads, and the kernel gives that to the threads. What a loop
writes but arrays is its own: it cannot add up a number over its iterations. Kernels raise nothing,
so an error in a part is not passed on.

As with numba's own the loop's variable is a uint64, of which arrays ask no sign.
"""

import ast
import inspect
import textwrap

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.targetconfig import ConfigStack
from numba.core.typed_passes import _reload_parfors
from numba.extending import intrinsic

_INDEX = ir.IntType(64)
_BYTES = ir.IntType(8).as_pointer()
# What a thread calls: arguments, sizes, steps, data.
_THREAD = ir.FunctionType(
    ir.VoidType(), [_BYTES.as_pointer(), _INDEX.as_pointer(), _INDEX.as_pointer(), _BYTES]
)


def in_parts(function):
    """Return the function of a kernel so that threads run its loops over `prange`."""
    kernel = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    kernel.decorator_list = []
    loops = _Loops(function, kernel)
    return _define(function, loops.visit(kernel), loops.runners)


class _Loops(ast.NodeTransformer):
    """Replaces loops over `prange` by calls of `runners`, functions that run them in threads."""

    def __init__(self, function, kernel):
        self._function, self.runners = function, {}
        self._variables = {node.arg for node in ast.walk(kernel) if isinstance(node, ast.arg)}
        self._variables |= _names(kernel, ast.Store)

    def visit_For(self, loop):
        """Return the call in place of a loop, or the loop if it is not over `prange`."""
        if not (isinstance(loop.iter, ast.Call) and ast.unparse(loop.iter.func) == "prange"):
            return self.generic_visit(loop)
        (count,) = map(ast.unparse, loop.iter.args)
        read = sorted(_names(loop, ast.Load) & self._variables - _names(loop, ast.Store))
        name = f"_part_{len(self.runners)}"
        part = ast.parse(f"def {name}({', '.join(['_first', '_last', *read])}): pass").body[0]
        loop.iter = ast.parse("range(_first, _last)", mode="eval").body
        part.body = [loop]
        self.runners[name] = _runner(_define(self._function, part, {}))
        return ast.copy_location(ast.parse(f"{name}({', '.join([count, *read])})").body[0], loop)


def _names(tree, context):
    """Return the names that a tree reads (ast.Load) or writes (ast.Store)."""
    named = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    return {node.id for node in named if isinstance(node.ctx, context)}


def _define(function, tree, used):
    """Return the function that a tree defines where another one stands; it uses more functions."""
    used = inspect.getclosurevars(function).nonlocals | used
    maker = ast.parse(f"def make({', '.join(used)}):\n    return {tree.name}")
    maker.body[0].body.insert(0, tree)
    ast.increment_lineno(maker, function.__code__.co_firstlineno - 1)  # for numba's errors
    code = compile(ast.fix_missing_locations(maker), function.__code__.co_filename, "exec")
    made = {}
    exec(code, function.__globals__, made)
    made = made["make"](**used)
    made.__module__, made.__qualname__ = function.__module__, function.__qualname__
    if tree.name != function.__name__:
        made.__qualname__ += tree.name
    return made


def _runner(part):
    """Return a function of a count and more that has threads run `part` for 0 to the count."""

    @intrinsic
    def run(typingctx, count, *given):
        def generate(context, builder, signature, arguments):
            count, given = arguments
            called = types.void(types.uint64, types.uint64, *signature.args[1])
            flags = ConfigStack.top_or_none().copy()
            flags.noalias = True  # as numba has it for such loops
            compiled = context._compile_subroutine_no_cache(builder, part, called, flags=flags)
            context.active_code_library._reload_init.add(_reload_parfors)  # starts the threads
            _reload_parfors()
            threads = builder.call(_declared(builder, "get_num_threads", _INDEX, []), [])
            values = [count, threads, *cgutils.unpack_tuple(builder, given)]
            data = cgutils.alloca_once(builder, ir.LiteralStructType([v.type for v in values]))
            for i, value in enumerate(values):
                builder.store(value, cgutils.gep_inbounds(builder, data, 0, i))
            thread = ir.Function(builder.module, _THREAD, f"{builder.function.name}{part.__name__}")
            thread.linkage = "internal"
            _fill(context, thread, data.type, compiled.fndesc, called)
            # The argument of a thread is the number of its part: a pointer that begins at 0 and
            # goes up by 1.
            numbers = cgutils.alloca_once_value(builder, _BYTES(None))
            size = cgutils.alloca_once_value(builder, threads)
            step = cgutils.alloca_once_value(builder, _INDEX(1))
            kinds = [_BYTES] * 5 + [_INDEX] * 3
            start = _declared(builder, "numba_parallel_for", ir.VoidType(), kinds)
            pointers = [builder.bitcast(p, _BYTES) for p in (thread, numbers, size, step, data)]
            builder.call(start, [*pointers, _INDEX(0), _INDEX(1), threads])
            return context.get_dummy_value()

        return types.void(types.int64, types.StarArgTuple(given)), generate

    return run


def _uncounted(context, builder, kind, value):
    """Return a value whose arrays have no owner, so that threads do not count their references.

    All threads would count in one place, which takes longer than what they do.
    """
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo, array.parent = (
            cgutils.get_null_value(p.type) for p in (array.meminfo, array.parent)
        )
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for i, part in enumerate(kind):
            field = _uncounted(context, builder, part, builder.extract_value(value, i))
            value = builder.insert_value(value, field, i)
    return value


def _fill(context, thread, data, part, called):
    """Write what a thread does: it calls the part with its share of the iterations."""
    builder = ir.IRBuilder(thread.append_basic_block())
    numbers, sizes, _, given = thread.args
    given = builder.bitcast(given, data)
    fields = range(len(data.pointee.elements))
    values = [builder.load(cgutils.gep_inbounds(builder, given, 0, i)) for i in fields]
    count, threads = values[:2]
    number = builder.ptrtoint(builder.load(numbers), _INDEX)
    ends = number, builder.add(number, builder.load(sizes))
    ends = [builder.sdiv(builder.mul(count, end), threads) for end in ends]
    kinds = called.args[2:]
    values = [
        _uncounted(context, builder, kind, value)
        for kind, value in zip(kinds, values[2:], strict=True)
    ]
    context.call_internal_no_propagate(builder, part, called, [*ends, *values])
    builder.ret_void()


def _declared(builder, name, result, arguments):
    kind = ir.FunctionType(result, arguments)
    return cgutils.get_or_insert_function(builder.module, kind, name)
