"""Cameras that exist, as the keys of a rig's table, with the source of each figure.

A focal length in millimetres is that of the lens; `focal_length_mm` / `pixel_pitch_um` is the focal length in pixels.
The figures describe the product, not one unit of it: a unit has its own calibration.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

from twinlens.camera.distortion import Distortion, KannalaBrandt
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, check_known


@dataclass(frozen=True)
class CameraPreset:
    """One camera, or a pair of equal cameras.

    camera : with all pixels of its sensor.
    f_number : of the lens, wide open; None if it is not known.
    baseline : of a pair, metres; None for a single camera.
    source : where the figures are from.
    """

    description: str
    camera: Camera
    source: str
    f_number: float | None = None
    baseline: float | None = None

    def size(self, width: int | None = None, height: int | None = None) -> tuple[int, int]:
        """The given size; without a width that of the sensor, without a height the one of all rows."""
        width = width or self.camera.width
        return width, height or max(1, round(self.camera.height * width / self.camera.width))

    def resized(self, width: int | None = None, height: int | None = None) -> Camera:
        """The camera with all columns of the sensor binned to `width` pixels, and the `height` rows in its middle.

        Raises InputError where the sensor has fewer rows.

        >>> wide = CAMERAS["realsense-d435"].resized(640)
        >>> wide.height, round(wide.fx, 3), wide.pixel_pitch_um
        (400, 321.667, 6.0)
        """
        own, most = self.camera, self.size(width)[1]
        width, height = self.size(width, height)
        if height > most:
            raise InputError(f"height: the sensor has {most} rows at a width of {width}, got {height}")
        scale = width / own.width
        cx, cy = (own.cx + 0.5) * scale - 0.5, 0.5 * (height - 1) + (own.cy - 0.5 * (own.height - 1)) * scale
        pitch = own.pixel_pitch_um / scale
        return replace(
            own, width=width, height=height, fx=own.fx * scale, fy=own.fy * scale, cx=cx, cy=cy, pixel_pitch_um=pitch
        )

    def reference(self, name: str) -> dict[str, Any]:
        """The preset as plain data."""
        camera, distortion = self.camera, self.camera.distortion
        return {
            "name": name,
            "description": self.description,
            "width": camera.width,
            "height": camera.height,
            "pixel_pitch_um": camera.pixel_pitch_um,
            "focal_length_mm": camera.film_distance * 1e3,
            "fov_x_deg": camera.fov_x_deg,
            "f_number": self.f_number,
            "baseline": self.baseline,
            "distortion": None if distortion is None else {"model": distortion.name, **asdict(distortion)},
            "source": self.source,
        }


def _camera(
    width: int,
    height: int,
    pixel_pitch_um: float,
    focal_length_mm: float,
    centre: tuple[float, float] | None = None,
    distortion: Distortion | None = None,
) -> Camera:
    fx = 1e3 * focal_length_mm / pixel_pitch_um
    cx, cy = centre or (0.5 * (width - 1), 0.5 * (height - 1))
    return Camera(width, height, fx, fx, cx, cy, distortion, pixel_pitch_um)


CAMERAS: dict[str, CameraPreset] = {
    "bumblebee2": CameraPreset(
        "machine-vision pair, Point Grey Bumblebee2 BB2-08S2-60: CCD ICX204, 6 mm lenses",
        _camera(1024, 768, 4.65, 6.0),
        "Point Grey Research, Bumblebee2 data sheet: Sony ICX204, 1/3 inch, 1024x768 pixels of 4.65 um; baseline 12 "
        "cm; focal length 6 mm, 43 degrees horizontal field of view",
        baseline=0.12,
    ),
    "realsense-d435": CameraPreset(
        "depth camera, Intel RealSense D435: the left and right infrared imagers",
        _camera(1280, 800, 3.0, 1.93),
        "Intel, RealSense D400 Series Product Family Datasheet, 337029-017, 2023: imagers OV9282, 1280x800; focal "
        "length 1.93 mm, f/2.0; baseline 50 mm. OmniVision, OV9282 product brief: pixels of 3 um",
        f_number=2.0,
        baseline=0.05,
    ),
    "gopro-hero9-wide": CameraPreset(
        "action camera with a fisheye lens, GoPro HERO9 Black, video at 960x540 with the wide field of view",
        Camera(960, 540, 435.45, 435.45, 479.12, 274.46, KannalaBrandt(0.05, 0.07, -0.11, 0.05), 6.43),
        "S. Urban, OpenImuCameraCalibrator, github.com/urbste/OpenImuCameraCalibrator, Readme.md, dataset 3: "
        "calibration of one unit, fisheye model, coefficients rounded to 0.01. The pixel pitch is assumed, 6.17 mm of "
        "a 1/2.3 inch sensor over 960 pixels; only light and diffraction depend on it",
    ),
    "pixel4": CameraPreset(
        "phone pair, Google Pixel 4: the main camera twice, at the distance of the phone's two rear cameras",
        _camera(4032, 3024, 1.4, 4.435),
        "Google, Pixel 4 technical specifications: rear camera of 12.2 megapixels, 1.4 um, f/1.7, field of view 77 "
        "degrees, which over the diagonal of 5040 pixels is a focal length of 4.435 mm. Google AI Blog, Improvements "
        "to Portrait Mode on the Google Pixel 4 and Pixel 4 XL, 2019: two rear cameras 13 mm apart",
        f_number=1.7,
        baseline=0.013,
    ),
    "mer-navcam": CameraPreset(
        "Mars rover pair, navigation cameras of the Mars Exploration Rovers Spirit and Opportunity",
        _camera(1024, 1024, 12.0, 14.67),
        "Maki et al., Mars Exploration Rover Engineering Cameras, Journal of Geophysical Research 108(E12), 8071, "
        "2003: 1024x1024 pixels of 12 um; focal length 14.67 mm, f/12, field of view 45 degrees; baseline 20 cm",
        f_number=12.0,
        baseline=0.2,
    ),
}
"""Every preset by its name."""


def find_camera(name: str) -> CameraPreset:
    """The preset of that name. Raises InputError naming the nearest one."""
    check_known("camera", name, CAMERAS)
    return CAMERAS[name]
