"""How far the second camera of a real pair differs from the first: one spread per field of `Mismatch` and level.

Spreads are standard deviations of the difference of two cameras, sqrt(2) times that of one camera where a source gives
tolerances of one. Levels: `calibrated`, a pair whose gains, white balance and flat fields were equalised, with a fresh
calibration; `typical`, two cameras and lenses of one model with the same settings; `consumer`, inexpensive modules.

Where no source is named, the value is assumed. The assumed ones were chosen for the left-right differences of 24 real
pairs (docs/realism.md): gain of grey levels off by 0.013 (0.002 to 0.028), offset -3.4 to 4.2 grey levels, slow
differences of 2.4 (1.4 to 5.4) grey levels. No ranking of methods was used.

gain, time
    Assumed. Cameras are matched to a master camera in the factory (Basler L100k and A202k manuals, section 3.5); time
    differs where each camera exposes automatically.
black_level
    Assumed, from the offset of real pairs.
f_number
    M12 lens 3.9 mm f/1.0 (ElectroDragon data sheet): +-10%, here three standard deviations of one lens, `consumer`;
    half of it `typical`.
shading_right, shading_down
    A lens of relative illumination 0.43 at the corner (same data sheet) whose axis is 0.1 mm (`typical`) or 0.2 mm
    (`consumer`) off the centre of a 1/2.8" sensor: a slope of 2 * 0.57 * 0.1 / 2.8 = 0.04. The shift is assumed.
shading_corner
    The same lens: relative illumination falls from 0.455 to 0.406 as the field grows by 7%; focal lengths within +-5%
    (three standard deviations) then change the corner by 4%.
veiling_glare
    15 to 276 double reflections at 0.5% per surface give 0.04 to 0.7% (Imatest, Veiling glare); about half of it
    differs between two lenses (assumed).
stray_light
    Assumed, of the order of the veiling glare.
blur_px
    Assumed; 0.3 px lowers the contrast at 0.25 cycles per pixel by 10%, about the spread between copies of a lens
    (Cicala, Measuring lens variance, LensRentals 2015).
filter_shift, white_balance_red, white_balance_blue
    Sony IMX219 data sheet, table 46: R/G 0.51 +- 0.06, B/G 0.46 +- 0.06, three standard deviations of one sensor:
    `consumer`, without white balance of each camera. The other levels and the shift of the bands are assumed.
tone_exponent
    Assumed; 0.005 changes middle grey by 0.5 grey levels.
pitch_px, yaw_px, roll_px, scale_px, distortion_px
    Calibration errors of 0.25 px are realistic (Hirschmueller and Gehrig, CVPR 2009); above 1 px a calibration should
    be repeated (NI Vision, Maximum rectification error). `typical` is about 0.2 px, `consumer` 0.4 px rms between rows.
"""

LEVELS = ("none", "calibrated", "typical", "consumer")

SPREADS: dict[str, tuple[float, float, float]] = {
    "gain": (0.005, 0.01, 0.05),
    "time": (0.0, 0.0, 0.1),
    "black_level": (0.25, 1.0, 3.0),
    "f_number": (0.002, 0.024, 0.047),
    "shading_right": (0.01, 0.04, 0.08),
    "shading_down": (0.01, 0.04, 0.08),
    "shading_corner": (0.01, 0.04, 0.08),
    "veiling_glare": (0.001, 0.003, 0.01),
    "stray_light": (0.001, 0.005, 0.02),
    "blur_px": (0.1, 0.3, 0.6),
    "filter_shift": (0.005, 0.02, 0.05),
    "white_balance_red": (0.005, 0.02, 0.055),
    "white_balance_blue": (0.005, 0.02, 0.06),
    "tone_exponent": (0.002, 0.005, 0.02),
    "pitch_px": (0.05, 0.15, 0.4),
    "yaw_px": (0.02, 0.05, 0.15),
    "roll_px": (0.03, 0.1, 0.25),
    "scale_px": (0.03, 0.1, 0.25),
    "distortion_px": (0.03, 0.1, 0.25),
}
"""Standard deviations at `calibrated`, `typical` and `consumer`."""
