"""A plan on one page: the robot at the grasp, and the hand at the object from two sides.

The middle picture looks from where the camera stood, the right one from behind the object, where
the camera saw nothing: what is drawn there is what was believed. In both the arm is left out and
the hand is translucent, so that the object shows through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import Painted, look_at, shaded_image, table_mesh
from pointsdf_cli.viz.sheets import save_figure

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.integer]]

SEEN_COLOUR = (0.10, 0.35, 0.85)
BELIEVED_COLOUR = (0.62, 0.80, 0.66)
TRUE_COLOUR = (0.93, 0.72, 0.45)
OBSTACLE_COLOUR = (0.72, 0.55, 0.55)
POINT_SIZE = 0.0014
MOST_POINTS = 1500
TRANSLUCENT = 0.62
"""How much of the robot covers what is behind it, in the close-ups."""


@dataclass(frozen=True)
class PlanScene:
    """What a plan picture shows besides the robot; all in the world, m.

    Attributes:
        points: [N, 3], the seen points of the object.
        camera: [3], where the (first) camera stood.
        believed: The object's surface as planning took it, None if it took none.
        obstacles: Everything else that stands around.
        true: The true object, where it is known; drawn instead of the believed one.
    """

    points: Array
    camera: Array
    believed: Mesh | None
    obstacles: Sequence[Mesh] = ()
    true: Mesh | None = None

    @property
    def centre(self) -> Array:
        """[3], the middle of the object's box."""
        shape = self.believed or self.true
        around = self.points if shape is None else np.concatenate([self.points, shape[0]])
        return np.asarray((around.min(axis=0) + around.max(axis=0)) / 2)

    def painted(self) -> list[Painted]:
        """Object, seen points, obstacles and table."""
        meshes = [table_mesh()]
        for shape, colour in ((self.true, TRUE_COLOUR), (self.believed, BELIEVED_COLOUR)):
            if shape is not None:
                meshes.append(Painted(shape[0], np.asarray(shape[1], dtype=np.int64), colour))
                break
        meshes.append(dots(self.points))
        for vertices, faces in self.obstacles:
            meshes.append(Painted(vertices, np.asarray(faces, dtype=np.int64), OBSTACLE_COLOUR))
        return meshes


def plan_picture(
    path: Path, robot: RobotMeshes, q: Array, scene: PlanScene, title: str, below: str = ""
) -> None:
    """Draw the robot at a configuration [J] in its scene into a PNG of three pictures.

    Args:
        path: The PNG.
        robot: Its shapes.
        q: The grasp, or where the robot stands if there is none.
        scene: Everything else.
        title, below: Words above and below.
    """
    pictures = [overview(robot, q, scene), *close_ups(robot, q, scene)]
    captions = ["", "from the camera", "from behind: unseen by the camera"]
    save_figure(_page([(title, pictures)], captions, below), path, dpi=100)


def overview(
    robot: RobotMeshes, q: Array, scene: PlanScene, size: tuple[int, int] = (480, 440)
) -> NDArray[np.uint8]:
    """The whole robot with the table, from the side where the hand is."""
    hand = robot.at(q)[-1].vertices.mean(axis=0)
    side = 1.0 if hand[1] > scene.centre[1] else -1.0
    camera = look_at((1.75, 1.75 * side, 1.15), (0.3, 0.0, 0.45))
    return shaded_image([*robot.at(q), *scene.painted()], camera, size, 0.62)


def close_ups(
    robot: RobotMeshes, q: Array, scene: PlanScene, size: tuple[int, int] = (480, 440)
) -> list[NDArray[np.uint8]]:
    """The object with the hand, from where the camera stood and from the opposite side."""
    return [close_up(robot, q, scene, behind, size) for behind in (False, True)]


def close_up(
    robot: RobotMeshes,
    q: Array,
    scene: PlanScene,
    behind: bool,
    size: tuple[int, int] = (480, 440),
) -> NDArray[np.uint8]:
    """The object with the translucent hand, from where the camera stood or from behind.

    The arm is left out: it reaches over from behind, and would stand before everything.
    """
    toward = scene.camera - scene.centre
    heading = float(np.arctan2(toward[1], toward[0])) + (np.pi if behind else 0.0)
    way = np.array([np.cos(heading), np.sin(heading), 0.45])
    camera = look_at(scene.centre + 0.62 * way, scene.centre)
    without = scene.painted()
    front = shaded_image([*robot.at(q, hand_only=True), *without], camera, size, 0.62).astype(float)
    back = shaded_image(without, camera, size, 0.62).astype(float)
    return (TRANSLUCENT * front + (1 - TRANSLUCENT) * back).astype(np.uint8)


def dots(points: Array, colour: tuple[float, float, float] = SEEN_COLOUR) -> Painted:
    """Points [N, 3] as small octahedra; of many, every n-th."""
    points = points[:: max(1, len(points) // MOST_POINTS)]
    corners = POINT_SIZE * np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[i, j, k] for i in (0, 3) for j in (1, 4) for k in (2, 5)])
    vertices = (points[:, None] + corners).reshape(-1, 3)
    every = (6 * np.arange(len(points))[:, None, None] + faces).reshape(-1, 3)
    return Painted(vertices, every, colour)


def _page(
    rows: Sequence[tuple[str, Sequence[NDArray[np.uint8]]]], captions: Sequence[str], below: str
) -> Figure:
    """Rows of pictures with their titles, captions over the columns, words under all."""
    columns = max(len(pictures) for _, pictures in rows)
    figure, axes = plt.subplots(
        len(rows), columns, figsize=(4.8 * columns, 4.7 * len(rows)), squeeze=False
    )
    for row, (title, pictures) in zip(axes, rows, strict=True):
        for axis, picture, caption in zip(row, pictures, captions, strict=True):
            axis.imshow(picture)
            axis.axis("off")
            axis.set_title(caption, fontsize=10)
        # Names of files and links are no formulas, even with dollars in them.
        row[0].set_title("\n".join(wrap(title, 58)), fontsize=10, loc="left", parse_math=False)
    if below:
        text = "\n".join(wrap(below, 190))
        figure.text(0.01, 0.0, text, fontsize=9, va="top", parse_math=False)
    figure.subplots_adjust(0.0, 0.0, 1.0, 0.92, wspace=0.01)
    return figure
