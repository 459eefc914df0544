"""Lenses: how a point of the film and a point of the aperture become a ray.

Three levels, each of which adds what more of twinlens needs:

    Lens            rays and a chief ray                        images and ground truth
    ApertureLens    an aperture, a ray through each point       samples: blur circles, light on the film, mismatches
    Paraxial        a vergence: rays differ by a pure shift     lens grids, parts of an aperture, light fields

`Pinhole`, `ThinLens` and `BareAperture` are paraxial.

Rays are in the camera frame (x right, y down, z forward, metres), from the aperture into the scene. Vectors are tuples
of three components, each a number or an array, so that one formula serves NumPy and the renderer's arrays.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from twinlens import optics
from twinlens.camera.aperture import (
    FULL_DISK,
    NUMPY,
    Aperture,
    ArrayFunctions,
    Disk,
)
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, format_value
from twinlens.geometry import Float
from twinlens.optics.irradiance import (
    barrel_vignetting,
    disk_irradiance,
    hole_irradiance,
    lens_irradiance,
    natural_vignetting,
)
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

_STRATA = 256  # per side, over a bare aperture that is not a disk
_BLUR_POINTS = 33  # of the aperture's horizontal diameter, with both ends

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


class ApertureLens(Lens):
    """A lens with an aperture, of which the ray through each point of that aperture is known.

    A subclass has the two attributes and `through`. Everything else follows from them, and is overridden where a lens
    has a closed form or light of its own.

    aperture_diameter : A in metres, 0 for a lens without blur.
    aperture : the shape of the opening inside the circle of diameter A.
    """

    aperture_diameter: float
    aperture: Aperture = FULL_DISK
    is_bare: ClassVar[bool] = False
    """Whether it is an opening without glass, which has no focus."""

    @abstractmethod
    def through(
        self, x: Any, y: Any, ax: Any, ay: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        """Origin, direction and weight of the ray from a film point through a point of the aperture, as in `rays`.

        ax, ay : the point of the aperture, metres right and down from its middle.
        """

    def rays(
        self, x: Any, y: Any, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        radius = xp.constant(0.5 * self.aperture_diameter)
        across, down = self.aperture.sample(u1, u2, xp)
        return self.through(x, y, radius * across, radius * down, xp)

    def chief_ray(self, x: Any, y: Any) -> tuple[Vector, Vector]:
        """The ray through the middle of the aperture."""
        origin, direction, _ = self.through(x, y, 0.0, 0.0)
        return origin, direction

    def blur_px(
        self, depth: ArrayLike, fx: float, x: ArrayLike = 0.0, y: ArrayLike = 0.0
    ) -> Float:
        """Signed width of the blur circle along the rows of the image, pixels, of points at `depth`; float64.

        The largest distance between rays through 33 points of the aperture's horizontal diameter. These rays need not
        be those at the rim: with spherical aberration the rim can be sharp where the rest is not. The width is
        positive, as before the plane of focus, if of the two rays farthest apart at `depth` the right one is also the
        right one in the aperture.

        depth : metres along the axis, > 0; +inf is allowed.
        x, y : film points, by default on the axis.
        """
        radius = 0.5 * self.aperture_diameter
        inverse_depth = 1.0 / np.asarray(depth, dtype=np.float64)
        least = most = self._tangent_at(x, y, -radius, inverse_depth)
        ax_least = ax_most = np.asarray(-radius)
        # One ray at a time, as `depth` may be a map of many pixels.
        for ax in np.linspace(-radius, radius, _BLUR_POINTS)[1:]:
            tangent = self._tangent_at(x, y, ax, inverse_depth)
            ax_least = np.where(tangent < least, ax, ax_least)
            ax_most = np.where(tangent > most, ax, ax_most)
            least = np.minimum(tangent, least)
            most = np.maximum(tangent, most)
        sign = np.where(ax_most < ax_least, -1.0, 1.0)
        return np.asarray(fx * sign * (most - least))

    def _tangent_at(self, x: Any, y: Any, ax: float, inverse_depth: Float) -> Any:
        """X/Z of the point at a depth on the ray through (ax, 0) of the aperture."""
        origin, direction, _ = self.through(x, y, ax, 0.0)
        slope = direction[0] / direction[2]
        # X = ox + (Z - oz) slope, over Z: in this form also for Z = inf.
        return slope + (origin[0] - origin[2] * slope) * inverse_depth

    def depth_of_field(self, fx: float) -> tuple[float, float] | None:
        """(near, far) depths between which the blur circle is at most a pixel wide; None if they are not known."""
        return None

    def distance_to_film(self, camera: Camera) -> float:
        """v in metres: by default the camera's, fx times pixel pitch."""
        return camera.film_distance

    def irradiance(self, camera: Camera) -> float:
        """E/L in steradians on the axis of a lens with A > 0: light on the film over radiance."""
        f_number = self.distance_to_film(camera) / self.aperture_diameter
        return lens_irradiance(f_number, self.aperture.area_fraction)

    def relative_light(self, camera: Camera) -> Float:
        """The light of the pixels relative to the axis, (H, W), of images whose rays have their weights already.

        By default cos^4 of the angle between the axis and the line from the aperture to the pixel.
        """
        x = (np.arange(camera.width) - camera.cx) / camera.fx
        y = (np.arange(camera.height) - camera.cy) / camera.fy
        return natural_vignetting(x[None, :], y[:, None])

    def adjusted(self, f_number: float, defocus: float) -> "ApertureLens":
        """The lens with the aperture diameter divided by `f_number`, and with the vergence raised by `defocus`, 1/m.

        Its light on the axis is divided by f_number^2; chief rays, vignetting and film distance stay. A `rays` of the
        lens must start at points of the aperture: those are drawn towards the middle. A lens for which this is not
        right replaces `adjusted`.
        """
        return _Adjusted(self, f_number, defocus)


@dataclass(frozen=True)
class _Forwarded(ApertureLens):
    """All but the rays of a lens that is stopped down by a factor and has another focus."""

    lens: ApertureLens
    f_number: float
    defocus: float

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.lens.name

    @property
    def aperture_diameter(self) -> float:  # type: ignore[override]
        return self.lens.aperture_diameter / self.f_number

    @property
    def aperture(self) -> Aperture:  # type: ignore[override]
        return self.lens.aperture

    @property
    def is_bare(self) -> bool:  # type: ignore[override]
        return self.lens.is_bare

    def distance_to_film(self, camera: Camera) -> float:
        return self.lens.distance_to_film(camera)

    def irradiance(self, camera: Camera) -> float:
        """In proportion to the area of the aperture."""
        return self.lens.irradiance(camera) / self.f_number**2

    def relative_light(self, camera: Camera) -> Float:
        return self.lens.relative_light(camera)

    def blur_px(
        self, depth: ArrayLike, fx: float, x: ArrayLike = 0.0, y: ArrayLike = 0.0
    ) -> Float:
        """That of the adjusted rays, or from the lens's own: c = A fx (1/z - k) with another A and k."""
        if not _replaces(self.lens, "blur_px"):
            return super().blur_px(depth, fx, x, y)
        tilt = self.lens.aperture_diameter * fx * self.defocus
        return (self.lens.blur_px(depth, fx, x, y) - tilt) / self.f_number

    def depth_of_field(self, fx: float) -> tuple[float, float] | None:
        """That of the adjusted lens, or from the lens's own: 1/z = k +- c / (A fx) with another A and k."""
        if not _replaces(self.lens, "depth_of_field"):
            return super().depth_of_field(fx)
        depths = self.lens.depth_of_field(fx)
        if depths is None or (self.f_number, self.defocus) == (1.0, 0.0):
            return depths
        near, far = depths
        if not 0 < near <= far < np.inf:
            return None  # k does not follow from one end alone
        middle = 0.5 * (1 / near + 1 / far) + self.defocus
        margin = 0.5 * (1 / near - 1 / far) * self.f_number
        ends = middle + margin, middle - margin
        near, far = (1 / end if end > 0 else np.inf for end in ends)
        return near, far


def _replaces(lens: ApertureLens, name: str) -> bool:
    """Whether a lens has a method of its own instead of that of its level."""
    method = getattr(type(lens), name)
    return method not in (getattr(ApertureLens, name), getattr(Paraxial, name))


@dataclass(frozen=True)
class _Adjusted(_Forwarded):
    """A lens stopped down by a factor, whose rays are tilted by another focus."""

    def rays(
        self, x: Any, y: Any, u1: Any, u2: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        if not _replaces(self.lens, "rays"):
            return super().rays(x, y, u1, u2, xp)
        (ax, ay, _), _, weight = self.lens.rays(x, y, u1, u2, xp)
        scale = xp.constant(1.0 / self.f_number)
        origin, direction, _ = self.through(x, y, scale * ax, scale * ay, xp)
        return origin, direction, weight

    def through(
        self, x: Any, y: Any, ax: Any, ay: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        origin, (dx, dy, dz), weight = self.lens.through(x, y, ax, ay, xp)
        defocus = xp.constant(self.defocus)
        return origin, (dx - defocus * ax * dz, dy - defocus * ay * dz, dz), weight

    def chief_ray(self, x: Any, y: Any) -> tuple[Vector, Vector]:
        """That of the lens: the middle of the aperture has no tilt."""
        return self.lens.chief_ray(x, y)

    def adjusted(self, f_number: float, defocus: float) -> "_Adjusted":
        return _Adjusted(self.lens, self.f_number * f_number, self.defocus + defocus)


class Paraxial(ApertureLens):
    """A lens whose rays differ from those of a pinhole by a pure shift, in proportion to the aperture point.

    A point (ax, ay, 0) of the aperture sends the ray with the direction (x - k ax, y - k ay, 1), with the vergence k.
    All film points use one aperture, and a change of k shifts images by a known amount for each aperture point. Lens
    grids trace one ray for lenses with different k, so that a subclass cannot replace the rays. Raises TypeError for a
    class that does.
    """

    def __init_subclass__(cls, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        for name in ("rays", "through", "chief_ray"):
            if getattr(cls, name) is not getattr(Paraxial, name):
                raise TypeError(
                    f"{cls.__name__} is Paraxial and must not replace {name!r}: derive it from ApertureLens"
                )

    @property
    @abstractmethod
    def vergence(self) -> float:
        """k in 1/m: points at the depth 1/k are sharp."""

    def through(
        self, x: Any, y: Any, ax: Any, ay: Any, xp: ArrayFunctions = NUMPY
    ) -> tuple[Vector, Vector, Any]:
        vergence = xp.constant(self.vergence)
        return *paraxial_ray(x, y, ax, ay, vergence), 1.0

    def blur_px(
        self, depth: ArrayLike, fx: float, x: ArrayLike = 0.0, y: ArrayLike = 0.0
    ) -> Float:
        """`optics.circle_of_confusion_px`: the same at all film points. Samples rely on this."""
        return optics.circle_of_confusion_px(
            depth, self.aperture_diameter, fx, self.vergence
        )

    def depth_of_field(self, fx: float) -> tuple[float, float]:
        return optics.depth_of_field(self.aperture_diameter, fx, self.vergence)

    def adjusted(self, f_number: float, defocus: float) -> "Paraxial":
        return _AdjustedParaxial(self, f_number, defocus)


@dataclass(frozen=True)
class _AdjustedParaxial(_Forwarded, Paraxial):  # type: ignore[misc]  # depth_of_field may be None
    """A paraxial lens with another aperture diameter and vergence."""

    lens: Paraxial

    @property
    def vergence(self) -> float:
        return self.lens.vergence + self.defocus

    def adjusted(self, f_number: float, defocus: float) -> "_AdjustedParaxial":
        return _AdjustedParaxial(
            self.lens, self.f_number * f_number, self.defocus + defocus
        )


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
    is_bare: ClassVar[bool] = True
    aperture_diameter = 0.0
    vergence = 0.0

    def adjusted(self, f_number: float, defocus: float) -> "Pinhole":
        """The pinhole itself, which has no focus."""
        return self


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

    def relative_light(self, camera: Camera) -> Float:
        """`natural_vignetting`, and for a lens of some width `barrel_vignetting` of `optics.irradiance`."""
        natural = super().relative_light(camera)
        radius = 0.5 * self.aperture_diameter
        if radius == 0:
            return natural
        return natural * barrel_vignetting(natural, radius, camera.film_distance)

    def adjusted(self, f_number: float, defocus: float) -> "ThinLens":
        return self.replace(
            aperture_diameter=self.aperture_diameter / f_number,
            defocus=self.defocus + defocus,
        )


@dataclass(frozen=True)
class BareAperture(Settings, Paraxial, noun="lens"):
    """An aperture without a lens in front of a film: the camera obscura.

    The aperture has its shape inside the circle of its diameter; film_distance / fx is the pixel pitch.

    Raises InputError when a value is out of range.
    """

    name: ClassVar[str] = "bareaperture"
    is_bare: ClassVar[bool] = True
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

    def distance_to_film(self, camera: Camera) -> float:
        """Its own: the film need not be at fx times the pixel pitch."""
        return self.film_distance

    def irradiance(self, camera: Camera) -> float:
        """Exact on the axis, at most pi; of other shapes than a disk to 0.1 % up to A/v = 100."""
        radius = 0.5 * self.diameter
        if isinstance(self.aperture, Disk):
            return disk_irradiance(radius, self.film_distance)
        middles = (np.arange(_STRATA) + 0.5) / _STRATA
        x, y = self.aperture.sample(*np.meshgrid(middles, middles))
        fraction = self.aperture.area_fraction
        return hole_irradiance(x, y, radius, self.film_distance, fraction)

    def adjusted(self, f_number: float, defocus: float) -> "BareAperture":
        """The hole with another diameter: it has no focus."""
        return self.replace(diameter=self.diameter / f_number)


RecipeLens = Pinhole | ThinLens | BareAperture
"""The lenses that recipes and records can hold."""


def check_lens(lens: object) -> Lens:
    """`lens`, if it is a lens. Raises InputError for other objects."""
    if not isinstance(lens, Lens):
        raise InputError(
            f"a lens must be a twinlens.camera.Lens, such as Pinhole or ThinLens, got {format_value(lens)}"
        )
    return lens


def require_aperture(lens: object, purpose: str) -> ApertureLens:
    """`lens`, if it has an aperture. Raises InputError that says what needs it: `purpose`, as "an exposure"."""
    checked = check_lens(lens)
    if not isinstance(checked, ApertureLens):
        raise InputError(
            f"{purpose} needs a lens with an aperture (an ApertureLens, as ThinLens is), got the lens {checked.name!r}"
        )
    return checked


def require_paraxial(lens: object, purpose: str) -> Paraxial:
    """`lens`, if it is paraxial. Raises InputError that says what needs it: `purpose`, as "a lens grid".

    What needs it moves an image by one shift for each point of the aperture, the same at all film points.
    """
    checked = check_lens(lens)
    if not isinstance(checked, Paraxial):
        raise InputError(
            f"{purpose} needs a paraxial lens (one shift of all rays for each point of the aperture, as ThinLens has), "
            f"got the lens {checked.name!r}"
        )
    return checked


def check_lens_on(camera: Camera, lens: object) -> None:
    """Raise InputError unless `lens` is a lens, and a `Pinhole` if the camera `is_wide`.

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
    if isinstance(lens, ApertureLens):
        return lens.distance_to_film(camera)
    return camera.film_distance
