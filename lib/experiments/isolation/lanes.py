"""Numbers of several runs as one: inside kernels, vectors of the processor with a lane for each run.

Channel c of run r stands at c * runs + r. `together` is a tuple as long as the runs are many, so that the compiler
knows their number, or None for a single run, whose numbers are plain. A kernel written with `take` and `put` serves
both: every lane goes through the operations of a single run in their order, to the same bits.

What stands here becomes part of kernels' machine code, whose folder (`stillwork.base.kernel_folder`) is named after
every file that says ``stillwork.base.kernel``, as this sentence does.
"""

import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models, register_default
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

NUMBER = 8  # bytes; an array's lanes need not start at a multiple of their size


class Lanes(types.Type):
    """Vector of so many float64."""

    def __init__(self, count: int):
        self.count = count
        super().__init__(name=f"Lanes({count})")


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


class _Arithmetic(AbstractTemplate):
    """Lanes with lanes, or with one number for all of them."""

    def generic(self, arguments, options):
        lanes = [each for each in arguments if isinstance(each, Lanes)]
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


def _kind(array, together):
    """Type of a channel's numbers."""
    if isinstance(together, types.NoneType):
        return array.dtype
    if array.dtype != types.float64 or array.layout != "C":
        raise TypingError(f"lanes are taken from contiguous arrays of float64, not from {array}")
    return Lanes(len(together))


def _pointer(context, builder, signature, arguments):
    """Where a channel's first number stands."""
    kind, place, together = signature.args[0], signature.args[1], signature.args[-1]
    places = (
        [arguments[1]] if isinstance(place, types.Integer) else cgutils.unpack_tuple(builder, arguments[1])
    )
    if not isinstance(together, types.NoneType):
        places[-1] = builder.mul(places[-1], context.get_constant(types.intp, len(together)))
    array = make_array(kind)(context, builder, arguments[0])
    return cgutils.get_item_pointer(context, builder, kind, array, places)


def _room(context, builder, signature, arguments, kind):
    """The pointer of its kind, and the alignment."""
    pointer = _pointer(context, builder, signature, arguments)
    if not isinstance(kind, Lanes):
        return pointer, None
    return builder.bitcast(pointer, context.get_value_type(kind).as_pointer()), NUMBER


@intrinsic
def runs_of(context, together):
    """How many runs there are, a constant for the compiler."""
    count = 1 if isinstance(together, types.NoneType) else len(together)
    return types.intp(together), lambda context, *given: context.get_constant(types.intp, count)


@intrinsic
def same(context, number, together):
    """One number for every run."""
    kind = types.float64 if isinstance(together, types.NoneType) else Lanes(len(together))
    return kind(kind, together), lambda context, builder, signature, arguments: arguments[0]


@intrinsic
def take(context, array, place, together):
    """The numbers of a channel at `place`, an index or one for each axis, of which the last counts channels."""
    kind = _kind(array, together)

    def generate(context, builder, signature, arguments):
        pointer, align = _room(context, builder, signature, arguments, kind)
        return builder.load(pointer, align=align)

    return kind(array, types.unliteral(place), together), generate


@intrinsic
def put(context, array, place, numbers, together):
    """Write the numbers of a channel, or one number for all runs."""
    kind = _kind(array, together)

    def generate(context, builder, signature, arguments):
        pointer, align = _room(context, builder, signature, arguments, kind)
        builder.store(arguments[2], pointer, align=align)
        return context.get_dummy_value()

    return types.void(array, types.unliteral(place), kind, together), generate


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
