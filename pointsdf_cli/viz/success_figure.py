"""Figure 3: F1 of the success networks beside the published ones, with their calibration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

from pointsdf_cli.io.atomic import atomic_path

OURS, THEIRS, PLAIN = "#2a6f97", "#c9ccd1", "#9aa5b1"


def draw_success_figure(
    path: Path | str, table: Mapping[str, Mapping[str, Any]], published: Mapping[str, float]
) -> None:
    """Bars of F1 with the paper's beside, average precision, and reliability.

    Args:
        path: The picture, .png, .pdf or .svg.
        table: Table of `gs_evaluation.measure`, by method.
        published: The paper's F1 by method.
    """
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    bars, ranks, curve = figure.subplots(1, 3, width_ratios=(1.25, 1.0, 0.9))
    names = list(table)
    place = np.arange(len(names))
    for axes, key, title in (
        (bars, "f1", "F1 at threshold 0.5"),
        (ranks, "average_precision", "average precision"),
    ):
        values = np.array([table[name][key]["value"] for name in names])
        low, high = (np.array([table[n][key][end] for n in names]) for end in ("low", "high"))
        spread = np.fmax(0.0, [values - low, high - values])
        wide = 0.4 if axes is bars else 0.7
        colours = [OURS if "reliability" in table[name] else PLAIN for name in names]
        shift = -wide / 2 if axes is bars else 0.0
        axes.bar(place + shift, values, wide, yerr=spread, color=colours, capsize=2)
        for x, value in zip(place + shift, values, strict=True):
            axes.text(x, 0.01, f"{value:.2f}", ha="center", color="white", fontsize=7)
        axes.set_xticks(place, names, rotation=35, ha="right", fontsize=8)
        _plain(axes.get_xticklabels())
        axes.set(title=title, ylim=(0, 1))
        axes.grid(axis="y", alpha=0.3)
    theirs = [(k, published[name]) for k, name in enumerate(names) if name in published]
    if theirs:
        at, heights = zip(*theirs, strict=True)
        bars.bar(np.array(at) + 0.2, heights, 0.4, color=THEIRS, label="paper (its own grasps)")
        for x, value in theirs:
            bars.text(x + 0.2, 0.01, f"{value:.2f}", ha="center", fontsize=7)
        bars.legend(frameon=False, fontsize=8)
    curve.plot([0, 1], [0, 1], color="k", lw=0.8, ls=":")
    for name in names:
        if "reliability" in table[name]:
            found = np.array(table[name]["reliability"])
            error = table[name]["calibration_error"]["value"]
            curve.plot(found[:, 0], found[:, 1], "o-", ms=3, lw=1, label=f"{name} ({error:.3f})")
    curve.set(
        title="reliability (calibration error)",
        xlabel="predicted probability",
        ylabel="share that held",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    curve.grid(alpha=0.3)
    _plain(curve.legend(frameon=False, fontsize=7).get_texts())
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130, metadata={"Software": "rgrasp"})


def _plain(texts: Iterable[Text]) -> None:
    """Show names as they are: a checkpoint's name is no formula."""
    for text in texts:
        text.set_parse_math(False)
