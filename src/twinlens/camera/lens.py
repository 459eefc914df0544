"""Lenses: how a point of the film and a point of the aperture become a ray.

`Lens` is all that the renderer knows of a lens. `Paraxial` adds what formulas of blur, light and diffraction need: an
aperture and a vergence. The three lenses of twinlens, `Pinhole`, `ThinLens` and `BareAperture`, are paraxial.

Rays are in the camera frame (x right, y down, z forward, metres), from the aperture into the scene. Vectors are tuples
of three components, each a number or an array, so that one formula serves NumPy and the renderer's arrays.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from twinlens import optics
from twinlens.camera.aperture import FULL_DISK, NUMPY, Aperture, ArrayFunctions
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, format_value
from twinlens.geometry import Float
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

Vector = tuple[Any, Any, Any]
"""Components x, y, z, which broadcast against each other."""


class Lens(ABC):
    """A lens, as the renderer and the ground truth see it.

    A point of the film is given by the direction (x, y, 1) in which an ideal pinhole would look from there: the
    undistorted coordinates x = (u - cx)/fx, y = (v - cy)/fy of a pixel (u, v).
    """

    name: ClassVar[str]

    @abstractmethod
    def rays(
        self, x: Any, y: Any, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        """Origin, direction and weight of the rays from film points through random points of the aperture.

        x, y : film points.
        u1, u2 : uniform random numbers in [0, 1), which choose the point of the aperture.
        xp : the functions of the array library of x, y, u1 and u2. Pass numbers of the lens through `xp.constant`, so
            that a sweep over lenses does not compile again.

        The direction need not be normalised. The weight is a factor of the radiance: 1 for a clear lens, 0 for a ray
        that a rim blocks.
        """

    @abstractmethod
    def chief_ray(self, x: Any, y: Any) -> tuple[Vector, Vector]:
        """Origin and direction of the ray that stands for a film point in ground truth; NumPy, float64.

        The direction need not be normalised, but must not vanish.
        """


class Paraxial(Lens):
    """A lens whose rays differ from those of a pinhole by a pure shift, in proportion to the aperture point.

    A point (ax, ay, 0) of the aperture sends the ray with the direction (x - k ax, y - k ay, 1), with the vergence k.
    All film points use one aperture, and a change of k shifts images by a known amount for each aperture point.

    aperture_diameter : A in metres, 0 for a pinhole.
    aperture : the shape of the opening inside the circle of diameter A.
    """

    aperture_diameter: float
    aperture: Aperture

    @property
    @abstractmethod
    def vergence(self) -> float:
        """k in 1/m: points at the depth 1/k are sharp."""

    def rays(
        self, x: Any, y: Any, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        radius = xp.constant(0.5 * self.aperture_diameter)
        across, down = self.aperture.sample(u1, u2, xp)
        vergence = xp.constant(self.vergence)
        return *paraxial_ray(x, y, radius * across, radius * down, vergence), 1.0

    def chief_ray(self, x: Any, y: Any) -> tuple[Vector, Vector]:
        """The ray of the pinhole in the middle of the aperture."""
        return (0.0, 0.0, 0.0), (x, y, 1.0)


def paraxial_ray(
    x: Any, y: Any, ax: Any, ay: Any, vergence: Any
) -> tuple[Vector, Vector]:
    """Origin and direction of the ray of a film point through the aperture point (ax, ay), metres.

    It crosses the chief ray (x, y, 1) at the depth 1 / vergence.
    """
    return (ax, ay, 0.0), (x - vergence * ax, y - vergence * ay, 1.0)


@dataclass(frozen=True)
class Pinhole(Paraxial):
    """The ideal pinhole: an aperture of zero width, sharp everywhere."""

    name: ClassVar[str] = "pinhole"
    aperture = FULL_DISK
    aperture_diameter = 0.0
    vergence = 0.0


@dataclass(frozen=True)
class ThinLens(Settings, Paraxial, noun="lens"):
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
class BareAperture(Settings, Paraxial, noun="lens"):
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
    def aperture_diameter(self) -> float:  # type: ignore[override]
        """The diameter, metres, under the name that lenses have in common."""
        return self.diameter

    @property
    def vergence(self) -> float:
        """k = -1/film_distance, in 1/m."""
        return optics.vergence(0.0, self.film_distance)


RecipeLens = Pinhole | ThinLens | BareAperture
"""The lenses that recipes and records can hold."""


def check_lens(lens: object) -> Lens:
    """`lens`, if it is a lens. Raises InputError for other objects."""
    if not isinstance(lens, Lens):
        raise InputError(
            f"a lens must be a Pinhole, ThinLens or BareAperture, got {format_value(lens)}"
        )
    return lens


def require_paraxial(lens: object, purpose: str) -> Paraxial:
    """`lens`, if it is paraxial. Raises InputError that says what needs it: `purpose`, as "a lens grid"."""
    checked = check_lens(lens)
    if not isinstance(checked, Paraxial):
        raise InputError(
            f"{purpose} needs a paraxial lens (Pinhole, ThinLens or BareAperture), got the lens {checked.name!r}"
        )
    return checked


def check_lens_on(camera: Camera, lens: object) -> None:
    """Raise InputError unless `lens` is a lens, and one of zero width if the camera `is_wide`.

    The film points of a lens are ideal coordinates (x, y), which such a camera does not have.
    """
    checked = check_lens(lens)
    if camera.is_wide and not isinstance(checked, Pinhole):
        raise InputError(
            f"a camera that sees 90 degrees or more from its axis needs a Pinhole, got the lens {checked.name!r}"
        )


def chief_rays(camera: Camera, lens: Lens, pixels: ArrayLike) -> tuple[Float, Float]:
    """Origins and directions (..., 3) of the chief rays of pixels (..., 2): camera frame, metres, float64.

    Directions are not normalised: they have z = 1 for a paraxial lens. A camera that `is_wide` has unit directions. NaN
    where the camera has no ray. Raises InputError for other lenses than a pinhole on a camera that `is_wide`.

    >>> camera = Camera.from_fov(64, 48, fov_x_deg=90)
    >>> origins, directions = chief_rays(camera, ThinLens(0.01, 2.0), [31.5, 23.5])
    >>> origins.tolist(), directions.tolist()
    ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    """
    check_lens_on(camera, lens)
    if camera.is_wide:
        directions = camera.rays(pixels)
        return np.zeros_like(directions), directions
    x, y, _ = np.moveaxis(camera.unproject(pixels), -1, 0)
    origin, direction = lens.chief_ray(x, y)
    return _stacked(origin, x.shape), _stacked(direction, x.shape)


def _stacked(vector: Vector, shape: tuple[int, ...]) -> Float:
    return np.stack([np.broadcast_to(part, shape) for part in vector], axis=-1)


def film_distance(camera: Camera, lens: Lens) -> float:
    """v in metres: the bare aperture's own, otherwise the camera's fx times pixel pitch.

    >>> camera = Camera.from_fov(640, 480, fov_x_deg=90, pixel_pitch_um=5.0)
    >>> round(film_distance(camera, Pinhole()), 9), film_distance(camera, BareAperture(1e-3, film_distance=0.05))
    (0.0016, 0.05)
    """
    if isinstance(lens, BareAperture):
        return lens.film_distance
    return camera.film_distance
