"""Points on the surface of every link, dense enough for collision checks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.shapes import Shape, cover_points

SPACING = 0.01
"""No point of a link's surface is farther than this [m] from a sample."""


def link_surface(shapes: tuple[Shape, ...], spacing: float = SPACING) -> Array:
    """Points [P, 3] on a union of shapes, link frame, that cover its surface within `spacing`.

    Each shape is covered by itself. What lies deeper than `spacing` inside another shape covers
    nothing of the union's surface and is left out.

    Raises:
        InputError: The spacing is not positive.
    """
    if not 1e-4 <= spacing <= 1.0:
        raise InputError(f"a spacing of {spacing} m", allowed="0.0001 to 1 m")
    kept = []
    for i, shape in enumerate(shapes):
        points = cover_points(shape, spacing)
        kept.append(points[clear_of(points, [*shapes[:i], *shapes[i + 1 :]], -spacing)])
    return np.concatenate(kept) if kept else np.zeros((0, 3))


def clear_of(points: Array, shapes: Iterable[Shape], distance: float) -> Mask:
    """Mask of the points [N, 3] farther than a distance [m] outside of all shapes; link frame."""
    clear = np.ones(len(points), dtype=bool)
    for shape in shapes:
        clear &= shape.signed_distance(torch.from_numpy(points)).numpy() > distance
    return clear


def robot_surface(robot: RobotDescription, spacing: float = SPACING) -> dict[str, Array]:
    """Surface points [P_l, 3] of every link that has a shape, in the link's frame, m.

    These are the points x of FK_l(q) at which the paper's constraints are evaluated
    (section IV-C): each link's value is the minimum over them.
    """
    return {
        link: link_surface(shapes, spacing) for link, shapes in robot.tree.shapes.items() if shapes
    }
