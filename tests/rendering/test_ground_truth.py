"""The truth against closed forms, from everywhere: depth, disparity, visibility, normals, names.

Where an answer differs, the pixel must lie within a stated distance of an edge in the closed form itself.
"""

import numpy as np
import pytest

from tests.rendering import rendering_cases as cases
from tests.rendering.rendering_answers import View
from twinlens.camera.truth import MATERIAL_KINDS

RIGS = dict(enumerate(cases.rigs())) | {"crossed": cases.crossed_rig()}
GRAZING = 0.02  # cosine of the angle of incidence


@pytest.fixture(scope="session")
def answers():
    """The closed forms of every view: (case, view) -> View, pixels, depth, body."""
    bodies = cases.bodies()
    views = {
        (name, i): View(bodies, rig, i)
        for name, rig in RIGS.items()
        for i in range(len(rig.cameras))
    }
    return {
        key: (view, pixels := view.pixels(), *view.hits(pixels)[:2])
        for key, view in views.items()
    }


@pytest.fixture
def compare(renderer, answers):
    """All views of a backend: (truth field by name, View, pixels, depth, body)."""
    truth = renderer("truth")

    def rows():
        for (name, index), answer in answers.items():
            yield Fields(truth, f"{name}/{index}"), *answer

    return rows


class Fields:
    """Truth fields of one view, one row a pixel."""

    def __init__(self, arrays, prefix):
        self._arrays, self._prefix = arrays, prefix

    def __getitem__(self, field):
        array = self._arrays[f"{self._prefix}/{field}"]
        return array.reshape(-1, *array.shape[2:])


def test_object_ids_equal_the_closed_form(compare):
    """Ids equal the closed form's nearest body, but within a thousandth of a pixel of a silhouette."""
    excused = total = 0
    for truth, view, pixels, _, body in compare():
        wrong = truth["object_id"] != body + 1
        assert view.near_edge(view.label, pixels[wrong], 1e-3).all()
        excused, total = excused + wrong.sum(), total + len(pixels)
        assert set(np.unique(body)) > {-1} or (body >= 0).all()
    assert excused < 1e-4 * total


def test_depth_equals_the_closed_form(compare):
    """1e-6 on triangles, 3e-6 on analytic shapes, at every hit pixel that is not grazing, silhouettes or not."""
    worst = {}
    for truth, view, _, depth, body in compare():
        same = (truth["object_id"] == body + 1) & (body >= 0)
        clear = same & (view.all_cosines > GRAZING)
        assert clear.sum() > 0.9 * same.sum()
        error = np.abs(truth["depth"][clear] / depth[clear] - 1)
        for index in np.unique(body[clear]):
            worst[index] = max(worst.get(index, 0.0), error[body[clear] == index].max())
    bodies = cases.bodies()
    assert set(worst) == set(range(len(bodies)))
    assert all(error <= bodies[index].relative for index, error in worst.items()), worst


def test_disparity_equals_the_closed_form(compare):
    """Within 1e-4 px at every pixel further than a thousandth of a pixel from a silhouette, grazing or not."""
    excused = total = 0
    for truth, view, pixels, depth, body in compare():
        if len(view.rig.cameras) != 2:
            continue
        hit = body >= 0
        expected = np.full(len(pixels), np.inf)
        partner = view.partner_pixels(view.points(pixels[hit], depth[hit]))[:, 0]
        expected[hit] = (pixels[hit, 0] - partner) * (1 if view.index == 0 else -1)
        given = truth["disparity"].astype(float)
        with np.errstate(invalid="ignore"):
            wrong = ~((np.abs(given - expected) <= 1e-4) | (given == expected))
        assert view.near_edge(view.label, pixels[wrong], 1e-3).all()
        excused, total = excused + wrong.sum(), total + len(pixels)
    assert total > 100_000
    assert excused < 1e-4 * total


def test_disparity_is_fx_b_over_z_less_doffs(compare):
    """The other closed form, of the depth map alone."""
    for truth, view, _, _, _ in compare():
        left, right = view.rig.cameras[:2]
        if len(view.rig.cameras) != 2:
            assert np.isinf(truth["disparity"]).all()
            continue
        baseline = np.linalg.norm(
            view.rig.world_from_cams[1][:3, 3] - view.rig.world_from_cams[0][:3, 3]
        )
        expected = left.fx * baseline / truth["depth"] - (right.cx - left.cx)
        known = np.isfinite(truth["depth"])
        assert np.abs(truth["disparity"] - expected)[known].max() <= 1e-4
        assert (truth["disparity"][~known] == np.inf).all()


def test_visibility_equals_the_closed_form(compare):
    """Everywhere further than a hundredth of a pixel from where the closed form itself changes its mind."""
    seen = excused = total = 0
    for truth, view, pixels, _, _ in compare():
        expected = view.all_visible
        wrong = truth["visible"] != expected
        assert view.near_edge(view.visible, pixels[wrong], 0.01).all()
        seen, excused, total = (
            seen + expected.sum(),
            excused + wrong.sum(),
            total + len(pixels),
        )
    assert 0.3 * total < seen < 0.9 * total
    assert excused < 1e-4 * total


def test_positions_project_onto_their_own_pixels_and_at_their_disparity_into_the_partner(
    compare,
):
    for truth, view, pixels, _, _ in compare():
        hit = truth["object_id"] > 0
        position = truth["position"][hit]
        own = View(view.bodies, view.rig, view.other)
        if own.other == view.index:
            assert np.abs(own.partner_pixels(position) - pixels[hit]).max() <= 1e-6
        if len(view.rig.cameras) != 2:
            continue
        there = view.partner_pixels(position)
        along = (pixels[hit, 0] - there[:, 0]) * (1 if view.index == 0 else -1)
        assert np.abs(there[:, 1] - pixels[hit, 1]).max() <= 1e-6
        assert np.abs(along - truth["disparity"][hit]).max() <= 1e-4


def test_both_views_agree_on_points_visible_in_both(renderer):
    """The right camera's rays through the exact image points of what it should see hit the same points of the same
    objects: no resampling on the way."""
    truth = renderer("truth")
    for name, rig in RIGS.items():
        if name == "crossed":
            continue
        left, right = truth[f"{name}/again/left"], truth[f"{name}/again/right"]
        assert len(left) == 40
        assert np.array_equal(
            truth[f"{name}/again/left_id"], truth[f"{name}/again/right_id"]
        )
        distance = np.linalg.norm(left - rig.world_from_cams[1][:3, 3], axis=1)
        assert (np.linalg.norm(left - right, axis=1) <= 3e-6 * distance).all()


def test_normals_are_unit_face_the_camera_and_equal_the_closed_form(compare):
    checked = total = 0
    for truth, view, pixels, _, body in compare():
        hit = truth["object_id"] > 0
        for field in ("normal", "shading_normal"):
            assert np.abs(np.linalg.norm(truth[field][hit], axis=1) - 1).max() < 1e-6
            assert not truth[field][~hit].any()
        assert (
            (truth["normal"][hit] * view.directions(pixels[hit])).sum(-1) <= 1e-6
        ).all()
        same = hit & (truth["object_id"] == body + 1)
        expected = view.all_normals
        wrong = same & (np.abs(truth["normal"] - expected).max(axis=-1) > 1e-4)
        assert (
            near_crease(view, pixels[wrong]) | (view.cosine(pixels[wrong]) < GRAZING)
        ).all()
        checked, total = checked + wrong.sum(), total + same.sum()
        assert np.allclose(
            truth["normal"], truth["shading_normal"], atol=1e-6
        )  # all of these are flat, or smooth themselves
    assert checked < 1e-3 * total


def near_crease(view, pixels):
    """Whether the closed form's own normal jumps within a thousandth of a pixel."""
    here = view.normals(pixels)
    jumps = [
        np.abs(view.normals(pixels + 1e-3 * np.array(step)) - here).max(-1) > 0.01
        for step in ((1, 1), (-1, -1))
    ]
    return jumps[0] | jumps[1]


def test_names_and_materials_belong_to_the_ids(compare):
    names = []
    kinds = {}
    for thing in cases.things():
        name = thing.scene_object.name
        own = (
            [f"{name}[{i}]" for i in range(len(thing.bodies))]
            if thing.scene_object.instances
            else [name]
        )
        kinds |= dict.fromkeys(
            own, (thing.scene_object.material, cases.KINDS[thing.scene_object.material])
        )
        names += own
    for truth, *_ in compare():
        assert truth._arrays[f"{truth._prefix}/object_names"].tolist() == names
        materials = truth._arrays[f"{truth._prefix}/material_names"].tolist()
        for index in np.unique(truth["object_id"]):
            mine = truth["object_id"] == index
            material, kind = kinds[names[index - 1]] if index else ("", "none")
            assert (
                truth["material_id"][mine]
                == (materials.index(material) + 1 if index else 0)
            ).all()
            assert (truth["material_kind"][mine] == MATERIAL_KINDS.index(kind)).all()


def test_rays_that_hit_nothing_are_unknown_in_every_field(compare):
    missed = 0
    for truth, _, _, depth, _ in compare():
        miss = truth["object_id"] == 0
        assert (truth["depth"][miss] == np.inf).all()
        assert (truth["position"][miss] == np.inf).all()
        assert (truth["disparity"][miss] == np.inf).all()
        assert not truth["visible"][miss].any()
        assert np.isfinite(truth["depth"][~miss]).all()
        missed += (miss & np.isinf(depth)).sum()
    assert missed > 10_000


def test_the_sky_may_have_the_disparity_at_infinity(renderer):
    truth = renderer("truth")
    left, right = RIGS[0].cameras
    for view in (0, 1):
        plain, sky = truth[f"0/{view}/disparity"], truth[f"sky/{view}/disparity"]
        miss = truth[f"0/{view}/object_id"] == 0
        assert miss.any()
        assert np.allclose(sky[miss], left.cx - right.cx, atol=1e-5)
        assert np.array_equal(sky[~miss], plain[~miss])


def test_arrays_have_the_documented_shapes_and_types(renderer):
    truth = renderer("truth")
    types = {
        "depth": "f8",
        "position": "f8",
        "disparity": "f4",
        "visible": "?",
        "normal": "f4",
        "shading_normal": "f4",
        "object_id": "i4",
        "material_id": "i4",
        "material_kind": "u1",
    }
    for name, rig in RIGS.items():
        for index, camera in enumerate(rig.cameras):
            for field, dtype in types.items():
                array = truth[f"{name}/{index}/{field}"]
                assert array.dtype == np.dtype(dtype)
                assert array.shape[:2] == (camera.height, camera.width)
                assert array.shape[2:] == (
                    (3,) if field in ("position", "normal", "shading_normal") else ()
                )
