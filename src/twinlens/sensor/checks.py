"""What a sensor asks of the seeds it is given."""

import numpy as np

from twinlens.errors import InputError, in_one_line


def check_seed(name: str, value: int) -> None:
    """InputError unless `value` is a whole number >= 0."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise InputError(f"{name} must be a whole number >= 0, got {in_one_line(value)}")
