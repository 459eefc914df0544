"""The smallest scene, which tests modify."""

from typing import Protocol, get_args

MINIMAL = """\
camera.position = [0, -3, 1]
camera.look_at = [0, 0, 0.5]
camera.depth_range = [1.0, 9.0]
materials.grey.type = "diffuse"
materials.grey.reflectance = 0.5
lights.sky.type = "constant"
lights.sky.radiance = 1.0
objects.ball.shape = "sphere"
objects.ball.radius = 0.5
objects.ball.material = "grey"
"""
NOTHING = "nothing"


class Read(Protocol):
    def __call__(self, text="", without=NOTHING): ...


def key_of(line):
    return line.partition(" = ")[0]


def changed(text="", without=NOTHING):
    """The minimal scene with the lines of `text`, which replace those of the same key.

    Its own lines that start with `without` are left out.
    """
    replaced = {key_of(line) for line in text.splitlines()}
    kept = [line for line in MINIMAL.splitlines() if key_of(line) not in replaced]
    return "\n".join([*(line for line in kept if not line.startswith(without)), text])


def required(keys):
    """The keys of a plugin, shape or texture that have no default: their types do not admit None."""
    return [key for key, kind in keys.items() if type(None) not in get_args(kind)]
