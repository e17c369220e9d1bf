"""Analytic distances of the robot's shapes: to the table, and of links to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.shapes import bounding_box
from pointsdf_cli.robot.surface import SPACING, link_surface


def table_clearance(
    robot: RobotDescription, rotation: Tensor, position: Tensor
) -> tuple[tuple[str, ...], Tensor]:
    """Height of every link's lowest point above the table top z = 0; exact, differentiable.

    Args:
        robot: The robot.
        rotation, position: [..., L, 3, 3] and [..., L, 3] of all links, from `Kinematics`.

    Returns:
        The links that may not touch the table, and their clearances [..., L'] in m.
    """
    links, heights = [], []
    for i, link in enumerate(robot.tree.links):
        shapes = robot.tree.shapes[link]
        if not shapes or link in robot.links_on_table:
            continue
        lowest = [s.lowest(rotation[..., i, :, :], position[..., i, :]) for s in shapes]
        links.append(link)
        heights.append(torch.stack(lowest, dim=-1).amin(dim=-1))
    if not links:
        return (), rotation.new_full((*rotation.shape[:-3], 0), torch.inf)
    return tuple(links), torch.stack(heights, dim=-1)


@dataclass(frozen=True)
class _Body:
    """Self-collision model of one link: its index, points and enclosing ball."""

    index: int
    link: str
    points: Tensor
    centre: Tensor
    radius: float


class SelfCollision:
    """Distances between links that may not touch, for batches of configurations.

    A pair's distance is the smallest signed distance of surface points of either link to the
    shapes of the other: exact but for the points' spacing, so at most a few millimetres too
    large where two edges cross. Pairs whose enclosing balls are farther apart than `exact_to` get
    that gap, a lower bound, instead.

    Args:
        kinematics: Kinematics of the robot.
        spacing: Spacing of the surface points [m].
        exact_to: Distances up to here [m] are computed from the shapes.
        pairs: The pairs; the robot's checked ones if None.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        spacing: float = SPACING,
        exact_to: float = 0.02,
        pairs: Sequence[tuple[str, str]] | None = None,
    ) -> None:
        self._robot = kinematics.robot
        self.exact_to = exact_to
        self.pairs = self._robot.checked_pairs if pairs is None else tuple(pairs)
        self._bodies: dict[str, _Body] = {}
        for link in {link for pair in self.pairs for link in pair}:
            shapes = self._robot.tree.shapes[link]
            points = link_surface(shapes, spacing)
            low, high = bounding_box(shapes)
            centre = (low + high) / 2
            corners = np.concatenate([shape.triangulated()[0] for shape in shapes])
            radius = float(np.linalg.norm(corners - centre, axis=1).max())
            self._bodies[link] = _Body(
                kinematics.index(link), link, torch.tensor(points), torch.tensor(centre), radius
            )
        first = [self._bodies[a] for a, _ in self.pairs]
        second = [self._bodies[b] for _, b in self.pairs]
        self._first = torch.tensor([body.index for body in first])
        self._second = torch.tensor([body.index for body in second])
        self._sum = torch.tensor([a.radius + b.radius for a, b in zip(first, second, strict=True)])

    def __call__(self, rotation: Tensor, position: Tensor) -> Tensor:
        """Signed distances [B, pairs] in m, negative where links overlap.

        Args:
            rotation, position: [B, L, 3, 3] and [B, L, 3] of all links.
        """
        if not self.pairs:
            return position.new_zeros(len(position), 0)
        dtype = position.dtype
        centres = position.clone()
        for body in self._bodies.values():
            turned = rotation[:, body.index] @ body.centre.to(dtype)
            centres[:, body.index] = position[:, body.index] + turned
        apart = (centres[:, self._first] - centres[:, self._second]).square().sum(-1)
        gap = (apart + 1e-20).sqrt() - self._sum.to(dtype)
        columns = list(gap.unbind(dim=1))
        near = gap.detach() < self.exact_to
        for k in torch.nonzero(near.any(dim=0)).flatten().tolist():
            rows = torch.nonzero(near[:, k]).flatten()
            a, b = (self._bodies[link] for link in self.pairs[k])
            distance = torch.minimum(
                self._one_way(a, b, rotation[rows], position[rows]),
                self._one_way(b, a, rotation[rows], position[rows]),
            )
            columns[k] = columns[k].index_put((rows,), distance)
        return torch.stack(columns, dim=1)

    def _one_way(self, a: _Body, b: _Body, rotation: Tensor, position: Tensor) -> Tensor:
        """Smallest signed distance [R] of a's points to b's shapes."""
        points = a.points.to(position.dtype)
        world = points @ rotation[:, a.index].transpose(-1, -2) + position[:, a.index, None]
        local = (world - position[:, b.index, None]) @ rotation[:, b.index]
        shapes = self._robot.tree.shapes[b.link]
        return torch.stack([s.signed_distance(local).amin(dim=-1) for s in shapes]).amin(dim=0)
