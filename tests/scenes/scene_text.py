"""The smallest scene, which tests modify."""

from typing import Any, Protocol, get_args

from twinlens.scenes import Scene

MINIMAL = """
[camera]
position = [0, -3, 1]
look_at = [0, 0, 0.5]
depth_range = [1.0, 9.0]

[materials.grey]
type = "diffuse"
reflectance = 0.5

[lights.sky]
type = "constant"
radiance = 1.0

[objects.ball]
shape = "sphere"
radius = 0.5
material = "grey"
"""


class Read(Protocol):
    def __call__(self, extra: str = "", *changes: tuple[str, str]) -> Scene: ...


def required(keys: dict[str, Any]) -> list[str]:
    """The keys of a plugin, shape or texture that have no default: their types do not admit None."""
    return [key for key, kind in keys.items() if type(None) not in get_args(kind)]
