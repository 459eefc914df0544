"""Parts of vectors, and sums of products of small whole numbers: what one instruction of many processors adds up."""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

from twinlens.matching.kernels.lanes import INT32, call_intrinsic

INT16 = ir.IntType(16)
PART = 64  # lanes at a time: LLVM keeps the order it is given, and all at once would not fit the registers
ROOM = 512 // 32  # int32 lanes of the widest register


def has(context: Any, feature: str) -> bool:
    """Has the processor that is compiled for this LLVM feature?"""
    return f"+{feature}" in context.codegen().magic_tuple()[2].split(",")


def cut(builder: Any, values: Any, first: int, n: int) -> Any:
    """The n values from `first` on."""
    places = ir.Constant(ir.VectorType(INT32, n), list(range(first, first + n)))
    return builder.shuffle_vector(values, ir.Constant(values.type, ir.Undefined), places)


def joined(builder: Any, parts: list[Any]) -> Any:
    """The vectors one after the other; a power of two of them."""
    while len(parts) > 1:
        size = 2 * parts[0].type.count
        places = ir.Constant(ir.VectorType(INT32, size), list(range(size)))
        parts = [builder.shuffle_vector(*parts[i : i + 2], places) for i in range(0, len(parts), 2)]
    return parts[0]


def _deal(builder: Any, values: Any, first: int) -> Any:
    """Every second lane, from `first` on."""
    n = values.type.count // 2
    places = ir.Constant(ir.VectorType(INT32, n), list(range(first, 2 * n, 2)))
    return builder.shuffle_vector(values, ir.Constant(values.type, ir.Undefined), places)


def dot_onto(context: Any, builder: Any, total: Any, words: Any, factors: Any) -> Any:
    """total[i] + words[2 i] factors[2 i] + words[2 i + 1] factors[2 i + 1], of int16 into int32."""
    n = total.type.count
    if has(context, "avx512vnni") and n % ROOM == 0:
        name, part = "llvm.x86.avx512.vpdpwssd.512", ir.VectorType(INT32, ROOM)
        whole = [total, builder.bitcast(words, total.type), builder.bitcast(factors, total.type)]
        cuts = [[cut(builder, value, first, ROOM) for value in whole] for first in range(0, n, ROOM)]
        return joined(builder, [call_intrinsic(builder, name, part, values) for values in cuts])
    full = ir.VectorType(INT32, 2 * n)
    product = builder.mul(builder.sext(words, full), builder.sext(factors, full))
    # LLVM would add the halves to the total one by one and miss its match. The one fence it has is for floats.
    fenced = ir.VectorType(ir.FloatType(), n)
    dots = builder.bitcast(builder.add(_deal(builder, product, 0), _deal(builder, product, 1)), fenced)
    dots = builder.bitcast(call_intrinsic(builder, f"llvm.arithmetic.fence.v{n}f32", fenced, [dots]), total.type)
    return builder.add(total, dots)
