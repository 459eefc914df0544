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

    def size(
        self, width: int | None = None, height: int | None = None
    ) -> tuple[int, int]:
        """The given size; without a width that of the sensor, without a height the one of all rows."""
        width = width or self.camera.width
        return width, height or max(
            1, round(self.camera.height * width / self.camera.width)
        )

    def resized(self, width: int | None = None, height: int | None = None) -> Camera:
        """The camera with all columns of the sensor binned to `width` pixels, and the `height` rows in its middle.

        Raises InputError where the sensor has fewer rows.

        >>> wide = CAMERAS["realsense-d435"].resized(640)
        >>> wide.height, round(wide.fx, 3), wide.pixel_pitch_um
        (400, 321.667, 6.0)
        """
        sensor, most = self.camera, self.size(width)[1]
        width, height = self.size(width, height)
        if height > most:
            raise InputError(
                f"height: the sensor has {most} rows at a width of {width}, got {height}; use at most {most}"
            )
        scale = width / sensor.width
        # Columns are binned from the image's left edge, at -0.5; rows stay centred.
        below_centre = sensor.cy - 0.5 * (sensor.height - 1)
        return replace(
            sensor,
            width=width,
            height=height,
            fx=sensor.fx * scale,
            fy=sensor.fy * scale,
            cx=(sensor.cx + 0.5) * scale - 0.5,
            cy=0.5 * (height - 1) + below_centre * scale,
            pixel_pitch_um=sensor.pixel_pitch_um / scale,
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
            "distortion": None
            if distortion is None
            else {"model": distortion.name, **asdict(distortion)},
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
    "oak-d": CameraPreset(
        "machine-vision pair, Luxonis OAK-D: the two global-shutter cameras",
        _camera(1280, 800, 3.0, 2.35),
        "Luxonis, OAK-D, docs.luxonis.com/projects/hardware/en/latest/pages/BW1098OAK: OV9282, 1280x800 pixels of 3 "
        "um; effective focal length 2.35 mm, f/2.0 +-5%, 80 degrees horizontal field of view; baseline 7.5 cm",
        f_number=2.0,
        baseline=0.075,
    ),
    "realsense-d435": CameraPreset(
        "depth camera, Intel RealSense D435: the left and right infrared imagers",
        _camera(1280, 800, 3.0, 1.93),
        "Intel, RealSense D400 Series Datasheet, 337029-017, September 2023, table 3-13 and the table of SKU "
        "properties, realsenseai.com/wp-content/uploads/2023/10/"
        "Intel-RealSense-D400-Series-Datasheet-September-2023.pdf: OV9282, 1280x800; focal length 1.93 mm, f/2.0, 91.2 "
        "degrees horizontal field of view; baseline 50 mm. Luxonis, OV9282, "
        "docs.luxonis.com/projects/hardware/en/latest/pages/articles/sensors/ov9282: pixels of 3 um",
        f_number=2.0,
        baseline=0.05,
    ),
    "gopro-hero9-wide": CameraPreset(
        "action camera with a fisheye lens, GoPro HERO9 Black, video at 960x540 with the wide field of view",
        Camera(
            960,
            540,
            435.45,
            435.45,
            479.12,
            274.46,
            KannalaBrandt(0.05, 0.07, -0.11, 0.05),
            6.43,
        ),
        "S. Urban, OpenImuCameraCalibrator, github.com/urbste/OpenImuCameraCalibrator, Readme.md of commit 0a06c13, "
        "dataset 3: calibration of one unit, fisheye model, coefficients rounded to 0.01. "
        "cameradecision.com/faq/what-is-the-Sensor-Size-of-GoPro-Hero9-Black: a sensor of 6.17 mm, here over the 960 "
        "pixels; only light and diffraction depend on it",
    ),
    "pixel4": CameraPreset(
        "phone pair, Google Pixel 4: the main camera twice, at the distance of the phone's two rear cameras",
        _camera(4032, 3024, 1.4, 4.38),
        "en.wikipedia.org/wiki/Pixel_4: main camera of 12.2 megapixels, 1.4 um. Lens in the metadata of its "
        "photographs: Pixel 4 back camera 4.38mm f/1.73. Google AI Blog, "
        "ai.googleblog.com/2019/12/improvements-to-portrait-mode-on-google.html: two rear cameras 13 mm apart",
        f_number=1.73,
        baseline=0.013,
    ),
    "mer-pancam": CameraPreset(
        "Mars rover pair, panoramic cameras of Spirit and Opportunity, without their toe-in of 1 degree",
        _camera(1024, 1024, 12.0, 43.0),
        "Bell et al., Mars Exploration Rover Athena Panoramic Camera (Pancam) Investigation, Journal of Geophysical "
        "Research 108(E12), 8063, 2003, doi.org/10.1029/2003JE002070: 1024x1024 pixels; focal length 43 mm, f/20, "
        "field of view 16 degrees; 30 cm apart. Cornell University, niac.marsunderground.org/education/mer/mer00.html: "
        "pixels of 12 um",
        f_number=20.0,
        baseline=0.3,
    ),
}
"""Every preset by its name."""


def find_camera(name: str) -> CameraPreset:
    """The preset of that name. Raises InputError naming the nearest one."""
    check_known("camera", name, CAMERAS)
    return CAMERAS[name]
