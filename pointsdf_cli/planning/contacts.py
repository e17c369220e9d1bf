"""Signed distances of the robot to its surroundings, with their witness points.

Every constraint of the plan is a distance d between a point that moves with a link and a point of
another body. Its derivative needs no differentiation of the distance itself: at the nearest
points, ∂d/∂q = n · (∂a/∂q − ∂b/∂q), with a, b the witness points as fixed to their bodies and n the
direction in which d grows when a moves (the envelope theorem).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.robot.kinematics import Kinematics

WORLD = -1
"""Link index of fixed bodies."""


class Poses(NamedTuple):
    """All links of B configurations: rotation [B, L, 3, 3], position [B, L, 3], in the world."""

    rotation: Array
    position: Array


def link_poses(kinematics: Kinematics, q: Array) -> Poses:
    """The poses of all links at q [B, J]."""
    rotation, position = kinematics(q)
    return Poses(rotation.numpy(), position.numpy())


@dataclass(frozen=True)
class Contacts:
    """M distances at B configurations.

    Attributes:
        distance: [B, M], m, negative where bodies overlap.
        link: [M], the link that the first point moves with.
        point: [B, M, 3], that point in the world.
        normal: [B, M, 3], the gradient of the distance with respect to the first point.
        other_link: [M], the link that the second point moves with, or WORLD.
        other_point: [B, M, 3], the second point in the world; undefined if its link is WORLD.
    """

    distance: Array
    link: Indices
    point: Array
    normal: Array
    other_link: Indices
    other_point: Array


def join(contacts: list[Contacts]) -> Contacts:
    """Several sets of contacts as one, side by side."""
    parts = zip(*(vars(c).values() for c in contacts), strict=True)
    return Contacts(*(np.concatenate(part, axis=min(1, part[0].ndim - 1)) for part in parts))


class ContactJacobian:
    """Derivatives of contact distances with respect to the joints, from the chain's geometry.

    A revolute joint with world axis a through o moves a point x by a × (x − o), a prismatic one
    by a.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        tree, robot = kinematics.robot.tree, kinematics.robot
        self._child = np.array([kinematics.index(joint.child) for joint in robot.joints])
        self._axis = np.array([joint.axis for joint in robot.joints])
        self._slides = robot.slides
        # moved[l, j]: joint j moves link l. The last row, index WORLD, is moved by none.
        self.moved = np.zeros((len(tree.links) + 1, len(robot.joints)), dtype=bool)
        for column, joint in enumerate(robot.joints):
            for link in tree.subtree([joint.child]):
                self.moved[kinematics.index(link), column] = True

    def __call__(self, poses: Poses, contacts: Contacts, chosen: Indices) -> Array:
        """∂d/∂q [B, K, J] of the contacts `chosen` [B, K] (columns of `contacts`)."""
        normal = _pick(contacts.normal, chosen)
        axis = (poses.rotation[:, self._child] @ self._axis[:, :, None])[..., 0]
        origin = poses.position[:, self._child]
        first = self._moves(axis, origin, _pick(contacts.point, chosen), normal)
        result = np.where(self.moved[contacts.link[chosen]], first, 0.0)
        if (contacts.other_link[chosen] != WORLD).any():
            second = self._moves(axis, origin, _pick(contacts.other_point, chosen), normal)
            result -= np.where(self.moved[contacts.other_link[chosen]], second, 0.0)
        return result

    def _moves(self, axis: Array, origin: Array, point: Array, normal: Array) -> Array:
        """n · ∂x/∂q_j [B, K, J] of points x [B, K, 3], joint axes and origins [B, J, 3]."""
        # n · (a × (x − o)) = a · (x × n) − n · (a × o): no array of [B, K, J, 3] is needed.
        turning = np.cross(point, normal) @ axis.transpose(0, 2, 1)
        turning -= normal @ np.cross(axis, origin).transpose(0, 2, 1)
        if not self._slides.any():
            return turning
        sliding = normal @ axis.transpose(0, 2, 1)
        return np.where(self._slides, sliding, turning)


def _pick(array: Array, chosen: Indices) -> Array:
    """[B, K, 3] from [B, M, 3] and [B, K]."""
    return np.take_along_axis(array, chosen[..., None], axis=1)
