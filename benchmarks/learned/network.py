"""The network, its training and its ONNX file."""

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

REPORT = 50  # steps between lines and checkpoints


@dataclass(frozen=True)
class Training:
    """Hyperparameters, chosen on held-out scenes.

    crops, rows, columns : of each step. temperature : of the softmax over the candidates of a pixel.
    augment : change gain, gamma and noise of each image, and the rows of the right one, beyond what the data has.
    """

    channels: int = 64
    steps: int = 500
    crops: int = 4
    rows: int = 40
    columns: int = 176
    rate: float = 2e-3
    temperature: float = 0.07
    augment: bool = True


def convolution(inputs: int, outputs: int, dilation: int = 1) -> nn.Conv2d:
    """3x3; outside the image its edge pixels are repeated."""
    return nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation, padding_mode="replicate")


def stack(*layers: nn.Module) -> nn.Sequential:
    """Layers, each followed by a rectifier."""
    return nn.Sequential(*(part for layer in layers for part in (layer, nn.ReLU())))


class Descriptor(nn.Module):
    """Grey levels (N, 1, H, W), 0 to 1, to descriptors of unit length (N, C, H, W).

    Convolutions at full and at half resolution, which see 46 x 46 pixels.
    """

    WINDOW = 11  # pixels, of the local mean and standard deviation
    FLOOR = 0.02  # of grey levels, added to the standard deviation: about the noise

    def __init__(self, channels: int) -> None:
        super().__init__()
        c, fine = channels, channels // 2
        self.fine = stack(convolution(1, fine), convolution(fine, fine))
        self.coarse = stack(convolution(fine, c), convolution(c, c), convolution(c, c, dilation=2))
        self.joined = nn.Sequential(nn.Conv2d(fine + c, c, 1), nn.ReLU(), convolution(c, c))

    def forward(self, image: Tensor) -> Tensor:
        fine = self.fine(self.normalised(image))
        coarse = self.coarse(functional.avg_pool2d(fine, 2, ceil_mode=True))
        coarse = functional.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
        out = self.joined(torch.cat([fine, coarse[:, :, : image.shape[2], : image.shape[3]]], 1))
        return out / (out.square().sum(1, keepdim=True) + 1e-8).sqrt()

    def normalised(self, image: Tensor) -> Tensor:
        """The image without its local mean, over its local standard deviation."""
        mean = self.local_mean(image)
        centred = image - mean
        return centred / (self.local_mean(centred.square()).sqrt() + self.FLOOR)

    def local_mean(self, image: Tensor) -> Tensor:
        r = self.WINDOW // 2
        return functional.avg_pool2d(functional.pad(image, (r, r, r, r), mode="replicate"), self.WINDOW, stride=1)


def loss_of(left: Tensor, right: Tensor, disparity: Tensor, temperature: float) -> Tensor:
    """InfoNCE: the cross entropy of the true match of each pixel among all pixels of the row of the right crop.

    left, right (N, C, H, W): descriptors. disparity (N, H, W): -1 where unknown or occluded. A match between two pixels
    is shared by both, in proportion to their distance.
    """
    columns = torch.arange(disparity.shape[2], dtype=disparity.dtype)
    match = columns - disparity
    used = (disparity >= 0) & (match >= 0)
    scores = torch.einsum("nchu,nchv->nhuv", left, right)[used] / temperature
    target = match[used]
    low = target.floor()
    share = target - low
    high = (low + 1).clamp(max=len(columns) - 1)
    logs = functional.log_softmax(scores, 1)
    picked = logs.gather(1, torch.stack([low, high], 1).long())
    return -((1 - share) * picked[:, 0] + share * picked[:, 1]).mean()


def cut(pairs: dict[str, Tensor], settings: Training, random: torch.Generator) -> tuple[Tensor, Tensor]:
    """Random crops of random pairs: images (2 B, 1, h, w), the left ones first, and disparities (B, h, w)."""
    total, height, width = pairs["disparity"].shape

    def whole(limit: int) -> int:
        return int(torch.randint(limit, (), generator=random))

    def number(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=random))

    lefts, rights, maps = [], [], []
    for _ in range(settings.crops):
        n, y, x = whole(total), whole(height - settings.rows + 1), whole(width - settings.columns + 1)
        window = (n, slice(y, y + settings.rows), slice(x, x + settings.columns))
        pair = [pairs[side][window].float() / 255 for side in ("left", "right")]
        disparity = pairs["disparity"][window]
        if whole(2):  # upside down
            pair, disparity = [image.flip(0) for image in pair], disparity.flip(0)
        if settings.augment:
            shift = number(-0.5, 0.5)  # of the rows of the right image
            moved = pair[1].roll(1 if shift > 0 else -1, 0)
            pair[1] = (1 - abs(shift)) * pair[1] + abs(shift) * moved
            base = number(0.7, 1.4)
            for side in (0, 1):
                exponent, gain = base * number(0.93, 1.08), number(0.85, 1.15)
                noise = number(0, 0.015) * torch.randn(pair[side].shape, generator=random)
                pair[side] = (gain * pair[side].clamp(min=1e-3) ** exponent + noise).clamp(0, 1)
        lefts.append(pair[0])
        rights.append(pair[1])
        maps.append(disparity)
    return torch.stack(lefts + rights)[:, None], torch.stack(maps)


def train(
    draws: Sequence[dict[str, Tensor]], settings: Training, seed: int, checkpoint: Path | None = None
) -> Descriptor:
    """Train on pairs, of which each draw has the same ones with other cameras and noise. Resumes a checkpoint."""
    torch.manual_seed(seed)
    random = torch.Generator().manual_seed(seed)
    net = Descriptor(settings.channels)
    optimiser = torch.optim.AdamW(net.parameters(), settings.rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.rate, total_steps=settings.steps)
    parts: dict[str, Any] = {"net": net, "optimiser": optimiser, "schedule": schedule}
    step, losses = 0, []
    if checkpoint is not None and checkpoint.exists():
        saved = torch.load(checkpoint)
        step = saved["step"]
        random.set_state(saved["random"])
        for name, part in parts.items():
            part.load_state_dict(saved[name])
    start = time.process_time()
    while step < settings.steps:
        images, disparity = cut(draws[step % len(draws)], settings, random)
        left, right = net(images).chunk(2)
        loss = loss_of(left, right, disparity, settings.temperature)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        step += 1
        losses.append(float(loss.detach()))
        if step % REPORT == 0 or step == settings.steps:
            used = time.process_time() - start
            print(
                f"seed {seed}, step {step}/{settings.steps}: loss {sum(losses) / len(losses):.3f}, {used:.0f} s",
                flush=True,
            )
            losses.clear()
            if checkpoint is not None:
                state = {name: part.state_dict() for name, part in parts.items()}
                torch.save({**state, "step": step, "random": random.get_state()}, checkpoint.with_suffix(".new"))
                checkpoint.with_suffix(".new").replace(checkpoint)
    return net.eval()


def export(net: Descriptor, file: Path) -> None:
    """Write the network as ONNX with free height and width."""
    axes = {2: "height", 3: "width"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about itself
        torch.onnx.export(
            net, (torch.rand(1, 1, 48, 64),), str(file), input_names=["image"], output_names=["descriptors"],
            dynamic_axes={"image": axes, "descriptors": axes}, opset_version=17, dynamo=False,
        )  # fmt: skip
