"""A cloud of a table to a grasp of what stands on it: python examples/plan_a_grasp.py [CLOUD]"""

import sys

import numpy as np

from pointsdf_cli import GraspPlanner, plan_on_table, read_cloud

path = sys.argv[1] if len(sys.argv) > 1 else "assets/clouds/table.ply"
planner = GraspPlanner()  # loads the networks and the robot, once
session = plan_on_table(planner, [read_cloud(path)], [path], seed=0)
plan = session.answer.plan
print(session.report[0])
if plan.reason:
    sys.exit(f"no plan: {plan.reason}. {plan.sentence}")
print(f"{plan.kind} grasp, success probability {plan.success_probability:.2f}")
print("arm and hand [rad]:", np.round(plan.q, 2))
print(f"motion of {len(plan.trajectory)} points, {plan.times[-1]:.1f} s")
