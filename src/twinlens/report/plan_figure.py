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
    near, far = plan.task.depth_range
    depth = np.geomspace(near / _MARGIN, far * _MARGIN, 400)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Sheet(figsize=(6.4, 7.6), layout="constrained")
        axes = sheet.subplots(3, sharex=True)
        for draw, each in zip(
            (_draw_error, _draw_blur, _draw_disparity), axes, strict=True
        ):
            each.axvspan(near, far, color="#F0F0F0", linewidth=0)
            each.axvline(
                plan.best.focus_distance, color=_GREY, linestyle=":", linewidth=1.2
            )
            draw(each, plan.best, depth)
            each.grid(True, color="#DDDDDD", linewidth=0.6)
            each.set_axisbelow(True)
            each.legend(frameon=False, loc="upper left", fontsize=8)
        axes[-1].set_xscale("log")
        axes[-1].set(
            xlim=(depth[0], depth[-1]),
            xlabel="depth (m); grey: the depths to measure, dotted: the focus",
        )
        axes[-1].xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes[-1].xaxis.set_minor_formatter(NullFormatter())
        best = plan.best
        title = f"Baseline {1e3 * best.baseline:.4g} mm, {1e3 * best.focal_length:.4g} mm f/{best.f_number:.3g}"
        sheet.suptitle(
            f"{title}, focus {best.focus_distance:.3g} m",
            fontsize=11.5,
            fontweight="bold",
            x=0.012,
            ha="left",
        )
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
