"""The light that rough surfaces reflect towards the views of a light field, shared by all views.

Views of a light field see the same surfaces from nearly the same place. A few light paths from each view give the light
of cells: pieces of surface as large as a pixel of a camera in the middle of the views. Then each view traces rays to
first surfaces only, which costs about a tenth of a path, and takes their light from the cells:

    radiance = matte part of the BSDF * irradiance + rest

The matte part is that at the ray's own point, so that cells do not blur its texture. The rest, such as highlights,
depends on the direction towards the view. Cells have it for four corners around all views, evaluated for the same light
paths, and views interpolate between them.

Each view traces light paths itself where cells do not serve: at surfaces with narrower highlights than interpolation
permits, surfaces that some corners see from behind, mirrors, glass, and cells without samples. Each view also computes
light directly from projectors.

The samples of a cell, from all views, are points of one scrambled Sobol sequence. Importing this module sets up the
backend.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.camera.light_field import places_in_plane
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.frames import SceneFrame
from twinlens.rendering.irradiance_cache import from_emitter, mis
from twinlens.rendering.paths import (
    Paths,
    PathState,
    lit_by,
    matte_part,
    shading_cosine,
)
from twinlens.rendering.ray_generation import opaque
from twinlens.rendering.sobol import SobolSampler

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

_LIGHT_RAYS, _CAMERA_RAYS = 1 << 19, 1 << 23  # at once
_SLICES = 20.0  # of cells, per unit of the logarithm of depth
_NARROW = 0.01  # density of the mirror's direction, times the solid angle of the square around the views
_GOLDEN = (math.sqrt(5) - 1) / 2
_CORNERS = 4

# Rows of the sums over a cell: the matte part of the BSDF, what it reflects, the rest towards each corner, the count.
_MATTE = slice(0, 3)
_LIT = slice(3, 6)
_REST = slice(6, 6 + 3 * _CORNERS)
_COUNT = -1
_ROWS = 7 + 3 * _CORNERS


class Batch(NamedTuple):
    """Consecutive views and samples."""

    views: range
    samples: range


class Place(NamedTuple):
    """Rays of a batch: number of the view, column and row of the pixel, number of the sample."""

    view: Any
    column: Any
    row: Any
    sample: Any


class Views:
    """The rays of a rig of pinhole cameras in one plane, and the four corners around them, all in `frame`.

    axes : x, y and z of the cameras.
    middle, middle_principal : centre and principal point of a camera in the middle of the views.
    corners : of the rectangle around the views; `extent` is its longer side.
    weights : (4, N), of each corner at each view, for bilinear interpolation.
    """

    def __init__(self, rig: Rig, frame: SceneFrame) -> None:
        places = frame.scale * places_in_plane(rig)
        poses = [frame.rigid(pose) for pose in rig.world_from_cams]
        camera, pose = rig.cameras[0], poses[0]
        self.count, self.width, self.height = len(rig), camera.width, camera.height
        self._pixels = dr.opaque(mi.UInt32, camera.width * camera.height)
        self._columns = dr.opaque(mi.UInt32, camera.width)
        self.focal = opaque(camera.fx), opaque(camera.fy)
        self.axes = [mi.Vector3f(*map(opaque, axis)) for axis in pose[:3, :3].T]

        principal = np.array([(camera.cx, camera.cy) for camera in rig.cameras])
        origins = np.array([pose[:3, 3] for pose in poses])
        self._principal = [_on_device(values) for values in principal.T]
        self._origins = [_on_device(values) for values in origins.T]
        middle = origins.mean(axis=0)
        self.middle = mi.Point3f(*map(opaque, middle))
        self.middle_principal = [*map(opaque, principal.mean(axis=0))]

        low, high = places.min(axis=0), places.max(axis=0)
        self.extent = opaque((high - low).max())
        self.corners = []
        for y in (low[1], high[1]):
            for x in (low[0], high[0]):
                corner = middle + pose[:3, :2] @ (x, y)
                self.corners.append(mi.Point3f(*map(opaque, corner)))
        self.weights = _bilinear_weights(places, low, high)

    def batches(self, samples: int, rays: int) -> Iterator[Batch]:
        """All samples of all views, in order of views; each batch has at most `rays` rays, or one image."""
        images = max(1, rays // (self.width * self.height))
        views_at_once = max(1, images // samples)
        for first in range(0, self.count, views_at_once):
            views = range(first, min(first + views_at_once, self.count))
            for start in range(0, samples, images):
                yield Batch(views, range(start, min(start + images, samples)))

    def split(self, ray: Any, batch: Batch) -> Place:
        """The places of rays of a batch, from their numbers: view, then pixel, then sample."""
        count = dr.opaque(mi.UInt32, len(batch.samples))
        pixel_of_view = ray // count
        view = pixel_of_view // self._pixels
        pixel = pixel_of_view - view * self._pixels
        row = pixel // self._columns
        return Place(
            view + dr.opaque(mi.UInt32, batch.views[0]),
            pixel - row * self._columns,
            row,
            ray - pixel_of_view * count + dr.opaque(mi.UInt32, batch.samples[0]),
        )

    def rays(self, batch: Batch) -> Any:
        """Numbers of the rays of a batch, pixel by pixel."""
        images = len(batch.views) * len(batch.samples)
        return dr.arange(mi.UInt32, images * self.width * self.height)

    def ray(self, view: Any, column: Any, row: Any, x: Any, y: Any) -> Any:
        """The ray through the point (x, y) in [0, 1)^2 of a pixel, whose centre is at (0.5, 0.5)."""
        cx, cy = (dr.gather(mi.Float, values, view) for values in self._principal)
        across = (mi.Float(column) - 0.5 + x - cx) / self.focal[0]
        down = (mi.Float(row) - 0.5 + y - cy) / self.focal[1]
        direction = dr.normalize(
            across * self.axes[0] + down * self.axes[1] + self.axes[2]
        )
        origin = (dr.gather(mi.Float, values, view) for values in self._origins)
        return mi.Ray3f(mi.Point3f(*origin), direction)

    def film_ray(self, ray: Any, batch: Batch, samples: int, seed: int) -> Any:
        """Ray number `ray` of a batch of `samples`.

        The points of each pixel are a lattice with a random shift: sample k of n is at (k/n, k times the golden
        section), modulo 1.
        """
        view, column, row, sample = self.split(ray, batch)
        pixel = view * self._pixels + row * self._columns + column
        random = mi.sample_tea_32(pixel, dr.opaque(mi.UInt32, seed))
        x, y = (mi.Float(bits >> 8) * 2.0**-24 for bits in random)
        x = (mi.Float(sample) + x) / opaque(samples)
        y += mi.Float(sample) * _GOLDEN
        return self.ray(view, column, row, x, y - dr.floor(y))


def _on_device(values: Float) -> Any:
    return mi.Float(values.astype(np.float32))


def _bilinear_weights(places: Float, low: Float, high: Float) -> Float:
    """Weights (4, N) of the corners of the rectangle from `low` to `high` (2,) at places (N, 2) in it."""
    fractions = np.zeros_like(places)
    np.divide(places - low, high - low, out=fractions, where=high > low)
    right, below = fractions.T
    left, above = 1 - right, 1 - below
    return np.stack([left * above, right * above, left * below, right * below])


class SharedLight:
    """The light of the cells, from `samples` light paths per pixel of each view.

    Cells are pixels of the middle camera, whose film is continued on all sides, divided by shape, normal and depth. A
    cell is known by its pixel and a code of the rest; both are sorted, and `_ends` has the first cell of each pixel.
    """

    def __init__(
        self, scene: Any, paths: Paths, views: Views, samples: int, seed: int
    ) -> None:
        self.views = views
        self._margin = max(views.width, views.height) // 2
        self._columns = views.width + 2 * self._margin
        self._rows = views.height + 2 * self._margin

        # Points of the pixels, one of each stratum of a row and of a column for the samples of all views together.
        random, count = np.random.default_rng(seed), views.count * samples
        strata = np.stack([random.permutation(count), np.arange(count)])
        film = (strata + random.random((2, count))) / count
        order = random.permutation(count).astype(np.uint32)

        cells, sums = np.zeros(0, np.int64), np.zeros((_ROWS, 0))
        for batch in views.batches(samples, _LIGHT_RAYS):
            new_cells, values = self._samples(
                scene, paths, batch, samples, film, order, seed
            )
            cells, sums = _merged(cells, sums, new_cells, values)
        self.count = len(cells)
        self._irradiance = np.full((3, self.count), np.nan)
        np.divide(
            sums[_LIT], sums[_MATTE], out=self._irradiance, where=sums[_MATTE] > 0
        )
        self._rest = (sums[_REST] / sums[_COUNT]).reshape(_CORNERS, 3, -1)
        pixels = np.arange(self._columns * self._rows + 1)
        self._ends = mi.UInt32(np.searchsorted(cells >> 32, pixels).astype(np.uint32))
        self._codes = mi.UInt32(np.append(cells, 0).astype(np.uint32))

    def towards(self, views: range) -> Any:
        """Irradiance, and rest of the radiance towards each of `views`, as one array of colours on the device.

        Colour 2 (k n + c) is the irradiance of cell c for the k-th of `views`, n the number of cells; the next colour
        is the rest. Irradiance is NaN where no sample has a matte part.
        """
        rest = np.tensordot(self.views.weights[:, views], self._rest, (0, 0))
        irradiance = np.broadcast_to(self._irradiance, rest.shape)
        light = np.stack([irradiance, rest], axis=1).transpose(0, 3, 1, 2).ravel()
        return _on_device(np.append(light, 0.0))  # Dr.Jit reads no empty arrays

    def look_up(self, si: Any, ray: Any, active: Any) -> tuple[Any, Any]:
        """Whether there is a cell at `si`, and its number."""
        inside, column, row, code = self._place(si, ray, active)
        pixel = row * self._columns + column
        start = dr.gather(mi.UInt32, self._ends, pixel, inside)
        end = dr.gather(mi.UInt32, self._ends, pixel + 1, inside)

        def is_other(cell: Any, end: Any, code: Any) -> Any:
            in_pixel = cell < end
            return in_pixel & (
                dr.gather(mi.UInt32, self._codes, cell, in_pixel) != code
            )

        cell, *_ = dr.while_loop(
            (start, end, code), is_other, lambda cell, end, code: (cell + 1, end, code)
        )
        return inside & (cell < end), cell

    def needs_paths(self, si: Any, bsdf: Any, active: Any) -> Any:
        """Whether the BSDF may change between the corners by more than interpolation permits.

        It does if a lobe is narrow, or if the corners are on both sides of the surface.
        """
        flags = bsdf.flags()
        glossy = mi.has_flag(flags, mi.BSDFFlags.Glossy)
        mirrored = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)
        density = bsdf.pdf(mi.BSDFContext(), si, mirrored, active & glossy)
        solid_angle = dr.square(self.views.extent / si.t)
        narrow = glossy & (density * solid_angle > _NARROW)
        narrow |= mi.has_flag(flags, mi.BSDFFlags.Delta)
        narrow |= mi.has_flag(flags, mi.BSDFFlags.GlossyTransmission)
        cosine = mi.Frame3f.cos_theta(si.wi)
        for corner in self.views.corners:
            narrow |= cosine * dr.dot(si.sh_frame.n, corner - si.p) <= 0
        return narrow

    def _place(self, si: Any, ray: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Whether a surface is on the middle camera's film, its pixel there, and the code of its cell in the pixel."""
        views = self.views
        x, y, z = (dr.dot(si.p - views.middle, axis) for axis in views.axes)
        cx, cy = views.middle_principal
        column = dr.floor(views.focal[0] * x / z + cx + 0.5) + self._margin
        row = dr.floor(views.focal[1] * y / z + cy + 0.5) + self._margin
        inside = active & (z > 0) & (column >= 0) & (row >= 0)
        inside &= (column < self._columns) & (row < self._rows)
        # Normals in 5 steps of each component, depth in steps of equal ratio: a cell is as deep as about a twentieth of
        # its distance, at every distance. A hash of both and of the shape fits 32 bits; equal hashes of different
        # surfaces in one pixel are rare enough not to be seen.
        facing = dr.select(dr.dot(si.n, ray.d) > 0, -si.n, si.n)
        i, j, k = (mi.UInt32(mi.Int32(dr.floor(2 * part + 2.5))) for part in facing)
        depth = mi.UInt32(mi.Int32(dr.floor(dr.log(z) * _SLICES)))
        shape = dr.reinterpret_array(mi.UInt32, si.shape)
        code = mi.sample_tea_32(shape, 125 * depth + 25 * i + 5 * j + k)[0]
        return inside, mi.UInt32(column), mi.UInt32(row), code

    def _samples(
        self,
        scene: Any,
        paths: Paths,
        batch: Batch,
        samples: int,
        film: Float,
        order: NDArray[np.uint32],
        seed: int,
    ) -> tuple[NDArray[np.int64], Float]:
        """Cells (N,) and what is summed over them (_ROWS, N), from a batch of light paths."""
        views = self.views
        view, column, row, sample = views.split(views.rays(batch), batch)
        number = view * dr.opaque(mi.UInt32, samples) + sample
        x, y = (dr.gather(mi.Float, _on_device(values), number) for values in film)
        ray = views.ray(view, column, row, x, y)
        si = scene.ray_intersect(ray, mi.RayFlags.All, True)
        active, column, row, code = self._place(si, ray, si.is_valid())
        active &= ~self.needs_paths(si, si.bsdf(), active)
        # All samples that meet a pixel of the middle camera are points of one sequence, in a random order.
        sampler = SobolSampler(len(order), self._columns)
        place_in_sequence = dr.gather(mi.UInt32, mi.UInt32(order), number)
        sampler.seed_at(column, row, place_in_sequence, seed)

        values = self._light(scene, paths, si, sampler, active)
        place = row * self._columns + column, code
        dr.eval(active, place, values)  # else each channel would trace the paths again
        kept: Any = dr.compress(active)
        pixel, code = (
            np.array(dr.gather(mi.UInt32, part, kept)).astype(np.int64)
            for part in place
        )
        columns = [
            np.array(dr.gather(mi.Float, channel, kept), np.float64)
            for channel in values
        ]
        return pixel << 32 | code, np.stack([*columns, np.ones(len(pixel))])

    def _light(
        self, scene: Any, paths: Paths, si: Any, sampler: Any, active: Any
    ) -> list[Any]:
        """The rows of sums but the count: one light path from each surface."""
        bsdf, context = si.bsdf(), mi.BSDFContext()
        reflects = active & (paths.max_depth > 1)
        smooth = reflects & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        # As in `Paths`: a point on an emitter, and a direction in which the path goes on.
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), False, smooth)
        to_light = si.to_local(ds.d)
        _, pdf, chosen, factor = bsdf.eval_pdf_sample(
            context, si, to_light, sampler.next_1d(), sampler.next_2d(), reflects
        )
        is_lit = smooth & (ds.pdf != 0)
        light = light * dr.select(ds.delta, 1.0, mis(ds.pdf, pdf))
        light = from_emitter(scene, ds, si, light, is_lit, paths.openings)
        goes_on = reflects & (chosen.pdf > 0) & dr.any(factor != 0)
        end = paths.follow(scene, _second_surface(si, chosen, sampler, goes_on))
        reached = dr.select(goes_on, end.radiance / chosen.pdf, 0.0)
        light = dr.select(dr.isfinite(light), light, 0.0)
        reached = dr.select(dr.isfinite(reached), reached, 0.0)

        is_diffuse = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        matte = matte_part(bsdf, si, active & is_diffuse)
        from_light = light * shading_cosine(si, to_light)
        from_path = reached * shading_cosine(si, chosen.wo)
        lit = matte * (from_light + from_path)
        values = [*matte, *lit]
        # The same light, reflected towards each corner.
        for corner in self.views.corners:
            seen = mi.SurfaceInteraction3f(si)
            seen.wi = si.to_local(dr.normalize(corner - si.p))
            whole = light * bsdf.eval(context, seen, to_light, smooth)
            whole += reached * bsdf.eval(context, seen, chosen.wo, goes_on)
            values.extend(whole - lit)
        return values


def _second_surface(si: Any, chosen: Any, sampler: Any, active: Any) -> PathState:
    """Paths on the way from `si` in the direction that was chosen there, whose weight is left out."""
    onward = si.spawn_ray(si.to_world(chosen.wo))
    return PathState(
        active=active,
        sampler=sampler,
        origin=onward.o,
        direction=onward.d,
        weight=mi.Spectrum(1.0),
        eta=chosen.eta,
        depth=mi.UInt32(1),
        previous_point=mi.Point3f(si.p),
        previous_pdf=chosen.pdf,
        previous_is_delta=mi.Bool(False),
        was_diffuse=mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Diffuse),
        features=(),
        radiance=mi.Spectrum(0.0),
    )


def _merged(
    cells: NDArray[np.int64],
    sums: Float,
    new_cells: NDArray[np.int64],
    values: Float,
) -> tuple[NDArray[np.int64], Float]:
    """Sorted cells and their sums, after values (_ROWS, N) of `new_cells` (N,) are added."""
    cells, row = np.unique(np.concatenate([cells, new_cells]), return_inverse=True)
    merged = [
        np.bincount(row, np.append(old, new), len(cells))
        for old, new in zip(sums, values, strict=True)
    ]
    return cells, np.stack(merged)


def shared_images(
    scene: Any, paths: Paths, light: SharedLight, samples: int, seed: int, sky: bool
) -> Iterator[Float]:
    """Mean radiance (H, W, 3) of each view. `sky` says whether they see it."""
    total: Any = 0.0
    for batch in light.views.batches(samples, _CAMERA_RAYS):
        total = total + _radiance(scene, paths, light, batch, samples, seed, sky)
        if batch.samples[-1] == samples - 1:
            yield from total / samples
            total = 0.0


def _radiance(
    scene: Any,
    paths: Paths,
    light: SharedLight,
    batch: Batch,
    samples: int,
    seed: int,
    sky: bool,
) -> Float:
    """Sums of the radiance (V, H, W, 3) of a batch."""
    views = light.views
    rays = views.rays(batch)
    place = views.split(rays, batch)
    ray = views.film_ray(rays, batch, samples, seed)
    si = scene.ray_intersect(ray, mi.RayFlags.All, True)
    valid = si.is_valid()
    has_cell, reflected = _from_cells(light, si, ray, batch, place.view)
    traced = valid & ~has_cell
    shows_emitter = has_cell | (~valid & sky)
    radiance = dr.select(shows_emitter, si.emitter(scene).eval(si), 0.0)
    radiance += dr.select(has_cell, reflected, 0.0)
    sampler = SobolSampler(samples, views.width)
    if paths.lamps:
        _seed(sampler, place, seed)
        for from_lamp in _from_lamps(scene, paths, si, sampler, has_cell):
            radiance += from_lamp
    dr.eval(radiance, traced)

    # Whole light paths for the rays that found no cell.
    alone: Any = dr.compress(traced)
    if len(alone):
        _seed(sampler, views.split(alone, batch), seed)
        ray = views.film_ray(alone, batch, samples, seed)
        traced_radiance, *_ = paths.sample(scene, sampler, ray)
        for channel, values in zip(radiance, traced_radiance, strict=True):
            dr.scatter(channel, values, alone)
    # The samples of a pixel are next to each other.
    sums = [dr.block_sum(channel, len(batch.samples)) for channel in radiance]
    shape = len(batch.views), views.height, views.width, 3
    return np.stack([np.asarray(part, np.float64) for part in sums], -1).reshape(shape)


def _from_lamps(
    scene: Any, paths: Paths, si: Any, sampler: Any, active: Any
) -> Iterator[Any]:
    """The radiance that leaves surfaces along their rays by light directly from each lamp."""
    bsdf = si.bsdf()
    is_smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    smooth = active & (paths.max_depth > 1) & is_smooth
    for lamp in paths.lamps:
        yield lit_by(
            scene, lamp, bsdf, si, sampler.next_2d(), smooth, 0.0, paths.openings
        )


def _from_cells(
    light: SharedLight, si: Any, ray: Any, batch: Batch, view: Any
) -> tuple[Any, Any]:
    """Whether cells have the light that surfaces reflect along their rays, and this radiance."""
    bsdf = si.bsdf()
    has_cell, cell = light.look_up(si, ray, si.is_valid())
    has_cell &= ~light.needs_paths(si, bsdf, has_cell)
    is_diffuse = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
    matte = matte_part(bsdf, si, has_cell & is_diffuse)
    # Two colours for each view of the batch and each cell: irradiance, and the rest of the radiance.
    colours = light.towards(batch.views)
    view_in_batch = view - dr.opaque(mi.UInt32, batch.views[0])
    place = 2 * (view_in_batch * dr.opaque(mi.UInt32, light.count) + cell)
    irradiance = dr.gather(mi.Color3f, colours, place, has_cell)
    rest = dr.gather(mi.Color3f, colours, place + 1, has_cell)
    reflected = dr.select(matte > 0, matte * irradiance, 0.0) + rest
    # NaN: part of the texture is black, and so were all samples of the cell.
    has_cell &= ~dr.any(dr.isnan(reflected))
    return has_cell, reflected


def _seed(sampler: SobolSampler, place: Place, seed: int) -> None:
    """Seed for rays at `place`, differently for each view: else all views would have the same noise in a pixel."""
    of_view = mi.sample_tea_32(place.view, dr.opaque(mi.UInt32, seed))[0]
    sampler.seed_at(place.column, place.row, place.sample, of_view)
