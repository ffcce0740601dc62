"""Sixteen pixels at once: the blender's inner loop, written in vector instructions.

LLVM does not keep sixteen pixels in registers over a list of splats by itself: plain loops store
and load nine rows of sixteen numbers for every splat. This function keeps them.
The same formula in plain Python is the tests' reference.
"""

import numpy as np

from rainsim.jit import cgutils, intrinsic, ir, types
from rainsim.splatting import project

LANES = 16
CHANNELS = 9  # transmittance; colour (3), depth, normal (3), plane distance
DEPTH_ROW = 4  # of the channels
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


def _offsets(step):
    """Columns and rows of sixteen places in rows of four, `step` apart."""
    return (
        ir.Constant(_vector, [float(step * (i % 4)) for i in range(LANES)]),
        ir.Constant(_vector, [float(step * (i // 4)) for i in range(LANES)]),
    )


def _data(context, builder, signature, arguments, k):
    """Where the numbers of the array lie that is argument k."""
    return cgutils.create_struct_proxy(signature.args[k])(context, builder, arguments[k]).data


class _Tools:
    """Arithmetic on vectors of sixteen numbers, and on a splat's record.

    builder : llvmlite.ir.IRBuilder. Each call appends instructions at its end.
    record : llvmlite.ir.Value, optional. Where the records of the splats lie.
    """

    def __init__(self, builder, record=None):
        self.builder, self.record, self.base = builder, record, None

    def read(self, splat):
        """Let `spread` read the record number `splat`."""
        self.base = self.builder.mul(splat, ir.Constant(_int, project.RECORD))

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

    def vector_at(self, base, index, kind=_vector):
        """Where sixteen numbers begin, `index` numbers behind `base`."""
        return self.builder.bitcast(self.builder.gep(base, [index]), kind.as_pointer())

    def load(self, base, index, kind=_vector):
        """Sixteen numbers, which need not begin at a multiple of their size."""
        value = self.builder.load(self.vector_at(base, index, kind))
        value.align = 4
        return value

    def bits(self, mask):
        """The sixteen truths of a comparison as the bits of a number."""
        return self.builder.bitcast(mask, ir.IntType(LANES))

    def alpha(self, px, py):
        """The opacities of the splat at sixteen pixels; 0 where they are below the least."""
        add, sub, mul, spread = self.add, self.sub, self.mul, self.spread
        dx, dy = sub(px, spread(project.R_U)), sub(py, spread(project.R_V))
        along = mul(dx, add(mul(spread(project.R_CONIC), dx), mul(spread(project.R_CONIC + 1), dy)))
        power = sub(
            sub(spread(project.R_LEVEL), along), mul(spread(project.R_CONIC + 2), mul(dy, dy))
        )
        above = self.builder.fcmp_ordered(">=", power, _constant(project.MIN_ALPHA_LOG2 / 8))
        e = _constant(EXP2[-1])  # below the threshold this may be anything: it is not selected
        for c in EXP2[-2::-1]:
            e = add(mul(e, power), _constant(c))
        for _ in range(3):
            e = mul(e, e)
        most = _constant(MAX_ALPHA)
        e = self.builder.select(self.builder.fcmp_ordered("<", e, most), e, most)
        return self.builder.select(above, e, _constant(0))

    def ended_or(self, before, clear, weight):
        """Transmittance and weight by the rule that `drop` asks for."""
        kept = self.builder.fcmp_ordered(">", clear, _constant(LAST_LIGHT))
        weight = self.builder.select(kept, weight, _constant(0))
        sign = ir.Constant(_words, [1 << 31] * LANES)
        ended = self.builder.or_(self.builder.bitcast(before, _words), sign)
        return self.builder.select(kept, clear, self.builder.bitcast(ended, _vector)), weight

    def half_mark(self, before, clear, splat, mark):
        """The depth row by the rule that `halfway` asks for."""
        half = _constant(0.5)
        crossed = self.builder.and_(
            self.builder.fcmp_ordered(">", before, half),
            self.builder.fcmp_ordered("<=", clear, half),
        )
        number = self.copies(self.builder.add(splat, ir.Constant(_word, 1)))
        return self.builder.select(crossed, self.builder.bitcast(number, _vector), mark)

    def blended(self, rows, splat, px, py, find_half, drop_last):
        """The nine rows of sixteen pixels after splat number `splat`, a 32-bit number."""
        self.read(self.builder.zext(splat, _int))
        weight = self.mul(self.alpha(px, py), rows[0])
        clear = left = self.sub(rows[0], weight)
        if drop_last:
            left, weight = self.ended_or(rows[0], clear, weight)
        after = [left]
        for c in range(1, CHANNELS):
            if c == DEPTH_ROW and find_half:
                after.append(self.half_mark(rows[0], clear, splat, rows[c]))
            else:
                after.append(
                    self.add(rows[c], self.mul(weight, self.spread(project.R_COLOR - 1 + c)))
                )
        return after


@intrinsic
def meets_blocks(typingctx, record, splat, x, y):
    """Return 16 bits: which blocks of 4 x 4 pixels of a tile the splat can reach.

    A line parts a block from the ellipse if it lies across the exponent's gradient g at the block's
    centre d and the ellipse, which reaches R sqrt(g.d) along g, ends before the block begins, at
    g.d less BLOCK_HALF (|gx| + |gy|).

    record : float32 array (n, 16)
    splat : int64
    x, y : float32. Image point at the middle of the tile's first block.
    """

    def codegen(context, builder, signature, arguments):
        tools = _Tools(builder, _data(context, builder, signature, arguments, 0))
        tools.read(arguments[1])
        add, sub, mul, spread = tools.add, tools.sub, tools.mul, tools.spread
        right, down = _offsets(4)
        dx = sub(add(tools.copies(arguments[2]), right), spread(project.R_U))
        dy = sub(add(tools.copies(arguments[3]), down), spread(project.R_V))
        cross = mul(spread(project.R_CONIC + 1), _constant(0.5))
        # Half the gradient of the exponent; the line across it is what may part block and ellipse.
        gx = add(mul(spread(project.R_CONIC), dx), mul(cross, dy))
        gy = add(mul(cross, dx), mul(spread(project.R_CONIC + 2), dy))
        exponent = add(mul(dx, gx), mul(dy, gy))
        support = mul(add(tools.size(gx), tools.size(gy)), _constant(project.BLOCK_HALF))
        beyond = sub(exponent, support)
        within = builder.fcmp_ordered("<=", beyond, _constant(0))
        near = builder.fcmp_ordered(
            "<=", mul(beyond, beyond), mul(spread(project.R_REACH), exponent)
        )
        return builder.zext(tools.bits(builder.or_(within, near)), _int)

    return types.int64(record, splat, x, y), codegen


@intrinsic
def prefetch(typingctx, record, splat):
    """Ask for the cache line of record number `splat` before it is needed."""

    def codegen(context, builder, signature, arguments):
        record = _data(context, builder, signature, arguments, 0)
        place = builder.gep(record, [builder.mul(arguments[1], ir.Constant(_int, project.RECORD))])
        byte = ir.IntType(8).as_pointer()
        function = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.VoidType(), [byte, _word, _word, _word]),
            "llvm.prefetch.p0",
        )
        read, high, data = (ir.Constant(_word, n) for n in (0, 3, 1))
        builder.call(function, [builder.bitcast(place, byte), read, high, data])
        return context.get_dummy_value()

    return types.void(record, splat), codegen


@intrinsic
def put_chosen(typingctx, bits, number, k, block, chosen, place):
    """Write the numbers of the splats, of sixteen, that a block has to blend; return how many.

    bits, number : uint32 array. From `k` on: the masks of sixteen splats, as
        `meets_blocks` returns them, and their numbers.
    k, block : int64
    chosen : uint32 array. From `place` on sixteen numbers are written, of which
        only the first are valid.
    place : int64
    """

    def codegen(context, builder, signature, arguments):
        bits, number, chosen = (_data(context, builder, signature, arguments, k) for k in (0, 1, 4))
        tools = _Tools(builder)
        one = builder.shl(ir.Constant(_word, 1), builder.trunc(arguments[3], _word))
        wanted = builder.and_(tools.load(bits, arguments[2], _words), tools.copies(one))
        mask = builder.icmp_unsigned("!=", wanted, ir.Constant(_words, [0] * LANES))
        masks = ir.VectorType(ir.IntType(1), LANES)
        compress = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(_words, [_words, masks, _words]),
            f"llvm.experimental.vector.compress.v{LANES}i32",
        )
        numbers = tools.load(number, arguments[2], _words)
        packed = builder.call(compress, [numbers, mask, ir.Constant(_words, ir.Undefined)])
        builder.store(packed, tools.vector_at(chosen, arguments[5], _words)).align = 4
        return builder.zext(builder.ctpop(tools.bits(mask)), _int)

    return types.int64(bits, number, k, block, chosen, place), codegen


@intrinsic
def blend_lanes(typingctx, record, chosen, first, last, state, at, x, y, halfway, drop):
    """Blend the splats record[chosen[first:last]] into sixteen pixels, front to back.

    Returns whether more than TRANSMITTANCE_STOP of the light passes in any of them.

    record : float32 array (n, 16). See `rainsim.splatting.project`.
    chosen : uint32 array
    first, last : int64
    state : float32 array (m,). From `at` on: nine rows of sixteen numbers,
        modified in place.
    at : int64
    x, y : float32. Image point of the first pixel; the others follow in rows of
        four.
    halfway : literal int. 1: the depth row gets, as bits, one more than the
        number of the record that brings the transmittance to 0.5.
    drop : literal int. 1: a splat that would bring the transmittance to
        LAST_LIGHT is left out, and the pixel ends: its transmittance is negative
        from then on.
    """
    if not all(isinstance(rule, types.IntegerLiteral) for rule in (halfway, drop)):
        return None
    find_half, drop_last = halfway.literal_value, drop.literal_value

    def codegen(context, builder, signature, arguments):
        record, chosen, state = (
            _data(context, builder, signature, arguments, k) for k in (0, 1, 4)
        )
        begin, end, offset = arguments[2], arguments[3], arguments[5]
        tools = _Tools(builder, record)
        across, down = _offsets(1)
        px = tools.add(tools.copies(arguments[6]), across)
        py = tools.add(tools.copies(arguments[7]), down)

        def row(k):
            return builder.add(offset, ir.Constant(_int, k * LANES))

        initial = [tools.load(state, row(k)) for k in range(CHANNELS)]
        entry = builder.block
        loop, done = builder.append_basic_block("splat"), builder.append_basic_block("done")
        builder.cbranch(builder.icmp_signed("<", begin, end), loop, done)

        builder.position_at_end(loop)
        k = builder.phi(_int)
        k.add_incoming(begin, entry)
        rows = [builder.phi(_vector) for _ in range(CHANNELS)]
        splat = builder.load(builder.gep(chosen, [k]))
        after = tools.blended(rows, splat, px, py, find_half, drop_last)
        following = builder.add(k, ir.Constant(_int, 1))
        k.add_incoming(following, loop)
        for phi, first, value in zip(rows, initial, after, strict=True):
            phi.add_incoming(first, entry)
            phi.add_incoming(value, loop)
        builder.cbranch(builder.icmp_signed("<", following, end), loop, done)

        builder.position_at_end(done)
        last = [builder.phi(_vector) for _ in range(CHANNELS)]
        for c, (phi, first, value) in enumerate(zip(last, initial, after, strict=True)):
            phi.add_incoming(first, entry)
            phi.add_incoming(value, loop)
            builder.store(phi, tools.vector_at(state, row(c))).align = 4
        clear = builder.fcmp_ordered(">", last[0], _constant(TRANSMITTANCE_STOP))
        return builder.icmp_unsigned("!=", tools.bits(clear), ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(*[record, chosen, first, last, state, at, x, y, halfway, drop]), codegen
