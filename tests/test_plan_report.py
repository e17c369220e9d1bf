"""`rgrasp report` on single files: a plan and grasps as one page each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from plan_files import turning_plan, turning_plan_file
from test_viz_scene import write_two_grasps

from pointsdf_cli.io.plans import write_plan
from pointsdf_cli.planning.plan_artifact import no_plan
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.plan_report import plan_report

ROBOT = load_robot()


def test_a_plan_is_one_page_with_its_distances_and_rejections(
    tmp_path: Path, cli: Callable
) -> None:
    path = turning_plan_file(tmp_path, ROBOT)
    done = cli("report", path)
    assert done.code == 0, done.err
    page = (tmp_path / "plan.html").read_text()
    assert page.count("data:image/png;base64") == 1
    for text in ("allegro_palm", "object_collision", "0.75", "Time by stage", "-4"):
        assert text in page
    assert cli("report", path).code == 2  # it is there already
    assert cli("report", path, "--force").code == 0


def test_no_plan_says_why(tmp_path: Path, cli: Callable) -> None:
    write_plan(tmp_path / "no.h5", no_plan(ROBOT, "no_object", "There is nothing."), seed=0)
    assert cli("report", tmp_path / "no.h5").code == 0
    page = (tmp_path / "no.html").read_text()
    assert "no_object" in page
    assert "There is nothing." in page


def test_far_distances_are_words_and_near_ones_millimetres() -> None:
    plan = turning_plan(ROBOT)
    page = plan_report(plan, ROBOT, "p")
    first = 1e3 * plan.link_clearance_object[0]
    assert f'<td class="number">{first:.4g}</td>' in page
    assert np.isinf(plan.rejected.slack[0, 2])
    assert "<td>far</td>" in page


def test_grasps_by_file_and_by_folder(tmp_path: Path, cli: Callable) -> None:
    path = write_two_grasps(tmp_path)
    (tmp_path / "report.html").write_text("of collect-grasps, with pictures")
    assert cli("report", path).code == 0
    assert cli("report", tmp_path, "--force").code == 0
    for page in (tmp_path / "g.html", tmp_path / "grasps.html"):
        assert "What became of the attempts" in page.read_text()
    assert (tmp_path / "report.html").read_text() == "of collect-grasps, with pictures"
