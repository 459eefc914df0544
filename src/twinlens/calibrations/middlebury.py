"""The text of a calib.txt: the calibration of a rectified pair, as Middlebury writes it since 2014.

Lines of ``name=value``: cameras as ``[fx 0 cx; 0 fy cy; 0 0 1]``, doffs in pixels, baseline in millimetres, ... Numbers
are written with as many digits as read back to the same float64.

Source: https://vision.middlebury.edu/stereo/data/scenes2014/ and .../submit3/, "calib.txt".
"""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens import geometry
from twinlens.camera import Camera, Rig
from twinlens.errors import FileError, InputError, nearest, warn_not_used

_REQUIRED = ("cam0", "cam1", "doffs", "baseline", "width", "height")
_DOFFS_TOLERANCE = 0.01  # px: Middlebury rounds cx and doffs to three digits


@dataclass(frozen=True)
class Calibration:
    """Calibration of a rectified pair.

    cam0, cam1 : (fx, fy, cx, cy) of the left and right camera, pixels, pixel centres at integers.
    baseline : metres. width, height : pixels. doffs : cx1 - cx0, pixels.
    ndisp : bound of the disparities, 0 <= d < ndisp, or None.
    isint : whether the true disparities are integers; Middlebury's evaluation then rounds estimates.
    vmin, vmax : bounds of the true disparities, for colour maps, or None.

    Raises InputError for numbers that are not finite or not positive, and for doffs that differ from cx1 - cx0.
    """

    cam0: tuple[float, float, float, float]
    cam1: tuple[float, float, float, float]
    baseline: float
    width: int
    height: int
    doffs: float
    ndisp: int | None = None
    isint: bool = False
    vmin: float | None = None
    vmax: float | None = None

    def __post_init__(self) -> None:
        numbers = (*self.cam0, *self.cam1, self.baseline, self.doffs)
        if (
            len(self.cam0) != 4
            or len(self.cam1) != 4
            or not all(math.isfinite(number) for number in numbers)
        ):
            raise InputError(
                "a calibration needs finite numbers: fx, fy, cx, cy of two cameras, baseline and doffs"
            )
        if (
            min(*self.cam0[:2], *self.cam1[:2], self.baseline) <= 0
            or min(self.width, self.height) < 1
        ):
            raise InputError(
                "a calibration needs positive fx, fy, baseline, width and height"
            )
        if self.ndisp is not None and self.ndisp < 1:
            raise InputError(f"ndisp must be 1 or more, got {self.ndisp}")
        if abs(self.cam1[2] - self.cam0[2] - self.doffs) > _DOFFS_TOLERANCE:
            raise InputError(
                f"doffs must be cx1 - cx0 = {self.cam1[2] - self.cam0[2]}, got {self.doffs}"
            )

    @classmethod
    def from_rig(cls, rig: Rig, ndisp: int | None = None) -> "Calibration":
        """The calibration of a rig's first two cameras. Raises InputError if they are not a rectified pair."""
        if len(rig) < 2 or not rig.is_rectified():
            raise InputError(
                "calib.txt describes a rectified pair; these cameras are none"
            )
        left, right = rig.cameras[:2]
        cam0, cam1 = (
            (float(c.fx), float(c.fy), float(c.cx), float(c.cy)) for c in (left, right)
        )
        return cls(
            cam0,
            cam1,
            tidy(rig.baseline()),
            left.width,
            left.height,
            float(rig.doffs()),
            ndisp,
        )

    @property
    def fx(self) -> float:
        """Focal length of the left camera, pixels."""
        return self.cam0[0]

    def check_size(self, shape: tuple[int, ...], name: object) -> None:
        """Raise InputError, which names the calibration, unless images of a shape (H, W, ...) have its size."""
        height, width = shape[:2]
        if (width, height) != (self.width, self.height):
            raise InputError(
                f"{name} is of {self.width}x{self.height} pixels, but the images have {width}x{height}; "
                "scale one of them"
            )

    def rig(self) -> Rig:
        """The pair as a Rig; the world frame is the left camera's."""
        left, right = (
            Camera(self.width, self.height, *cam) for cam in (self.cam0, self.cam1)
        )
        return Rig.stereo(left, self.baseline, right=right)

    def depth(self, disparity: ArrayLike) -> NDArray[np.float64]:
        """z = fx B / (d + doffs), metres; +inf stays +inf. See `geometry.depth_from_disparity`."""
        return geometry.depth_from_disparity(
            disparity, self.fx, self.baseline, self.doffs
        )

    def replace(self, **changes: object) -> "Calibration":
        """A checked copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


def encode_calib(calibration: Calibration) -> str:
    """The text of calib.txt.

    >>> pair = Calibration((700.0, 700.0, 319.5, 239.5), (700.0, 700.0, 319.5, 239.5), 0.1, 640, 480, 0.0, ndisp=64)
    >>> print(encode_calib(pair), end="")
    cam0=[700.0 0 319.5; 0 700.0 239.5; 0 0 1]
    cam1=[700.0 0 319.5; 0 700.0 239.5; 0 0 1]
    doffs=0.0
    baseline=100.0
    width=640
    height=480
    ndisp=64
    isint=0
    """
    # A shift of the decimal point is exact: metres to millimetres and back lose no bit.
    millimetres = format(
        Decimal(repr(float(calibration.baseline))).scaleb(3).normalize(), "f"
    )
    fields: dict[str, object] = {}
    for name in ("cam0", "cam1"):
        fx, fy, cx, cy = map(float, getattr(calibration, name))
        fields[name] = f"[{fx!r} 0 {cx!r}; 0 {fy!r} {cy!r}; 0 0 1]"
    fields["doffs"] = float(calibration.doffs)
    fields["baseline"] = millimetres if "." in millimetres else f"{millimetres}.0"
    fields |= {name: int(getattr(calibration, name)) for name in ("width", "height")}
    fields |= {"ndisp": calibration.ndisp, "isint": int(calibration.isint)}
    fields |= {"vmin": calibration.vmin, "vmax": calibration.vmax}
    return "".join(
        f"{key}={value}\n" for key, value in fields.items() if value is not None
    )


def decode_calib(text: str, name: str = "calib.txt") -> Calibration:
    """Parse the text of a calib.txt. A warning names unknown keys: Middlebury has added keys over time.

    Raises FileError, whose message starts with `name`, for an invalid line or number and for a missing key.
    """
    fields: dict[str, str] = {}
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        key, equals, value = (part.strip() for part in line.partition("="))
        if line.strip() and not (key and equals):
            raise FileError(
                f"{name}: line {number} must read name=value, got {line.strip()[:40]!r}"
            )
        if key in fields:
            raise FileError(f"{name}: line {number} repeats the key {key}")
        if equals:
            fields[key] = value
    if missing := [key for key in _REQUIRED if key not in fields]:
        raise FileError(
            f"{name}: has no {missing[0]}= line; required are {', '.join(_REQUIRED)}"
        )
    warn_not_used(name, _unknown(fields))
    values = {}
    for key, value in fields.items():
        if key not in _READ:
            continue
        kind, read = _READ[key]
        try:
            values[key] = read(value)
        except (ValueError, ArithmeticError):
            raise FileError(
                f"{name}: {key} must be {kind}, got {value[:80]!r}"
            ) from None
    try:
        return Calibration(**values)
    except InputError as error:
        raise FileError(f"{name}: {error}") from None


def _unknown(keys: Iterable[str]) -> list[str]:
    """The keys that are neither read nor Middlebury's, and the key that each may be meant to be."""
    parts = []
    for key in keys:
        if key in _READ or key in _LEFT_OUT:
            continue
        meant = nearest(key, [*_READ, *_LEFT_OUT])
        hint = f", did you mean {meant}?" if meant else ""
        parts.append(f"{key[:40]!r} (unknown key{hint})")
    return parts


_CAMERA_LINE = re.compile(r"^\s*cam[01]\s*=", re.MULTILINE)


def is_calib(text: str) -> bool:
    """Whether a text has the line of a camera of a calib.txt, cam0=[...].

    >>> is_calib("cam0=[700 0 319.5; 0 700 239.5; 0 0 1]"), is_calib("cam0:\\n  camera_model: pinhole")
    (True, False)
    """
    return _CAMERA_LINE.search(text) is not None


def tidy(length: float) -> float:
    """`length` without the last bits that a difference of two poses loses: 0.1, not 0.09999999999999998."""
    return float(f"{length:.14g}")


def _camera(text: str) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) of "[fx 0 cx; 0 fy cy; 0 0 1]". Raises ValueError for other texts."""
    row_texts = re.sub(r"^\[|\]$", "", text).replace(",", " ").split(";")
    rows = [list(map(float, row.split())) for row in row_texts]
    (fx, skew, cx), (zero, fy, cy), last = rows
    if skew or zero or last != [0.0, 0.0, 1.0]:
        raise ValueError
    return fx, fy, cx, cy


def _integer(text: str) -> int:
    """A whole number, which some programs write as 12.0. Raises ValueError for others."""
    number = float(text)
    if not number.is_integer():
        raise ValueError
    return int(number)


_CAMERA = "[fx 0 cx; 0 fy cy; 0 0 1], without skew"
_READ: dict[str, tuple[str, Callable[[str], Any]]] = {
    **dict.fromkeys(("cam0", "cam1"), (_CAMERA, _camera)),
    **dict.fromkeys(("doffs", "vmin", "vmax"), ("a number of pixels", float)),
    **dict.fromkeys(("width", "height", "ndisp"), ("a whole number", _integer)),
    "baseline": (
        "a number of millimetres",
        lambda text: float(Decimal(text).scaleb(-3)),
    ),
    "isint": ("0 or 1", lambda text: float(text) != 0),
}
"""What the value of a key must be, and the function that reads it."""

_LEFT_OUT = ("dyavg", "dymax")
"""Keys of Middlebury and ETH3D that say how far rows are misaligned."""
