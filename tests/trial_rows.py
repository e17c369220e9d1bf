"""A row of trials to write, change and count."""

from __future__ import annotations

from pointsdf_cli.io.trials import TrialRow

ROW = TrialRow(
    object="mustard",
    yaw_index=0,
    repeat=0,
    yaw=1.5,
    camera="high",
    method="reconstruction",
    ablation="",
    status="ok",
    reason="",
    kind="side",
    cause="held",
    planning_time=4.0,
    planning_cpu=2.0,
    success_probability=0.9,
    contact=False,
    moved=0.0,
    penetration=0.0,
    lifted=True,
    held=True,
    unshaken=1,
    lost_in="",
    final_height=0.149,
    seed=0,
)
