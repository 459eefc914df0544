"""A body of a scene: one of the `kinds` or a user's mesh, with its size and its material."""

from dataclasses import dataclass

from twinlens.families.composition import Composition
from twinlens.families.draws import log_uniform, weighted
from twinlens.families.kinds import GLASSY, KINDS, METALLIC
from twinlens.families.materials import body_material, draw_finish, user_texture
from twinlens.families.solids import Solid, box_mapped
from twinlens.scenes.scene import Plugin

_USER_MESHES = 0.6  # how often a body is a user's mesh, where the user gave any
_USER_SIZE = (0.14, 0.34)
_USER_PATTERNS = ("cloudy", "speckled", "granite", "stripes")


@dataclass(frozen=True, eq=False)
class Body:
    """A body whose largest extent is `size` metres; `kind` is "" for a user's mesh."""

    name: str
    kind: str
    solid: Solid
    size: float
    scene: Composition
    part: tuple[str | int, ...]

    def material(self, pixel: float) -> Plugin:
        """Its material where a pixel covers `pixel` metres: no texel is smaller than that."""
        scene, part = self.scene, self.part
        finish = draw_finish(scene.rng(*part, "finish"), self.kind in METALLIC, self.kind in GLASSY)
        own = user_texture(scene, *part) if finish in ("matte", "satin", "glossy") else None
        names = KINDS[self.kind].patterns if self.kind else _USER_PATTERNS
        stream = scene.rng(*part, "texture")
        return body_material(stream, self.solid, self.size, pixel, scene.palette, finish, names if own is None else own)


def draw_body(scene: Composition, part: tuple[str | int, ...], among: tuple[str, ...] | None = None) -> Body:
    """The body of one part of a scene, of one of the kinds `among`. Without `among`: of any kind, or a user's mesh."""
    rng = scene.rng(*part, "shape")
    if among is None and scene.assets.meshes and scene.rng(*part, "own").random() < _USER_MESHES:
        drawn = scene.assets.mesh(scene.rng(*part, "mesh"))
        if drawn is not None:
            name, mesh = drawn
            if mesh.normals is None or mesh.uv is None:
                mesh = box_mapped(mesh.vertices, mesh.faces, 30.0)
            return Body(name, "", Solid(mesh, True), float(rng.uniform(*_USER_SIZE)), scene, part)
    names = among or tuple(KINDS)
    name = weighted(scene.rng(*part, "kind"), names, [KINDS[each].weight for each in names])
    size = log_uniform(scene.rng(*part, "size"), *KINDS[name].size)
    return Body(name, name, KINDS[name].make(rng), size, scene, part)
