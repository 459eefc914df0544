"""A projector: a camera in reverse, which lights the scene with a pattern."""

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.camera.patterns import named
from twinlens.errors import InputError, check_known, check_number, format_value
from twinlens.geometry import Float, check_rigid, float_array
from twinlens.optics import check_focus

FILTERS = ("bilinear", "nearest")
BANDS = ("nir", "rgb")
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

    Raises InputError when a value is out of range, or the pattern has another size.
    """

    pose: Float
    intrinsics: Camera
    pattern: NDArray[np.float32]
    power: float = 1.0
    band: str = "nir"
    filter: str = "bilinear"
    aperture_diameter: float = 0.0
    focus_distance: float = math.inf

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
    ) -> None:
        if not isinstance(intrinsics, Camera):
            raise InputError(
                f"a projector's intrinsics must be a Camera, got {format_value(intrinsics)}"
            )
        if intrinsics.is_wide:
            raise InputError(
                "a projector's pattern must be within 90 degrees of its axis: use a larger fx and fy"
            )
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
        if isinstance(pattern, str):
            pattern = named(pattern, intrinsics.width, intrinsics.height)
        values = {
            "pose": check_rigid(
                np.eye(4) if pose is None else pose, "a projector's pose"
            ),
            "intrinsics": intrinsics,
            "pattern": _checked_pattern(pattern, intrinsics),
            "power": float(power),
            "band": band,
            "filter": filter,
            "aperture_diameter": float(aperture_diameter),
            "focus_distance": float(focus_distance),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def emitted_power(self) -> float:
        """Watts that the pattern sends: power times its mean."""
        return self.power * float(self.pattern.mean(dtype=np.float64))

    def agrees_with(self, other: "Projector") -> bool:
        """Whether all values are equal, but for the rounding of poses."""
        names = [field.name for field in fields(self) if field.name != "pose"]
        equal = all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in names
        )
        return equal and np.allclose(self.pose, other.pose, rtol=1e-12, atol=1e-9)

    def with_pattern(self, pattern: ArrayLike | str) -> "Projector":
        """The same projector with another pattern: an array, or a name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return Projector(**{**values, "pattern": pattern})

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


def _checked_pattern(pattern: ArrayLike, intrinsics: Camera) -> NDArray[np.float32]:
    values = float_array("a projector's pattern", pattern).astype(np.float32)
    size = intrinsics.height, intrinsics.width
    if values.shape != size:
        raise InputError(
            f"a projector's pattern must have the shape {size} of its intrinsics, got {values.shape}"
        )
    if not ((values >= 0) & (values <= 1)).all():
        raise InputError(
            "a projector's pattern must have values from 0 to 1, and no NaN"
        )
    values.setflags(write=False)
    return values
