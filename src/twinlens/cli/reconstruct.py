"""`twinlens reconstruct`: a sample's views made into points and triangles, and held against its truth."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.cli.places import PATH, PLACE, check_free
from twinlens.cli.progress import progress_bar
from twinlens.cli.samples import open_sample
from twinlens.errors import InputError, OutputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from twinlens.dataset import Place, StoredSample
    from twinlens.reconstruction import Cloud, DepthView

_CELLS = 160  # along the longest side of what is reconstructed
_RECORD = "reconstruction.json"
_SIDES = (-25.0, 25.0)  # degrees round it from which it is pictured


@click.command("reconstruct")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option("-o", "--output", required=True, type=PATH, help="Folder for it.")
@click.option("--method", default="truth", show_default=True, help="truth, or a matcher: sgm, zncc:block_size=11, ...")
@click.option("--cell-mm", type=float, help="Cells of the fused surface.  [default: a 160th of the longest side]")
@click.option("--min-views", type=click.IntRange(min=1), default=1, show_default=True, help="That confirm a point.")
@click.option("--far", type=float, help="Leave out what is further than this, metres.")
@click.option("--spacing-mm", type=float, help="Thin both clouds before comparing.  [default: half a cell]")
@click.option("--overwrite", is_flag=True, help="Replace an earlier reconstruction.")
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON.")
def command(
    sample: "Place",
    output: Path,
    method: str,
    cell_mm: float | None,
    min_views: int,
    far: float | None,
    spacing_mm: float | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Reconstruct a sample from the depths of all its views: true ones, or matched between neighbours.

    Neighbouring views that are no rectified pair are rectified first. OUTPUT gets the fused points (points.ply), the
    surface (mesh.ply, mesh.glb), how both compare with the true surface in millimetres (reconstruction.json), and a
    picture of them from two sides (reconstruction.png).

    \b
    Example:  twinlens reconstruct out/tabletop --method sgm -o rebuilt
    """
    import numpy as np

    from twinlens.dataset import encode_png
    from twinlens.dataset.files import write_folder
    from twinlens.dataset.record import encode_json
    from twinlens.reconstruction import fuse, integrate, sampled, surface_of
    from twinlens.reconstruction.export import glb_bytes, ply_bytes

    _check_output(output, overwrite)
    stored = open_sample(sample)
    with progress_bar("reconstructing") as report:
        views = [_cut(view, far) for view in depth_views(stored, method)]
        report(0.4, "fusing")
        cloud = fuse(views, min_views=min_views)
        if not len(cloud):
            raise InputError(f"{sample}: no point is left; allow further ones, or fewer views to confirm them")
        cell = _longest(cloud) / _CELLS if cell_mm is None else 1e-3 * cell_mm
        surface = surface_of(integrate(views, cell))
        spread = sampled(surface, 0.5 * cell)
        report(0.8, "comparing")
        spacing = 500 * cell if spacing_mm is None else spacing_mm
        found = _against_truth(_true_surface(stored, far), spacing, points=cloud, mesh=spread)
    record = {
        "sample": str(sample), "method": method, "views": len(views), "min_views": min_views, "points": len(cloud),
        "vertices": len(surface.vertices), "faces": len(surface.faces), "cell_mm": 1e3 * cell, "against_truth": found,
    }  # fmt: skip
    files = {
        "points.ply": ply_bytes(cloud),
        "mesh.ply": ply_bytes(surface),
        "mesh.glb": glb_bytes(surface, views[0].world_from_cam),
        _RECORD: encode_json(record),
        "reconstruction.png": encode_png(np.concatenate(_pictures(views, cloud, spread), axis=0)),
    }
    write_folder(output, files, overwrite)
    click.echo(json.dumps(record, indent=1) if as_json else _told(output, record))


def _check_output(output: Path, overwrite: bool) -> None:
    """Refuse what may not be written before the work; to overwrite is to remove, so nothing but a reconstruction is."""
    check_free(output, overwrite)
    if not output.exists() or (output / _RECORD).is_file():
        return
    if not output.is_dir() or any(output.iterdir()):
        raise OutputError(f"{output}: is there and is no reconstruction, so it is not overwritten; choose another name")


def depth_views(stored: "StoredSample", method: str) -> "list[DepthView]":
    """The depth maps of a sample: every view's truth, or those that `method` finds between neighbours."""
    from twinlens.reconstruction import view_of_truth

    rig = stored.rig
    if method == "truth":
        return [view_of_truth(stored.truth(i), rig, i, stored.image(i)) for i in range(len(rig))]
    if len(rig) < 2:
        raise InputError(f"{stored.folder}: has one view; matching needs two: use --method truth")
    return [_matched(stored, method, i, i + 1) for i in range(len(rig) - 1)]


def _matched(stored: "StoredSample", method: str, left: int, right: int) -> "DepthView":
    """The depths that a matcher finds between two views; rectified first where they are no rectified pair."""
    from twinlens.camera.rectification import rectify
    from twinlens.matching import parse_method
    from twinlens.reconstruction import view_of_disparity

    rig, images = stored.rig.pair(left, right), [stored.image(i) for i in (left, right)]
    if not rig.is_rectified():
        result = rectify(rig, zero_doffs=False)
        images, rig = [result.warp(side, image) for side, image in enumerate(images)], result.rectified_rig
    low, count = _range(stored, rig, left)
    matcher = parse_method(method).matcher(num_disparities=count, min_disparity=low)
    return view_of_disparity(matcher.match(*images), rig, image=images[0])


def _range(stored: "StoredSample", rig: Any, left: int) -> tuple[int, int]:
    """(lowest, count) of the disparities of what the left view truly sees, a few more on both sides.

    A plain folder without truth says its count in calib.txt.
    """
    import numpy as np

    if not stored.has(f"truth{left}.exr"):
        return 0, stored.ndisp
    truth = stored.truth(left)
    x = [rig.project(side, truth.position[truth.hit])[:, 0] for side in (0, 1)]
    inside = np.isfinite(x[0]) & np.isfinite(x[1])
    if not inside.any():
        raise InputError(f"{stored.folder}: view {left} sees nothing that could be matched; leave it out")
    low, high = np.percentile((x[0] - x[1])[inside], (0.1, 99.9))
    return int(np.floor(low)) - 2, int(np.ceil(high) - np.floor(low)) + 5


def _cut(view: "DepthView", far: float | None) -> "DepthView":
    import numpy as np

    from twinlens.reconstruction import DepthView

    if far is None:
        return view
    return DepthView(view.camera, view.world_from_cam, np.where(view.depth <= far, view.depth, np.inf), view.image)


def _true_surface(stored: "StoredSample", far: float | None) -> "Cloud | None":
    """What the truth of all views samples; None for a folder without."""
    from twinlens.reconstruction import fuse

    if not stored.has("truth0.exr"):
        return None
    return fuse([_cut(view, far) for view in depth_views(stored, "truth")])


def _against_truth(true: "Cloud | None", spacing_mm: float, **clouds: "Cloud") -> dict[str, Any]:
    """How each cloud compares with the true surface; nothing where that is not known."""
    from twinlens.reconstruction import compare

    if true is None:
        return {}
    return {name: compare(cloud, true, spacing_mm=spacing_mm).to_dict() for name, cloud in clouds.items()}


def _longest(cloud: "Cloud") -> float:
    return float((cloud.points.max(axis=0) - cloud.points.min(axis=0)).max())


def _pictures(views: "Sequence[DepthView]", *clouds: "Cloud") -> "list[NDArray[np.uint8]]":
    """Each cloud from two sides, beside each other: uint8 (H, W, 3)."""
    import numpy as np

    from twinlens.reconstruction.picture import orbit, splat

    middle = views[len(views) // 2]
    camera = middle.camera.replace(distortion=None)
    target = np.median(clouds[0].points, axis=0)
    poses = [orbit(middle.world_from_cam, target, side, 10.0) for side in _SIDES]
    return [np.concatenate([splat(cloud, camera, pose, 3) for pose in poses], axis=1) for cloud in clouds]


def _told(output: Path, record: dict[str, Any]) -> str:
    lines = [f"{output}: {record['points']} points, {record['faces']} triangles from {record['views']} depth maps"]
    for name, found in record["against_truth"].items():
        means = f"accuracy {found['accuracy_mean_mm']:.3g} mm, completeness {found['completeness_mean_mm']:.3g} mm"
        shares = ", ".join(f"{share['f_score']:.1%} at {share['tolerance_mm']:g} mm" for share in found["shares"])
        lines.append(f"{name}: {means} (means up to {found['max_distance_mm']:g} mm), F {shares}")
    return "\n".join(lines)
