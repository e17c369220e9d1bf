"""Tables of trials: written and read back, summed up, and shown in a page that stands alone."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.container import BarContainer
from trial_rows import ROW

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.trials import (
    Evidence,
    TrialRow,
    read_trial,
    read_trials,
    write_trial,
    write_trials,
)
from pointsdf_cli.trials.report import html_report, markdown_report, p_value, success_figure
from pointsdf_cli.trials.summary import compare, summarise


@pytest.fixture
def rows() -> list[TrialRow]:
    """Two objects, two cameras, two methods, one ablation; who holds is written here."""
    made = []
    for item in ("mustard", "lego"):
        for camera in ("high", "low"):
            row = replace(ROW, object=item, camera=camera)
            made.append(row)
            lost = replace(row, method="partial-view", held=False, cause="dropped", contact=True)
            made.append(lost)
            none = replace(
                row,
                ablation="oracle",
                status="no_plan",
                reason="table_collision",
                cause="no_plan",
                held=item == "mustard",
                penetration=0.0,
            )
            made.append(none)
    return made


def test_rows_come_back_as_they_were(rows: list[TrialRow], tmp_path: Path) -> None:
    write_trials(tmp_path / "trials.h5", rows, seed=3, config={"a": 1})
    assert read_trials(tmp_path / "trials.h5") == rows
    with pytest.raises(InputError, match="no trials"):
        write_trials(tmp_path / "none.h5", [], seed=0, config={})


def test_an_unknown_method_is_refused(rows: list[TrialRow], tmp_path: Path) -> None:
    write_trials(tmp_path / "trials.h5", [replace(rows[0], method="luck")], seed=3, config={})
    with pytest.raises(InputError, match="method is 'luck'"):
        read_trials(tmp_path / "trials.h5")


def test_a_trial_comes_back_with_its_evidence(tmp_path: Path) -> None:
    evidence = Evidence(
        cloud=np.ones((5, 3), np.float32),
        T_world_camera=np.eye(4),
        vertices=np.zeros((0, 3), np.float32),
        faces=np.zeros((0, 3), np.int32),
        phases=("planned", "settle"),
        q=np.zeros((2, 23)),
        T_world_object=np.stack([np.eye(4)] * 2),
        trajectory=np.zeros((3, 23)),
        times=np.arange(3.0),
    )
    write_trial(tmp_path / "one.h5", ROW, evidence, {"b": 2})
    row, back = read_trial(tmp_path / "one.h5")
    assert row == ROW
    assert back.phases == evidence.phases
    np.testing.assert_array_equal(back.times, evidence.times)


def test_summary_counts_what_was_written(rows: list[TrialRow]) -> None:
    whole, partial, oracle = summarise(rows)
    assert (whole.name, partial.name, oracle.name) == (
        "reconstruction",
        "partial-view",
        "reconstruction/oracle",
    )
    assert (whole.held.successes, whole.held.trials) == (4, 4)
    assert partial.by_camera["low"].successes == 0
    assert partial.contact.value == 1.0
    assert oracle.no_plan.value == 1.0
    assert oracle.reasons == {"table_collision": 4}
    assert oracle.by_object["lego"].successes == 0
    test = compare(rows, "reconstruction", "partial-view")
    assert (test.paired.only_first, test.paired.only_second) == (4, 0)
    assert test.paired.p == pytest.approx(2 / 16)
    # Four trials with two objects are two objects: of four signs two agree with both.
    assert test.objects == (2, 2)
    assert test.by_object == pytest.approx(2 / 4)


def test_a_median_of_planning_times_is_of_what_was_planned(rows: list[TrialRow]) -> None:
    unseen = replace(ROW, status="no_plan", reason="no_object", planning_time=0.0, planning_cpu=0.0)
    (found,) = summarise([ROW, *4 * [unseen]])
    assert (found.seconds, found.cpu_seconds) == (ROW.planning_time, ROW.planning_cpu)
    assert np.isnan(summarise([unseen])[0].seconds)


def test_verdicts_are_told_apart_and_lost_objects_by_the_step() -> None:
    in_hold = replace(ROW, held=False, unshaken=0, lost_in="hold", cause="slipped")
    in_push = replace(ROW, unshaken=0, lost_in="push -y")
    (summary,) = summarise([ROW, in_hold, in_push, in_push])
    assert [s.successes for s in (summary.lifted, summary.held, summary.unshaken)] == [4, 3, 1]
    assert summary.lost_in == {"push -y": 2, "hold": 1}
    page = markdown_report([ROW, in_hold, in_push, in_push], "t")
    assert "25% [5, 70] of 4 | push -y 2, hold 1 |" in page
    # Where nothing was pushed there is no share of what withstood it.
    (alone,) = summarise([replace(ROW, unshaken=-1)])
    assert alone.unshaken.trials == 0


def test_lifts_stand_beside_what_was_predicted() -> None:
    drawn = [(0.1, False), (0.3, True), (0.7, True), (0.75, False), (1.0, True)]
    rows = [replace(ROW, success_probability=h, lifted=lifted) for h, lifted in drawn]
    rows.append(replace(ROW, ablation="no-success-network", success_probability=1.0))
    rows.append(replace(ROW, status="no_plan", success_probability=float("nan"), lifted=False))
    page = markdown_report(rows, "t")
    assert "| planner | 0 to 0.3 | 0.3 to 0.6 | 0.6 to 0.8 | 0.8 to 1 |" in page
    line = page.split("## Lifted, by predicted success probability")[1].split("\n")[4]
    said = page.split("## Lifted, by predicted")[1].split("##")[0]
    assert "no-success-network" not in said
    counts = [cell.split(" ")[0] + cell.split("]")[1] for cell in line.split(" | ")[1:]]
    assert counts == ["0% of 1", "100% of 1", "50% of 2", "100% of 1 |"]


def test_what_would_end_a_cell_or_a_row_is_escaped() -> None:
    page = markdown_report([replace(ROW, object="a|b")], "t", {"vase": "is\nbroken | open"})
    assert "| a\\|b | 1 of 1 |" in page
    assert "| vase | is broken \\| open |" in page


def test_the_page_stands_alone_and_says_what_the_table_says(rows: list[TrialRow]) -> None:
    page = html_report(rows, [("a failure <here>", b"\x89PNG")], "trials", {"vase": "is broken"})
    HTMLParser().feed(page)
    sources = re.findall(r'src="([^"]{0,20})', page)
    assert sources
    assert all(source.startswith("data:image/png") for source in sources)
    assert "<script" not in page
    for text in ("100% [51, 100] of 4", "table_collision 4", "a failure &lt;here&gt;", "is broken"):
        assert text in page
    # The published rates stand beside ours.
    assert "reconstruction, published" in page
    assert "48%" in page
    markdown = markdown_report(rows, "trials")
    assert "| reconstruction | 100% [34, 100] of 2 |" in markdown
    assert "When does geometry matter" in markdown
    assert "Skipped" not in markdown
    assert "| vase, 1 of 4 trials | is broken |" in markdown_report(
        rows, "trials", {"vase, 1 of 4 trials": "is broken"}
    )
    # Names of files are no formulas; without a plan there is no planning time.
    odd = [
        replace(row, object="a $^$ b", planning_time=np.nan, planning_cpu=np.nan) for row in rows
    ]
    assert "nan" not in html_report(odd, [], "trials").partition("<table")[2]


def test_a_small_p_is_no_zero() -> None:
    assert [p_value(p) for p in (1.0, 0.0063, 2 * 0.5**39)] == ["1", "0.0063", "3.6e-12"]


def test_what_was_not_tried_has_no_bar(rows: list[TrialRow]) -> None:
    partial = [
        row
        for row in rows
        if not row.ablation
        and (row.method == "reconstruction" or (row.camera, row.object) == ("high", "lego"))
    ]
    figure = success_figure(summarise(partial))
    drawn = [group for group in figure.axes[1].containers if isinstance(group, BarContainer)]
    heights = [[bar.get_height() for bar in group] for group in drawn]
    assert [len(group) for group in heights] == [2, 2]
    assert sum(np.isnan(height) for group in heights for height in group) == 1


def test_a_published_mean_of_both_cameras_stands_beside_both_only(rows: list[TrialRow]) -> None:
    def published(some: list[TrialRow]) -> str:
        lines = markdown_report(some, "t").splitlines()
        return next(line for line in lines if line.startswith("| reconstruction, published | "))

    assert published(rows).split("|")[2:-1] == [" 50% ", " 42% ", " 48% "]
    high = [row for row in rows if row.camera == "high"]
    assert published(high).split("|")[2:-1] == [" 50% ", " – "]
