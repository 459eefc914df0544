"""How far the second camera of a real pair differs from the first: one spread per field of `Mismatch` and level.

Spreads are standard deviations of the difference of two cameras, sqrt(2) times that of one camera where a source gives
tolerances of one. Levels: `calibrated`, a pair whose gains, white balance and flat fields were equalised, with a fresh
calibration; `typical`, two cameras and lenses of one model with the same settings; `consumer`, inexpensive modules.

docs/realism.md gives the source of each value, or the reason for one that is assumed.
"""

LEVELS = ("none", "calibrated", "typical", "consumer")

SPREADS: dict[str, tuple[float, float, float]] = {
    "gain": (0.005, 0.01, 0.05),
    "time": (0.0, 0.0, 0.1),
    "black_level": (0.25, 1.0, 3.0),
    "f_number": (0.002, 0.012, 0.047),
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
