"""The network, its training and its ONNX file."""

import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from crops import random_crops
from torch import Tensor, nn
from torch.nn import functional

REPORT = 50  # steps between lines and checkpoints
LARGEST_GRADIENT = 5.0  # norm
LARGEST_ENTROPY = 20.0  # of a window: its true match may be far from all candidates


@dataclass(frozen=True)
class Training:
    """Hyperparameters, chosen on synthetic pairs (about.md).

    crops, rows, columns : number and size of the crops of a step.
    scale : the largest reduction of a crop.
    shapes : number of shapes that are pasted in front of a crop.
    temperature : temperature of the softmax over the candidates of a pixel.
    window, window_temperature, window_depth : side of the windows of the second loss, temperature of its softmax, and
        its number of disparities.
    """

    channels: int = 64
    steps: int = 1600
    crops: int = 4
    rows: int = 40
    columns: int = 176
    scale: float = 1.8
    shapes: int = 3
    rate: float = 2e-3
    temperature: float = 0.07
    window: int = 11
    window_temperature: float = 0.04
    window_depth: int = 64

    def covering(self, disparity: float) -> "Training":
        """These settings, with more candidates and wider crops if the disparities of the data need them."""
        depth = math.ceil(disparity) + 2
        if depth <= self.window_depth:
            return self
        return replace(
            self, window_depth=depth, columns=self.columns * depth // self.window_depth
        )


def convolution(inputs: int, outputs: int, dilation: int = 1) -> nn.Conv2d:
    """3x3; outside the image its edge pixels are repeated."""
    return nn.Conv2d(
        inputs,
        outputs,
        3,
        padding=dilation,
        dilation=dilation,
        padding_mode="replicate",
    )


def stack(*layers: nn.Module) -> nn.Sequential:
    """Layers, each followed by a rectifier."""
    return nn.Sequential(*(part for layer in layers for part in (layer, nn.ReLU())))


def box_mean(images: Tensor, side: int) -> Tensor:
    """The means over windows; outside the image its edge pixels are repeated."""
    r = side // 2
    wide = functional.avg_pool2d(
        functional.pad(images, (r, r, 0, 0), mode="replicate"), (1, side), stride=1
    )
    return functional.avg_pool2d(
        functional.pad(wide, (0, 0, r, r), mode="replicate"), (side, 1), stride=1
    )


class Descriptor(nn.Module):
    """Grey levels (N, 1, H, W), 0 to 1, to descriptors of unit length (N, C, H, W).

    Convolutions at full and at half resolution, which see 46 x 46 pixels, of the locally normalised image and of the
    differences to the 24 neighbours of each pixel, which saturate, as those of a census transform.
    """

    WINDOW = 11  # pixels, of the local mean and standard deviation
    FLOOR = 0.02  # of grey levels, added to the standard deviation: about the noise
    REACH = 2  # pixels, of the neighbours
    STEP = 0.04  # of grey levels, at which a difference to a neighbour saturates

    def __init__(self, channels: int) -> None:
        super().__init__()
        c, fine = channels, channels // 2
        self.fine = stack(
            convolution((2 * self.REACH + 1) ** 2, fine), convolution(fine, fine)
        )
        self.coarse = stack(
            convolution(fine, c), convolution(c, c), convolution(c, c, dilation=2)
        )
        self.joined = nn.Sequential(
            nn.Conv2d(fine + c, c, 1), nn.ReLU(), convolution(c, c)
        )

    def forward(self, image: Tensor) -> Tensor:
        fine = self.fine(
            torch.cat([self.normalised(image), self.differences(image)], 1)
        )
        coarse = self.coarse(functional.avg_pool2d(fine, 2, ceil_mode=True))
        coarse = functional.interpolate(
            coarse, scale_factor=2.0, mode="bilinear", align_corners=False
        )
        out = self.joined(
            torch.cat([fine, coarse[:, :, : image.shape[2], : image.shape[3]]], 1)
        )
        return out / (out.square().sum(1, keepdim=True) + 1e-8).sqrt()

    def normalised(self, image: Tensor) -> Tensor:
        """The image without its local mean, over its local standard deviation."""
        centred = image - box_mean(image, self.WINDOW)
        return centred / (
            box_mean(centred.square(), self.WINDOW).clamp(min=0).sqrt() + self.FLOOR
        )

    def differences(self, image: Tensor) -> Tensor:
        """(N, 24, H, W): tanh of the differences between the neighbours and the pixel."""
        r, (height, width) = self.REACH, image.shape[2:]
        padded = functional.pad(image, (r, r, r, r), mode="replicate")
        places = [
            (i, j)
            for i in range(2 * r + 1)
            for j in range(2 * r + 1)
            if (i, j) != (r, r)
        ]
        near = torch.cat(
            [padded[:, :, i : i + height, j : j + width] for i, j in places], 1
        )
        return torch.tanh((near - image) / self.STEP)


def loss_of(
    left: Tensor, right: Tensor, disparity: Tensor, settings: Training
) -> Tensor:
    """InfoNCE of single pixels, among all pixels of the row of the right crop, plus that of the means over windows.

    left, right (N, C, H, W): descriptors. disparity (N, H, W): -1 where unknown or occluded.
    """
    width = disparity.shape[2]
    match = torch.arange(width) - disparity
    used = (disparity >= 0) & (match >= 0)
    near = used & (disparity < settings.window_depth - 1)
    products = torch.einsum("nchu,nchv->nhuv", left, right)
    of_pixels = cross_entropy(
        products / settings.temperature, match.clamp(0, width - 1)
    )[used]
    candidates = (
        window_products(products, settings.window_depth, settings.window)
        / settings.window_temperature
    )
    of_windows = cross_entropy(
        candidates, disparity.clamp(0, settings.window_depth - 2)
    )[near]
    return (
        of_pixels.sum() + of_windows.clamp(max=LARGEST_ENTROPY).sum()
    ) / used.sum().clamp(min=1)


def cross_entropy(scores: Tensor, target: Tensor) -> Tensor:
    """The cross entropy (...) of the true matches (...) among the candidates of scores (..., K).

    A match between two candidates is shared by both, in proportion to their distance.
    """
    low = target.floor()
    share = target - low
    high = (low + 1).clamp(max=scores.shape[-1] - 1)
    picked = functional.log_softmax(scores, -1).gather(
        -1, torch.stack([low, high], -1).long()
    )
    return -((1 - share) * picked[..., 0] + share * picked[..., 1])


def window_products(products: Tensor, depth: int, side: int) -> Tensor:
    """(N, H, W, depth): the means over windows of the products (N, H, W, W) of each pixel u with u - d, d < depth.

    Candidates outside the image have a product of -1000.
    """
    columns = torch.arange(products.shape[3])
    partner = columns[:, None] - torch.arange(depth)
    volume = products.gather(
        3, partner.clamp(min=0).expand(*products.shape[:3], depth)
    ).permute(0, 3, 1, 2)
    return box_mean(volume, side).permute(0, 2, 3, 1).masked_fill(partner < 0, -1000)


def train(
    draws: Sequence[dict[str, Tensor]],
    settings: Training,
    seed: int,
    checkpoint: Path | None = None,
) -> Descriptor:
    """Train on pairs, of which each draw has the same ones with other cameras (data.training_draws).

    Resumes a checkpoint.
    """
    torch.manual_seed(seed)
    random = torch.Generator().manual_seed(seed)
    net = Descriptor(settings.channels).to(
        memory_format=torch.channels_last
    )  # faster on processors
    optimiser = torch.optim.AdamW(net.parameters(), settings.rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, settings.rate, total_steps=settings.steps, cycle_momentum=False
    )
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
        pairs, size = draws[step % len(draws)], (settings.rows, settings.columns)
        crops = random_crops(
            pairs, settings.crops, size, settings.scale, settings.shapes, random
        )
        left, right = net(torch.cat([crops.left, crops.right])).chunk(2)
        loss = loss_of(left, right, crops.disparity, settings)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), LARGEST_GRADIENT)
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
                torch.save(
                    {**state, "step": step, "random": random.get_state()},
                    checkpoint.with_suffix(".new"),
                )
                checkpoint.with_suffix(".new").replace(checkpoint)
    return net.eval()


def export(net: Descriptor, file: Path) -> None:
    """Write the network as ONNX with free height and width. An interruption leaves no partial file."""
    part = file.with_suffix(".part")
    axes = {2: "height", 3: "width"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about itself
        torch.onnx.export(
            net, (torch.rand(1, 1, 48, 64),), str(part), input_names=["image"], output_names=["descriptors"],
            dynamic_axes={"image": axes, "descriptors": axes}, opset_version=17, dynamo=False,
        )  # fmt: skip
    part.replace(file)
