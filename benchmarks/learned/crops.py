"""Random crops of the training pairs: at other scales, with shapes in front, and with the noise of the sensor."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional


class Crops(NamedTuple):
    """left, right (B, 1, h, w), grey levels 0 to 1; disparity (B, h, w), -1 where unknown or occluded."""

    left: Tensor
    right: Tensor
    disparity: Tensor


def random_crops(
    pairs: dict[str, Tensor],
    count: int,
    size: tuple[int, int],
    scale: float,
    shapes: int,
    random: torch.Generator,
) -> Crops:
    """Crops (rows, columns) of random pairs. A pixel of a crop has up to `scale` pixels of the pair along each side.

    Pairs smaller than a crop are enlarged.
    """
    (total, height, width), (rows, columns) = pairs["disparity"].shape, size
    scale = min(scale, (height - 1) / rows, (width - 1) / columns)
    number = torch.randint(total, (count,), generator=random)
    step = uniform(random, (count, 1), min(0, math.log(scale)), math.log(scale)).exp()
    x, y = (
        uniform(random, (count, 1), 0, 1) * (whole - 1 - part * step)
        + (torch.arange(part) + 0.5) * step
        - 0.5
        for whole, part in ((width, columns), (height, rows))
    )
    left, right = (
        averaged(pairs[side][number][:, None].float() / 255, x, y, step)
        for side in ("left", "right")
    )
    disparity = pairs["disparity"][
        number[:, None, None], y.round().long()[:, :, None], x.round().long()[:, None]
    ]
    crops = Crops(
        left, right, torch.where(disparity >= 0, disparity / step[..., None], disparity)
    )
    for _ in range(shapes):
        crops = with_shape(crops, random)
    upside_down = uniform(random, (count, 1, 1), 0, 1) < 0.5
    left, right = (
        noisy(
            torch.where(upside_down[:, None], image.flip(2), image),
            pairs["noise"],
            random,
        )
        for image in crops[:2]
    )
    return Crops(
        left, right, torch.where(upside_down, crops.disparity.flip(1), crops.disparity)
    )


def uniform(
    random: torch.Generator, shape: tuple[int, ...], low: float, high: float
) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=random)


def averaged(images: Tensor, x: Tensor, y: Tensor, step: Tensor) -> Tensor:
    """The means of four points around (x, y), which are `step` pixels apart: x (B, w), y (B, h), step (B, 1)."""
    away = (step - 1) / 2
    return sum(
        looked_up(images, (x + i * away)[:, None], (y + j * away)[:, :, None]) / 4
        for i in (-1, 1)
        for j in (-1, 1)
    )


def looked_up(images: Tensor, x: Tensor, y: Tensor, outside: str = "border") -> Tensor:
    """Bilinear interpolation of images (B, 1, H, W) at pixels x, y, which broadcast to (B, h, w)."""
    height, width = images.shape[2:]
    grid = torch.stack(
        torch.broadcast_tensors((2 * x + 1) / width - 1, (2 * y + 1) / height - 1), 3
    )
    return functional.grid_sample(
        images, grid, padding_mode=outside, align_corners=False
    )


def with_shape(crops: Crops, random: torch.Generator) -> Crops:
    """The crops with a bar, mostly thin, or an ellipse in front, at one disparity, with the texture of another crop."""
    left, right, disparity = crops
    count, rows, columns = disparity.shape
    x, y = (
        torch.arange(columns, dtype=torch.float32),
        torch.arange(rows, dtype=torch.float32)[:, None],
    )

    def number(low: float, high: float) -> Tensor:
        return uniform(random, (count, 1, 1), low, high)

    centre, angle, is_bar = (
        (number(0, columns), number(0, rows)),
        number(0, math.pi),
        number(0, 1) < 0.7,
    )
    length = torch.where(
        is_bar, number(2.3, 4.5), number(1.4, 3.4)
    ).exp()  # half of it, pixels
    breadth = torch.where(is_bar, number(-0.3, 1.4), number(1.4, 3.0)).exp()

    def distance(x: Tensor) -> Tensor:
        """To the edge of the shape, in pixels, negative inside; for the ellipse it is approximate."""
        along = (x - centre[0]) * angle.cos() + (y - centre[1]) * angle.sin()
        across = (y - centre[1]) * angle.cos() - (x - centre[0]) * angle.sin()
        bar = torch.maximum(along.abs() - length, across.abs() - breadth)
        ellipse = ((along / length).square() + (across / breadth).square()).sqrt() - 1
        return torch.where(is_bar, bar, ellipse * torch.minimum(length, breadth))

    edge = distance(x)
    behind = (
        torch.where(edge < 1, disparity, -1).amax((1, 2), keepdim=True).clamp(min=0)
    )
    front = behind + number(1.5, 14)
    texture = left.roll(int(torch.randint(1, max(count, 2), (), generator=random)), 0)
    moved, gain = (number(-30, 30), number(-10, 10)), number(0.5, 1.6)[:, None]

    def pasted(image: Tensor, x: Tensor) -> Tensor:
        cover = (0.5 - distance(x)).clamp(0, 1)[:, None]
        colour = gain * looked_up(
            texture, x + moved[0], y + moved[1], outside="reflection"
        )
        return (cover * colour + (1 - cover) * image).clamp(0, 1)

    hidden = (
        distance(x - disparity + front) < 0.7
    )  # the partner of a pixel of the scene
    scene = torch.where((edge < 0.5) | hidden, -1, disparity)
    return Crops(
        pasted(left, x),
        pasted(right, x + front),
        torch.where(edge < -0.2, front, scene),
    )


def noisy(images: Tensor, noise: Tensor, random: torch.Generator) -> Tensor:
    """Images with normal noise; noise (256,): its standard deviation for each grey level."""
    deviation = noise[(255 * images).round().long()]
    return (images + deviation * torch.randn(images.shape, generator=random)).clamp(
        0, 1
    )
