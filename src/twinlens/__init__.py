"""Physically based synthetic stereo: rendered image pairs, exact ground truth, and a benchmark for stereo matchers.

The public names and their types are listed in ``__init__.pyi``. Each is imported on first use, so that
``import twinlens`` imports neither mitsuba nor numba.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
