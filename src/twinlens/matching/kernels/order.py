"""The census transform of an image, one word at a time."""
# numba types what it compiles by itself; its decorators and the functions given to it carry no annotations
# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-any-return, misc"

from twinlens.matching.kernels.compiling import jit


@jit
def census_words(padded, side, first, last, words):
    """words (H, W), zeros: the bits first..last of the window, row by row without its centre: is it darker than that?

    padded (H + side - 1, W + side - 1). The first bit ends up highest.
    """
    height, width = words.shape
    one = words.dtype.type(1)
    radius = side // 2
    for y in range(height):
        centre, word = padded[y + radius, radius : radius + width], words[y]
        for bit in range(first, last):
            place = bit + (bit >= side * side // 2)
            column = place % side
            neighbour = padded[y + place // side, column : column + width]
            for x in range(width):
                word[x] = (word[x] << one) | words.dtype.type(neighbour[x] < centre[x])
