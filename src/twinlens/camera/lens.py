"""Lens models: the ideal pinhole, the thin lens, and the bare aperture without a lens.

Each has an `aperture_diameter` (metres), an `aperture` shape and a `vergence` k (1/m).
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from twinlens import optics
from twinlens.camera.aperture import FULL_DISK, Aperture
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, format_value
from twinlens.settings import Field, Setting, Settings

DIAMETER = Setting(
    "Diameter of the aperture; 0 is a pinhole.",
    "metres",
    least=optics.SHORTEST,
    most=optics.LONGEST,
    or_zero=True,
)
SHAPE = Setting("Shape of the aperture.")
F_NUMBER = Field(
    "f_number",
    float,
    False,
    Setting("Focal length over aperture diameter.", least=1e-6, most=1e9),
)


@dataclass(frozen=True)
class Pinhole:
    """The ideal pinhole: an aperture of zero width, sharp everywhere."""

    name: ClassVar[str] = "pinhole"
    aperture: ClassVar[Aperture] = FULL_DISK
    aperture_diameter: ClassVar[float] = 0.0
    vergence: ClassVar[float] = 0.0


@dataclass(frozen=True)
class ThinLens(Settings, noun="lens"):
    """A thin lens focused on the plane z = focus_distance.

    The aperture has its shape inside the circle of diameter A. With a defocus the lens is sharp at
    1 / (1/focus_distance + defocus), and nowhere if this is negative.

    Raises InputError when a value is out of range.
    """

    name: ClassVar[str] = "thinlens"
    aperture_diameter: Annotated[float, DIAMETER]
    focus_distance: Annotated[
        float,
        Setting(
            "Depth of the sharp plane.", "metres", least=optics.SHORTEST, infinite=True
        ),
    ]
    aperture: Annotated[Aperture, SHAPE] = FULL_DISK
    defocus: Annotated[
        float,
        Setting(
            "Error of the focus, added to the vergence.", "1/m", least=-1e6, most=1e6
        ),
    ] = 0.0

    @classmethod
    def from_f_number(
        cls,
        f_number: float,
        focus_distance: float,
        film_distance: float,
        aperture: Aperture = FULL_DISK,
    ) -> "ThinLens":
        """The lens of f-number N = f/A and focal length f = 1/(1/focus_distance + 1/film_distance).

        `film_distance` is in metres, as `Camera.film_distance`. Raises InputError unless all three are positive.
        """
        F_NUMBER.checked(f_number, "lens")
        return cls(
            optics.focal_length(focus_distance, film_distance) / f_number,
            focus_distance,
            aperture,
        )

    @property
    def vergence(self) -> float:
        """k = 1/focus_distance + defocus, in 1/m."""
        return 1.0 / self.focus_distance + self.defocus


@dataclass(frozen=True)
class BareAperture(Settings, noun="lens"):
    """An aperture without a lens in front of a film: the camera obscura.

    The aperture has its shape inside the circle of its diameter; film_distance / fx is the pixel pitch.

    Raises InputError when a value is out of range.
    """

    name: ClassVar[str] = "bareaperture"
    diameter: Annotated[float, DIAMETER]
    film_distance: Annotated[
        float,
        Setting(
            "From the aperture to the film.",
            "metres",
            least=optics.SHORTEST,
            most=optics.LONGEST,
        ),
    ]
    aperture: Annotated[Aperture, SHAPE] = FULL_DISK

    @property
    def aperture_diameter(self) -> float:
        """The diameter, metres, under the name that lenses have in common."""
        return self.diameter

    @property
    def vergence(self) -> float:
        """k = -1/film_distance, in 1/m."""
        return optics.vergence(0.0, self.film_distance)


Lens = Pinhole | ThinLens | BareAperture


def check_lens(lens: Lens) -> None:
    """Raise InputError unless `lens` is a lens."""
    if not isinstance(lens, Lens):
        raise InputError(
            f"a lens must be a Pinhole, ThinLens or BareAperture, got {format_value(lens)}"
        )


def film_distance(camera: Camera, lens: Lens) -> float:
    """v in metres: the bare aperture's own, otherwise the camera's fx times pixel pitch.

    >>> camera = Camera.from_fov(640, 480, fov_x_deg=90, pixel_pitch_um=5.0)
    >>> round(film_distance(camera, Pinhole()), 9), film_distance(camera, BareAperture(1e-3, film_distance=0.05))
    (0.0016, 0.05)
    """
    return (
        lens.film_distance if isinstance(lens, BareAperture) else camera.film_distance
    )
