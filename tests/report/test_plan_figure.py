"""The figure of a plan shows its curves and limits, and is reproducible."""

from twinlens.optics.planning import plan_rig
from twinlens.optics.rig_task import RigTask
from twinlens.report import plan_figure as module

TASK = RigTask(640, 480, 5.0, (1.0, 4.0), fov_x_deg=60, depth_error=0.03)


def test_curves_and_limits_of_each_panel(monkeypatch):
    sheets = []
    monkeypatch.setattr(
        module, "encode", lambda sheet, kind: sheets.append(sheet) or b""
    )
    module.plan_figure(plan_rig(TASK))
    error, blur, disparity = sheets[0].axes
    assert [axes.get_ylabel() for axes in sheets[0].axes] == [
        "depth error (mm)",
        "diameter (px)",
        "disparity (px)",
    ]
    x, y = error.lines[1].get_data()
    assert (y / x**2).std() < 1e-9  # proportional to the squared depth
    assert {text.get_text() for axes in (error, blur, disparity) for text in axes.texts} == {
        "tolerated", "largest blur circle", "largest Airy disk", "end of the search", "least overlap",
    }  # fmt: skip
    assert error.lines[-1].get_ydata()[0] == 30.0
