"""A body of a scene: one of the `kinds` or a user's mesh, with its size and its material."""

from dataclasses import dataclass

from twinlens.families.composition import Composition
from twinlens.families.draws import log_uniform, weighted
from twinlens.families.kinds import GLASSY, KINDS, METALLIC
from twinlens.families.materials import body_material, draw_finish, user_body_material, user_texture
from twinlens.families.solids import Solid, box_mapped
from twinlens.scenes.scene import Mesh, Plugin

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
        rng = self.scene.rng(*self.part, "texture")
        finish = draw_finish(self.scene.rng(*self.part, "finish"), self.kind in METALLIC, self.kind in GLASSY)
        own = user_texture(self.scene.request, *self.part)
        if own is not None and finish in ("matte", "satin", "glossy"):
            return user_body_material(own, rng, self.solid, self.size, pixel, finish)
        patterns = KINDS[self.kind].patterns if self.kind else _USER_PATTERNS
        return body_material(rng, self.solid, self.size, pixel, self.scene.palette, finish, patterns)


def draw_body(scene: Composition, part: tuple[str | int, ...], among: tuple[str, ...] | None = None) -> Body:
    """The body of one part of a scene, of one of the kinds `among`. Without `among`: of any kind, or a user's mesh."""
    rng = scene.rng(*part, "shape")
    assets = scene.request.assets
    if among is None and assets.meshes and scene.rng(*part, "own").random() < _USER_MESHES:
        drawn = assets.mesh(scene.rng(*part, "mesh"))
        if drawn is not None:
            return Body(drawn[0], "", _user_solid(drawn[1]), float(rng.uniform(*_USER_SIZE)), scene, part)
    names = among or tuple(KINDS)
    name = weighted(scene.rng(*part, "kind"), names, [KINDS[each].weight for each in names])
    size = log_uniform(scene.rng(*part, "size"), *KINDS[name].size)
    return Body(name, name, KINDS[name].make(rng), size, scene, part)


def _user_solid(mesh: Mesh) -> Solid:
    """A user's mesh, with normals and texture coordinates if it has none."""
    if mesh.normals is None or mesh.uv is None:
        mesh = box_mapped(mesh.vertices, mesh.faces, 30.0)
    return Solid(mesh, True)
