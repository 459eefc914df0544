"""The rig of a sample: the scene's own or a recipe's table, with options of the command line in its place."""

from collections.abc import Mapping, Set
from typing import Any

from twinlens.camera import Camera, Rig
from twinlens.errors import InputError
from twinlens.scenes import Scene, rig_from_table


def default_rig(
    scene: Scene,
    width: int,
    height: int,
    fov_x_deg: float | None = None,
    baseline: float | None = None,
    intrinsics: Mapping[str, Any] | None = None,
) -> Rig:
    """The rig in the scene's file, or a rectified pair at the scene's viewpoint.

    Parameters
    ----------
    width, height : int
        Image size, pixels.
    fov_x_deg, baseline : float, optional
        Replace the scene's.
    intrinsics : mapping, optional
        Keys of a rig's table (docs/rigs.md) that replace those of all cameras: fx, fy, cx, cy, distortion,
        pixel_pitch_um, sensor_width_mm.
    """
    options = {"fov_x_deg": fov_x_deg, "baseline": baseline, **(intrinsics or {})}
    given = {key: value for key, value in options.items() if value is not None}
    if scene.rig is not None or intrinsics:
        return rig_from_table({**_without(scene.rig or {}, given.keys()), **given}, scene, width, height)
    camera = Camera.from_fov(width, height, scene.fov_x_deg if fov_x_deg is None else fov_x_deg)
    return Rig.stereo(camera, scene.baseline if baseline is None else baseline, scene.world_from_left)


def _without(table: Mapping[str, Any], given: Set[str]) -> dict[str, Any]:
    """A rig's table without the keys that are given otherwise, in the tables of its cameras too."""
    replaced = set(given)
    if given & {"fov_x_deg", "fx"}:
        replaced |= {"fov_x_deg", "fx", "fy"}
    if given & {"pixel_pitch_um", "sensor_width_mm"}:
        replaced |= {"pixel_pitch_um", "sensor_width_mm"}

    def kept(part: Any) -> Any:
        return {key: part[key] for key in part if key not in replaced} if isinstance(part, Mapping) else part

    own: dict[str, Any] = kept(table)
    if isinstance(own.get("cameras"), list):
        own["cameras"] = [kept(camera) for camera in own["cameras"]]
    return own


def check_common_view(rig: Rig, scene: Scene) -> None:
    """Raise InputError for parallel views that are farther apart than they are wide at the scene's far end."""
    camera, far = rig.cameras[0], scene.depth_range[1]
    wide = far * camera.width / camera.fx
    parallel = len(rig) > 1 and abs(rig.b_from_a(0, 1)[2, 2] - 1) < 1e-9
    if parallel and rig.baseline() >= wide:
        raise InputError(
            f"--baseline {rig.baseline():g}: the views have nothing in common; at {far:g} m, the far end of "
            f"{scene.name}, each is {wide:.3g} m wide"
        )
