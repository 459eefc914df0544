"""The shipped network: method `learned`, and one step of its training."""

import sys
from pathlib import Path

import numpy as np
import pytest

import twinlens as tl
import twinlens.matching as tm
from twinlens.matching.costs import LEARNED_FILE
from twinlens.matching.options import MissingExtraError

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "learned"


def textured(height: int = 60, width: int = 140, shift: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Smooth noise, and the same moved by `shift` pixels with another gain, offset and noise."""
    random = np.random.default_rng(5)
    noise = random.normal(size=(height // 4 + 1, width // 4 + 1))
    right = np.kron(noise, np.ones((4, 4)))[:height, :width] * 30 + random.normal(size=(height, width)) * 6 + 120
    left = np.roll(right, shift, axis=1) * 0.8 + 30 + random.normal(size=(height, width)) * 2
    return left.clip(0, 255).astype(np.uint8), right.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("method", ["learned", "sgm:cost=learned", "learned:support=cross,block_size=25"])
def test_the_shipped_network_matches(method):
    pytest.importorskip("onnxruntime")
    found = tm.match(*textured(), method, num_disparities=16)
    errors = np.abs(found[:, 16:] - 6) > 1
    assert errors.mean() < 0.01


def test_it_is_small_and_part_of_the_package():
    assert LEARNED_FILE.is_relative_to(Path(tl.__file__).parent)
    assert LEARNED_FILE.stat().st_size < 1_000_000
    assert "learned.onnx=" in tm.parse_method("learned").spec


def test_without_onnxruntime_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'twinlens\[onnx\]'"):
        tm.parse_method("learned").check_parts()


def test_a_step_of_training_and_the_onnx_file(tmp_path, monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(str(BENCHMARK))
    import network

    left, right = textured()
    disparity = np.full(left.shape, 6, np.float32)
    disparity[:, :6] = -1
    arrays = {"left": left, "right": right, "disparity": disparity}
    pairs = {name: torch.from_numpy(values)[None] for name, values in arrays.items()}
    settings = network.Training(channels=8, steps=2, columns=96)
    checkpoint = tmp_path / "net.pt"
    net = network.train([pairs], settings, 0, checkpoint)
    again = network.train([pairs], settings, 0, checkpoint)  # the checkpoint is complete: no step is left
    for one, other in zip(net.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)
    network.export(net, tmp_path / "net.onnx")
    found = tm.external.descriptors(str(tmp_path / "net.onnx"), left[:51, :73])
    with torch.no_grad():
        expected = net(torch.from_numpy(left[None, None, :51, :73]).float() / 255)[0]
    np.testing.assert_allclose(found, np.moveaxis(expected.numpy(), 0, 2), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1, atol=1e-3)


def test_the_loss_of_equal_descriptors_is_that_of_a_guess(monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(str(BENCHMARK))
    import network

    same = torch.zeros(1, 4, 2, 10)
    same[:, 0] = 1
    disparity = torch.tensor([[[-1.0, 2, 0.5, 3] + [1.0] * 6] * 2])
    assert float(network.loss_of(same, same, disparity, 0.1)) == pytest.approx(np.log(10), rel=1e-5)
    unit = torch.eye(10).reshape(1, 10, 1, 10).expand(1, 10, 2, 10)  # each column has its own descriptor
    half = torch.full((1, 2, 10), 0.5)
    half[..., 0] = -1
    expected = -np.log(np.exp(10.0) / (np.exp(10.0) + 9)) / 2 + np.log(np.exp(10.0) + 9) / 2
    assert float(network.loss_of(unit, unit, half, 0.1)) == pytest.approx(expected, rel=1e-4)
