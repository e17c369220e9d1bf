"""README's first picture: what the camera saw, its reconstruction, the plan.

    python pipelines/first_picture.py CAPTURE MESH PLAN PICTURE

CAPTURE holds color.jpg and T_world_camera.json, MESH is of `rgrasp mesh` (camera frame), PLAN of
`rgrasp plan`. pipelines/demo.sh runs it on assets/captures/mustard.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import trimesh
from PIL import Image

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.depth_images import read_colour
from pointsdf_cli.io.plans import read_plan
from pointsdf_cli.io.poses import camera_pose
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.plan_picture import BELIEVED_COLOUR
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import Painted, Stage, look_at, table_mesh
from pointsdf_cli.viz.sheets import save_figure

HEIGHT = 440
CAPTIONS = (
    "one colour and depth image",
    "completed: as seen, and from behind",
    "the planned grasp",
)


def draw(capture: Path, mesh: Path, plan: Path, picture: Path) -> None:
    T_world_camera = camera_pose(str(capture / "T_world_camera.json"))
    made = trimesh.load(mesh, process=False)
    vertices = apply_transform(T_world_camera, np.asarray(made.vertices))
    shape = Painted(vertices, np.asarray(made.faces, dtype=np.int64), BELIEVED_COLOUR)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    away = T_world_camera[:3, 3] - middle
    views = [look_at(middle + way, middle) for way in (away, away * (-1, -1, 1))]
    completed = [Stage([shape, table_mesh()]).image(view, (270, HEIGHT), 0.5) for view in views]

    planned = read_plan(plan)
    if planned.status != "ok":
        sys.exit(f"{plan}: no plan ({planned.reason})")
    eye = middle + (0.75, 1.0, 0.55)
    scene = [*RobotMeshes(load_robot()).at(planned.q), shape, table_mesh()]
    grasp = Stage(scene).image(look_at(eye, middle + (-0.2, 0.0, 0.15)), (520, HEIGHT), 0.55)

    pictures = [read_colour(capture / "color.jpg"), np.concatenate(completed, axis=1), grasp]
    shares = [image.shape[1] / image.shape[0] for image in pictures]
    figure, axes = plt.subplots(
        1, 3, figsize=(4.4 * sum(shares), 4.8), gridspec_kw={"width_ratios": shares}
    )
    for axis, image, caption in zip(axes, pictures, CAPTIONS, strict=True):
        axis.imshow(image)
        axis.set_axis_off()
        axis.set_title(caption, fontsize=13)
    figure.subplots_adjust(0.0, 0.0, 1.0, 0.93, wspace=0.02)
    save_figure(figure, picture, dpi=90)
    with Image.open(picture) as drawn:  # 256 colours: a third of the bytes
        fewer = drawn.convert("RGB").quantize(256)
    with atomic_path(picture) as temporary:
        fewer.save(temporary, optimize=True)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    draw(*map(Path, sys.argv[1:]))
