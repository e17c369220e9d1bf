"""A plan on one page: the robot at the grasp, and the hand at the object from two sides.

The middle picture looks from where the camera stood, the right one from the far side of the object,
where the camera saw little: most of what is drawn there was believed. In both the arm is left out
and the hand is translucent, so that the object shows through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.viz.lettering import lettering
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import Painted, Stage, dots, look_at, table_mesh

Mesh = tuple[Array, NDArray[np.integer]]

SEEN_COLOUR = (0.10, 0.35, 0.85)
BELIEVED_COLOUR = (0.62, 0.80, 0.66)
OBSTACLE_COLOUR = (0.72, 0.55, 0.55)
POINT_SIZE = 0.0014
MOST_POINTS = 1500
SIZE, FIELD_OF_VIEW = (480, 440), 0.62
"""Width and height of each picture [pixels], and its vertical field of view [rad]."""
LOWEST = 0.05
"""Least height over distance from which the close-ups look."""
TRANSLUCENT = 0.62
"""Opacity of the robot over the objects behind it, in the close-ups."""


@dataclass(frozen=True)
class PlanScene:
    """Contents of a plan picture besides the robot; all in the world, m.

    Attributes:
        points: [N, 3], the seen points of the object.
        camera: [3], where the (first) camera stood.
        believed: The object's surface as planning took it, None if it took none.
        obstacles: Everything else that stands around.
        table: Whether there is a table.
    """

    points: Array
    camera: Array
    believed: Mesh | None
    obstacles: Sequence[Mesh] = ()
    table: bool = True

    @property
    def centre(self) -> Array:
        """[3], the middle of the object's box."""
        known = [self.points] if self.believed is None else [self.points, self.believed[0]]
        around = np.concatenate(known)
        return np.asarray((around.min(axis=0) + around.max(axis=0)) / 2)

    def painted(self) -> list[Painted]:
        """Object, seen points and table."""
        points = self.points[:: max(1, len(self.points) // MOST_POINTS)]
        meshes = [dots(points, POINT_SIZE, SEEN_COLOUR)]
        if self.table:
            meshes.append(table_mesh())
        if self.believed is not None:
            meshes.append(Painted(*self.believed, BELIEVED_COLOUR))
        return meshes

    def obstacle_meshes(self) -> list[Painted]:
        """The obstacles, to be drawn translucent: they may stand around the object."""
        return [Painted(*mesh, OBSTACLE_COLOUR) for mesh in self.obstacles]


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
    captions = ["from the camera (blue: seen)", "from the far side"]
    with atomic_path(path) as temporary:
        _page(pictures, title, captions, below).save(temporary, format="png", compress_level=3)


def overview(robot: RobotMeshes, q: Array, scene: PlanScene) -> NDArray[np.uint8]:
    """The whole robot with the table, from the side where the hand is."""
    hand = robot.at(q)[-1].vertices.mean(axis=0)
    side = 1.0 if hand[1] > scene.centre[1] else -1.0
    camera = look_at((1.75, 1.75 * side, 1.15), (0.3, 0.0, 0.45))
    around = scene.obstacle_meshes()
    stage = Stage([*around, *robot.at(q), *scene.painted()], len(around), TRANSLUCENT)
    return stage.image(camera, SIZE, FIELD_OF_VIEW)


def close_ups(robot: RobotMeshes, q: Array, scene: PlanScene) -> list[NDArray[np.uint8]]:
    """The object with translucent hand and obstacles, from where the camera stood and from the far
    side.

    The far side is the lower, the more the camera looked down, as far as the table allows. The arm
    is left out: it reaches over from behind, and would stand before everything.
    """
    before = [*scene.obstacle_meshes(), *robot.at(q, hand_only=True)]
    stage = Stage([*before, *scene.painted()], translucent=len(before), opacity=TRANSLUCENT)
    x, y, z = (scene.camera - scene.centre) / np.linalg.norm(scene.camera - scene.centre)
    z = max(z, LOWEST)  # a camera pose that is only assumed may lie below the table
    level, heading = np.hypot(x, y), np.arctan2(y, x)
    far = np.array([-np.cos(heading), -np.sin(heading), 0.45 * level])
    return [
        stage.image(look_at(scene.centre + 0.68 * way, scene.centre), SIZE, FIELD_OF_VIEW)
        for way in (np.array([x, y, z]), far / np.linalg.norm(far))
    ]


LETTERS, SMALL_LETTERS, LINE = 14, 13, 17
"""Heights [pixels] of letters above and below, and of a line."""
GAP = 5
"""Between the pictures, and around the page [pixels]."""


def _page(
    pictures: Sequence[NDArray[np.uint8]], title: str, captions: Sequence[str], below: str
) -> Image.Image:
    """Pictures side by side: the title over the first, captions over the others, words below."""
    height, width = pictures[0].shape[:2]
    titles, words = wrap(title, 58), wrap(below, 190)
    top = GAP + LINE * max(1, len(titles))
    size = (len(pictures) * (width + GAP) + GAP, top + height + 2 * GAP + LINE * len(words))
    page = Image.new("RGB", size, "white")
    for k, picture in enumerate(pictures):
        page.paste(Image.fromarray(picture), (GAP + k * (width + GAP), top))
    draw = ImageDraw.Draw(page)
    font = lettering(LETTERS)
    for k, line in enumerate(titles):
        draw.text((GAP, GAP + k * LINE), line, "black", font)
    for k, caption in enumerate(captions, start=1):
        middle = GAP + k * (width + GAP) + width // 2
        draw.text((middle, top - LINE), caption, "black", font, anchor="ma")
    small = lettering(SMALL_LETTERS)
    for k, line in enumerate(words):
        draw.text((GAP, top + height + GAP + k * LINE), line, "black", small)
    return page
