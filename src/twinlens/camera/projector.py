"""A projector: a camera in reverse, which lights the scene with a pattern."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.camera.patterns import Pattern, checked_pattern, named
from twinlens.camera.structured_light import Code, GrayCode, PhaseShift, Still
from twinlens.errors import (
    InputError,
    check_int,
    check_known,
    check_number,
    format_value,
)
from twinlens.geometry import Float, check_rigid, float_array
from twinlens.optics import check_focus

FILTERS = ("bilinear", "nearest")
BANDS = ("nir", "rgb")
MAX_FRAMES = 1000
"""Most patterns of a sequence."""
LUMENS_PER_WATT = 353.7
"""Of light with equal power in narrow bands at 611, 549 and 464 nm, those of `twinlens.sensor.Sensor`."""


@dataclass(frozen=True, eq=False)
class Projector:
    """A projector at a pose in a rig. Its pixel (u, v) is sent where a camera there sees it.

    A pixel of value p sends the radiant flux p * power / (W * H), so that, without distortion, a uniform pattern lights
    a plane at right angles to the axis evenly. The irradiance of a surface at depth z along the axis, whose normal is
    at the angle a to the ray and which the ray leaves the axis for at the angle b, is

        E = p * power * fx * fy / (W * H * z^2) * cos(a) / cos(b)

    in W/m^2, a third of it in each channel of an image (`Sensor.radiance_scale`).

    pose : rig_from_projector, a rigid (4, 4); the rig's axes are those of its first camera. Default: at this camera.
    intrinsics : size, focal lengths, principal point and distortion.
    pattern : float32 (H, W) in [0, 1], of the size of the intrinsics, or a name in `twinlens.camera.patterns.PATTERNS`.
    power : watts that a white pattern sends; a pattern sends `emitted_power`. `with_lux` sets it from an illuminance.
    band : "nir", which only cameras that see the near infrared see, or "rgb", equal parts of red, green and blue.
    filter : between pixel centres the pattern is interpolated ("bilinear"), or pixels are squares ("nearest").
    aperture_diameter : A, metres, of the disk that light leaves. With 0 it is a point: the pattern is sharp everywhere.
    focus_distance : f, metres along the axis; may be inf. At depth z, a point of the pattern is a disk of A |1 - z/f|.
    sequence : codes whose patterns are shown one after another, one in each frame of a sample: `GrayCode`,
        `PhaseShift`, and single patterns as arrays or names. `pattern` is the first of them; leave it out.

    Raises InputError when a value is out of range, or a pattern has another size.
    """

    pose: Float
    intrinsics: Camera
    pattern: NDArray[np.float32]
    power: float = 1.0
    band: str = "nir"
    filter: str = "bilinear"
    aperture_diameter: float = 0.0
    focus_distance: float = math.inf
    sequence: tuple[Code, ...] = ()

    def __init__(
        self,
        pose: ArrayLike | None,
        intrinsics: Camera,
        pattern: ArrayLike | str = "white",
        power: float = 1.0,
        band: str = "nir",
        filter: str = "bilinear",
        aperture_diameter: float = 0.0,
        focus_distance: float = math.inf,
        sequence: Sequence[Code | ArrayLike | str] = (),
    ) -> None:
        _check_intrinsics(intrinsics)
        check_number(
            "a projector's power",
            power,
            "a number of watts >= 0, at most 1e9",
            least=0,
            most=1e9,
        )
        check_known("band of a projector", band, BANDS)
        check_known("filter of a projector", filter, FILTERS)
        check_number(
            "a projector's aperture_diameter",
            aperture_diameter,
            "a number of metres >= 0",
            least=0,
        )
        check_focus(focus_distance)
        codes = _checked_sequence(sequence, intrinsics)
        rig_from_projector = np.eye(4) if pose is None else pose
        values = {
            "pose": check_rigid(rig_from_projector, "a projector's pose"),
            "intrinsics": intrinsics,
            "pattern": _shown_first(pattern, codes, intrinsics),
            "power": float(power),
            "band": band,
            "filter": filter,
            "aperture_diameter": float(aperture_diameter),
            "focus_distance": float(focus_distance),
            "sequence": codes,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def num_frames(self) -> int:
        """The number of patterns of the sequence; 1 without one."""
        return max(1, sum(code.num_patterns for code in self.sequence))

    @property
    def patterns(self) -> list[Pattern]:
        """The pattern of each frame."""
        return [self.at_frame(frame).pattern for frame in range(self.num_frames)]

    def at_frame(self, frame: int) -> "Projector":
        """The projector with the pattern of a frame, without a sequence. Without one, it does not change.

        Raises InputError for a frame that the sequence does not have.
        """
        check_int("frame", frame, 0, self.num_frames - 1 if self.sequence else None)
        first = 0
        for code in self.sequence:
            if frame < first + code.num_patterns:
                return self.with_pattern(code.pattern(frame - first))
            first += code.num_patterns
        return self

    @property
    def emitted_power(self) -> float:
        """Watts that the pattern sends: power times its mean."""
        return self.power * float(self.pattern.mean(dtype=np.float64))

    def agrees_with(self, projector: "Projector") -> bool:
        """Whether all values are equal, but for the rounding of poses."""
        special = ("pose", "sequence")
        names = [field.name for field in fields(self) if field.name not in special]
        equal = all(
            np.array_equal(getattr(self, name), getattr(projector, name))
            for name in names
        )
        equal = equal and np.array_equal(self.patterns, projector.patterns)
        return equal and np.allclose(self.pose, projector.pose, rtol=1e-12, atol=1e-9)

    def with_pattern(self, pattern: ArrayLike | str) -> "Projector":
        """The same projector with another pattern, an array or a name, in place of its own and of its sequence."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return Projector(**{**values, "pattern": pattern, "sequence": ()})

    def with_sequence(self, sequence: Sequence[Code | ArrayLike | str]) -> "Projector":
        """The same projector with another sequence of patterns in place of its pattern."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return Projector(**{**values, "pattern": "white", "sequence": sequence})

    def with_lux(self, lux: float, distance: float = 1.0) -> "Projector":
        """The same projector, with the power for which white has this illuminance on the axis at `distance` metres.

        `LUMENS_PER_WATT` converts lux to W/m^2. Raises InputError for a near infrared projector.
        """
        if self.band == "nir":
            raise InputError(
                "lux is a unit of visible light: use band='rgb', or give the power in watts"
            )
        check_number("lux", lux, "a number of lux >= 0", least=0)
        check_number("distance", distance, "a number of metres > 0", above=0)
        camera = self.intrinsics
        lit_area = (
            camera.width * camera.height / (camera.fx * camera.fy) * distance**2
        )  # of a plane, m^2
        return replace(self, power=lux / LUMENS_PER_WATT * lit_area)


def _of_size(pattern: ArrayLike | str, intrinsics: Camera) -> Pattern:
    """A named pattern or an array. Raises InputError unless it has the size of the intrinsics."""
    if isinstance(pattern, str):
        pattern = named(pattern, intrinsics.width, intrinsics.height)
    size = intrinsics.height, intrinsics.width
    values = float_array("a projector's pattern", pattern)
    if values.shape != size:
        raise InputError(
            f"a projector's pattern must have the shape {size} of its intrinsics, got {values.shape}"
        )
    return checked_pattern(values)


def _check_intrinsics(intrinsics: Camera) -> None:
    if not isinstance(intrinsics, Camera):
        raise InputError(
            f"a projector's intrinsics must be a Camera, got {format_value(intrinsics)}"
        )
    if intrinsics.is_wide:
        raise InputError(
            "a projector's pattern must be within 90 degrees of its axis: use a larger fx and fy"
        )


def _checked_sequence(
    sequence: Sequence[Code | ArrayLike | str], intrinsics: Camera
) -> tuple[Code, ...]:
    """The codes of a sequence; arrays and names become `Still`. Raises InputError for another size or too many."""
    if isinstance(sequence, str) or not isinstance(sequence, Sequence):
        raise InputError(
            f"a projector's sequence must be a list of codes and patterns, got {format_value(sequence)}"
        )
    codes: list[Code] = []
    for part in sequence:
        if isinstance(part, GrayCode | PhaseShift | Still):
            code: Code = part
        else:
            code = Still(_of_size(part, intrinsics))
        if (code.width, code.height) != (intrinsics.width, intrinsics.height):
            raise InputError(
                f"a code of a projector's sequence must have the size {intrinsics.width} x {intrinsics.height} of its"
                f" intrinsics, got {code.width} x {code.height}"
            )
        codes.append(code)
    frames = sum(code.num_patterns for code in codes)
    if frames > MAX_FRAMES:
        raise InputError(
            f"a projector's sequence may have at most {MAX_FRAMES} patterns, got {frames}"
        )
    return tuple(codes)


def _shown_first(
    pattern: ArrayLike | str, codes: Sequence[Code], intrinsics: Camera
) -> Pattern:
    """The pattern, or the first of a sequence. Raises InputError where both are given and differ."""
    if not codes:
        return _of_size(pattern, intrinsics)
    first = checked_pattern(codes[0].pattern(0))
    is_left_out = isinstance(pattern, str) and pattern == "white"
    if not is_left_out and not np.array_equal(_of_size(pattern, intrinsics), first):
        raise InputError(
            "a projector has a pattern or a sequence of them, not both; leave one out"
        )
    return first
