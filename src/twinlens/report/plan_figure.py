"""The figure of a planned rig: depth error, blur and disparity against depth, with their limits."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from twinlens.errors import InputError
from twinlens.optics.planning import RigPlan
from twinlens.optics.rig_task import RigChoice
from twinlens.report.plots import PALETTE, RC_PARAMS, encode

_MARGIN = 1.6  # depths outside the task's range, as a factor
_GREY = "#444444"


def plan_figure(plan: RigPlan, kind: str = "png") -> bytes:
    """The figure of the best choice as PNG or SVG. Raises InputError if the task is infeasible."""
    if plan.best is None:
        raise InputError("an infeasible plan has no figure")
    best = plan.best
    near, far = plan.task.depth_range
    depth = np.geomspace(near / _MARGIN, far * _MARGIN, 400)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Sheet(figsize=(6.4, 7.6), layout="constrained")
        panels = sheet.subplots(3, sharex=True)
        for draw, axes in zip(
            (_draw_error, _draw_blur, _draw_disparity), panels, strict=True
        ):
            axes.axvspan(near, far, color="#F0F0F0", linewidth=0)
            axes.axvline(best.focus_distance, color=_GREY, linestyle=":", linewidth=1.2)
            draw(axes, best, depth)
            axes.grid(True, color="#DDDDDD", linewidth=0.6)
            axes.set_axisbelow(True)
            axes.legend(frameon=False, loc="upper left", fontsize=8)
        bottom = panels[-1]
        bottom.set_xscale("log")
        label = "depth (m); grey: the depths to measure, dotted: the focus"
        bottom.set(xlim=(depth[0], depth[-1]), xlabel=label)
        bottom.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        bottom.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bottom.xaxis.set_minor_formatter(NullFormatter())
        title = (
            f"Baseline {1e3 * best.baseline:.4g} mm, {1e3 * best.focal_length:.4g} mm "
            f"f/{best.f_number:.3g}, focus {best.focus_distance:.3g} m"
        )
        sheet.suptitle(title, fontsize=11.5, fontweight="bold", x=0.012, ha="left")
        return encode(sheet, kind)


def _draw_error(axes: Any, best: RigChoice, depth: Any) -> None:
    label = f"for a disparity error of {best.task.disparity_error_px:g} px"
    axes.plot(depth, 1e3 * best.depth_error(depth), color=PALETTE[0], label=label)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set(ylabel="depth error (mm)")
    if best.task.depth_error is not None:
        _draw_limit(axes, 1e3 * best.task.depth_error, "tolerated", PALETTE[1])


def _draw_blur(axes: Any, best: RigChoice, depth: Any) -> None:
    axes.plot(depth, best.blur_px(depth), color=PALETTE[0], label="blur circle")
    axes.axhline(best.airy_px, color=PALETTE[2], label="Airy disk")
    _draw_limit(axes, best.task.blur_px, "largest blur circle", PALETTE[0])
    _draw_limit(axes, best.task.airy_px, "largest Airy disk", PALETTE[2])
    axes.set(
        ylabel="diameter (px)",
        ylim=(0, 1.5 * max(best.task.airy_px, best.task.blur_px)),
    )


def _draw_disparity(axes: Any, best: RigChoice, depth: Any) -> None:
    axes.plot(depth, best.disparity(depth), color=PALETTE[0], label="disparity")
    limits = best.largest_disparity
    _draw_limit(axes, limits["disparities"], "end of the search", PALETTE[1])
    _draw_limit(axes, limits["overlap"], "least overlap", PALETTE[2])
    axes.set(ylabel="disparity (px)", ylim=(0, 1.3 * max(limits.values())))


def _draw_limit(axes: Any, value: float, text: str, colour: str) -> None:
    axes.axhline(value, color=colour, linestyle="--", linewidth=1.2)
    axes.annotate(
        text, (0.995, value), xycoords=axes.get_yaxis_transform(), xytext=(0, 2), textcoords="offset points",
        ha="right", va="bottom", fontsize=8, color=colour,
    )  # fmt: skip
