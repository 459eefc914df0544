"""Lens models: the ideal pinhole, the thin lens, and the bare aperture without a lens.

Each has an `aperture_diameter` (metres), an `aperture` shape and a `vergence` k (1/m).
"""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from twinlens import optics
from twinlens.camera.aperture import FULL_DISK, Aperture
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, check_number, format_value


@dataclass(frozen=True)
class Pinhole:
    """The ideal pinhole: an aperture of zero width, sharp everywhere."""

    name: ClassVar[str] = "pinhole"
    aperture: ClassVar[Aperture] = FULL_DISK
    aperture_diameter: ClassVar[float] = 0.0
    vergence: ClassVar[float] = 0.0


class _OpenLens:
    """Base of the lenses with an aperture."""

    aperture: Aperture

    def _check_aperture(self, name: str) -> None:
        optics.check_diameter(name, getattr(self, name))
        if not isinstance(self.aperture, Aperture):
            got = format_value(self.aperture)
            raise InputError(
                f"aperture must be Disk, Polygon, Annulus or MaskAperture, got {got}"
            )

    def replace(self, **changes: object) -> Self:
        """A copy with some fields changed, checked again."""
        return replace(self, **changes)  # type: ignore[type-var]


@dataclass(frozen=True)
class ThinLens(_OpenLens):
    """A thin lens focused on the plane z = focus_distance, metres, > 0; may be inf.

    aperture_diameter : diameter A of the entrance pupil in metres, >= 0; 0 is a pinhole.
    aperture : its shape inside the circle of diameter A.
    defocus : error of the focus, 1/m, added to the vergence: it is sharp at 1 / (1/focus_distance + defocus), and
    nowhere if this is negative.
    """

    name: ClassVar[str] = "thinlens"
    aperture_diameter: float
    focus_distance: float
    aperture: Aperture = FULL_DISK
    defocus: float = 0.0

    def __post_init__(self) -> None:
        self._check_aperture("aperture_diameter")
        optics.check_focus(self.focus_distance)
        check_number(
            "defocus",
            self.defocus,
            "a number of 1/m from -1e6 to 1e6",
            least=-1e6,
            most=1e6,
        )

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
        check_number(
            "f_number", f_number, "positive, from 1e-6 to 1e9", least=1e-6, most=1e9
        )
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
class BareAperture(_OpenLens):
    """An aperture without a lens in front of a film: the camera obscura.

    diameter : of the aperture, metres, >= 0; `aperture` is its shape inside the circle.
    film_distance : from the aperture to the film, metres, > 0; film_distance / fx is the pixel pitch.
    """

    name: ClassVar[str] = "bareaperture"
    diameter: float
    film_distance: float
    aperture: Aperture = FULL_DISK

    def __post_init__(self) -> None:
        self._check_aperture("diameter")
        optics.check_length("film_distance", self.film_distance)

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
