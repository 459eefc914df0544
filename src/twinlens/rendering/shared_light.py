"""The light that rough surfaces reflect towards the views of a light field, shared by all views.

Views of a light field see the same surfaces from nearly the same place. A few light paths from each view give the light
of cells: pieces of surface as large as a pixel of a camera in the middle of the views. Then each view traces rays to
first surfaces only, which costs about a tenth of a path, and takes their light from the cells:

    radiance = matte part of the BSDF * irradiance + rest

The matte part is that at the ray's own point, so that cells do not blur its texture. The rest, such as highlights,
depends on the direction towards the view. Cells have it for four corners around all views, evaluated for the same light
paths, and views interpolate between them. Each view traces light paths for surfaces with narrower highlights than that
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
from twinlens.rendering.irradiance_cache import mis
from twinlens.rendering.paths import Paths, lit_by, matte_part, shading_cosine
from twinlens.rendering.ray_generation import opaque
from twinlens.rendering.sobol import SobolSampler

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

_LIGHT_RAYS, _CAMERA_RAYS = 1 << 19, 1 << 23  # at once
_SLICES = 20.0  # of cells, per unit of the logarithm of depth
_NARROW = 0.01  # density of the mirror's direction, times the solid angle of the square around the views
_GOLDEN = (math.sqrt(5) - 1) / 2
_CORNERS = 4
_MATTE, _LIT, _REST, _COUNT = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 6 + 3 * _CORNERS),
    -1,
)  # rows of sums over a cell


class Batch(NamedTuple):
    """Consecutive views and samples."""

    views: range
    samples: range


class Views:
    """The rays of a rig of pinhole cameras in one plane, and the four corners around them."""

    def __init__(self, rig: Rig) -> None:
        places = places_in_plane(rig)
        camera, pose = rig.cameras[0], rig.world_from_cams[0]
        self.count, self.width, self.height = len(rig), camera.width, camera.height
        self._pixels = dr.opaque(mi.UInt32, camera.width * camera.height)
        self._columns = dr.opaque(mi.UInt32, camera.width)
        self.focal = opaque(camera.fx), opaque(camera.fy)
        self.axes = [mi.Vector3f(*map(opaque, column)) for column in pose[:3, :3].T]
        principal = np.array([(each.cx, each.cy) for each in rig.cameras])
        origins = np.array([each[:3, 3] for each in rig.world_from_cams])
        self._principal, self._origins = (
            [mi.Float(column.astype(np.float32)) for column in values.T]
            for values in (principal, origins)
        )
        middle = origins.mean(axis=0)
        self.middle, self.middle_principal = (
            mi.Point3f(*map(opaque, middle)),
            [*map(opaque, principal.mean(axis=0))],
        )
        low, high = places.min(axis=0), places.max(axis=0)
        corners = [(x, y) for y in (low[1], high[1]) for x in (low[0], high[0])]
        self.corners = [
            mi.Point3f(*map(opaque, middle + pose[:3, :2] @ corner))
            for corner in corners
        ]
        self.extent = opaque((high - low).max())
        right, below = np.divide(
            places - low, high - low, out=np.zeros_like(places), where=high > low
        ).T
        self.weights = np.stack(
            [
                (1 - right) * (1 - below),
                right * (1 - below),
                (1 - right) * below,
                right * below,
            ]
        )

    def batches(self, samples: int, rays: int) -> Iterator["Batch"]:
        """All samples of all views, in order of views; each batch has at most `rays` rays, or one image."""
        images = max(1, rays // (self.width * self.height))
        for first in range(0, self.count, max(1, images // samples)):
            views = range(first, min(first + max(1, images // samples), self.count))
            for start in range(0, samples, images):
                yield Batch(views, range(start, min(start + images, samples)))

    def split(self, ray: Any, batch: "Batch") -> tuple[Any, Any, Any, Any]:
        """View, column, row and sample of the rays of a batch."""
        count = dr.opaque(mi.UInt32, len(batch.samples))
        place = ray // count
        view = place // self._pixels
        pixel = place - view * self._pixels
        row = pixel // self._columns
        first = [dr.opaque(mi.UInt32, each[0]) for each in (batch.views, batch.samples)]
        return (
            view + first[0],
            pixel - row * self._columns,
            row,
            ray - place * count + first[1],
        )

    def rays(self, batch: "Batch") -> Any:
        """Numbers of the rays of a batch, pixel by pixel."""
        return dr.arange(
            mi.UInt32, len(batch.views) * self.width * self.height * len(batch.samples)
        )

    def ray(self, view: Any, column: Any, row: Any, x: Any, y: Any) -> Any:
        """The ray through the point (x, y) in [0, 1)^2 of a pixel."""
        cx, cy = (dr.gather(mi.Float, values, view) for values in self._principal)
        across = (mi.Float(column) - 0.5 + x - cx) / self.focal[0]
        down = (mi.Float(row) - 0.5 + y - cy) / self.focal[1]
        direction = dr.normalize(
            across * self.axes[0] + down * self.axes[1] + self.axes[2]
        )
        return mi.Ray3f(
            mi.Point3f(
                *(dr.gather(mi.Float, values, view) for values in self._origins)
            ),
            direction,
        )

    def film_ray(self, ray: Any, batch: "Batch", samples: int, seed: int) -> Any:
        """Ray number `ray` of a batch of `samples`. The points of each pixel are a lattice with a random shift."""
        view, column, row, sample = self.split(ray, batch)
        pixel = view * self._pixels + row * self._columns + column
        x, y = (
            mi.Float(bits >> 8) * 2.0**-24
            for bits in mi.sample_tea_32(pixel, dr.opaque(mi.UInt32, seed))
        )
        y += mi.Float(sample) * _GOLDEN
        return self.ray(
            view, column, row, (mi.Float(sample) + x) / opaque(samples), y - dr.floor(y)
        )


class SharedLight:
    """The light of the cells, from `samples` light paths per pixel of each view.

    Cells are pixels of the middle camera, whose film is continued on all sides, divided by shape, normal and depth.
    """

    def __init__(
        self, scene: Any, paths: Paths, views: Views, samples: int, seed: int
    ) -> None:
        self.views = views
        self._margin = max(views.width, views.height) // 2
        self._columns, self._rows = (
            views.width + 2 * self._margin,
            views.height + 2 * self._margin,
        )
        cells, sums = np.zeros(0, np.int64), np.zeros((7 + 3 * _CORNERS, 0))
        random, count = np.random.default_rng(seed), views.count * samples
        film = np.stack([random.permutation(count), np.arange(count)]) + random.random(
            (2, count)
        )
        order = random.permutation(count).astype(np.uint32)
        for batch in views.batches(samples, _LIGHT_RAYS):
            found, values = self._samples(
                scene, paths, batch, samples, film / count, order, seed
            )
            cells, row = np.unique(np.concatenate([cells, found]), return_inverse=True)
            sums = np.stack(
                [
                    np.bincount(row, np.append(*both), len(cells))
                    for both in zip(sums, values, strict=True)
                ]
            )
        self._irradiance = np.divide(
            sums[_LIT],
            sums[_MATTE],
            out=np.full((3, len(cells)), np.nan),
            where=sums[_MATTE] > 0,
        )
        self._rest = (sums[_REST] / sums[_COUNT]).reshape(_CORNERS, 3, -1)
        ends = np.searchsorted(cells >> 32, np.arange(self._columns * self._rows + 1))
        self._ends, self._codes = (
            mi.UInt32(ends.astype(np.uint32)),
            mi.UInt32(np.append(cells, 0).astype(np.uint32)),
        )
        self.count = len(cells)

    def towards(self, views: range) -> Any:
        """Irradiance, and rest of the radiance towards each of `views`: cell c of the first view has the first colours
        number 2 c and 2 c + 1. Irradiance is NaN where no sample has a matte part.
        """
        rest = np.tensordot(self.views.weights[:, views], self._rest, (0, 0))
        irradiance = np.broadcast_to(self._irradiance, rest.shape)
        light = np.stack([irradiance, rest], axis=1).transpose(0, 3, 1, 2).ravel()
        return mi.Float(
            np.append(light, 0.0).astype(np.float32)
        )  # Dr.Jit does not read from empty arrays

    def look_up(self, si: Any, ray: Any, active: Any) -> tuple[Any, Any]:
        """Whether there is a cell at `si`, and its number."""
        inside, column, row, code = self._place(si, ray, active)
        pixel = row * self._columns + column
        start, end = (
            dr.gather(mi.UInt32, self._ends, pixel + i, inside) for i in (0, 1)
        )

        def is_other(cell: Any, end: Any, code: Any) -> Any:
            return (cell < end) & (
                dr.gather(mi.UInt32, self._codes, cell, cell < end) != code
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
        narrow = glossy & (density * dr.square(self.views.extent / si.t) > _NARROW)
        narrow |= mi.has_flag(flags, mi.BSDFFlags.Delta) | mi.has_flag(
            flags, mi.BSDFFlags.GlossyTransmission
        )
        own = mi.Frame3f.cos_theta(si.wi)
        for corner in self.views.corners:
            narrow |= own * dr.dot(si.sh_frame.n, corner - si.p) <= 0
        return narrow

    def _place(self, si: Any, ray: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Whether a surface is on the middle camera's film, its pixel there, and the code of its cell in the pixel."""
        views = self.views
        x, y, z = (dr.dot(si.p - views.middle, axis) for axis in views.axes)
        column, row = (
            dr.floor(focal * along / z + principal + 0.5) + self._margin
            for focal, along, principal in zip(
                views.focal, (x, y), views.middle_principal, strict=True
            )
        )
        inside = (
            active
            & (z > 0)
            & (column >= 0)
            & (row >= 0)
            & (column < self._columns)
            & (row < self._rows)
        )
        facing = dr.select(dr.dot(si.n, ray.d) > 0, -si.n, si.n)
        i, j, k = (
            mi.UInt32(mi.Int32(dr.floor(2 * component + 2.5))) for component in facing
        )
        depth = mi.UInt32(mi.Int32(dr.floor(dr.log(z) * _SLICES)))
        code = mi.sample_tea_32(
            dr.reinterpret_array(mi.UInt32, si.shape), 125 * depth + 25 * i + 5 * j + k
        )[0]
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
        """Cells (N,) and what is summed over them (C, N), from a batch of light paths."""
        views = self.views
        view, column, row, sample = views.split(views.rays(batch), batch)
        number = view * dr.opaque(mi.UInt32, samples) + sample
        ray = views.ray(
            view,
            column,
            row,
            *(
                dr.gather(mi.Float, mi.Float(of.astype(np.float32)), number)
                for of in film
            ),
        )
        si = scene.ray_intersect(ray, mi.RayFlags.All, True)
        active, column, row, code = self._place(si, ray, si.is_valid())
        bsdf, context = si.bsdf(), mi.BSDFContext()
        active &= ~self.needs_paths(si, bsdf, active)
        sampler = SobolSampler(len(order), self._columns)
        sampler.seed_at(
            column, row, dr.gather(mi.UInt32, mi.UInt32(order), number), seed
        )

        reflects = active & (paths.max_depth > 1)
        smooth = reflects & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), True, smooth)
        to_light = si.to_local(ds.d)
        _, pdf, chosen, factor = bsdf.eval_pdf_sample(
            context, si, to_light, sampler.next_1d(), sampler.next_2d(), reflects
        )
        light = dr.select(
            smooth & (ds.pdf != 0),
            light * dr.select(ds.delta, 1.0, mis(ds.pdf, pdf)),
            0.0,
        )
        goes_on = reflects & (chosen.pdf > 0) & dr.any(factor != 0)
        diffuse, last = (
            mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Diffuse),
            (mi.Point3f(si.p), chosen.pdf),
        )
        ray = si.spawn_ray(si.to_world(chosen.wo))
        onwards = (
            goes_on,
            sampler,
            (ray.o, ray.d),
            mi.Spectrum(1.0),
            chosen.eta,
            mi.UInt32(1),
        )
        reached, _ = paths.follow(scene, *onwards, (*last, mi.Bool(False)), diffuse, ())
        light, reached = (
            dr.select(dr.isfinite(each), each, 0.0)
            for each in (light, dr.select(goes_on, reached / chosen.pdf, 0.0))
        )
        matte = matte_part(
            bsdf, si, active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        )
        lit = matte * (
            light * shading_cosine(si, to_light)
            + reached * shading_cosine(si, chosen.wo)
        )
        values = [*matte, *lit]
        for corner in self.views.corners:
            seen = mi.SurfaceInteraction3f(si)
            seen.wi = si.to_local(dr.normalize(corner - si.p))
            whole = light * bsdf.eval(context, seen, to_light, smooth)
            whole += reached * bsdf.eval(context, seen, chosen.wo, goes_on)
            values.extend(whole - lit)
        place = row * self._columns + column, code
        dr.eval(active, place, values)  # else each channel would trace the paths again
        kept: Any = dr.compress(active)
        cells = (dr.gather(mi.UInt32, each, kept) for each in place)
        pixel, code = (np.array(each).astype(np.int64) for each in cells)
        found = [
            np.array(dr.gather(mi.Float, each, kept), np.float64) for each in values
        ]
        return pixel << 32 | code, np.stack([*found, np.ones(len(pixel))])


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
    ray = views.film_ray(rays, batch, samples, seed)
    si = scene.ray_intersect(ray, mi.RayFlags.All, True)
    valid, bsdf = si.is_valid(), si.bsdf()
    known, cell = light.look_up(si, ray, valid)
    known &= ~light.needs_paths(si, bsdf, known)
    matte = matte_part(
        bsdf, si, known & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
    )
    view, column, row, sample = views.split(rays, batch)
    colours = light.towards(batch.views)
    place = 2 * (
        (view - dr.opaque(mi.UInt32, batch.views[0]))
        * dr.opaque(mi.UInt32, light.count)
        + cell
    )
    irradiance, rest = (
        dr.gather(mi.Color3f, colours, place + i, known) for i in (0, 1)
    )
    reflected = dr.select(matte > 0, matte * irradiance, 0.0) + rest
    known &= ~dr.any(
        dr.isnan(reflected)
    )  # some of the texture is black, and so were all samples of the cell
    traced = valid & ~known
    radiance = dr.select(known | (~valid & sky), si.emitter(scene).eval(si), 0.0)
    radiance += dr.select(known, reflected, 0.0)
    sampler = SobolSampler(samples, views.width)
    if paths.lamps:
        sampler.seed_at(column, row, sample, _stream(seed, view))
        smooth = (
            known
            & (paths.max_depth > 1)
            & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        )
        for lamp in paths.lamps:
            radiance += lit_by(scene, lamp, bsdf, si, sampler.next_2d(), smooth, 0.0)
    dr.eval(radiance, traced)
    alone: Any = dr.compress(traced)
    if len(alone):
        view, column, row, sample = views.split(alone, batch)
        sampler.seed_at(column, row, sample, _stream(seed, view))
        found, *_ = paths.sample(
            scene, sampler, views.film_ray(alone, batch, samples, seed)
        )
        for channel, values in zip(radiance, found, strict=True):
            dr.scatter(channel, values, alone)
    sums = [
        np.asarray(dr.block_sum(channel, len(batch.samples)), dtype=np.float64)
        for channel in radiance
    ]
    return np.stack(sums, axis=-1).reshape(
        len(batch.views), views.height, views.width, 3
    )


def _stream(seed: int, view: Any) -> Any:
    """A seed for each view: without it, all views would have the same noise in a pixel."""
    return mi.sample_tea_32(view, dr.opaque(mi.UInt32, seed))[0]
