"""The compiled inner loops of the matching room: arrays in, arrays out, nothing checked. Importing it imports numba.

Everything here is written for one shape of loop: the disparity is innermost and lies in SIMD lanes, so a step to the
next pixel is a handful of vector instructions for all its candidates at once.
"""
