"""Write the light of docs/own_objects.md: a panorama of a workshop with tube lights and a window, as .exr.

Run: ``python make_light.py workshop.exr``. A photographed panorama takes its place.
"""

import sys

import numpy as np
import OpenEXR

LOW, HIGH = (
    np.array([-5.0, -4.0, -0.8]),
    np.array([5.0, 4.0, 2.7]),
)  # the room around the camera, metres, z up


def panorama(height: int = 256) -> np.ndarray:
    """Radiance, float32 (height, 2 height, 3). The top row looks up, the middle column along -y, the next to -x."""
    rows, columns = np.mgrid[0:height, 0 : 2 * height] + 0.5
    polar, turn = np.pi * rows / height, np.pi * columns / height - np.pi
    ray = np.stack(
        [-np.sin(turn) * np.sin(polar), -np.cos(turn) * np.sin(polar), np.cos(polar)],
        axis=-1,
    )
    with np.errstate(divide="ignore"):
        distances = np.where(ray > 0, HIGH, LOW) / ray
    x, y, z = np.moveaxis(ray * distances.min(axis=-1, keepdims=True), -1, 0)
    wall = distances.argmin(axis=-1)
    light = np.where(
        (wall == 2)[..., None], [0.08, 0.075, 0.07], [0.20, 0.19, 0.18]
    )  # floor, walls
    light[(wall == 2) & (z > 0)] = 0.25  # ceiling
    light[(wall < 2) & (z < 0.3)] = [0.10, 0.13, 0.16]  # cupboards
    tubes = (
        (wall == 2)
        & (z > 0)
        & (np.abs(np.abs(y) - 1.5) < 0.12)
        & (np.abs(x) % 2.4 > 0.4)
    )
    light[tubes] = [30.0, 29.0, 26.0]
    window = (
        (wall == 0)
        & (x > 0)
        & (np.abs(y) < 2.2)
        & (z > 0.2)
        & (z < 2.0)
        & (np.abs(y) % 1.1 > 0.06)
    )
    light[window] = [5.0, 6.0, 7.5]
    return light.astype(np.float32)


def main(path: str) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": panorama()}) as file:
        file.write(path)


if __name__ == "__main__":
    main(*sys.argv[1:2] or ["workshop.exr"])
