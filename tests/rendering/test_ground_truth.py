"""The truth against closed forms, from everywhere: depth, disparity, visibility, normals, names.

Where an answer differs, the pixel must lie within a stated distance of an edge in the closed form itself.
"""

import numpy as np
import pytest

import twinlens as tl
from tests.rendering import rendering_cases as cases, rendering_corners as corners
from tests.rendering.rendering_answers import View
from tests.rendering.rendering_bodies import unit
from twinlens.camera import Camera, KannalaBrandt, Rig
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.scenes import SceneObject

GRAZING = 0.02  # cosine of the angle of incidence


class Answer:
    """The truth of a view, by field with one row per pixel, and its closed form."""

    def __init__(self, truth, bodies, rig, index):
        self.truth = truth
        self.view = View(bodies, rig, index)
        self.pixels = self.view.pixels()
        self.depth, self.body, _ = self.view.all_hits
        self.hit = self["object_id"] > 0
        self.is_pair = len(rig.cameras) == 2

    def __getitem__(self, field):
        array = getattr(self.truth, field)
        return array.reshape(-1, *array.shape[2:])

    def all_near_edge(self, wrong, form, distance_px):
        """Whether the closed form changes within this distance of all pixels that are `wrong`."""
        return self.view.near_edge(form, self.pixels[wrong], distance_px).all()


@pytest.fixture(scope="module")
def scene():
    return cases.scene()


@pytest.fixture(scope="module")
def answers(scene):
    """Every view of every rig around the scene of all shapes."""
    return [
        Answer(truth, cases.bodies(), rig, index)
        for rig in [*cases.rigs(), cases.crossed_rig()]
        for index, truth in enumerate(tl.ground_truth(scene, rig, objects=False))
    ]


@pytest.fixture(scope="module")
def corner_answers():
    """Every view of the hard cases, by (name, index)."""
    return {
        (name, index): Answer(truth, bodies, rig, index)
        for name, (bodies, mesh, rig) in corners.cases().items()
        for index, truth in enumerate(
            tl.ground_truth(corners.scene(mesh), rig, objects=False)
        )
    }


def test_object_ids_equal_the_closed_form(answers):
    """Ids equal the closed form's nearest body, but within a thousandth of a pixel of a silhouette."""
    wrong_pixels = []
    for answer in answers:
        wrong = answer["object_id"] != answer.body + 1
        assert answer.all_near_edge(wrong, answer.view.label, 1e-3)
        wrong_pixels.append(wrong)
    assert np.concatenate(wrong_pixels).mean() < 1e-4


def test_depth_equals_the_closed_form(answers):
    """1e-6 on triangles, 3e-6 on analytic shapes, at every hit pixel that is not grazing, silhouettes or not."""
    bodies = cases.bodies()
    worst = np.full(len(bodies), -1.0)
    for answer in answers:
        same = (answer["object_id"] == answer.body + 1) & (answer.body >= 0)
        clear = same & (answer.view.all_cosines > GRAZING)
        assert clear.sum() > 0.9 * same.sum()
        error = np.abs(answer["depth"][clear] / answer.depth[clear] - 1)
        np.maximum.at(worst, answer.body[clear], error)
    assert (worst >= 0).all()
    assert (worst <= [body.relative for body in bodies]).all(), worst


def test_disparity_equals_the_closed_form(answers):
    """Within 1e-4 px at every pixel further than a thousandth of a pixel from a silhouette, grazing or not."""
    wrong_pixels = []
    for answer in answers:
        if not answer.is_pair:
            assert np.isinf(answer["disparity"]).all()
            continue
        view = answer.view
        hit = answer.body >= 0
        points = view.points(answer.pixels[hit], answer.depth[hit])
        to_partner = answer.pixels[hit, 0] - view.pixels_in(view.other, points)[:, 0]
        expected = np.full(len(hit), np.inf)
        expected[hit] = to_partner if view.index == 0 else -to_partner
        disparity = answer["disparity"].astype(float)
        wrong = ~np.isclose(disparity, expected, rtol=0, atol=1e-4)
        assert answer.all_near_edge(wrong, view.label, 1e-3)
        wrong_pixels.append(wrong)
    wrong_pixels = np.concatenate(wrong_pixels)
    assert len(wrong_pixels) > 100_000
    assert wrong_pixels.mean() < 1e-4


def test_visibility_equals_the_closed_form(answers):
    """Everywhere further than a hundredth of a pixel from where the closed form itself changes its mind."""
    wrong_pixels = []
    visible = []
    for answer in answers:
        wrong = answer["visible"] != answer.view.all_visible
        assert answer.all_near_edge(wrong, answer.view.visible, 0.01)
        wrong_pixels.append(wrong)
        visible.append(answer.view.all_visible)
    assert 0.3 < np.concatenate(visible).mean() < 0.9
    assert np.concatenate(wrong_pixels).mean() < 1e-4


def test_positions_project_onto_their_own_pixels(answers):
    for answer in answers:
        view = answer.view
        pixels = answer.pixels[answer.hit]
        projected = view.pixels_in(view.index, answer["position"][answer.hit])
        assert np.abs(projected - pixels).max() <= 1e-6


def test_normals_are_unit_face_the_camera_and_equal_the_closed_form(answers):
    wrong_count = total = 0
    for answer in answers:
        view = answer.view
        hit = answer.hit
        normal = answer["normal"]
        for field in ("normal", "shading_normal"):
            lengths = np.linalg.norm(answer[field][hit], axis=1)
            assert np.abs(lengths - 1).max() < 1e-6
            assert not answer[field][~hit].any()
        rays = view.directions(answer.pixels[hit])
        assert ((normal[hit] * rays).sum(-1) <= 1e-6).all()
        same = hit & (answer["object_id"] == answer.body + 1)
        wrong = same & (np.abs(normal - view.all_normals).max(axis=-1) > 1e-4)
        pixels = answer.pixels[wrong]
        assert (near_crease(view, pixels) | (view.cosine(pixels) < GRAZING)).all()
        # All of these shapes are flat, or smooth themselves.
        assert np.allclose(normal, answer["shading_normal"], atol=1e-6)
        wrong_count, total = wrong_count + wrong.sum(), total + same.sum()
    assert wrong_count < 1e-3 * total


def near_crease(view, pixels):
    """Whether the closed form's own normal jumps within a thousandth of a pixel."""
    here = view.normals(pixels)
    jumps = np.zeros(len(pixels), bool)
    for step in (1e-3, -1e-3):
        jumps |= np.abs(view.normals(pixels + step) - here).max(-1) > 0.01
    return jumps


def test_names_and_materials_belong_to_the_ids(answers):
    names = []
    materials = []
    for item in cases.things():
        placed = item.scene_object
        copies = [f"{placed.name}[{i}]" for i in range(len(placed.instances))]
        copies = copies or [placed.name]
        names += copies
        materials += [placed.material] * len(copies)
    for answer in answers:
        truth = answer.truth
        assert list(truth.object_names) == names
        for index in np.unique(answer["object_id"][answer.hit]):
            is_object = answer["object_id"] == index
            material = materials[index - 1]
            kind = MATERIAL_KINDS.index(cases.KINDS[material])
            material_id = 1 + truth.material_names.index(material)
            assert (answer["material_id"][is_object] == material_id).all()
            assert (answer["material_kind"][is_object] == kind).all()
        for field in ("material_id", "material_kind"):
            assert not answer[field][~answer.hit].any()


def test_rays_that_hit_nothing_are_unknown_in_every_field(answers):
    missed = 0
    for answer in answers:
        for field in ("depth", "position", "disparity"):
            assert (answer[field][~answer.hit] == np.inf).all()
        assert not answer["visible"][~answer.hit].any()
        assert np.isfinite(answer["depth"][answer.hit]).all()
        missed += (~answer.hit & np.isinf(answer.depth)).sum()
    assert missed > 10_000


def test_a_plane_does_not_occlude_itself_at_grazing_angles(corner_answers):
    for (name, index), answer in corner_answers.items():
        if name.startswith("edge on") and index == 0:
            wrong = answer["visible"] != answer.view.all_visible
            assert answer.all_near_edge(wrong, answer.view.visible, 0.01), name
            assert answer.hit.sum() > 100


def test_mirrored_stretched_and_reversed_meshes_equal_their_closed_form(corner_answers):
    for (name, _), answer in corner_answers.items():
        if name.startswith("edge on"):
            continue
        view = answer.view
        expected_hit = answer.body >= 0
        assert answer.all_near_edge(answer.hit != expected_hit, view.label, 1e-3), name
        clear = answer.hit & expected_hit & (view.all_cosines > GRAZING)
        assert clear.sum() > 200
        error = answer["depth"][clear] / answer.depth[clear] - 1
        assert np.abs(error).max() <= 1e-6, name
        wrong = answer["visible"] != view.all_visible
        assert answer.all_near_edge(wrong, view.visible, 0.01), name
        error = np.abs(answer["normal"] - view.all_normals)[clear]
        assert np.quantile(error, 0.99) < 1e-6, name


def test_smooth_normals_are_interpolated_and_face_the_camera(corner_answers):
    """Those of a ball are its radii, to the square of the triangles' size, whichever way its faces are wound."""
    for name in ("plain ball", "mirrored ball", "inside out ball"):
        answer = corner_answers[name, 0]
        radius = unit(answer["position"][answer.hit])
        smooth, flat = (
            answer[field][answer.hit] for field in ("shading_normal", "normal")
        )
        assert np.abs(smooth - radius).max() < 0.007
        assert np.abs(flat - radius).max() > 0.05
        assert ((smooth * flat).sum(axis=-1) > 0.99).all()
        assert np.abs(np.linalg.norm(smooth, axis=-1) - 1).max() < 1e-6


def test_a_fisheye_of_200_degrees_has_ray_distances_and_depths_behind_it():
    """A camera in a ball, off its centre; at r pixels from the middle it looks at an angle of r / f to its axis."""
    size = 65
    radius = 2.0
    centre = np.array([0.3, -0.2, 0.5])
    focal = (size - 1) / np.deg2rad(200)
    middle = (size - 1) / 2
    fisheye = KannalaBrandt()
    camera = Camera(size, size, focal, focal, middle, middle, fisheye)
    placed = np.eye(4)
    placed[:3, :3] *= radius
    placed[:3, 3] = centre
    ball = SceneObject("ball", {"type": "sphere"}, "chalk", placed)
    truth = tl.ground_truth(corners.scene(ball), Rig([camera], [np.eye(4)]))[0]
    offset = camera.pixel_grid() - middle
    angle = np.linalg.norm(offset, axis=-1) / focal
    azimuth = np.arctan2(offset[..., 1], offset[..., 0])
    x = np.sin(angle) * np.cos(azimuth)
    y = np.sin(angle) * np.sin(azimuth)
    along = np.stack([x, y, np.cos(angle)], axis=-1) @ centre
    distance = along + np.sqrt(along**2 - centre @ centre + radius**2)
    position = truth.position
    np.testing.assert_allclose(truth.depth, distance * np.cos(angle), atol=3e-6)
    np.testing.assert_allclose(position[..., 0], distance * x, atol=3e-6)
    np.testing.assert_allclose(position[..., 1], distance * y, atol=3e-6)
    assert truth.depth.min() < -1
    (whole,) = truth.objects
    assert whole.pixel_count == whole.visible_pixel_count == size**2
