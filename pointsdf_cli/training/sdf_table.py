"""Table I: scores of many reconstructions by method (docs/method.md, "Table I")."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.metrics import Score

METRICS = {"iou": (1.0, 3), "chamfer": (1e3, 2), "normals": (1.0, 3)}
"""Factor and digits of each metric in the table."""
BOOTSTRAPS = 10_000

#: Mean and, where printed, standard deviation in the paper's Table I; Chamfer-L1 in metres.
PUBLISHED: dict[str, dict[str, dict[str, tuple[float, float | None]]]] = {
    "graspdb": {
        "PointSDF (paper)": {
            "iou": (0.71933, 0.18807), "chamfer": (0.00150, 0.00432), "normals": (0.83611, 0.06540),
        },
        "VoxelCNN (paper)": {
            "iou": (0.53172, None), "chamfer": (0.00296, None), "normals": (0.83625, None),
        },
    },
    "ycb": {
        "PointSDF (paper)": {
            "iou": (0.56975, 0.28807), "chamfer": (0.00256, 0.00237), "normals": (0.77919, 0.10078),
        },
        "VoxelCNN (paper)": {
            "iou": (0.44039, None), "chamfer": (0.00458, None), "normals": (0.78665, None),
        },
    },
}  # fmt: skip


@dataclass(frozen=True)
class ScoredView:
    """The score of one method on one view of one object."""

    method: str
    object_name: str
    view: int
    score: Score


class Statistic(NamedTuple):
    """One metric of one method.

    Attributes:
        mean, deviation, median: Statistics over views.
        low, high: 95% bootstrap interval of the mean, over objects; NaN for one object.
    """

    mean: float
    deviation: float
    median: float
    low: float
    high: float


def summarise(scored: Sequence[ScoredView], seed: int = 0) -> dict[str, Any]:
    """Each method's statistics: {method: {metric: {...}, views, objects, failures}}.

    Intervals resample whole objects, because views of one object are not independent.
    """
    table = {}
    for method in dict.fromkeys(view.method for view in scored):
        rows = [view for view in scored if view.method == method]
        names = sorted({row.object_name for row in rows})
        index = np.array([names.index(row.object_name) for row in rows])
        summary: dict[str, Any] = {}
        for metric in METRICS:
            values = np.array([getattr(row.score, metric) for row in rows])
            summary[metric] = statistic(values, index, seed)._asdict()
        failures = sum(row.score.failed for row in rows)
        table[method] = summary | {"views": len(rows), "objects": len(names), "failures": failures}
    return table


def statistic(values: NDArray[np.float64], groups: NDArray[np.integer], seed: int) -> Statistic:
    """Statistics of values [N] that belong to objects numbered 0 to G−1 by `groups` [N]."""
    count = int(groups.max()) + 1
    sums, sizes = np.bincount(groups, values, count), np.bincount(groups, minlength=count)
    drawn = np.random.default_rng(seed).integers(count, size=(BOOTSTRAPS, count))
    means = sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5]) if count > 1 else (np.nan, np.nan)
    deviation = values.std(ddof=1) if len(values) > 1 else 0.0
    return Statistic(*map(float, (values.mean(), deviation, np.median(values), low, high)))


def table_lines(table: dict[str, Any], beside: str | None = None) -> list[str]:
    """The table as aligned text, with the published rows of the data set `beside`."""
    head = ("method", "IoU", "median", "95%", "Chamfer-L1 [mm]", "95%", "normals", "95%", "failed")
    rows: list[Sequence[str]] = [head]
    for method, entry in table.items():
        cells = [method]
        for metric, (scale, digits) in METRICS.items():
            found = entry[metric]
            cells.append(_with_deviation((found["mean"], found["deviation"]), scale, digits))
            if metric == "iou":
                cells.append(f"{found['median']:.{digits}f}")
            cells.append(interval(scale * found["low"], scale * found["high"], digits))
        rows.append((*cells, f"{entry['failures']} of {entry['views']}"))
    for method, published in PUBLISHED.get(beside or "", {}).items():
        iou, chamfer, normals = (_with_deviation(published[m], *METRICS[m]) for m in METRICS)
        rows.append((method, iou, "", "", chamfer, "", normals, "", ""))
    return aligned(rows)


def interval(low: float, high: float, digits: int) -> str:
    """An interval as "0.71–0.85"; a dash if it is NaN."""
    return "–" if np.isnan(low) else f"{low:.{digits}f}–{high:.{digits}f}"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table's rows, its columns below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def objects_csv(scored: Sequence[ScoredView]) -> str:
    """One line for each method and object: means and deviations over its views."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["method", "object", "views", "failures"]
        + [f"{metric}_{kind}" for metric in METRICS for kind in ("mean", "deviation")]
    )
    for method, name in dict.fromkeys((view.method, view.object_name) for view in scored):
        rows = [v.score for v in scored if (v.method, v.object_name) == (method, name)]
        cells: list[Any] = [method, name, len(rows), sum(score.failed for score in rows)]
        for metric in METRICS:
            values = np.array([getattr(score, metric) for score in rows])
            cells += [f"{values.mean():.6f}", f"{values.std(ddof=1 if len(rows) > 1 else 0):.6f}"]
        writer.writerow(cells)
    return text.getvalue()


def _with_deviation(published: tuple[float, float | None], scale: float, digits: int) -> str:
    mean, deviation = published
    text = f"{scale * mean:.{digits}f}"
    return text if deviation is None else f"{text} ({scale * deviation:.{digits}f})"
