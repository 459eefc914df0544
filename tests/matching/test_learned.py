"""The shipped network: method `learned`, and one step of its training."""

import sys
from pathlib import Path

import numpy as np
import pytest

import twinlens as tl
import twinlens.matching as tm
from twinlens.errors import InputError, MissingExtraError
from twinlens.matching.costs import LEARNED_FILE

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "learned"


def textured() -> tuple[np.ndarray, np.ndarray]:
    """Smooth noise, and the same moved by 6 pixels with another gain, offset and noise."""
    height, width, shift = 60, 140, 6
    random = np.random.default_rng(5)
    noise = random.normal(size=(height // 4 + 1, width // 4 + 1))
    coarse = np.kron(noise, np.ones((4, 4)))[:height, :width]
    right = 120 + 30 * coarse + 6 * random.normal(size=coarse.shape)
    left = 30 + 0.8 * np.roll(right, shift, axis=1)
    left += 2 * random.normal(size=left.shape)
    return left.clip(0, 255).astype(np.uint8), right.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    "method", ["learned", "sgm:cost=learned", "learned:support=cross,block_size=25"]
)
def test_the_shipped_network_matches(method):
    pytest.importorskip("onnxruntime")
    found = tm.match(*textured(), method, num_disparities=16)
    errors = np.abs(found[:, 16:] - 6) > 1
    assert errors.mean() < 0.01


def test_its_file_is_part_of_the_package_and_of_the_spec():
    assert LEARNED_FILE.is_relative_to(Path(tl.__file__).parent)
    assert "learned.onnx=" in tm.parse_method("learned").spec


def test_without_onnxruntime_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'twinlens\[onnx\]'"):
        tm.parse_method("learned").check_parts()


@pytest.fixture
def benchmark_path(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARK))
    return pytest.importorskip("torch")


def training_pairs(torch) -> dict:
    left, right = textured()
    disparity = np.full(left.shape, 6, np.float32)
    disparity[:, :6] = -1
    arrays = {"left": left, "right": right, "disparity": disparity}
    return {name: torch.from_numpy(values)[None] for name, values in arrays.items()} | {
        "noise": torch.zeros(256)
    }


def test_a_step_of_training_and_the_onnx_file(tmp_path, benchmark_path):
    torch = benchmark_path
    import network

    left, pairs = textured()[0], training_pairs(torch)
    settings = network.Training(channels=8, steps=2, columns=96)
    checkpoint = tmp_path / "net.pt"
    net = network.train([pairs], settings, 0, checkpoint)
    again = network.train(
        [pairs], settings, 0, checkpoint
    )  # the checkpoint is complete: no step is left
    for one, other in zip(net.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)
    network.export(net, tmp_path / "net.onnx")
    found = tm.networks.descriptors(str(tmp_path / "net.onnx"), left[:51, :73])
    with torch.no_grad():
        expected = net(torch.from_numpy(left[None, None, :51, :73]).float() / 255)[0]
    np.testing.assert_allclose(found, np.moveaxis(expected.numpy(), 0, 2), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1, atol=1e-3)


def test_the_loss_of_equal_descriptors_is_that_of_a_guess(benchmark_path):
    torch = benchmark_path
    import network

    def loss(products, disparity, **changes):
        match = torch.arange(disparity.shape[2]) - disparity
        entropy = network.cross_entropy(
            products / 0.1, match.clamp(0, disparity.shape[2] - 1)
        )
        return float(entropy[(disparity >= 0) & (match >= 0)].mean())

    same = torch.ones(1, 2, 10, 10)
    disparity = torch.tensor([[[-1.0, 2, 0.5, 3] + [1.0] * 6] * 2])
    assert loss(same, disparity) == pytest.approx(np.log(10), rel=1e-5)
    unit = torch.eye(10).expand(1, 2, 10, 10)  # each column has its own descriptor
    half = torch.full((1, 2, 10), 0.5)
    half[..., 0] = -1
    expected = (
        -np.log(np.exp(10.0) / (np.exp(10.0) + 9)) / 2 + np.log(np.exp(10.0) + 9) / 2
    )
    assert loss(unit, half) == pytest.approx(expected, rel=1e-4)


def test_the_loss_of_windows_adds_that_of_their_candidates(benchmark_path):
    torch = benchmark_path
    import network

    same = torch.zeros(1, 4, 3, 10)
    same[:, 0] = 1
    disparity = torch.full((1, 3, 10), -1.0)
    disparity[:, :, 6] = (
        2  # of pixels, 10 candidates; of windows, the 4 below the depth
    )
    settings = network.Training(window=3, window_depth=4)
    assert float(network.loss_of(same, same, disparity, settings)) == pytest.approx(
        np.log(10) + np.log(4), rel=1e-5
    )


def test_products_of_windows_are_means_over_squares(benchmark_path):
    torch = benchmark_path
    import network

    products = torch.rand(1, 7, 9, 9, generator=torch.Generator().manual_seed(0))
    found = network.window_products(products, depth=4, side=3)
    by_hand = [float(products[0, y, u, u - 2]) for y in (2, 3, 4) for u in (4, 5, 6)]
    assert float(found[0, 3, 5, 2]) == pytest.approx(np.mean(by_hand), rel=1e-5)
    assert (found[0, :, 1, 2:] == -1000).all()


def test_crops_of_every_scale_and_shape_keep_their_matches(benchmark_path):
    """The right pixel at u - d looks like the left one at u: on the scene, in front of it, and never in both."""
    torch = benchmark_path
    from crops import looked_up, random_crops

    random = np.random.default_rng(3)
    grain = np.kron(random.uniform(60, 200, (20, 60)), np.ones((6, 6)))
    smooth = (grain[:-5] + grain[5:]) / 2
    image = torch.from_numpy(smooth.astype(np.uint8))[None]
    disparity = torch.full(image.shape, 8.0)
    disparity[:, :, :8] = -1
    pairs = {
        "left": image,
        "right": image.roll(-8, 2),
        "disparity": disparity,
        "noise": torch.zeros(256),
    }
    crops = random_crops(
        pairs,
        8,
        (48, 160),
        scale=1.8,
        shapes=3,
        random=torch.Generator().manual_seed(1),
    )
    at = torch.arange(160) - crops.disparity
    matched = looked_up(
        crops.right, at, torch.arange(48.0)[:, None].expand(8, 48, 160)
    )[:, 0]
    finite = (crops.disparity >= 0) & (at >= 0)
    errors = (matched - crops.left[:, 0]).abs()[finite]
    assert len(torch.unique(crops.disparity[finite])) > 16
    assert finite.float().mean() > 0.5
    assert (errors > 0.05).float().mean() < 0.04


def test_pairs_smaller_than_a_crop_are_enlarged(benchmark_path):
    torch = benchmark_path
    from crops import random_crops

    pairs = training_pairs(torch)
    random = torch.Generator().manual_seed(0)
    crops = random_crops(pairs, 8, (40, 278), scale=1.8, shapes=0, random=random)
    finite = crops.disparity[crops.disparity >= 0]
    torch.testing.assert_close(finite, torch.full_like(finite, 6 * 278 / 139))


def test_the_noise_of_a_level_is_that_of_its_pixels(benchmark_path):
    torch = benchmark_path
    import data

    clean = torch.full((1, 100, 200), 40, dtype=torch.uint8)
    clean[:, :, 100:] = 200
    random = np.random.default_rng(1)
    noise = random.normal(size=clean.shape) * np.where(clean.numpy() == 40, 2, 4)
    noisy = torch.from_numpy(np.round(clean.numpy() + noise).astype(np.uint8))
    found = 255 * data.noise_of_levels(noisy, clean).numpy()
    np.testing.assert_allclose(
        found[[44, 204]], [2, 4], rtol=0.03
    )  # the centres of the levels' bins
    assert found[124] == pytest.approx(3, rel=0.03)


def test_an_interrupted_training_resumes_to_the_same_weights(
    tmp_path, benchmark_path, monkeypatch
):
    torch = benchmark_path
    import network

    settings = network.Training(channels=8, steps=5, crops=2, columns=96)
    pairs = training_pairs(torch)
    whole = network.train([pairs], settings, 0)
    loss_of, calls = network.loss_of, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return loss_of(*arguments)

    monkeypatch.setattr(network, "REPORT", 2)
    monkeypatch.setattr(network, "loss_of", interrupted)
    with pytest.raises(KeyboardInterrupt):
        network.train([pairs], settings, 0, tmp_path / "net.pt")
    assert torch.load(tmp_path / "net.pt")["step"] == 2
    monkeypatch.setattr(network, "loss_of", loss_of)
    resumed = network.train([pairs], settings, 0, tmp_path / "net.pt")
    for one, other in zip(whole.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(one, other)


@pytest.fixture
def script(benchmark_path):
    import run

    return run


def test_held_out_scenes_have_other_seeds_than_the_recipe(tmp_path, script):
    published = script.held_out_changes(BENCHMARK / "recipe.toml")
    assert [changes["seed"] for changes in published.values()] == [22, 23, 24]
    recipe = tmp_path / "my.toml"
    recipe.write_text(
        (BENCHMARK / "recipe.toml").read_text().replace("seed = 21", "seed = 22")
    )
    own = script.held_out_changes(recipe)
    assert [changes["seed"] for changes in own.values()] == [23, 25]


def test_networks_of_other_settings_are_refused(tmp_path, script):
    file = tmp_path / "training.json"
    file.write_bytes(script.check_settings(file, {"steps": 4}))
    script.check_settings(file, {"steps": 4})
    with pytest.raises(InputError, match="other settings"):
        script.check_settings(file, {"steps": 5})


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A sample with a fixed exposure, and a mismatch of which the recipe gives the gain."""
    pytest.importorskip("torch")
    folder = tmp_path_factory.mktemp("recipe")
    (folder / "my.toml").write_text(
        'seed = 3\ncount = 1\nfamilies = ["cards"]\nwidth = 64\nheight = 48\nspp = 4\nkeep = ["radiance"]\n'
        "[exposure]\ntime = 0.004\n"
        '[sensor]\nmismatch = { level = "calibrated", gain = 1.3, distortion_px = 0.0, focus_um = 0.0 }\n'
    )
    recipe = tl.factory.read_recipe(folder / "my.toml")
    assert tl.factory.generate(recipe, folder / "out").complete
    return tl.Dataset(folder / "out")[0]


def test_the_exposure_of_training_is_that_of_the_sample(stored, benchmark_path):
    import data

    exposed = data.Exposed()(stored)
    means = [tm.grey(stored.image(view)).mean() for view in (0, 1)]
    trained = [exposed[side].mean() for side in ("left", "right")]
    assert trained == pytest.approx(means, rel=0.03)
    assert means[1] > 1.08 * means[0], "another gain would pass"


def test_an_exposure_draws_the_mismatch_anew_except_what_the_recipe_gives(
    stored, benchmark_path
):
    import data

    record = stored.record["record"]
    sensor = tl.Sensor.from_record(record["sensor"])
    drawn = record["spec"]["drawn"]
    one, other = (data.Exposed().mismatch(sensor, drawn, seed) for seed in (1, 2))
    none = data.Exposed(level="none").mismatch(sensor, drawn, 1)
    yaw = sensor.mismatch_of(1).yaw_px
    assert yaw != 0
    assert one.yaw_px == other.yaw_px == none.yaw_px == yaw
    assert one.gain == other.gain == 1.3
    assert one.white_balance_red != other.white_balance_red
    assert (none.gain, none.white_balance_red) == (1, 1)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('families = ["cards", "flying", "room", "tabletop"]', 'scenes = ["cards"]', "families"),
        ("keep =", "#", "keep"),
        ("[rig]", '[rig]\nlayout = "toed_in"\ndistance = 2.0', "rectified pair"),
        ("[rig]", '[rig]\nlayout = "line"\ncount = 3\nspacing = 0.1', "rectified pair"),
        ("[sensor]", "[sensor]\nbits = 16", "sensor.bits: training needs 8, got 16"),
        ("[sensor]", "[sensor]\nbits = { sweep = [8, 16] }", "sensor.bits: training needs 8, got 16"),
    ],
)  # fmt: skip
def test_recipes_that_training_cannot_use_are_refused(
    tmp_path, script, old, new, message
):
    recipe = tmp_path / "my.toml"
    recipe.write_text((BENCHMARK / "recipe.toml").read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        script.data.checked_recipe(recipe)


def test_the_published_page_is_made_from_its_results(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARK))
    import tables

    assert (BENCHMARK / "README.md").read_text() == tables.page()


@pytest.mark.parametrize(("number", "deviations"), [(1, 1.96), (14, 2.91)])
def test_intervals_are_those_of_normal_means(script, number, deviations):
    """Quantiles of the normal distribution for 0.05 / 2 and 0.05 / 28."""
    differences = np.random.default_rng(2).normal(3, 2, (400, 1))
    half = deviations * differences.std() / np.sqrt(400)
    expected = differences.mean() + np.array([-half, half])
    np.testing.assert_allclose(
        script.score.interval(differences, number), expected, atol=0.1 * half
    )
