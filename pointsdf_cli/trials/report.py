"""Report on an experiment: one self-contained HTML page, and its tables as Markdown."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from pointsdf_cli.io.trials import TrialRow
from pointsdf_cli.trials.protocol import (
    METHODS,
    NO_SUCCESS,
    PARTIAL_VIEW,
    PUBLISHED,
    PUBLISHED_NO_PLAN,
    PUBLISHED_SECONDS,
    RECONSTRUCTION,
)
from pointsdf_cli.trials.statistics import Share, wilson
from pointsdf_cli.trials.summary import Summary, compare, summarise, variant_of
from pointsdf_cli.viz import html

COLOURS = {RECONSTRUCTION: "#2e7d4f", PARTIAL_VIEW: "#c0622d"}
Table = tuple[str, Sequence[str], Sequence[Sequence[object]]]
"""Title, header, rows."""


def trial_tables(rows: Sequence[TrialRow]) -> list[Table]:
    """All tables of the report."""
    summaries = summarise(rows)
    tables = [_success(summaries), _verdicts(summaries), _tests(rows, summaries)]
    tables += [_plans(summaries), _predictions(rows, summaries), _contacts(summaries)]
    if any(summary.ablation for summary in summaries):
        tables.append(_ablations(rows, summaries))
    if any(row.clutter for row in rows):
        tables.append(_clutter(rows, summaries))
    return [*tables, _objects(summaries), _causes(summaries)]


def html_report(
    rows: Sequence[TrialRow],
    pictures: Sequence[tuple[str, bytes]],
    title: str,
    refused: Mapping[str, str] | None = None,
) -> str:
    """The HTML page.

    Args:
        rows: All trials.
        pictures: Caption and PNG of each trial to show.
        title: Title of the page.
        refused: Trials that could not be run, with the reason.
    """
    summaries = [summary for summary in summarise(rows) if not summary.ablation]
    parts = []
    if summaries:
        parts.append(html.picture(success_figure(summaries), "success by camera and object"))
    for name, header, body in trial_tables(rows):
        parts += [html.heading(name), html.table(header, body)]
    if refused:
        parts += [html.heading("Skipped"), html.table(("trials", "reason"), refused.items())]
    if pictures:
        parts += [html.heading("What failed"), html.note(PICTURE_NOTE)]
        for text, image in pictures:
            parts += [html.note(text), html.png(image, text)]
    return html.page(title, parts)


def markdown_report(
    rows: Sequence[TrialRow], title: str, refused: Mapping[str, str] | None = None
) -> str:
    """The tables as Markdown; arguments as for `html_report`."""
    lines = [f"# {title}", ""]
    tables = trial_tables(rows)
    if refused:
        tables.append(("Skipped", ("trials", "reason"), list(refused.items())))
    for name, header, body in tables:
        lines += [f"## {name}", "", "| " + " | ".join(map(_plain, header)) + " |"]
        lines.append("|" + "---|" * len(header))
        lines += ["| " + " | ".join(_plain(cell) for cell in row) + " |" for row in body]
        lines.append("")
    return "\n".join(lines)


PICTURE_NOTE = (
    "From left to right: the points seen (blue) on the true object, as the camera stands; the "
    "surface that the planner believed in (orange) over the true object (green), from the side; "
    "the planned grasp; the hand closed; the end."
)


def success_figure(summaries: Sequence[Summary]) -> Figure:
    """Bar charts by camera, beside the published rates, and by object, with Wilson intervals."""
    objects = list(dict.fromkeys(item for s in summaries for item in s.by_object))[:24]
    figure = Figure(figsize=(13, 3.8))
    left, right = figure.subplots(1, 2, width_ratios=(1, max(1.2, 0.18 * len(objects))))
    cameras = [*dict.fromkeys(c for s in summaries for c in s.by_camera), "all"]
    none = wilson(0, 0)  # not tried: no bar
    width = 0.8 / (2 * len(summaries))
    for i, summary in enumerate(summaries):
        colour = COLOURS[summary.method]
        shares = [(summary.by_camera | {"all": summary.succeeded}).get(c, none) for c in cameras]
        _bars(left, np.arange(len(cameras)) + 2 * i * width, shares, width, colour, summary.name)
        published = [_published(summary.method, cameras).get(c, np.nan) for c in cameras]
        at = np.arange(len(cameras)) + (2 * i + 1) * width
        left.bar(at, published, width, color=colour, alpha=0.35, label=f"{summary.name}, published")
        wide = 0.8 / len(summaries)
        shares = [summary.by_object.get(item, none) for item in objects]
        _bars(right, np.arange(len(shares)) + i * wide, shares, wide, colour, summary.name)
    left.set_xticks(np.arange(len(cameras)) + 0.4 - width / 2, cameras)
    right.set_xticks(np.arange(len(objects)) + 0.3, objects, rotation=40, ha="right", fontsize=8)
    for label in (*right.get_xticklabels(), *left.get_xticklabels()):
        label.set_parse_math(False)  # a file's name is no formula
    for axes in (left, right):
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
        axes.spines[["top", "right"]].set_visible(False)
    left.set_ylabel("success")
    left.legend(fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return figure


def _bars(axes, at, shares: Sequence[Share], width: float, colour: str, label: str) -> None:  # type: ignore[no-untyped-def]
    values = np.array([share.value for share in shares])
    errors = np.array([[s.value - s.low, s.high - s.value] for s in shares]).T
    axes.bar(at, values, width, color=colour, label=label)
    axes.errorbar(at, values, np.maximum(errors, 0), fmt="none", ecolor="#333", lw=0.8, capsize=2)


def _success(summaries: Sequence[Summary]) -> Table:
    cameras = list(dict.fromkeys(c for s in summaries for c in s.by_camera))
    body: list[Sequence[object]] = []
    for s in summaries:
        shares = (percent(s.by_camera[c]) if c in s.by_camera else "–" for c in cameras)
        body.append((s.name, *shares, percent(s.succeeded)))
    for method in _whole_methods(summaries):
        rates = _published(method, cameras)
        published = [f"{rates[c]:.0%}" if c in rates else "–" for c in (*cameras, "all")]
        body.append((f"{method}, published", *published))
    title = "Success: held, no other object disturbed (95% Wilson interval)"
    return title, ("planner", *cameras, "all"), body


def _verdicts(summaries: Sequence[Summary]) -> Table:
    body = [
        (s.name, *map(percent, (s.lifted, s.held, s.unshaken)), _listed(s.lost_in))
        for s in summaries
    ]
    return "Verdicts", ("planner", "lifted", "held", "unshaken", "lost in"), body


def _published(method: str, cameras: Sequence[str]) -> dict[str, float]:
    """The paper's rates of a method by camera; with both cameras also "all", their mean."""
    both = {"high", "low"} <= set(cameras)
    return {c: rate for c, rate in PUBLISHED[method].items() if both or c != "all"}


def _whole_methods(summaries: Sequence[Summary]) -> list[str]:
    """Methods without an ablation."""
    return [m for m in METHODS if any(s.method == m and not s.ablation for s in summaries)]


def _tests(rows: Sequence[TrialRow], summaries: Sequence[Summary]) -> Table:
    names = [summary.name for summary in summaries if not summary.ablation]
    body: list[Sequence[object]] = []
    for first, second in itertools.combinations(names, 2):
        test, by_object, (objects, differing) = compare(rows, first, second)
        pairs = (test.both, test.only_first, test.only_second, test.neither)
        flips = f"{p_value(by_object)} ({differing} of {objects} differ)"
        body.append((f"{first} against {second}", *pairs, p_value(test.p), flips))
    header = (
        *("pairs of trials", "both succeeded", "only first", "only second", "neither"),
        *("p (McNemar, by trial)", "p (sign flips, by object)"),
    )
    return "Paired test", header, body


def _plans(summaries: Sequence[Summary]) -> Table:
    body = [
        (s.name, percent(s.no_plan), _listed(s.reasons), *map(_seconds, (s.seconds, s.cpu_seconds)))
        for s in summaries
    ]
    for method in _whole_methods(summaries):
        no_plan, seconds = f"{PUBLISHED_NO_PLAN[method]:.0%}", f"{PUBLISHED_SECONDS[method]} s"
        body.append((f"{method}, published", no_plan, "", seconds, ""))
    header = ("planner", "no plan", "reasons", "planning, median", "processor time")
    return "Plans", header, body


PREDICTED = (0.0, 0.3, 0.6, 0.8, 1.0)
"""Limits between ranges of the predicted success probability."""


def _predictions(rows: Sequence[TrialRow], summaries: Sequence[Summary]) -> Table:
    """Shares of plans that were lifted, by the success probability that they predicted."""
    ranges = list(itertools.pairwise(PREDICTED))
    body: list[Sequence[object]] = []
    for s in summaries:
        if s.ablation == NO_SUCCESS:  # its probabilities are all 1
            continue
        planned = [row for row in rows if variant_of(row) == s.name and row.status == "ok"]
        inside = [
            [row.lifted for row in planned if low <= row.success_probability < high + (high == 1)]
            for low, high in ranges
        ]
        body.append((s.name, *(percent(wilson(sum(one), len(one))) for one in inside)))
    header = ("planner", *(f"{low:g} to {high:g}" for low, high in ranges))
    return "Lifted, by predicted success probability", header, body


def _contacts(summaries: Sequence[Summary]) -> Table:
    body: list[Sequence[object]] = []
    for s in summaries:
        deepest, mean = (f"{1000 * depth:.1f} mm" for depth in s.penetration)
        body.append((s.name, percent(s.contact), percent(s.penetrated), mean, deepest))
    header = (
        *("planner", "touched before closing", "planned into the true object"),
        *("mean depth", "deepest"),
    )
    return "Contact with the true object", header, body


def _ablations(rows: Sequence[TrialRow], summaries: Sequence[Summary]) -> Table:
    body: list[Sequence[object]] = []
    for s in summaries:
        whole = next((t for t in summaries if t.method == s.method and not t.ablation), None)
        p = ""
        if whole is not None and s.ablation:
            p = p_value(compare(rows, s.name, whole.name).paired.p)
        depth, shares = f"{1000 * s.penetration[1]:.1f} mm", (s.succeeded, s.no_plan, s.contact)
        body.append((s.name, *map(percent, shares), depth, _seconds(s.cpu_seconds), p))
    header = (
        *("planner", "success", "no plan", "touched before closing"),
        *("mean depth in the truth", "processor time", "p against the whole method"),
    )
    return "When does geometry matter? (ablations)", header, body


def _clutter(rows: Sequence[TrialRow], summaries: Sequence[Summary]) -> Table:
    body: list[Sequence[object]] = []
    for s in summaries:
        mine = [row for row in rows if variant_of(row) == s.name and row.clutter]
        planned = [row for row in mine if row.status == "ok"]
        calm = wilson(sum(not row.disturbed for row in planned), len(planned))
        farthest = max((row.largest_move for row in planned), default=0.0)
        shares = map(percent, (s.held, calm, s.succeeded))
        body.append((s.name, *shares, f"{1000 * farthest:.0f} mm"))
    header = ("planner", "held", "nothing else disturbed", "both", "largest move")
    return "In clutter", header, body


def _objects(summaries: Sequence[Summary]) -> Table:
    body = [
        (item, *(counts(s.by_object[item]) if item in s.by_object else "–" for s in summaries))
        for item in dict.fromkeys(item for s in summaries for item in s.by_object)
    ]
    return "By object", ("object", *(s.name for s in summaries)), body


def _causes(summaries: Sequence[Summary]) -> Table:
    causes = dict.fromkeys(cause for s in summaries for cause in s.causes)
    body = [(cause, *(s.causes.get(cause, 0) for s in summaries)) for cause in causes]
    return "How executed trials ended", ("cause", *(s.name for s in summaries)), body


def percent(share: Share) -> str:
    """A share as "85% [76, 91] of 48"."""
    if not share.trials:
        return "–"
    return f"{share.value:.0%} [{100 * share.low:.0f}, {100 * share.high:.0f}] of {share.trials}"


def counts(share: Share) -> str:
    """A share as "5 of 6"."""
    return f"{share.successes} of {share.trials}"


def _listed(counts: Mapping[str, int]) -> str:
    """Counts as "side 2, top 1"."""
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "–"


def _seconds(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.1f} s"


def p_value(p: float) -> str:
    """Two significant digits, however small: "0.0063", "3.6e-12", "1"."""
    return f"{p:.2g}"


def _plain(cell: object) -> str:
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return " ".join(str(cell).split()).replace("|", "\\|")  # what would end a cell or a row
