"""The photographs of the study `aperture`: models of scenes, the lenses before them, their exposures.

What is photographed was chosen from theory's curves alone, so that its optimum lies within the sweep:

- Shot noise in place of all noise, the predicted error of a pixel that f/1 blurs by c goes as s^2 N + (c/4)^2 / N,
  least at N = c / (4 s). A texture of grain s = 1 to 1.4 px wants c near 10 px for an optimum about f/2. So each scene
  is a model of the size at which f/1 blurs all but the twentieth part of it that is farthest from the focus by no more
  than 24 px, half of it by 10 px or so.
- Pixels are as large as the sensor's whose noise is taken, 3.45 um: f/32's Airy disk is 12 px wide. Blur and
  diffraction are equal where N^2 = c p / (1.8 lambda), about f/6.
- The fixed exposure is f/1's automatic one. Any longer one would burn the wide lenses out, and what is burnt has its
  optimum where the exposure was set. Ten stops less light leave f/32 a few electrons.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.camera.diffraction import diffract
from twinlens.sensor import Exposure, Sensor, auto_exposure
from twinlens.studies.aperture_theory import SENSOR, WAVELENGTH
from twinlens.studies.stage import Stage

Radiance = list[NDArray[np.float32]]

F_NUMBERS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
PIXEL_PITCH_UM = 3.45
BLUR_PX = 24.0
"""What f/1 blurs the scene by at most, but for the twentieth part of its pixels."""
BLURRED_LESS = 0.95
EXPOSED_AT = 1.0
"""The fixed exposure is the automatic one of this f-number."""
GRAIN_AT = 5.6
"""The f-number whose picture is sharp enough to measure the texture's grain on."""
MODES = ("fixed exposure", "equal brightness")
LINEAR = Sensor.preset("machine_vision", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3)


@dataclass(frozen=True)
class Model:
    """A scene as a model that many times smaller, and the lenses before it.

    The renderer photographs the scene at its full size, through lenses as many times larger: the same picture, as rays
    have no size of their own. The sensor and diffraction, which have, look through the model's own lens.
    """

    stage: Stage
    scale: float

    @staticmethod
    def of(stage: Stage) -> "Model":
        """Of the size at which f/1 blurs the scene by BLUR_PX."""
        from_focus = np.abs(1.0 / stage.truth.depth[np.isfinite(stage.truth.depth)] - 1.0 / stage.middle_focus)
        spread = float(np.quantile(from_focus, BLURRED_LESS))
        return Model(stage, stage.camera.film_distance * stage.camera.fx * spread / BLUR_PX)

    def lens(self, f_number: float) -> ThinLens:
        """Of working f-number v/A, focused at the middle of the scene's disparities."""
        return ThinLens(self.stage.camera.film_distance / f_number, self.scale * self.stage.middle_focus)

    def full_size(self, lens: ThinLens) -> ThinLens:
        """What sees the scene as `lens` sees its model."""
        return ThinLens(lens.aperture_diameter / self.scale, lens.focus_distance / self.scale)


@dataclass(frozen=True, eq=False)
class Shot:
    """What one lens of a seed's grid leaves on the film, and how that is exposed."""

    f_number: float
    lens: ThinLens
    radiance: Radiance
    exposure: Exposure
    mode: str
    diffraction: str


def shots(model: Model, images: Sequence[Radiance]) -> Iterator[Shot]:
    """Every lens with and without diffraction, under both exposures."""
    at = F_NUMBERS.index(EXPOSED_AT)
    fixed = automatic(model.stage, model.lens(EXPOSED_AT), images[at])
    for number, sharp in zip(F_NUMBERS, images, strict=True):
        lens = model.lens(number)
        for diffraction, radiance in (("without", sharp), ("with", diffracted(model.stage, lens, sharp))):
            equal = automatic(model.stage, lens, radiance)
            for mode, exposure in zip(MODES, (fixed, equal), strict=True):
                yield Shot(number, lens, radiance, exposure, mode, diffraction)


def level(stage: Stage, shot: Shot) -> float:
    """Mean level of the left picture before its tone curve, white 1, noise and all."""
    photo = LINEAR.expose(shot.radiance[0], camera=stage.camera, lens=shot.lens, seed=0, exposure=shot.exposure)
    return float(photo.image.mean()) / 65535.0


def automatic(stage: Stage, lens: ThinLens, radiance: Radiance) -> Exposure:
    return auto_exposure(radiance, sensor=SENSOR, cameras=stage.rig.cameras, lens=lens)


def diffracted(stage: Stage, lens: ThinLens, radiance: Radiance) -> Radiance:
    return [diffract(image, stage.camera, lens, (WAVELENGTH,) * 3) for image in radiance]
