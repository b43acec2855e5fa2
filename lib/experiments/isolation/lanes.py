"""Numbers of several runs as one: inside kernels, vectors of the processor with a lane for each run.

Channel c of run r stands at c * runs + r. `lanes` shows such arrays as arrays of channels, whose items hold that channel
of every run: a kernel written for one run then serves several, and every lane goes through the operations of a single
run in their order, to the same bits. `together` is a tuple as long as the runs are many, so that the compiler knows
their number, or None for a single run, whose arrays stay as they are.

What stands here becomes part of kernels' machine code: the type's name holds this file's digest, by which it is kept.
"""

import hashlib
import operator
from pathlib import Path

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models, register_default
from numba.core.errors import TypingError
from numba.core.imputils import impl_ret_borrowed, lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

NUMBER = 8  # bytes
SOURCE = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]


class Lanes(types.Type):
    """Vector of so many float64; one number is taken for all of them."""

    def __init__(self, count: int):
        self.count = count
        super().__init__(name=f"Lanes({count}, {SOURCE})")

    def can_convert_from(self, context, other):
        """What a variable may hold before it holds lanes."""
        return Conversion.safe if isinstance(other, types.Float) else None


class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, ir.VectorType(ir.DoubleType(), kind.count))


def _broadcast(context, builder, source, target, value):
    number = context.cast(builder, value, source, types.float64)
    vector = ir.VectorType(ir.DoubleType(), target.count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.IntType(32)(0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), target.count), [0] * target.count)
    return builder.shuffle_vector(first, first, places)


register_default(Lanes)(_LanesModel)
lower_cast(types.Float, Lanes)(_broadcast)
lower_cast(types.Integer, Lanes)(_broadcast)


class _Arithmetic(AbstractTemplate):
    """Lanes with lanes, or with one number for all of them."""

    def generic(self, arguments, options):
        lanes = [argument for argument in arguments if isinstance(argument, Lanes)]
        if lanes and all(each == lanes[0] or isinstance(each, types.Float) for each in arguments):
            return lanes[0](*[lanes[0]] * len(arguments))
        return None


def _lower(instruction: str, operands: int, *operations):
    def lowered(context, builder, signature, arguments):
        return getattr(builder, instruction)(*arguments)

    for operation in operations:
        infer_global(operation)(type(operation.__name__, (_Arithmetic,), {}))
        lower_builtin(operation, *[Lanes] * operands)(lowered)


_lower("fadd", 2, operator.add, operator.iadd)
_lower("fsub", 2, operator.sub, operator.isub)
_lower("fmul", 2, operator.mul, operator.imul)
_lower("fdiv", 2, operator.truediv)
_lower("fneg", 1, operator.neg)


@intrinsic
def lanes(context, array, together):
    """The same memory, with the numbers of all runs as one item; of a tuple each array."""
    if isinstance(together, types.NoneType):

        def as_it_is(context, builder, signature, arguments):
            return impl_ret_borrowed(context, builder, array, arguments[0])

        return array(array, together), as_it_is
    count = len(together)
    if count & (count - 1):
        raise TypingError(f"together holds {count} runs; give a power of two, as vectors are long")
    if not isinstance(array, types.BaseTuple):
        shown = _shown(array, count)
        return shown(array, together), lambda context, builder, signature, arguments: impl_ret_borrowed(
            context, builder, shown, _show(context, builder, array, arguments[0], count)
        )
    shown = types.Tuple([_shown(each, count) for each in array])

    def each_shown(context, builder, signature, arguments):
        parts = zip(array, cgutils.unpack_tuple(builder, arguments[0]), strict=True)
        views = [_show(context, builder, kind, value, count) for kind, value in parts]
        return impl_ret_borrowed(context, builder, shown, context.make_tuple(builder, shown, views))

    return shown(array, together), each_shown


def _shown(kind, count):
    """Type of an array whose items are lanes, which need not start at a multiple of their size."""
    if kind.dtype != types.float64 or kind.layout != "C":
        raise TypingError(f"lanes are taken from contiguous arrays of float64, not from {kind}")
    return types.Array(Lanes(count), kind.ndim, "C", aligned=False)


def _show(context, builder, kind, array, count):
    """An array of `kind` with a last axis as much shorter as an item is longer."""
    wide = make_array(kind)(context, builder, array)
    view = make_array(_shown(kind, count))(context, builder)
    *before, last = cgutils.unpack_tuple(builder, wide.shape)
    populate_array(
        view,
        data=builder.bitcast(wide.data, view.data.type),
        shape=[*before, builder.udiv(last, last.type(count))],
        strides=[*cgutils.unpack_tuple(builder, wide.strides)[:-1], last.type(NUMBER * count)],
        itemsize=NUMBER * count,
        meminfo=wide.meminfo,
        parent=wide.parent,
    )
    return view._getvalue()


@intrinsic
def at_most(context, left, right):
    """Whether left <= right, of lanes in every one; false for NaN."""
    lanes = [each for each in (left, right) if isinstance(each, Lanes)]
    kind = lanes[0] if lanes else types.float64

    def generate(context, builder, signature, arguments):
        below = builder.fcmp_ordered("<=", *arguments)
        if not lanes:
            return below
        bits = builder.bitcast(below, ir.IntType(kind.count))
        return builder.icmp_unsigned("==", bits, ir.Constant(bits.type, -1))

    return types.boolean(kind, kind), generate
