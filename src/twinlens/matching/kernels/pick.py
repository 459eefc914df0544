"""One number out of many lanes: the smallest or largest, and where it stands."""

# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from twinlens.matching.kernels.lanes import BIT, INT64, call_intrinsic, splat_of


def _reduction(end: str) -> Any:
    @intrinsic
    def function(_typing: Any, value: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            kind = "f" if value.is_float else ("s" if value.dtype.signed else "u")
            flags = ("nnan", "nsz") if value.is_float else ()
            element = args[0].type.element
            name = f"llvm.vector.reduce.{kind}{end}.{value.suffix}"
            function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(element, [args[0].type]), name)
            return builder.call(function, args, fastmath=flags)

        return value.dtype(value), generate

    return function


lowest = _reduction("min")
"""lowest(value): the smallest of the lanes, a scalar. No lane may be NaN."""
highest = _reduction("max")
"""highest(value): the largest of the lanes, a scalar. No lane may be NaN."""


def _first(comparison: str) -> Any:
    @intrinsic
    def function(_typing: Any, value: Any, bound: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            target = splat_of(builder, args[1], value.n)
            signed = not value.is_float and value.dtype.signed
            whole = builder.icmp_signed if signed else builder.icmp_unsigned
            compare = builder.fcmp_ordered if value.is_float else whole
            mask = ir.IntType(value.n)
            bits = builder.bitcast(compare(comparison, args[0], target), mask)
            index = call_intrinsic(builder, f"llvm.cttz.i{value.n}", mask, [bits, BIT(1)])
            if value.n == INT64.width:
                return index
            return (builder.trunc if value.n > INT64.width else builder.zext)(index, INT64)

        return types.int64(value, value.dtype), generate

    return function


first_at_most = _first("<=")
"""first_at_most(value, bound): the index of the first lane <= the scalar bound; one of them must be."""
first_equal = _first("==")
"""first_equal(value, bound): the index of the first lane that is the scalar; one of them must be."""
