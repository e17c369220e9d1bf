"""A depth image and its camera's pose to a grasp: python examples/plan_from_depth.py"""

import json
import sys
from pathlib import Path

import numpy as np

from pointsdf_cli import GraspPlanner, plan_on_table, read_depth_image

capture = Path("assets/captures/mustard")
pose = np.array(json.loads((capture / "T_world_camera.json").read_text()))
# 0.1 mm a step; mask="mask.png" names the object, else the best one to grasp is taken.
cloud = read_depth_image(capture / "depth.png", capture / "K.json", pose, depth_scale=1e-4)
session = plan_on_table(GraspPlanner(), [cloud], ["mustard"], seed=0)
plan = session.answer.plan
if plan.reason:
    sys.exit(f"no plan: {plan.reason}. {plan.sentence}")
print(session.report[0])
print(f"{plan.kind} grasp, success probability {plan.success_probability:.2f}")
