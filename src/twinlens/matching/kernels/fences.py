"""Lanes that may not win: those of candidates outside the image, or outside the part of the range that is searched."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

from numba import types
from numba.extending import intrinsic

from twinlens.matching.kernels.compiling import inlined
from twinlens.matching.kernels.lanes import call_intrinsic, load_of


@intrinsic
def raised(_typing: Any, value: Any, array: Any, index: Any, needed: Any) -> Any:
    """raised(value, array, index, needed): the larger of value and array[index] and on; the value, if not `needed`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        before = builder.basic_block
        with builder.if_then(args[3], likely=False):
            other = load_of(context, builder, signature.args[1], args[1], args[2], value.n)
            if value.is_float:
                high = builder.select(builder.fcmp_ordered(">", args[0], other), args[0], other)
            else:
                sign = "s" if value.dtype.signed else "u"
                high = call_intrinsic(builder, f"llvm.{sign}max.{value.suffix}", other.type, [args[0], other])
            inner = builder.basic_block
        result = builder.phi(args[0].type)
        result.add_incoming(args[0], before)
        result.add_incoming(high, inner)
        return result

    return value(value, array, types.intp, types.boolean), generate


@inlined
def fenced(cost, fence, n, begin, end):
    """The lanes begin..end of cost, all others the largest number.

    fence holds n of the largest number, 2 n of the smallest, and n of the largest.
    """
    below = raised(cost, fence, n - min(max(begin, 0), n), begin > 0)
    return raised(below, fence, 3 * n - min(max(end, 0), n), end < n)
