"""Parameters of typical sensors, with their sources.

ideal
    EMVA 1288's ideal sensor: every photon is counted, without any noise but shot noise; ``shot_noise=False`` removes
    that too. Its full well and converter are chosen large, and it is without the vignetting of lenses.
machine_vision
    A global-shutter CMOS of 3.45 um pixels, Sony IMX250. Matrix Vision's manual of the mvBlueFOX3-2051 gives, after
    EMVA 1288 and for the monochrome camera, a maximal SNR of 40.3 dB, that is a full well of 10^4.03 = 10700 electrons,
    and a dynamic range of 71.2 dB, that is a threshold of 2.95 electrons = sqrt(s^2 + sq^2 + 1/4) + 1/2. With
    sq = 0.76 electrons of the 12-bit converter, the read noise is s = 2.3 electrons. Quantum efficiencies, dark current
    (at room temperature), PRNU and DSNU are typical of the class. Three values per pixel; the colour camera has
    ``filters="RGGB"``, the monochrome one ``filters="mono"``.
phone
    A back-illuminated CMOS of 1.4 um pixels, Sony IMX363 as in a Google Pixel 4a: full well 6000 electrons, read noise
    5 electrons, PRNU 0.7%, no measurable dark current or DSNU, 10 bits with black at 64, from Lyu, Goossens, Wandell
    and Farrell, Accurate smartphone camera simulation using 3D scenes, 2022 (arXiv:2201.07411), the ISETCam model
    `sensorIMX363`. Quantum efficiencies are typical of the class.

Near infrared cameras have a quantum efficiency of 0.15 at 850 nm with every preset but `ideal`, that of the monochrome
onsemi KAC-12040 (data sheet: 53 % at 500 nm, 15 % at 850 nm, 10 % at 900 nm).

Full well, read noise and dark current depend on the pixel size: give the camera `pixel_pitch_um` 3.45 or 1.4.
"""

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "ideal": {
        "quantum_efficiency": (1.0, 1.0, 1.0),
        "nir_efficiency": 1.0,
        "full_well": 100_000.0,
        "read_noise": 0.0,
        "dark_current": 0.0,
        "prnu": 0.0,
        "dsnu": 0.0,
        "adc_bits": 16,
        "black_level": 0.0,
        "vignetting": False,
    },
    "machine_vision": {},  # the defaults of `Sensor`
    "phone": {
        "quantum_efficiency": (0.55, 0.70, 0.65),
        "full_well": 6000.0,
        "read_noise": 5.0,
        "dark_current": 0.0,
        "prnu": 0.007,
        "dsnu": 0.0,
        "adc_bits": 10,
        "black_level": 64.0,
        "filters": "RGGB",
    },
}
