"""The images of the study `aperture`: scale models of scenes, lenses and exposures.

The parameters were chosen from the theory alone, so that its optimum is inside the sweep:

- With shot noise only, the predicted error of a pixel with blur c at f/1 is proportional to s^2 N + (c/4)^2 / N, least
  at N = c / (4 s). A texture of grain s = 1 to 1.4 px and an optimum near f/2 require c near 10 px. Each scene is
  therefore scaled so that f/1 blurs 95 % of its pixels by at most 24 px, and about half of them by 10 px.
- The pixel pitch is the sensor's 3.45 um: the Airy disk of f/32 is 12 px wide. Blur and diffraction are equal at
  N^2 = c p / (1.8 lambda), about f/6.
- The fixed exposure is the automatic one of f/1. A longer one would saturate the wide lenses. Ten stops less light
  leave f/32 a few electrons.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.camera.diffraction import diffract
from twinlens.sensor import Exposure, Sensor, auto_exposure
from twinlens.studies.aperture.theory import SENSOR, WAVELENGTH
from twinlens.studies.stage import Stage

Radiance = list[NDArray[np.float32]]

F_NUMBERS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
PIXEL_PITCH_UM = 3.45
BLUR_PX, BLURRED_LESS = 24.0, 0.95
"""The blur at f/1 that this fraction of the pixels does not exceed."""
EXPOSED_AT = 1.0
"""The f-number whose automatic exposure is the fixed exposure."""
GRAIN_AT = 5.6
"""The f-number whose image is sharp enough to measure the texture's grain."""
MODES = ("fixed exposure", "equal brightness")
LINEAR = Sensor.preset("machine_vision", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3)


@dataclass(frozen=True)
class Model:
    """A scale model of a scene and the lenses in front of it.

    The renderer uses the scene at full size with proportionally larger lenses, which gives the same image because rays
    are scale-free. The sensor and diffraction are not, and use the model's own lens.
    """

    stage: Stage
    scale: float

    @staticmethod
    def of(stage: Stage) -> "Model":
        """The model scaled so that f/1 blurs the scene by BLUR_PX."""
        from_focus = np.abs(1.0 / stage.truth.depth[np.isfinite(stage.truth.depth)] - 1.0 / stage.middle_focus)
        spread = float(np.quantile(from_focus, BLURRED_LESS))
        return Model(stage, stage.camera.film_distance * stage.camera.fx * spread / BLUR_PX)

    def lens(self, f_number: float) -> ThinLens:
        """The lens of working f-number v/A, focused at the middle of the disparity range."""
        return ThinLens(self.stage.camera.film_distance / f_number, self.scale * self.stage.middle_focus)

    def full_size(self, lens: ThinLens) -> ThinLens:
        """The lens that gives the same image of the scene at full size."""
        return ThinLens(lens.aperture_diameter / self.scale, lens.focus_distance / self.scale)

    def blur(self, lens: ThinLens) -> NDArray[np.float64]:
        """The signed blur circle of every left pixel, (H, W), pixels."""
        return self.stage.blur(self.full_size(lens))


@dataclass(frozen=True, eq=False)
class Shot:
    """The radiance behind one lens, and its exposure."""

    f_number: float
    lens: ThinLens
    radiance: Radiance
    exposure: Exposure
    mode: str
    diffraction: str


def shots(model: Model, images: Sequence[Radiance]) -> Iterator[Shot]:
    """Every lens with and without diffraction, with both exposures."""
    fixed = automatic(model.stage, model.lens(EXPOSED_AT), images[F_NUMBERS.index(EXPOSED_AT)])
    for number, sharp in zip(F_NUMBERS, images, strict=True):
        lens = model.lens(number)
        for diffraction, radiance in (("without", sharp), ("with", diffracted(model.stage, lens, sharp))):
            equal = automatic(model.stage, lens, radiance)
            for mode, exposure in zip(MODES, (fixed, equal), strict=True):
                yield Shot(number, lens, radiance, exposure, mode, diffraction)


def level(stage: Stage, shot: Shot) -> float:
    """Mean linear level of the left image with noise, white = 1."""
    photo = LINEAR.expose(shot.radiance[0], camera=stage.camera, lens=shot.lens, seed=0, exposure=shot.exposure)
    return float(photo.image.mean()) / 65535.0


def automatic(stage: Stage, lens: ThinLens, radiance: Radiance) -> Exposure:
    return auto_exposure(radiance, sensor=SENSOR, cameras=stage.rig.cameras, lens=lens)


def diffracted(stage: Stage, lens: ThinLens, radiance: Radiance) -> Radiance:
    return [diffract(image, stage.camera, lens, (WAVELENGTH,) * 3) for image in radiance]
