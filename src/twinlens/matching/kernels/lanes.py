"""SIMD vectors as numba values: `Lanes(dtype, n)` holds n numbers, and one operation acts on all of them.

numba's loop vectoriser gives up on kernels with many arrays, since it cannot know that they do not overlap. Here the
vectors are written down instead, as portable LLVM vector code that becomes AVX-512, AVX2, SSE or NEON instructions.
n need not fit one register: LLVM splits it. Integer arithmetic wraps around; unsigned unless a function says otherwise.
"""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

BIT = ir.IntType(1)
INT32 = ir.IntType(32)
INT64 = ir.IntType(64)


class Lanes(types.Type):
    """The numba type of n numbers of one dtype side by side."""

    def __init__(self, dtype: Any, n: int) -> None:
        self.dtype, self.n = dtype, n
        super().__init__(name=f"Lanes({dtype} x {n})")

    @property
    def is_float(self) -> bool:
        return isinstance(self.dtype, types.Float)

    @property
    def suffix(self) -> str:
        """How LLVM's intrinsics spell this type: v64i16, v16f32."""
        return f"v{self.n}{'f' if self.is_float else 'i'}{self.dtype.bitwidth}"


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """In LLVM a `Lanes` is a vector in registers."""

    def __init__(self, manager: Any, lanes: Lanes) -> None:
        element = manager.lookup(lanes.dtype).get_value_type()
        super().__init__(manager, lanes, ir.VectorType(element, lanes.n))


def splat_of(builder: Any, scalar: Any, n: int) -> Any:
    """The scalar in all of n lanes."""
    undefined = ir.Constant(ir.VectorType(scalar.type, n), ir.Undefined)
    first = builder.insert_element(undefined, scalar, INT32(0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(INT32, n), [0] * n))


def _narrow(builder: Any, index: Any, width: Any) -> Any:
    return index if width.width == index.type.width else builder.trunc(index, width)


def call_intrinsic(builder: Any, name: str, result: Any, args: list[Any]) -> Any:
    """Call one of LLVM's own functions."""
    signature = ir.FunctionType(result, [arg.type for arg in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), args)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, n: int) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(context.get_data_type(array_type.dtype), n)
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def load_of(context: Any, builder: Any, array_type: Any, array: Any, index: Any, n: int) -> Any:
    """n elements from array[index] on."""
    place = _pointer(context, builder, array_type, array, index, n)
    return builder.load(place, align=array_type.dtype.bitwidth // 8)


def store_to(context: Any, builder: Any, array_type: Any, array: Any, index: Any, value: Any) -> None:
    """Write a vector to array[index] and on."""
    place = _pointer(context, builder, array_type, array, index, value.type.count)
    builder.store(value, place, align=array_type.dtype.bitwidth // 8)


@intrinsic(prefer_literal=True)
def load(_typing: Any, array: Any, index: Any, n: Any) -> Any:
    """load(array, index, n): the n elements from array[index] on, of a contiguous 1-D array; not bounds-checked."""
    result = Lanes(array.dtype, n.literal_value)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return load_of(context, builder, signature.args[0], args[0], args[1], result.n)

    return result(array, types.intp, n), generate


@intrinsic
def store(_typing: Any, array: Any, index: Any, value: Any) -> Any:
    """store(array, index, value): write the lanes to array[index] and on; not bounds-checked."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        store_to(context, builder, signature.args[0], *args)
        return context.get_dummy_value()

    return types.none(array, types.intp, value), generate


@intrinsic
def read(_typing: Any, array: Any, index: Any) -> Any:
    """read(array, index): array[index] of a contiguous 1-D array; not bounds-checked, nor counted from the end."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.load(builder.gep(data, [args[1]]))

    return array.dtype(array, types.intp), generate


@intrinsic
def write(_typing: Any, array: Any, index: Any, value: Any) -> Any:
    """write(array, index, value): array[index] = value, as `read` reads; the value is of the array's dtype."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        builder.store(args[2], builder.gep(data, [args[1]]))
        return context.get_dummy_value()

    return types.none(array, types.intp, array.dtype), generate


@intrinsic(prefer_literal=True)
def lane(_typing: Any, value: Any, index: Any) -> Any:
    """lane(value, index): one of the lanes, a scalar; the index is written down."""
    place = INT32(index.literal_value)

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.extract_element(args[0], place)

    return value.dtype(value, index), generate


@intrinsic
def splat(_typing: Any, scalar: Any, like: Any) -> Any:
    """splat(scalar, like): the scalar in as many lanes as `like` has."""
    result = Lanes(scalar, like.n)

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return splat_of(builder, args[0], like.n)

    return result(scalar, like), generate


def _conversion(source: Lanes, target: Any) -> str:
    """The name of the LLVM instruction that takes the source's numbers to the target's dtype; "" for none."""
    wide, narrow = target.bitwidth, source.dtype.bitwidth
    if source.is_float and isinstance(target, types.Float):
        return "" if wide == narrow else ("fpext" if wide > narrow else "fptrunc")
    if source.is_float:
        return "fptosi" if target.signed else "fptoui"
    if isinstance(target, types.Float):
        return "sitofp" if source.dtype.signed else "uitofp"
    if wide == narrow:
        return ""
    return "trunc" if wide < narrow else ("sext" if source.dtype.signed else "zext")


@intrinsic
def convert(_typing: Any, value: Any, like: Any) -> Any:
    """convert(value, like): the same numbers in the dtype of `like`."""
    result = Lanes(like.dtype, value.n)
    instruction = _conversion(value, like.dtype)

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        if not instruction:
            return args[0]
        return getattr(builder, instruction)(args[0], context.get_value_type(result))

    return result(value, like), generate


def _binary(integer: str, floating: str) -> Any:
    @intrinsic
    def function(_typing: Any, a: Any, b: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            return getattr(builder, floating if a.is_float else integer)(*args)

        return a(a, b), generate

    return function


def _overload(symbol: Callable[..., Any], function: Any) -> None:
    @overload(symbol, inline="always", strict=False)
    def choose(a: Any, b: Any) -> Any:
        if isinstance(a, Lanes) and a == b:
            return lambda a, b: function(a, b)
        return None


_overload(operator.add, _binary("add", "fadd"))
_overload(operator.sub, _binary("sub", "fsub"))
_overload(operator.mul, _binary("mul", "fmul"))
_overload(operator.truediv, _binary("fdiv", "fdiv"))
_overload(operator.xor, _binary("xor", "xor"))


@intrinsic
def distance(_typing: Any, a: Any, b: Any) -> Any:
    """distance(a, b): |a - b| in each lane, without overflow for unsigned numbers."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        if a.is_float:
            return call_intrinsic(builder, f"llvm.fabs.{a.suffix}", args[0].type, [builder.fsub(*args)])
        high = call_intrinsic(builder, f"llvm.umax.{a.suffix}", args[0].type, args)
        low = call_intrinsic(builder, f"llvm.umin.{a.suffix}", args[0].type, args)
        return builder.sub(high, low)

    return a(a, b), generate


def _pairwise(integer: str, floating: str) -> Any:
    @intrinsic
    def function(_typing: Any, a: Any, b: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            if not a.is_float:
                sign = "s" if a.dtype.signed else "u"
                return call_intrinsic(builder, f"llvm.{sign}{integer}.{a.suffix}", args[0].type, args)
            return builder.select(builder.fcmp_ordered(floating, *args), *args)

        return a(a, b), generate

    return function


smaller = _pairwise("min", "<")
larger = _pairwise("max", ">")


@intrinsic
def ones(_typing: Any, value: Any) -> Any:
    """ones(value): how many bits are set in each lane."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return call_intrinsic(builder, f"llvm.ctpop.{value.suffix}", args[0].type, [args[0]])

    return value(value), generate


@intrinsic
def as_floats(_typing: Any, value: Any) -> Any:
    """as_floats(value): the float32 numbers whose bits int32 lanes, or one int32, hold."""
    result = Lanes(types.float32, value.n) if isinstance(value, Lanes) else types.float32

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(result))

    return result(value), generate


@intrinsic
def width_of(_typing: Any, value: Any) -> Any:
    """width_of(value): how many lanes there are."""

    def generate(_context: Any, _builder: Any, _signature: Any, _args: Any) -> Any:
        return INT64(value.n)

    return types.int64(value), generate


@intrinsic
def inside(_typing: Any, value: Any, start: Any, stop: Any, fill: Any) -> Any:
    """inside(value, start, stop, fill): lanes start <= i < stop kept, all others set to the scalar `fill`.

    start and stop lie in [-n, 2 n], so that they fit the lanes' own width.
    """

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        bound = ir.IntType(value.dtype.bitwidth)
        lanes = ir.Constant(ir.VectorType(bound, value.n), list(range(value.n)))
        above = builder.icmp_signed(">=", lanes, splat_of(builder, _narrow(builder, args[1], bound), value.n))
        below = builder.icmp_signed("<", lanes, splat_of(builder, _narrow(builder, args[2], bound), value.n))
        return builder.select(builder.and_(above, below), args[0], splat_of(builder, args[3], value.n))

    return value(value, types.int64, types.int64, value.dtype), generate
