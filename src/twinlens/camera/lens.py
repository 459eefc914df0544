"""What stands in front of the film: nothing but a point, a thin lens, or a bare hole. One law serves the three.

A lens answers two questions: how wide it is (`aperture_diameter`, metres) and its vergence k (1/m).
"""

from dataclasses import dataclass, replace
from typing import ClassVar

from twinlens import optics
from twinlens.camera.aperture import FULL_DISK, Aperture
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, check_number, format_value


@dataclass(frozen=True)
class Pinhole:
    """The ideal pinhole: an aperture of no width, sharp everywhere."""

    name: ClassVar[str] = "pinhole"
    aperture: ClassVar[Aperture] = FULL_DISK
    aperture_diameter: ClassVar[float] = 0.0
    vergence: ClassVar[float] = 0.0


@dataclass(frozen=True)
class ThinLens:
    """A thin lens focused on the plane z = focus_distance.

    Parameters
    ----------
    aperture_diameter : float
        Diameter A of the entrance pupil in metres, >= 0; 0 is a pinhole.
    focus_distance : float
        Depth of the plane in focus in metres, > 0; may be inf.
    aperture : Aperture
        Its shape, inside the circle of diameter A. A disk unless said otherwise.
    """

    name: ClassVar[str] = "thinlens"
    aperture_diameter: float
    focus_distance: float
    aperture: Aperture = FULL_DISK

    def __post_init__(self) -> None:
        _check_hole("aperture_diameter", self.aperture_diameter, self.aperture)
        optics.check_focus(self.focus_distance)

    @classmethod
    def from_f_number(
        cls, f_number: float, focus_distance: float, film_distance: float, aperture: Aperture = FULL_DISK
    ) -> "ThinLens":
        """The lens of f-number N = f/A whose focal length f = 1/(1/focus_distance + 1/film_distance).

        `film_distance` in metres, as `Camera.film_distance` gives it. Raises InputError unless all three are positive.
        """
        check_number("f_number", f_number, "positive, from 1e-6 to 1e9", least=1e-6, most=1e9)
        return cls(optics.focal_length(focus_distance, film_distance) / f_number, focus_distance, aperture)

    @property
    def vergence(self) -> float:
        """k = 1/focus_distance, in 1/m."""
        return 1.0 / self.focus_distance

    def replace(self, **changes: object) -> "ThinLens":
        """A copy with some fields changed, checked again."""
        return replace(self, **changes)  # type: ignore[arg-type]


@dataclass(frozen=True)
class BareAperture:
    """A hole and no lens, in front of a film at `film_distance`: the camera obscura, down to an open box.

    Parameters
    ----------
    diameter : float
        Of the hole, metres, >= 0.
    film_distance : float
        From the hole to the film, metres, > 0. With fx in pixels it fixes the pixel pitch: film_distance / fx.
    aperture : Aperture
        Shape of the hole inside its circle.
    """

    name: ClassVar[str] = "bareaperture"
    diameter: float
    film_distance: float
    aperture: Aperture = FULL_DISK

    def __post_init__(self) -> None:
        _check_hole("diameter", self.diameter, self.aperture)
        optics.check_length("film_distance", self.film_distance)

    @property
    def aperture_diameter(self) -> float:
        """The hole's diameter, metres: the name a lens gives it."""
        return self.diameter

    @property
    def vergence(self) -> float:
        """k = -1/film_distance, in 1/m: a lens of no power."""
        return optics.vergence(0.0, self.film_distance)

    def replace(self, **changes: object) -> "BareAperture":
        """A copy with some fields changed, checked again."""
        return replace(self, **changes)  # type: ignore[arg-type]


Lens = Pinhole | ThinLens | BareAperture


def check_lens(lens: Lens) -> None:
    """Raise InputError for what is no lens."""
    if not isinstance(lens, Lens):
        raise InputError(f"a lens is a Pinhole, a ThinLens or a BareAperture, got {format_value(lens)}")


def film_distance(camera: Camera, lens: Lens) -> float:
    """v in metres: the bare hole's own, else the camera's fx times pixel pitch.

    >>> camera = Camera.from_fov(640, 480, fov_x_deg=90, pixel_pitch_um=5.0)
    >>> round(film_distance(camera, Pinhole()), 9), film_distance(camera, BareAperture(1e-3, film_distance=0.05))
    (0.0016, 0.05)
    """
    return lens.film_distance if isinstance(lens, BareAperture) else camera.film_distance


def _check_hole(name: str, diameter: float, aperture: Aperture) -> None:
    optics.check_diameter(name, diameter)
    if not isinstance(aperture, Aperture):
        raise InputError(f"aperture must be Disk, Polygon, Annulus or MaskAperture, got {format_value(aperture)}")
