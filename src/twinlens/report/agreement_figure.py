"""The figure of two boards' agreement: each method's mean rank on both."""

import matplotlib
from matplotlib.figure import Figure

from twinlens.report.plots import PALETTE, RC_PARAMS, encode
from twinlens.scoring.agreement import Agreement

_ROW_INCHES, _MARGIN_INCHES, _WIDTH_INCHES = 0.22, 1.6, 6.4


def agreement_figure(agreement: Agreement, names: tuple[str, str], kind: str = "png") -> bytes:
    """One line per method, from its mean rank on the first board to that on the second, as PNG or SVG; rank 1 on top.

    names: what to call the boards. The methods that move most are coloured.
    """
    methods = len(agreement.moves)
    with matplotlib.rc_context(RC_PARAMS):
        sheet = Figure(figsize=(_WIDTH_INCHES, _ROW_INCHES * methods + _MARGIN_INCHES), layout="constrained")
        axes = sheet.subplots()
        largest = [m.method for m in agreement.moves[: min(3, methods)]]
        for move in agreement.moves:
            marked = move.method in largest
            colour = PALETTE[largest.index(move.method)] if marked else "#9AA5B1"
            axes.plot((0, 1), (move.rank_a, move.rank_b), "o-", color=colour, markersize=3, zorder=2 + marked)
        for side, align in ((0, "right"), (1, "left")):
            ranked = sorted((m.rank_b if side else m.rank_a, m.method) for m in agreement.moves)
            # Labels in equal steps, so that methods of nearly the same rank stay legible.
            for place, (rank, method) in enumerate(ranked, start=1):
                axes.annotate(
                    f"{rank:.1f}  {method}" if side else f"{method}  {rank:.1f}", (side, rank),
                    (1.16 if side else -0.16, place), ha=align, va="center", fontsize=8,
                    arrowprops={"arrowstyle": "-", "color": "#C9D1D9", "linewidth": 0.6},
                )  # fmt: skip
        axes.set_xlim(-1.1, 2.1)
        axes.set_ylim(methods + 0.7, 0.3)
        axes.set_xticks((0, 1), labels=names)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.set_yticks([])
        axes.spines[:].set_visible(False)
        axes.set_title(
            f"mean rank by {agreement.metric}, {agreement.region}; Kendall's tau-b {agreement.tau}", fontsize=9, pad=12
        )
        return encode(sheet, kind)
