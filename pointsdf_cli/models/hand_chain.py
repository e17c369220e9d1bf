"""Forward kinematics of the hand alone, laid out for many configurations at once.

The same equations as `robot/kinematics.py`, in float32, with the configurations along the last,
contiguous axis: products of thousands of 3 × 3 matrices become a few long vector operations, which
on a processor core is several times faster than a batched matrix product.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import torch
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import columns_of, joint_levels, joint_motions


class HandChain:
    """Poses of the hand's links in the palm frame; differentiable.

    Args:
        robot: The robot; joints before the palm's link do not matter.
        wanted: Names of the links to compute, with those between them and the palm.

    Attributes:
        links: The links in the order of the results, the palm's first.
        moved_link: int [J], the link that each of the hand's joints moves first.
        axes: f4 [J, 3], the joints' axes in the frames of these links.
        slides: bool [J], prismatic joints.
        below: f4 [J, L], 1 for the links that each joint moves.
    """

    def __init__(self, robot: RobotDescription, wanted: Collection[str]) -> None:
        carry = {link for link in robot.hand_links if {*wanted} & {*robot.tree.subtree([link])}}
        self.links = tuple(link for link in robot.hand_links if link in {robot.palm_link, *carry})
        joints = [robot.tree.parent_joint[link] for link in self.links[1:]]

        def constant(array: Array) -> Tensor:
            return torch.tensor(array, dtype=torch.float32)[..., None]

        root = invert_transform(robot.T_link_palm)[None]
        self._root = constant(root[:, :3, :3]), constant(root[:, :3, 3])
        # Joints of one depth together: four fingers take as many steps as one.
        self._levels = []
        order = [self.links[0]]
        for level, above in joint_levels(joints, self.links[0]):
            parents = torch.tensor(above)
            columns = torch.tensor(columns_of(level, robot.hand_joints))
            fixed, with_sine, with_versine, offset, slide = map(constant, joint_motions(level))
            self._levels.append((parents, columns, fixed, with_sine, with_versine, offset, slide))
            order += [joint.child for joint in level]
        self._order = torch.tensor([order.index(link) for link in self.links])
        joints = list(robot.joints[len(robot.arm_joints) :])
        number = {link: k for k, link in enumerate(self.links)}
        self.moved_link = torch.tensor([number.get(joint.child, 0) for joint in joints])
        self.axes = torch.tensor(np.array([joint.axis for joint in joints]), dtype=torch.float32)
        self.slides = torch.tensor(robot.slides[len(robot.arm_joints) :])
        moved = [robot.tree.subtree([joint.child]) for joint in joints]
        self.below = torch.tensor([[float(link in one) for link in self.links] for one in moved])

    def __call__(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Poses of all links.

        Args:
            q: [J, n], the hand's joints in the order of the description; float32.

        Returns:
            Rotations [L, 3, 3, n] and positions [L, 3, n].
        """
        count = q.shape[1]
        q = torch.cat([q, q.new_zeros(1, count)])
        sine, versine = torch.sin(q), 1 - torch.cos(q)
        rotation = self._root[0].expand(1, 3, 3, count)
        position = self._root[1].expand(1, 3, count)
        rotations, positions = [rotation], [position]
        for parents, columns, fixed, with_sine, with_versine, offset, slide in self._levels:
            rotation = rotation.index_select(0, parents)
            position = position.index_select(0, parents)
            local = torch.addcmul(fixed, sine[columns, None, None], with_sine)
            local = torch.addcmul(local, versine[columns, None, None], with_versine)
            place = torch.addcmul(offset, q[columns, None], slide)
            position = position + _times_vector(rotation, place)
            rotation = _times_matrix(rotation, local)
            rotations.append(rotation)
            positions.append(position)
        return (
            torch.cat(rotations).index_select(0, self._order),
            torch.cat(positions).index_select(0, self._order),
        )


def _times_matrix(a: Tensor, b: Tensor) -> Tensor:
    """Matrix products of [J, 3, 3, n] and [J, 3, 3, n]."""
    product = a[:, :, 0, None] * b[:, None, 0]
    product = product.addcmul(a[:, :, 1, None], b[:, None, 1])
    return product.addcmul(a[:, :, 2, None], b[:, None, 2])


def _times_vector(a: Tensor, b: Tensor) -> Tensor:
    """Products of matrices [J, 3, 3, n] and vectors [J, 3, n]."""
    product = a[:, :, 0] * b[:, None, 0]
    return product.addcmul(a[:, :, 1], b[:, None, 1]).addcmul(a[:, :, 2], b[:, None, 2])
