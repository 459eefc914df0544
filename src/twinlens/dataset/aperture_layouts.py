"""Export of dual pixels, light fields and focal stacks. `export` has the dict.

Sources: the readers of https://github.com/Abdullah-Abuolaim/defocus-deblurring-dual-pixel (DPDD),
https://github.com/lightfield-analysis/evaluation-toolkit (4D Light Field Benchmark),
https://github.com/doda42/LFToolbox (`LFReadESLF`) and https://github.com/dvl-tum/defocus-net (FoD500).
"""

import io
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

import twinlens
from twinlens.camera import ThinLens, light_field_grid
from twinlens.dataset.channels import DP_LEFT
from twinlens.dataset.codecs.exr import encode_exr
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.layouts import Source
from twinlens.errors import InputError, located

_BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


def dpdd(source: Source) -> Iterator[tuple[str, bytes]]:
    """{train,val,test}_c/{source,target}, _l/source and _r/source/<name>.png: 16-bit RGB, one per view.

    The sources are the whole image and the halves of the first lens with dual pixels, from the chosen lens on; the
    target is the image of the first pinhole. A split of another name is train. Readers sort each folder, so all files
    of a view have one name. <split>_disparity/<name>.pfm, which DPDD has not, is the disparity of the halves.
    """
    sample = source.sample
    shots = [sample.lens(k) for k in range(sample.num_lenses)]
    sharp = [shot for shot in shots if shot.lens.aperture_diameter == 0]
    dual = [
        shot for shot in shots[source.lens :] if shot.path(DP_LEFT.name(0)).is_file()
    ]
    if not sharp or not dual:
        missing = (
            "lens with dual pixels" if sharp else "pinhole, whose image is in focus"
        )
        raise InputError(
            f"{sample.name}: dpdd needs a {missing}; add it to [[lenses]] of the recipe"
        )
    split = source.split if source.split in ("train", "val", "test") else "train"
    readers = {
        "c/source": dual[0].image,
        "l/source": dual[0].dp_left,
        "r/source": dual[0].dp_right,
        "c/target": sharp[0].image,
    }
    views = len(sample.rig)
    for i in range(views):
        name = source.name if views == 1 else f"{source.name}-im{i}"
        for folder, read in readers.items():
            yield f"{split}_{folder}/{name}.png", encode_png(_rgb16(read(i)))
        yield f"{split}_disparity/{name}.pfm", encode_pfm(dual[0].dp_disparity(i))


def hci4d(source: Source) -> Iterator[tuple[str, bytes]]:
    """{training,test}/<name>/: input_Cam000.png ..., parameters.cfg, gt_disp_lowres.pfm and gt_depth_lowres.pfm.

    The views are those of a light field with an odd number of views per side. The truth is of the middle one; its
    disparity is that of neighbours, where nothing was hit that of infinity.
    """
    sample = source.sample
    n, spacing, vergence = _grid(source)
    middle = n**2 // 2
    camera = sample.rig.cameras[middle]
    if n % 2 == 0 or camera.fx != camera.fy:
        counted = f"{n} x {n} views, fx = {camera.fx:g} and fy = {camera.fy:g}"
        raise InputError(
            f"{sample.name}: hci4d needs an odd number of views per side and fx = fy, got {counted}"
        )
    depth = sample.truth(middle).depth
    # Of neighbouring views, in pixels: 0 at the plane that the grid is focused at.
    disparity = (camera.fx * spacing * (1 / depth - vergence)).astype(np.float32)
    root = f"{_hci4d_category(source)}/{source.name}"
    for i in range(n**2):
        yield f"{root}/input_Cam{i:03d}.png", encode_png(_rgb8(source, i))
    yield f"{root}/parameters.cfg", _hci4d_parameters(source, disparity)
    yield f"{root}/gt_disp_lowres.pfm", encode_pfm(disparity)
    yield f"{root}/gt_depth_lowres.pfm", encode_pfm(depth.astype(np.float32))


def _hci4d_category(source: Source) -> str:
    return "test" if source.split == "test" else "training"


def _hci4d_parameters(source: Source, disparity: NDArray[np.float32]) -> bytes:
    """parameters.cfg: the toolkit computes depth from its lengths, and the pose of the middle view is in Blender's."""
    low, high = float(np.floor(disparity.min())), float(np.ceil(disparity.max()))
    sections: dict[str, dict[str, Any]] = {
        "intrinsics": _hci4d_intrinsics(source),
        "extrinsics": _hci4d_extrinsics(source),
        "meta": {
            "scene": source.name,
            "category": _hci4d_category(source),
            "date": "",
            "version": f"twinlens {twinlens.__version__}",
            "authors": "",
            "contact": "",
            "disp_min": low,
            "disp_max": high,
            "frustum_disp_min": low,
            "frustum_disp_max": high,
            "depth_map_scale": 1.0,
        },
    }
    lines: list[str] = []
    for section, entries in sections.items():
        lines.append(f"[{section}]")
        lines += [f"{key} = {value}" for key, value in entries.items()]
        lines.append("")
    return "\n".join(lines).encode()


def _hci4d_intrinsics(source: Source) -> dict[str, Any]:
    """The middle view's camera; the width of its sensor is that of the longer side."""
    rig, lens = source.sample.rig, source.sample.lens(source.lens).lens
    camera = rig.cameras[len(rig) // 2]
    pitch_mm = 1e-3 * camera.pixel_pitch_um
    f_number = np.inf
    if lens.aperture_diameter > 0:
        f_number = camera.film_distance / lens.aperture_diameter
    return {
        "focal_length_mm": camera.fx * pitch_mm,
        "image_resolution_x_px": camera.width,
        "image_resolution_y_px": camera.height,
        "sensor_size_mm": max(camera.width, camera.height) * pitch_mm,
        "fstop": f_number,
    }


def _hci4d_extrinsics(source: Source) -> dict[str, Any]:
    """The grid of views and the pose of the middle one, as x, y, z and Euler angles in Blender's camera axes."""
    n, spacing, vergence = _grid(source)
    pose = source.sample.rig.world_from_cams[n**2 // 2]
    turn = Rotation.from_matrix(pose[:3, :3] @ _BLENDER_FROM_OPENCV)
    values: dict[str, Any] = {
        "num_cams_x": n,
        "num_cams_y": n,
        "baseline_mm": 1e3 * spacing,
        "focus_distance_m": 1 / vergence if vergence else np.inf,
    }
    for axis, metres in zip("xyz", pose[:3, 3].tolist(), strict=True):
        values[f"center_cam_{axis}_m"] = metres
    for axis, radians in zip("xyz", turn.as_euler("xyz").tolist(), strict=True):
        values[f"center_cam_r{axis}_rad"] = radians
    return values


def eslf(source: Source) -> Iterator[tuple[str, bytes]]:
    """<name>_eslf.png, the raw image of a plenoptic camera, and <name>.json, the sample's sample.json.

    Each microlens has n x n pixels, of which (row, column) is that of view (row, column) of the light field.
    """
    n = _grid(source)[0]
    views = np.stack([_rgb8(source, i) for i in range(n**2)])
    height, width = views.shape[1:3]
    # (row of the view, its column, y, x, RGB) to (y, row of the view, x, its column, RGB).
    lenslets = views.reshape(n, n, height, width, 3).transpose(2, 0, 3, 1, 4)
    raw = lenslets.reshape(height * n, width * n, 3)
    yield f"{source.name}_eslf.png", encode_png(raw)
    yield f"{source.name}.json", source.record()


def fod500(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """<number>_<k>All.tif of the first view at the k-th focus distance, and <number>Dpt.exr, its depth in metres.

    The stack is the images of all thin lenses with an aperture, from near to far. Its distances must be the same in all
    samples, as readers take them as an argument; focus_distances.txt has them. Depth is in half precision.
    """
    distances: list[float] = []
    for source in sources:
        sample, stack = source.sample, {}
        for shot in map(sample.lens, range(sample.num_lenses)):
            if isinstance(shot.lens, ThinLens) and shot.lens.aperture_diameter > 0:
                stack[shot.lens.focus_distance] = shot.number
        if len(stack) < 2 or (distances and distances != sorted(stack)):
            held = "a focal stack needs two or more"
            if distances:
                held = f"other samples have {distances}"
            counted = f"images of thin lenses at {len(stack)} focus distances {sorted(stack)} m"
            raise InputError(f"{sample.name}: has {counted}; {held}")
        distances = sorted(stack)
        for k, distance in enumerate(distances):
            stream = io.BytesIO()
            Image.fromarray(_rgb8(source, 0, stack[distance])).save(stream, "TIFF")
            yield f"{source.index:06d}_{k:02d}All.tif", stream.getvalue()
        with np.errstate(over="ignore"):
            depth = sample.truth(0).depth.astype(np.float16)
        yield f"{source.index:06d}Dpt.exr", encode_exr(dict.fromkeys("RGB", depth))
    listed = "".join(f"{distance!r}\n" for distance in distances)
    yield "focus_distances.txt", listed.encode()


def _grid(source: Source) -> tuple[int, float, float]:
    with located(source.sample.name):
        return light_field_grid(source.sample.rig)


def _rgb8(source: Source, i: int, lens: int | None = None) -> NDArray[np.uint8]:
    pixels = source.sample.lens(source.lens if lens is None else lens).image(i)
    return np.round(_rgb16(pixels) / 257.0).astype(np.uint8)


def _rgb16(pixels: NDArray[Any]) -> NDArray[np.uint16]:
    """uint16 (H, W, 3) of an image: 8 bits become 16, grey becomes RGB."""
    wide = pixels.astype(np.uint16)
    if pixels.dtype == np.uint8:
        wide = wide * np.uint16(257)
    if wide.ndim == 2:
        wide = np.repeat(wide[..., None], 3, axis=-1)
    return wide
