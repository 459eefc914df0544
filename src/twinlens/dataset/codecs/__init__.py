"""File formats of a sample, one module each: bytes to arrays and back, without knowledge of stereo.

Each codec has pure functions `encode_*` and `decode_*` (equal input gives equal bytes), and `read_*` and `write_*` for
files. A decoder raises FileError for a damaged file, and never allocates much more memory than a valid file of that
length could fill.
"""
