"""Lanes that may not win: those of candidates outside the image, or outside the part of the range that is searched."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

from numba import types
from numba.extending import intrinsic

from twinlens.matching.kernels.compiling import inlined
from twinlens.matching.kernels.lanes import call_intrinsic, load_of


def _moved(end: str, sign: str) -> Any:
    @intrinsic
    def function(_typing: Any, value: Any, array: Any, index: Any, needed: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            before = builder.basic_block
            with builder.if_then(args[3], likely=False):
                other = load_of(context, builder, signature.args[1], args[1], args[2], value.n)
                if value.is_float:
                    moved = builder.select(builder.fcmp_ordered(sign, args[0], other), args[0], other)
                else:
                    kind = "s" if value.dtype.signed else "u"
                    moved = call_intrinsic(builder, f"llvm.{kind}{end}.{value.suffix}", other.type, [args[0], other])
                inner = builder.basic_block
            result = builder.phi(args[0].type)
            result.add_incoming(args[0], before)
            result.add_incoming(moved, inner)
            return result

        return value(value, array, types.intp, types.boolean), generate

    return function


raised = _moved("max", ">")
"""raised(value, array, index, needed): the larger of value and array[index] and on; the value, if not `needed`."""
lowered = _moved("min", "<")
"""lowered(value, array, index, needed): the smaller of value and array[index] and on; the value, if not `needed`."""


@inlined
def fenced(cost, fence, n, begin, end):
    """The lanes begin..end of cost, all others the largest number.

    fence holds n of the largest number, 2 n of the smallest, and n of the largest.
    """
    below = raised(cost, fence, n - min(max(begin, 0), n), begin > 0)
    return raised(below, fence, 3 * n - min(max(end, 0), n), end < n)


@inlined
def barred(score, fence, n, begin, end):
    """The lanes begin..end of score, all others the smallest number.

    fence holds n of the smallest number, 2 n of the largest, and n of the smallest.
    """
    below = lowered(score, fence, n - min(max(begin, 0), n), begin > 0)
    return lowered(below, fence, 3 * n - min(max(end, 0), n), end < n)
