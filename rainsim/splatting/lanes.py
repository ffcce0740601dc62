"""Sixteen pixels at once: the blender's inner loop, written in vector instructions.

LLVM does not keep sixteen pixels in registers over a list of splats by itself: plain loops store
and load nine rows of sixteen numbers for every splat. This function keeps them.
The same formula in plain Python is the tests' reference.
"""

from __future__ import annotations

import numpy as np

from rainsim.jit import cgutils, intrinsic, ir, types
from rainsim.splatting.project import BLOCK_HALF, MIN_ALPHA_LOG2

LANES = 16
CHANNELS = 9  # transmittance; colour (3), depth, normal (3), plane distance
FLAGS = ("contract", "nsz", "arcp", "reassoc")

TRANSMITTANCE_STOP = np.float32(1e-4)  # what is behind cannot change an 8-bit image
LAST_LIGHT = 1e-4  # transmittance under which the training codes let no splat take a pixel
MAX_ALPHA = 0.999  # gsplat 1.5; the original code has 0.99
# 2^x on [-1.02, 0], Chebyshev interpolation of degree 5; the eighth power of it is within 1.3e-6.
EXP2 = (0.999999937, 0.693142739, 0.240175324, 0.0552866627, 0.00919464691, 0.000940499363)

_float = ir.FloatType()
_vector = ir.VectorType(_float, LANES)
_word = ir.IntType(32)
_words = ir.VectorType(_word, LANES)
_int = ir.IntType(64)


def _constant(value):
    return ir.Constant(_vector, [float(value)] * LANES)


class _Tools:
    """Arithmetic on vectors of sixteen numbers, and on a splat's record at `base`."""

    def __init__(self, builder, record, base):
        self.builder, self.record, self.base = builder, record, base

    def add(self, a, b):
        return self.builder.fadd(a, b, flags=FLAGS)

    def sub(self, a, b):
        return self.builder.fsub(a, b, flags=FLAGS)

    def mul(self, a, b):
        return self.builder.fmul(a, b, flags=FLAGS)

    def size(self, vector):
        """The numbers of a vector without their signs."""
        bits = self.builder.bitcast(vector, _words)
        bits = self.builder.and_(bits, ir.Constant(_words, [0x7FFFFFFF] * LANES))
        return self.builder.bitcast(bits, _vector)

    def copies(self, number):
        """Sixteen copies of a number."""
        undefined = ir.Constant(ir.VectorType(number.type, LANES), ir.Undefined)
        single = self.builder.insert_element(undefined, number, ir.Constant(_word, 0))
        mask = ir.Constant(_words, [0] * LANES)
        return self.builder.shuffle_vector(single, undefined, mask)

    def spread(self, c):
        """Sixteen copies of number c of the record."""
        place = self.builder.add(self.base, ir.Constant(_int, c))
        return self.copies(self.builder.load(self.builder.gep(self.record, [place])))


@intrinsic
def meets_blocks(typingctx, record, splat, x, y):
    """Return 16 bits: which blocks of 4 x 4 pixels of a tile the splat can reach.

    A line parts a block from the ellipse if it lies across the exponent's gradient g at the block's
    centre d and the ellipse, which reaches R sqrt(g.d) along g, ends before the block begins, at
    g.d less BLOCK_HALF (|gx| + |gy|).

    Parameters
    ----------
    record : ndarray of shape (n, 16), float32
    splat : int64
    x, y : float32
        Image point at the middle of the tile's first block.
    """

    def codegen(context, builder, signature, arguments):
        array = cgutils.create_struct_proxy(signature.args[0])(context, builder, arguments[0])
        tools = _Tools(builder, array.data, builder.mul(arguments[1], ir.Constant(_int, 16)))
        add, sub, mul, spread = tools.add, tools.sub, tools.mul, tools.spread
        right = ir.Constant(_vector, [4.0 * (i % 4) for i in range(LANES)])
        down = ir.Constant(_vector, [4.0 * (i // 4) for i in range(LANES)])
        dx = sub(add(tools.copies(arguments[2]), right), spread(0))
        dy = sub(add(tools.copies(arguments[3]), down), spread(1))
        cross = mul(spread(3), _constant(0.5))
        # Half the gradient of the exponent; the line across it is what may part block and ellipse.
        gx = add(mul(spread(2), dx), mul(cross, dy))
        gy = add(mul(cross, dx), mul(spread(4), dy))
        exponent = add(mul(dx, gx), mul(dy, gy))
        support = mul(add(tools.size(gx), tools.size(gy)), _constant(BLOCK_HALF))
        beyond = sub(exponent, support)
        within = builder.fcmp_ordered("<=", beyond, _constant(0))
        near = builder.fcmp_ordered("<=", mul(beyond, beyond), mul(spread(14), exponent))
        near = builder.or_(within, near)
        bits = builder.bitcast(near, ir.IntType(LANES))
        return builder.zext(bits, _int)

    return types.int64(record, splat, x, y), codegen


@intrinsic
def prefetch(typingctx, record, splat):
    """Ask for the cache line of record number `splat` before it is needed."""

    def codegen(context, builder, signature, arguments):
        array = cgutils.create_struct_proxy(signature.args[0])(context, builder, arguments[0])
        place = builder.gep(array.data, [builder.mul(arguments[1], ir.Constant(_int, 16))])
        word, byte = ir.IntType(32), ir.IntType(8).as_pointer()
        function = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.VoidType(), [byte, word, word, word]),
            "llvm.prefetch.p0",
        )
        read, high, data = (ir.Constant(word, n) for n in (0, 3, 1))
        builder.call(function, [builder.bitcast(place, byte), read, high, data])
        return context.get_dummy_value()

    return types.void(record, splat), codegen


@intrinsic
def put_chosen(typingctx, bits, number, k, block, chosen, place):
    """Write the numbers of the splats, of sixteen, that a block has to blend; return how many.

    Parameters
    ----------
    bits, number : ndarray of uint32
        From `k` on: the masks of sixteen splats, as `meets_blocks` returns them, and their numbers.
    k, block : int64
    chosen : ndarray of uint32
        From `place` on sixteen numbers are written, of which only the first are valid.
    place : int64
    """

    def codegen(context, builder, signature, arguments):
        def pointer(k):
            array = signature.args[k]
            return cgutils.create_struct_proxy(array)(context, builder, arguments[k]).data

        def at(base, index):
            return builder.bitcast(builder.gep(base, [index]), _words.as_pointer())

        def load(base):
            value = builder.load(at(base, arguments[2]))
            value.align = 4
            return value

        tools = _Tools(builder, None, None)
        one = builder.shl(ir.Constant(_word, 1), builder.trunc(arguments[3], _word))
        wanted = builder.and_(load(pointer(0)), tools.copies(one))
        mask = builder.icmp_unsigned("!=", wanted, ir.Constant(_words, [0] * LANES))
        masks = ir.VectorType(ir.IntType(1), LANES)
        compress = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(_words, [_words, masks, _words]),
            f"llvm.experimental.vector.compress.v{LANES}i32",
        )
        packed = builder.call(compress, [load(pointer(1)), mask, ir.Constant(_words, ir.Undefined)])
        builder.store(packed, at(pointer(4), arguments[5])).align = 4
        count = builder.ctpop(builder.bitcast(mask, ir.IntType(LANES)))
        return builder.zext(count, _int)

    return types.int64(bits, number, k, block, chosen, place), codegen


# long: it writes out the machine code of one loop, instruction by instruction
@intrinsic
def blend_lanes(typingctx, record, chosen, first, last, state, at, x, y, halfway, drop):
    """Blend the splats record[chosen[first:last]] into sixteen pixels, front to back.

    Returns whether more than TRANSMITTANCE_STOP of the light passes in any of them.

    Parameters
    ----------
    record : ndarray of shape (n, 16), float32
        See `rainsim.splatting.project`.
    chosen : ndarray of uint32
    first, last : int64
    state : ndarray of shape (m,), float32
        From `at` on: nine rows of sixteen numbers, modified in place.
    at : int64
    x, y : float32
        Image point of the first pixel; the others follow in rows of four.
    halfway : literal int
        1: the depth row gets, as bits, one more than the number of the record that brings the
        transmittance to 0.5.
    drop : literal int
        1: a splat that would bring the transmittance to LAST_LIGHT is left out, and the pixel ends:
        its transmittance is negative from then on.
    """
    if not all(isinstance(rule, types.IntegerLiteral) for rule in (halfway, drop)):
        return None
    find_half, drop_last = halfway.literal_value, drop.literal_value

    # long: the instructions of one loop, as said above
    def codegen(context, builder, signature, arguments):
        def pointer(k):
            array = signature.args[k]
            struct = cgutils.create_struct_proxy(array)(context, builder, arguments[k])
            return struct.data

        record_at, chosen_at, state_at = pointer(0), pointer(1), pointer(4)
        begin, end, offset = arguments[2], arguments[3], arguments[5]
        vector_pointer = _vector.as_pointer()

        def load(base, index, align=4):
            place = builder.bitcast(builder.gep(base, [index]), vector_pointer)
            value = builder.load(place)
            value.align = align
            return value

        def row(k):
            return builder.add(offset, ir.Constant(_int, k * LANES))

        tools = _Tools(builder, record_at, None)
        add, sub, mul, spread = tools.add, tools.sub, tools.mul, tools.spread
        px = add(
            tools.copies(arguments[6]), ir.Constant(_vector, [float(i % 4) for i in range(LANES)])
        )
        py = add(
            tools.copies(arguments[7]), ir.Constant(_vector, [float(i // 4) for i in range(LANES)])
        )
        initial = [load(state_at, row(k)) for k in range(CHANNELS)]
        entry = builder.block
        loop = builder.append_basic_block("splat")
        done = builder.append_basic_block("done")
        builder.cbranch(builder.icmp_signed("<", begin, end), loop, done)

        builder.position_at_end(loop)
        k = builder.phi(_int)
        k.add_incoming(begin, entry)
        rows = [builder.phi(_vector) for _ in range(CHANNELS)]
        for phi, value in zip(rows, initial, strict=True):
            phi.add_incoming(value, entry)
        splat = builder.load(builder.gep(chosen_at, [k]))
        tools.base = builder.mul(builder.zext(splat, _int), ir.Constant(_int, 16))

        dx, dy = sub(px, spread(0)), sub(py, spread(1))
        along = mul(dx, add(mul(spread(2), dx), mul(spread(3), dy)))
        power = sub(sub(spread(5), along), mul(spread(4), mul(dy, dy)))
        above = builder.fcmp_ordered(">=", power, _constant(MIN_ALPHA_LOG2 / 8))
        e = _constant(EXP2[-1])  # below the threshold this may be anything: it is not selected
        for c in EXP2[-2::-1]:
            e = add(mul(e, power), _constant(c))
        e = mul(e, e)
        e = mul(e, e)
        e = mul(e, e)
        most = _constant(MAX_ALPHA)
        e = builder.select(builder.fcmp_ordered("<", e, most), e, most)
        alpha = builder.select(above, e, _constant(0))
        weight = mul(alpha, rows[0])
        clear = sub(rows[0], weight)
        after = [clear]
        if drop_last:
            kept = builder.fcmp_ordered(">", clear, _constant(LAST_LIGHT))
            weight = builder.select(kept, weight, _constant(0))
            sign = ir.Constant(_words, [1 << 31] * LANES)
            ended = builder.or_(builder.bitcast(rows[0], _words), sign)
            after = [builder.select(kept, clear, builder.bitcast(ended, _vector))]
        for c in range(1, CHANNELS):
            if c == 4 and find_half:
                half = _constant(0.5)
                crossed = builder.and_(
                    builder.fcmp_ordered(">", rows[0], half),
                    builder.fcmp_ordered("<=", clear, half),
                )
                number = tools.copies(builder.add(splat, ir.Constant(_word, 1)))
                number = builder.bitcast(number, _vector)
                after.append(builder.select(crossed, number, rows[c]))
            else:
                after.append(add(rows[c], mul(weight, spread(5 + c))))
        following = builder.add(k, ir.Constant(_int, 1))
        k.add_incoming(following, loop)
        for phi, value in zip(rows, after, strict=True):
            phi.add_incoming(value, loop)
        builder.cbranch(builder.icmp_signed("<", following, end), loop, done)

        builder.position_at_end(done)
        for c in range(CHANNELS):
            phi = builder.phi(_vector)
            phi.add_incoming(initial[c], entry)
            phi.add_incoming(after[c], loop)
            initial[c] = phi
        for c, value in enumerate(initial):
            place = builder.bitcast(builder.gep(state_at, [row(c)]), vector_pointer)
            builder.store(value, place).align = 4
        clear = builder.fcmp_ordered(">", initial[0], _constant(TRANSMITTANCE_STOP))
        bits = builder.bitcast(clear, ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(*[record, chosen, first, last, state, at, x, y, halfway, drop]), codegen
