"""SIMD vectors as Numba values: a `Lanes` value holds `LANES` numbers, and one operation acts on all of them.

LLVM does not vectorise the loops of the searching kernels by itself, because it cannot prove that their arrays do not
overlap. This module therefore adds a vector type to Numba. Its operations are portable LLVM vector instructions, which
become AVX-512, AVX2, SSE or NEON code; LLVM splits a vector that is wider than a register. It is the only module that
builds LLVM code. Integer arithmetic wraps around.
"""

import operator
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    lower_builtin,
    models,
    register_model,
    type_callable,
)

from twinlens.matching.kernels import LANES

BIT = ir.IntType(1)
INT32 = ir.IntType(32)
INT64 = ir.IntType(64)


class Lanes(types.Type):
    """The Numba type of LANES numbers of one dtype."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        super().__init__(name=f"Lanes({dtype} x {LANES})")

    @property
    def is_float(self) -> bool:
        return isinstance(self.dtype, types.Float)

    @property
    def suffix(self) -> str:
        """The type's name in LLVM intrinsics, such as v32i16."""
        return f"v{LANES}{'f' if self.is_float else 'i'}{self.dtype.bitwidth}"


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """A `Lanes` value is an LLVM vector."""

    def __init__(self, manager: Any, lanes: Lanes) -> None:
        element = manager.lookup(lanes.dtype).get_value_type()
        super().__init__(manager, lanes, ir.VectorType(element, LANES))


def _splat(builder: Any, scalar: Any) -> Any:
    # LLVM's idiom for a broadcast, which it compiles to one instruction.
    undefined = ir.Constant(ir.VectorType(scalar.type, LANES), ir.Undefined)
    first = builder.insert_element(undefined, scalar, INT32(0))
    return builder.shuffle_vector(
        first, undefined, ir.Constant(ir.VectorType(INT32, LANES), [0] * LANES)
    )


def _call(
    builder: Any, name: str, result: Any, args: list[Any], flags: tuple[str, ...] = ()
) -> Any:
    """Call an LLVM intrinsic."""
    signature = ir.FunctionType(result, [arg.type for arg in args])
    return builder.call(
        cgutils.get_or_insert_function(builder.module, signature, name),
        args,
        fastmath=flags,
    )


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """The address of array[index]."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [index])


def _lanes_place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """The address of LANES elements from array[index] on."""
    vector = ir.VectorType(context.get_data_type(kind.dtype), LANES)
    return builder.bitcast(
        _place(context, builder, kind, array, index), vector.as_pointer()
    )


@intrinsic
def load(_typing: Any, array: Any, index: Any) -> Any:
    """load(array, index): LANES elements from array[index] on. The array is 1-D and contiguous; no bounds check."""
    align = array.dtype.bitwidth // 8
    return Lanes(array.dtype)(
        array, types.intp
    ), lambda context, builder, signature, args: builder.load(
        _lanes_place(context, builder, signature.args[0], *args), align=align
    )


@intrinsic
def store(_typing: Any, array: Any, index: Any, value: Any) -> Any:
    """store(array, index, value): write the lanes to array[index] and on; no bounds check."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _lanes_place(context, builder, signature.args[0], *args[:2])
        builder.store(args[2], place, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.none(array, types.intp, value), generate


@intrinsic
def read(_typing: Any, array: Any, index: Any) -> Any:
    """read(array, index): array[index] of a contiguous 1-D array; no bounds check, no negative indices."""
    return array.dtype(
        array, types.intp
    ), lambda context, builder, signature, args: builder.load(
        _place(context, builder, signature.args[0], *args)
    )


@intrinsic
def splat(_typing: Any, scalar: Any) -> Any:
    """splat(scalar): the scalar in all lanes."""
    return Lanes(scalar)(scalar), lambda _context, builder, _signature, args: _splat(
        builder, args[0]
    )


def _conversion(source: Any, target: Any) -> str:
    """The LLVM instruction that converts numbers of dtype `source` to dtype `target`; "" for none."""
    wide, narrow = target.bitwidth, source.bitwidth
    if isinstance(source, types.Float):
        if isinstance(target, types.Float):
            return "" if wide == narrow else ("fpext" if wide > narrow else "fptrunc")
        return "fptosi" if target.signed else "fptoui"
    if isinstance(target, types.Float):
        return "sitofp" if source.signed else "uitofp"
    if wide == narrow:
        return ""
    return "trunc" if wide < narrow else ("sext" if source.signed else "zext")


@intrinsic
def convert(_typing: Any, value: Any, array: Any) -> Any:
    """convert(value, array): the same numbers in the dtype of the array."""
    result, instruction = Lanes(array.dtype), _conversion(value.dtype, array.dtype)

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        if instruction:
            return getattr(builder, instruction)(
                args[0], context.get_value_type(result)
            )
        return args[0]

    return result(value, array), generate


def _lower(function: Any, generate: Any) -> None:
    """Define function(a, b) for two values of one type; generate(builder, lanes, a, b) returns the result."""

    @type_callable(function)
    def result_type(_context: Any) -> Any:
        return lambda a, b: a if isinstance(a, Lanes) and a == b else None

    @lower_builtin(function, Lanes, Lanes)
    def lower(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return generate(builder, signature.return_type, *args)


def _arithmetic(name: str) -> Any:
    return lambda builder, lanes, a, b: getattr(
        builder, f"f{name}" if lanes.is_float else name
    )(a, b)


def _extreme(name: str, comparison: str) -> Any:
    def generate(builder: Any, lanes: Any, a: Any, b: Any) -> Any:
        if lanes.is_float:
            # No lane is NaN; a compare and a select become one minimum or maximum instruction.
            return builder.select(builder.fcmp_ordered(comparison, a, b), a, b)
        sign = "s" if lanes.dtype.signed else "u"
        return _call(builder, f"llvm.{sign}{name}.{lanes.suffix}", a.type, [a, b])

    return generate


_lower(operator.add, _arithmetic("add"))
_lower(operator.sub, _arithmetic("sub"))
_lower(operator.mul, _arithmetic("mul"))
_lower(operator.truediv, lambda builder, _lanes, a, b: builder.fdiv(a, b))
_lower(operator.xor, lambda builder, _lanes, a, b: builder.xor(a, b))
_lower(min, _extreme("min", "<"))
_lower(max, _extreme("max", ">"))


@intrinsic
def count_ones(_typing: Any, value: Any) -> Any:
    """count_ones(value): the number of set bits in each lane."""
    return value(value), lambda _context, builder, _signature, args: _call(
        builder, f"llvm.ctpop.{value.suffix}", args[0].type, list(args)
    )


@intrinsic
def mask_outside(_typing: Any, value: Any, start: Any, stop: Any, fill: Any) -> Any:
    """mask_outside(value, start, stop, fill): the lanes start <= i < stop; the scalar `fill` in all others."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        bound = ir.IntType(16)  # the lanes of the comparison; their numbers fit
        lanes = ir.Constant(ir.VectorType(bound, LANES), list(range(LANES)))
        start, stop = (_splat(builder, builder.trunc(arg, bound)) for arg in args[1:3])
        inside = builder.and_(
            builder.icmp_signed(">=", lanes, start),
            builder.icmp_signed("<", lanes, stop),
        )
        return builder.select(inside, args[0], _splat(builder, args[3]))

    return value(value, types.int64, types.int64, value.dtype), generate


@intrinsic
def lowest(_typing: Any, value: Any) -> Any:
    """lowest(value): the smallest of the lanes, a scalar. No lane may be NaN."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        kind = "f" if value.is_float else ("s" if value.dtype.signed else "u")
        name = f"llvm.vector.reduce.{kind}min.{value.suffix}"
        return _call(
            builder,
            name,
            args[0].type.element,
            args,
            ("nnan", "nsz") if value.is_float else (),
        )

    return value.dtype(value), generate


@intrinsic
def first_at_most(_typing: Any, value: Any, bound: Any) -> Any:
    """first_at_most(value, bound): the index of the first lane <= the scalar bound. There must be one."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        whole = (
            builder.icmp_signed
            if not value.is_float and value.dtype.signed
            else builder.icmp_unsigned
        )
        compare = builder.fcmp_ordered if value.is_float else whole
        # One bit for each lane; the number of trailing zeros is the first lane.
        mask = ir.IntType(LANES)
        bits = builder.bitcast(compare("<=", args[0], _splat(builder, args[1])), mask)
        return builder.zext(
            _call(builder, f"llvm.cttz.i{LANES}", mask, [bits, BIT(1)]), INT64
        )

    return types.int64(value, value.dtype), generate
