"""The planned rig against a dense grid search, whose formulas are written independently, from similar triangles."""

import dataclasses
import math

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.optics.planning import LIMITS, plan_rig
from twinlens.optics.rig_task import Light, RigTask

TASKS = 200
RAISED = ("depth error", "blur", "diffraction", "noise", "disparities", "largest baseline", "longest focal length",
          "largest f-number")  # fmt: skip


def random_task(seed):
    """A task near the border of feasibility, so that about half are infeasible."""
    rng = np.random.default_rng(seed)
    near = rng.uniform(0.2, 3.0)
    far = near * rng.uniform(1.3, 8.0)
    width, pitch = int(rng.choice([640, 1280, 2048])), float(rng.uniform(1.4, 6.0))
    view = {"fov_x_deg": sorted_pair(rng, 30, 100)}
    if rng.random() < 0.5:
        view = {"focal_length_mm": sorted_pair(rng, 3, 14)}
    light = None
    if rng.random() < 0.5:
        light = Light(
            10 ** rng.uniform(3, 6),
            10 ** rng.uniform(-3, -1),
            rng.uniform(0, 10),
            1e4,
            rng.uniform(3, 30),
        )
    return RigTask(
        width, 480, pitch, (near, far), **view,
        baseline=sorted_pair(rng, 0.02, 0.6),
        f_number=sorted_pair(rng, 1.2, 16),
        focus_distance=None if rng.random() < 0.7 else float(rng.uniform(near, far)),
        depth_error=None if rng.random() < 0.3 else float(far * 10 ** rng.uniform(-2.7, -1.2)),
        disparity_error_px=rng.uniform(0.05, 0.3), blur_px=rng.uniform(0.4, 3), airy_px=rng.uniform(1, 5),
        overlap=rng.uniform(0.3, 0.9), max_disparities=int(rng.choice([48, 96, 192])), light=light,
    )  # fmt: skip


def sorted_pair(rng, least, most):
    """A range, or one number in a third of the cases."""
    low, high = sorted(np.exp(rng.uniform(math.log(least), math.log(most), 2)).tolist())
    return low if rng.random() < 0.3 else (low, high)


def naive_limits(task):
    """The limits by their names; focal lengths as film distances in metres."""

    def ends(value):
        return value if isinstance(value, tuple) else (value, value)

    low, high = task.depth_range
    focus = (
        2 * low * high / (low + high)
        if task.focus_distance is None
        else task.focus_distance
    )
    if task.fov_x_deg is None:
        films = [
            focus * 1e-3 * mm / (focus - 1e-3 * mm) for mm in ends(task.focal_length_mm)
        ]  # 1/f = 1/v + 1/focus
    else:
        half = 0.5 * task.width * task.pixel_pitch_um * 1e-6
        films = [
            half / math.tan(math.radians(deg) / 2) for deg in ends(task.fov_x_deg)
        ][::-1]
    limits = {
        "blur": task.blur_px, "diffraction": task.airy_px, "overlap": task.overlap,
        "disparities": task.max_disparities, "smallest baseline": ends(task.baseline)[0],
        "largest baseline": ends(task.baseline)[1], "shortest focal length": films[0],
        "longest focal length": films[-1], "smallest f-number": ends(task.f_number)[0],
        "largest f-number": ends(task.f_number)[1],
    }  # fmt: skip
    if task.depth_error is not None:
        limits["depth error"] = task.depth_error
    if task.light is not None:
        limits["noise"] = task.light.longest_exposure
    return limits, focus


def naive_feasible(task, limits, focus, film, baseline, number):
    """Which combinations of film distances (F, 1), baselines (1, B) and f-numbers (1, N) meet the limits, (F, B).

    Every quantity follows from rays through the lenses, in metres on the film.
    """
    pixel, slack = 1e-6 * task.pixel_pitch_um, 1 + 1e-9
    aperture = film / number
    sharp = np.ones(np.broadcast_shapes(film.shape, number.shape), dtype=bool)
    for z in (
        task.depth_range
    ):  # two rays from z through the rim of the lens that is focused at `focus`
        image = 1 / (1 / film + 1 / focus - 1 / z)
        circle = aperture * np.abs(image - film) / np.abs(image)
        sharp &= circle <= limits["blur"] * pixel * slack
    sharp &= (
        2 * 1.2196698912665045 * task.wavelength * number
        <= limits["diffraction"] * pixel * slack
    )
    if task.light is not None:
        electrons = task.light.electrons_per_second * limits["noise"] / number**2
        noise = np.sqrt(electrons + task.light.read_noise**2)
        sharp &= electrons * slack >= task.light.least_snr * noise
    near, far = task.depth_range
    shift_near, shift_far = (
        film * baseline / near / pixel,
        film * baseline / far / pixel,
    )
    ok = sharp.any(axis=1, keepdims=True) & (
        shift_near - shift_far <= (limits["disparities"] - 2) * slack
    )
    ok &= shift_near <= (1 - limits["overlap"]) * task.width * slack
    if "depth error" in limits:
        ok &= naive_error(task, film, baseline) <= limits["depth error"] * slack
    return ok


def naive_error(task, film, baseline):
    """The derivative of z = v B / (p d) by the disparity, by a difference, at the far end."""
    far, pixel, step = task.depth_range[1], 1e-6 * task.pixel_pitch_um, 1e-4
    d = film * baseline / far / pixel
    return (
        (film * baseline / pixel / (d - step) - film * baseline / pixel / (d + step))
        / (2 * step)
        * task.disparity_error_px
    )


def grid_search(task, limits, focus, points=(200, 400, 300)):
    """The best objective on a grid over the free quantities; inf if no point is feasible."""
    axes = [
        np.geomspace(limits[f"{least} {name}"], limits[f"{most} {name}"], n)
        for n, (least, most, name) in zip(points, (
            ("shortest", "longest", "focal length"), ("smallest", "largest", "baseline"),
            ("smallest", "largest", "f-number"),
        ), strict=True)
    ]  # fmt: skip
    film, baseline, number = axes[0][:, None], axes[1][None], axes[2][None]
    ok = naive_feasible(task, limits, focus, film, baseline, number)
    if not ok.any():
        return math.inf
    value = (
        naive_error(task, film, baseline)
        if task.depth_error is None
        else np.broadcast_to(baseline, ok.shape)
    )
    return float(value[ok].min())


def in_film(task, focus, name, value):
    """A value of the plan in the units of `naive_limits`."""
    if not name.endswith("focal length"):
        return value
    changed = (
        {"focal_length_mm": value} if task.fov_x_deg is None else {"fov_x_deg": value}
    )
    return naive_limits(dataclasses.replace(task, focus_distance=focus, **changed))[0][
        name
    ]


def loosened(name, value, factor):
    return value * factor if name in RAISED else value / factor


@pytest.fixture(scope="module")
def plans():
    return [(task, plan_rig(task)) for task in map(random_task, range(TASKS))]


def test_the_tasks_are_mixed(plans):
    feasible = sum(plan.best is not None for _, plan in plans)
    assert TASKS // 4 < feasible < 3 * TASKS // 4
    named = {name for _, plan in plans for change in plan.changes for name in change}
    assert named == set(LIMITS)
    assert {len(change) for _, plan in plans for change in plan.changes} >= {1, 2}


def test_the_best_choice_is_feasible_and_within_two_percent_of_a_grid_search(plans):
    for task, plan in plans:
        limits, focus = naive_limits(task)
        on_grid = grid_search(task, limits, focus)
        if plan.best is None:
            assert on_grid == math.inf, task
            continue
        best, slack = plan.best, 1 + 1e-9
        film, baseline, number = (
            np.array([[x]]) for x in (best.film_distance, best.baseline, best.f_number)
        )
        assert naive_feasible(task, limits, focus, film, baseline, number).all(), task
        assert (
            limits["shortest focal length"]
            <= film * slack
            <= limits["longest focal length"] * slack**2
        )
        assert (
            limits["smallest baseline"]
            <= baseline * slack
            <= limits["largest baseline"] * slack**2
        )
        assert (
            limits["smallest f-number"]
            <= number * slack
            <= limits["largest f-number"] * slack**2
        )
        value = (
            best.baseline
            if task.depth_error is not None
            else float(naive_error(task, film, baseline)[0, 0])
        )
        assert 0.98 * on_grid <= value <= 1.0001 * on_grid, task


def test_an_infeasible_task_names_the_limits_that_a_grid_search_finds(plans):
    """With the named limits 3 % looser than needed the grid has a point; 3 % tighter, or with any other limit, none."""
    for task, plan in plans:
        if plan.best is not None:
            continue
        limits, focus = naive_limits(task)
        assert plan.reasons
        assert plan.changes
        for change in plan.changes:
            needed = {
                name: in_film(task, focus, name, value)
                for name, value in change.items()
            }
            ample = {
                name: loosened(name, value, 1.03) for name, value in needed.items()
            }
            assert (
                grid_search(task, limits | ample, focus, (100, 200, 150)) < math.inf
            ), (task, change)
            for name, value in needed.items():
                short = needed | {name: loosened(name, value, 1 / 1.03)}
                assert (
                    grid_search(task, limits | short, focus, (60, 80, 60)) == math.inf
                ), (task, change)
            if change.keys() == {"disparities"}:
                enough = dataclasses.replace(
                    task, max_disparities=change["disparities"]
                )
                assert plan_rig(enough).best is not None, task
        single = {
            name for change in plan.changes for name in change if len(change) == 1
        }
        for name in limits.keys() - single:
            other = limits | {name: loosened(name, limits[name], 30)}
            assert grid_search(task, other, focus, (60, 80, 60)) == math.inf, (
                task,
                name,
            )


def feasible_plans(plans, count):
    return [
        (task, plan, *naive_limits(task))
        for task, plan in plans
        if plan.best is not None
    ][:count]


def test_feasible_ranges_end_where_the_grid_search_has_no_point(plans):
    """With one quantity fixed 1 % inside its range there is a point, 1 % outside none."""
    names = {
        "baseline": "baseline",
        "f_number": "f-number",
        "focal_length_mm": "focal length",
    }
    checked = []
    for task, plan, limits, focus in feasible_plans(plans, 40):
        for field, (low, high) in plan.feasible.items():
            if field not in names or high / low < 1.05:
                continue
            ends = [name for name in limits if name.endswith(names[field])]
            for value, inside in (
                (1.01 * low, True),
                (high / 1.01, True),
                (low / 1.01, False),
                (1.01 * high, False),
            ):
                film = (
                    value
                    if field != "focal_length_mm"
                    else 1e-3 * focus * value / (focus - 1e-3 * value)
                )
                if limits[ends[0]] <= film <= limits[ends[1]]:
                    cheapest = grid_search(
                        task, limits | dict.fromkeys(ends, film), focus, (100, 150, 100)
                    )
                    assert (cheapest < math.inf) == inside, (task, field, value)
                    checked.append((field, inside))
    assert {(field, inside) for field in names for inside in (True, False)} == set(
        checked
    )


def test_a_limit_binds_where_the_grid_search_improves_without_it(plans):
    for task, plan, limits, focus in feasible_plans(plans, 12):
        now = grid_search(task, limits, focus)
        for name, value in limits.items():
            better = grid_search(
                task, limits | {name: loosened(name, value, 1.1)}, focus
            )
            assert 1 - better / now == pytest.approx(
                plan.binding.get(name, 0.0), abs=0.015
            ), (task, name)


def test_used_is_within_the_limits(plans):
    for task, plan, *_ in feasible_plans(plans, TASKS):
        assert plan.used.keys() == plan.limits.keys()
        assert plan.best.search[1] <= task.max_disparities
        if task.light is not None:
            assert plan.best.snr >= task.light.least_snr * (1 - 1e-9)
            assert plan.best.exposure <= task.light.longest_exposure
        for name, used in plan.used.items():
            rising = (name in RAISED) != (
                task.fov_x_deg is not None and name.endswith("focal length")
            )
            margin = 1e-9 * plan.limits[name]
            assert (
                used <= plan.limits[name] + margin
                if rising
                else used >= plan.limits[name] - margin
            ), (task, name)


def test_light_needs_time_for_its_signal_to_noise_ratio():
    """Counting is a Poisson process: the ratio of a simulated exposure."""
    light = Light(
        electrons_per_second=2e5,
        longest_exposure=0.02,
        read_noise=5.0,
        most_electrons=1800,
        least_snr=12,
    )
    number = light.largest_f_number(0.02)
    rng = np.random.default_rng(1)
    counts = rng.poisson(2e5 * 0.02 / number**2, 400_000) + rng.normal(0, 5.0, 400_000)
    assert counts.mean() / counts.std() == pytest.approx(12, rel=0.01)
    assert light.exposure(4.0) == 0.02
    assert light.exposure(1.0) * 2e5 == pytest.approx(1800)  # white does not saturate


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth_range": (3.0, 1.0)}, "depth_range must be"),
        ({"depth_range": (1.0, math.inf)}, "depth_range must be"),
        ({"fov_x_deg": None}, "exactly one of fov_x_deg and focal_length_mm"),
        ({"focal_length_mm": 8.0}, "exactly one of fov_x_deg and focal_length_mm"),
        (
            {"fov_x_deg": None, "focal_length_mm": 2000.0},
            "must be below the focus distance, 1714.29 mm",
        ),
        (
            {"baseline": (0.3, 0.1)},
            r"baseline must be \(least, most\) with least <= most, got \(0.3, 0.1\)",
        ),
        (
            {"baseline": 0.0},
            "baseline must be a number from 1e-06 to 1e.06 metres, or .least, most. of them",
        ),
        ({"f_number": "4"}, "f_number must be"),
        ({"blur_px": 0.0}, "blur_px must be a number of pixels"),
        ({"overlap": 1.0}, "overlap must be a number from 0 to below 1"),
        (
            {"max_disparities": 64.5},
            "max_disparities must be a whole number from 3 to 1000000",
        ),
        ({"pixel_pitch_um": -1.0}, "pixel_pitch_um must be"),
        ({"depth_error": 0.0}, "depth_error must be"),
        ({"focus_distance": -2.0}, "focus_distance must be"),
    ],
)
def test_a_task_names_a_wrong_value(changes, message):
    with pytest.raises(InputError, match=message):
        RigTask(
            640,
            480,
            **{"pixel_pitch_um": 5.0, "depth_range": (1.0, 6.0), "fov_x_deg": 60.0}
            | changes,
        )


def test_a_sensor_that_saturates_below_the_ratio_is_refused():
    with pytest.raises(
        InputError,
        match=r"least_snr must be at most 9\.95, where white saturates, got 20",
    ):
        Light(1e5, 0.01, read_noise=1.0, most_electrons=100, least_snr=20)
