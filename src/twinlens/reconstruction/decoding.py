"""Structured light of a stored sample: its frames decoded, triangulated, and compared with the truth of projection."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Decoded, Rig, Still, decode_sequence
from twinlens.camera.light_planes import light_plane_points
from twinlens.camera.structured_light import Code
from twinlens.camera.truth import Truth
from twinlens.dataset import StoredSample
from twinlens.dataset.channels import IMAGE
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.pictures import colourise, rgb8
from twinlens.dataset.sample import shot_folder
from twinlens.dataset.stored import StoredShot
from twinlens.errors import InputError, counted, located
from twinlens.geometry import Float, inverse, transform_points
from twinlens.reconstruction.surface import Cloud, ply_bytes
from twinlens.sensor import Sensor

Mask = NDArray[np.bool_]
RECORD = "decoded.json"
_MOST_APART_PX = 2.0
"""Of the two axes: a point by one of them is kept if its projection is as far from the other's position, or less."""
_SHOWN_ERROR_PX = 2.0  # the end of the colours of errors
_TITLE_HEIGHT = 18  # pixels


@dataclass(frozen=True, eq=False)
class DecodedView:
    """What one camera of a sample sees of a projector's pattern.

    axes : by "u" and "v", those that the sequence codes: the decoded positions of all pixels; +inf where an image of
        the axis's codes is saturated.
    valid : (H, W), pixels that are decoded along every axis, whose point exists, and whose axes agree within 2 pixels.
    points : (H, W, 3), world, metres; +inf where not valid.
    image : of the first frame.
    against_truth : the comparison with the truth of projection, as `decode_sample` describes it; {} without truth.
    true_pixels : (H, W, 2), of the projector, that light each point; +inf where none does. None without truth.
    """

    axes: Mapping[str, Decoded]
    valid: Mask
    points: Float
    image: NDArray[Any]
    against_truth: Mapping[str, Any]
    true_pixels: Float | None

    def record(self) -> dict[str, Any]:
        """The shares of pixels and the comparison, as plain data."""
        share = float(self.valid.mean())
        return {"valid_share": share, "against_truth": dict(self.against_truth)}

    def files(self, view: int) -> dict[str, bytes]:
        """Contents by file name: the maps as NumPy arrays, the points as PLY with colours, and a picture."""
        arrays: dict[str, Any] = {"valid": self.valid, "points": self.points}
        for axis, decoded in self.axes.items():
            arrays[axis] = decoded.position.astype(np.float32)
            arrays[f"modulation_{axis}"] = decoded.modulation.astype(np.float32)
        cloud = Cloud(self.points[self.valid], rgb8(self.image)[self.valid])
        return {
            f"decoded{view}.npz": _npz(arrays),
            f"points{view}.ply": ply_bytes(cloud),
            f"decoded{view}.png": encode_png(self.picture()),
        }

    def picture(self) -> NDArray[np.uint8]:
        """The first image; and of each axis the decoded positions, the true ones and the error, with titles, uint8.

        Rows are axes.
        """
        rows = []
        for axis, decoded in self.axes.items():
            shown = np.where(self.valid, decoded.position, np.inf)
            finite = shown[np.isfinite(shown)]
            low, high = (0.0, 1.0)
            if finite.size and finite.min() < finite.max():
                low, high = float(finite.min()), float(finite.max())
            span_text = f"{round(low):d} to {round(high):d} px"
            tiles = [
                _titled(rgb8(self.image), "image"),
                _titled(colourise(shown, low, high), f"{axis} decoded, {span_text}"),
            ]
            if self.true_pixels is not None:
                true = self.true_pixels[..., "uv".index(axis)]
                tiles.append(_titled(colourise(true, low, high), f"{axis} true"))
                error = _difference(shown, true)
                span = _SHOWN_ERROR_PX
                coloured = colourise(error, -span, span, "berlin")
                title = f"{axis} error, -{span:g} to {span:g} px"
                tiles.append(_titled(coloured, title))
            rows.append(np.hstack(tiles))
        return np.vstack(rows)


def _titled(tile: NDArray[np.uint8], title: str) -> NDArray[np.uint8]:
    """A picture (H, W, 3) below a line of text, which is cut where it is too long."""
    from PIL import Image, ImageDraw, ImageFont

    line = Image.new("RGB", (tile.shape[1], _TITLE_HEIGHT), "white")
    font = ImageFont.load_default(_TITLE_HEIGHT - 6)
    ImageDraw.Draw(line).text((3, 2), title, "black", font)
    return np.vstack([np.asarray(line), tile])


def decode_sample(
    stored: StoredSample,
    *,
    lens: int = 0,
    projector: int | None = None,
    least: float = 0.05,
) -> list[DecodedView]:
    """Decode the frames of each camera of a sample, triangulate the points, and compare both with the truth.

    Images are made linear by the tone curve of their sensor. Points are those of the plane of light of a column (or of
    a row, where the camera and the projector are farther apart along the rows' axis) on each pixel's ray, by the
    calibration of the sample. `against_truth` of a view has

    lit_share : of the pixels, those that the projector lights according to the truth.
    decoded_of_lit : the share of these that are valid.
    unlit_of_decoded : the share of the valid pixels that the projector does not light.
    u_px, v_px : the error of positions in lit valid pixels: median, mean and root mean square of its magnitude, and the
        share within half a pixel.
    point_mm : the distance to the true point, in the same pixels: median, mean, root mean square.

    projector : its number; by default the first with a sequence that has a code.
    least : as in `structured_light.decode`.

    Raises InputError for a sample without such a sequence, FileError for a missing file.
    """
    rig = stored.rig
    shot = stored.lens(lens)
    with located(str(stored.folder)):
        number = _coded_projector(rig, projector)
        return [
            _decoded_view(stored, shot, view, number, least) for view in range(len(rig))
        ]


def _npz(arrays: Mapping[str, Any]) -> bytes:
    """A compressed .npz file of arrays by name."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _coded_projector(rig: Rig, asked: int | None) -> int:
    """The number of the projector to decode."""
    coded = []
    for number, projector in enumerate(rig.projectors):
        if any(not isinstance(code, Still) for code in projector.sequence):
            coded.append(number)
    remedy = 'give a projector sequence = [{ type = "gray_code" }] (docs/projectors.md)'
    if not coded:
        what = "no projector" if not rig.projectors else "no sequence of coded patterns"
        raise InputError(f"the sample has {what}; {remedy}")
    if asked is None:
        return coded[0]
    if asked not in coded:
        raise InputError(
            f"projector {asked} shows no sequence of coded patterns; those that do: {', '.join(map(str, coded))}"
        )
    return asked


def _decoded_view(
    stored: StoredSample, shot: StoredShot, view: int, projector: int, least: float
) -> DecodedView:
    """One camera of a sample decoded, through one lens."""
    rig = stored.rig
    frames = [shot.frame(number) for number in range(shot.num_frames)]
    _check_sizes(frames, view)
    images = [linear_image(frame, view) for frame in frames]
    sequence = rig.projectors[projector].sequence
    axes = _unsaturated(
        decode_sequence(images, sequence, least),
        sequence,
        [_saturated(frame, view) for frame in frames],
    )
    points = _points(rig, view, projector, axes)
    valid = _is_finite(points)
    against_truth: dict[str, Any] = {}
    true_pixels = None
    if stored.has_truth(view):
        truth = stored.truth(view)
        light = truth.projections[projector]
        true_pixels = np.where(light.lit[..., None], light.pixels, np.inf)
        against_truth = _against(truth, projector, axes, points, valid)
    return DecodedView(
        axes, valid, points, frames[0].image(view), against_truth, true_pixels
    )


def _check_sizes(frames: Sequence[StoredShot], view: int) -> None:
    """Raise InputError for a frame of a view whose size or number of channels differs from that of the first."""
    file = IMAGE.name(view)
    first = _form(frames[0].image(view))
    for frame in frames:
        form = _form(frame.image(view))
        if form != first:
            name = f"{shot_folder(0, frame.frame_number)}{file}"
            raise InputError(
                f"{name} is {form}, {file} of frame 0 is {first}; all frames must be alike"
            )


def _form(image: NDArray[Any]) -> str:
    """The size of an image and its channels, in words."""
    height, width = image.shape[:2]
    channels = 1 if image.ndim == 2 else image.shape[2]
    return f"{width}x{height} pixels of {counted(channels, 'channel')}"


def _unsaturated(
    axes: Mapping[str, Decoded], sequence: Sequence[Code], saturated: Sequence[Mask]
) -> dict[str, Decoded]:
    """The positions of each axis, +inf where a frame of its codes is saturated: the light there is not known.

    saturated : (H, W) for each frame.
    """
    positions = {axis: decoded.position for axis, decoded in axes.items()}
    first = 0
    for code in sequence:
        frames = saturated[first : first + code.num_patterns]
        first += code.num_patterns
        if not isinstance(code, Still):
            clipped = np.logical_or.reduce(frames)
            positions[code.axis] = np.where(clipped, np.inf, positions[code.axis])
    return {
        axis: Decoded(positions[axis], decoded.modulation)
        for axis, decoded in axes.items()
    }


def linear_image(frame: StoredShot, view: int) -> Float:
    """The image of a view with values proportional to light, by the tone curve in its record."""
    sensor = Sensor.from_record(_exposure(frame, view)["sensor"])
    return sensor.linear(frame.image(view))


def _saturated(frame: StoredShot, view: int) -> Mask:
    """Where the image of a view is saturated, (H, W)."""
    exposure = _exposure(frame, view)
    sensor = Sensor.from_record(exposure["sensor"])
    return sensor.saturated(frame.image(view), float(exposure.get("gain", 1.0)), view)


def _exposure(frame: StoredShot, view: int) -> Mapping[str, Any]:
    """How the image of a view was exposed, from its record."""
    exposures = frame.record.get("exposures")
    if not isinstance(exposures, list) or view >= len(exposures):
        raise InputError("sample.json does not have the sensor of each image")
    exposure: Mapping[str, Any] = exposures[view]
    return exposure


def _points(rig: Rig, view: int, projector: int, axes: Mapping[str, Decoded]) -> Float:
    """The points of all pixels; +inf where there is none, or where the two axes do not agree."""
    lamp_from_world = inverse(rig.world_from_projectors[projector])
    centre = transform_points(lamp_from_world, rig.world_from_cams[view][:3, 3])
    # Depth follows from the coordinate along which the camera and the projector are apart.
    axis = max(axes, key=lambda name: abs(centre["uv".index(name)]))
    points = light_plane_points(rig, view, projector, axes[axis].position, axis)
    for cross_axis in axes.keys() - {axis}:
        seen = _is_finite(points)
        lamp = rig.projectors[projector].intrinsics
        in_world = np.where(seen[..., None], points, 0.0)
        pixels = lamp.project(transform_points(lamp_from_world, in_world))
        apart = _difference(
            pixels[..., "uv".index(cross_axis)], axes[cross_axis].position
        )
        agrees = seen & (np.abs(np.nan_to_num(apart, nan=np.inf)) <= _MOST_APART_PX)
        points = np.where(agrees[..., None], points, np.inf)
    return points


def _is_finite(points: Float) -> Mask:
    """Where all three coordinates are finite, (H, W)."""
    return np.asarray(np.isfinite(points).all(axis=-1))


def _difference(first: Float, second: Float) -> Float:
    """first - second; +inf where one of them is not finite."""
    both = np.isfinite(first) & np.isfinite(second)
    difference = np.where(both, first, 0.0) - np.where(both, second, 0.0)
    return np.where(both, difference, np.inf)


def _against(
    truth: Truth,
    projector: int,
    axes: Mapping[str, Decoded],
    points: Float,
    valid: Mask,
) -> dict[str, Any]:
    """The comparison with the truth of projection, as `decode_sample` describes it."""
    projection = truth.projections[projector]
    compared = valid & projection.lit
    comparison: dict[str, Any] = {
        "lit_share": float(projection.lit.mean()),
        "decoded_of_lit": _share(valid, projection.lit),
        "unlit_of_decoded": _share(~projection.lit, valid),
    }
    for axis, decoded in axes.items():
        true = projection.pixels[..., "uv".index(axis)]
        error = np.abs(decoded.position[compared] - true[compared])
        within = float((error <= 0.5).mean()) if error.size else None
        comparison[f"{axis}_px"] = {**_magnitudes(error), "within_half": within}
    distance = np.linalg.norm(points[compared] - truth.position[compared], axis=-1)
    comparison["point_mm"] = _magnitudes(1e3 * distance)
    return comparison


def _share(condition: Mask, among: Mask) -> float | None:
    """The share of the pixels `among` that meet a condition; None if there are none."""
    return float(condition[among].mean()) if among.any() else None


def _magnitudes(values: Float) -> dict[str, float | None]:
    """Median, mean and root mean square of magnitudes; None without any."""
    if not values.size:
        return dict.fromkeys(("median", "mean", "rms"))
    return {
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "rms": float(np.sqrt(np.mean(values**2))),
    }
