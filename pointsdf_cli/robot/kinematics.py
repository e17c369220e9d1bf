"""Forward kinematics of the whole robot, batched and differentiable."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import cross_matrix
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.urdf import Joint

Values = TypeVar("Values", NDArray[Any], Tensor)


class Kinematics:
    """FK_l(q) of every link (paper section IV-C), on [B, J] configurations at once.

    Joints at one depth of the tree are evaluated together, so a four-fingered hand costs no more
    steps than one finger.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.links = robot.tree.links
        self._index = {link: i for i, link in enumerate(self.links)}
        # Level by level, so that a level's joints are a slice.
        levels = joint_levels(robot.tree.joints, self.links[0])
        joints = [joint for here, _ in levels for joint in here]
        by_level = [self.links[0], *(joint.child for joint in joints)]
        rotation, sine, versine, offset, slide = joint_motions(joints)
        self._arrays = _Constants(
            rotation=rotation,
            sine=sine,
            versine=versine,
            offset=offset,
            slide=slide,
            base=np.array(robot.T_world_base[:3]),
            columns=np.array(columns_of(joints, robot.joint_names)),
            order=np.array([by_level.index(link) for link in self.links]),
        )
        # float64 agrees with a physics engine to rounding.
        self._tensors = _Constants(*map(torch.from_numpy, self._arrays))
        self._levels: list[tuple[slice, Tensor | None]] = []
        end, above = 0, 1
        for here, parents in levels:
            same = parents == list(range(above))  # nothing needs to be gathered
            begin, end, above = end, end + len(here), len(here)
            self._levels.append((slice(begin, end), None if same else torch.tensor(parents)))
        self._palm = self._index[robot.palm_link]
        self._palm_offset = torch.from_numpy(np.array(robot.T_link_palm))

    def __call__(self, q: Tensor | Array) -> tuple[Tensor, Tensor]:
        """Poses of all links in the world.

        Args:
            q: [..., J]; gradients of a tensor that requires them flow through.

        Returns:
            Rotations [..., L, 3, 3] and positions [..., L, 3] in the order of `links`.
        """
        q = _tensor(q)
        fixed, batch = self._tensors, q.shape[:-1]
        flat = q.reshape(-1, q.shape[-1])
        angle = torch.cat([flat, flat.new_zeros(len(flat), 1)], dim=1)[:, fixed.columns]
        sine = torch.sin(angle)[..., None, None]
        versine = (1 - torch.cos(angle))[..., None, None]
        local_rotation = fixed.rotation + sine * fixed.sine + versine * fixed.versine
        local_position = fixed.offset + angle[..., None] * fixed.slide
        count = len(flat)
        # One entry a level; a level's links are found through (level, place) of their parents.
        rotations = [fixed.base[:, :3].expand(count, 1, 3, 3)]
        positions = [fixed.base[:, 3].expand(count, 1, 3)]
        for joints, parents in self._levels:
            rotation, position = rotations[-1], positions[-1]
            if parents is not None:
                rotation, position = rotation[:, parents], position[:, parents]
            turned = (rotation @ local_position[:, joints, :, None]).squeeze(-1)
            rotations.append(rotation @ local_rotation[:, joints])
            positions.append(position + turned)
        all_rotations = torch.cat(rotations, dim=1)[:, fixed.order]
        all_positions = torch.cat(positions, dim=1)[:, fixed.order]
        return (all_rotations.reshape(*batch, -1, 3, 3), all_positions.reshape(*batch, -1, 3))

    def poses(self, q: Array) -> tuple[Array, Array]:
        """The same without gradients, in numpy: of a few configurations in a quarter of the time.

        Args:
            q: [B, J].

        Returns:
            Rotations [B, L, 3, 3] and positions [B, L, 3] in the order of `links`, equal to a
            call's but for rounding.
        """
        fixed = self._arrays
        count, links = len(q), len(fixed.offset)
        angle = np.concatenate([q, np.zeros((count, 1))], axis=1)[:, fixed.columns]
        sine, versine = np.sin(angle)[..., None, None], 1 - np.cos(angle)[..., None, None]
        local = np.empty((count, links, 3, 4))
        local[..., :3] = fixed.rotation + sine * fixed.sine + versine * fixed.versine
        local[..., 3] = fixed.offset + angle[..., None] * fixed.slide
        world = np.empty((count, links + 1, 3, 4))
        world[:, 0] = fixed.base
        above = slice(0, 1)
        for joints, parents in self._levels:
            here = slice(joints.start + 1, joints.stop + 1)
            before = world[:, above] if parents is None else world[:, above][:, parents.numpy()]
            np.matmul(before[..., :3], local[:, joints], out=world[:, here])
            world[:, here, :, 3] += before[..., 3]
            above = here
        world = world[:, fixed.order]
        return world[..., :3], world[..., 3]

    def palm(self, q: Tensor | Array) -> Tensor:
        """T_world_palm [..., 4, 4] of configurations [..., J]."""
        rotation, position = self(q)
        return self.palm_of(rotation, position)

    def palm_of(self, rotation: Tensor, position: Tensor) -> Tensor:
        """T_world_palm [..., 4, 4] from the poses of all links."""
        pose = homogeneous(rotation[..., self._palm, :, :], position[..., self._palm, :])
        return pose @ self._palm_offset

    def index(self, link: str) -> int:
        """The place of a link in the results."""
        return self._index[link]

    def points(
        self, q: Tensor | Array, surface: Iterable[tuple[str, Tensor | Array]]
    ) -> list[Tensor]:
        """World positions [..., P_l, 3] of points [P_l, 3] that are fixed to links."""
        rotation, position = self(q)
        return [
            _tensor(points) @ rotation[..., self._index[link], :, :].transpose(-1, -2)
            + position[..., self._index[link], None, :]
            for link, points in surface
        ]


class _Constants(NamedTuple, Generic[Values]):
    """Constants of forward kinematics, level by level: of L - 1 joints, by their links.

    Attributes:
        rotation, sine, versine: [L - 1, 3, 3], the parts of a joint's rotation.
        offset, slide: [L - 1, 3], its place and where it slides.
        base: [3, 4], the robot's root in the world.
        columns: [L - 1], columns of q.
        order: [L], places of `links`.
    """

    rotation: Values
    sine: Values
    versine: Values
    offset: Values
    slide: Values
    base: Values
    columns: Values
    order: Values


def joint_levels(joints: Iterable[Joint], root: str) -> list[tuple[list[Joint], list[int]]]:
    """For each depth below a link the joints that lead there, and their parents' places one level
    up."""
    joints, above, levels = list(joints), [root], []
    while here := [joint for joint in joints if joint.parent in above]:
        levels.append((here, [above.index(joint.parent) for joint in here]))
        above = [joint.child for joint in here]
    return levels


def columns_of(joints: Iterable[Joint], names: Sequence[str]) -> list[int]:
    """Columns of joints in a configuration; others rest at 0, through one more column of zeros."""
    return [names.index(j.name) if j.name in names else len(names) for j in joints]


def joint_motions(joints: Sequence[Joint]) -> tuple[Array, Array, Array, Array, Array]:
    """Constants of Rodrigues' formula, R(q) = R0 + sin q R0 K + (1 - cos q) R0 K²; where a joint
    slides, p(q) = p0 + q R0 a.

    Returns:
        R0, R0 K and R0 K² [N, 3, 3], p0 and R0 a [N, 3], in the frame of each joint's parent; 0
        where a joint does not move so.
    """
    axes = np.array([joint.axis for joint in joints])
    turns = np.array([joint.kind in ("revolute", "continuous") for joint in joints])
    slides = np.array([joint.kind == "prismatic" for joint in joints])
    origins = np.array([joint.T_parent_joint for joint in joints])
    fixed, cross = origins[:, :3, :3].copy(), cross_matrix(axes)
    return (
        fixed,
        fixed @ cross * turns[:, None, None],
        fixed @ cross @ cross * turns[:, None, None],
        origins[:, :3, 3].copy(),
        np.einsum("jab,jb->ja", fixed, axes) * slides[:, None],
    )


def _tensor(values: Tensor | Array) -> Tensor:
    """Values as a tensor; an array is copied, as it may be read-only."""
    return values if isinstance(values, Tensor) else torch.tensor(values)


def homogeneous(rotation: Tensor, position: Tensor) -> Tensor:
    """[..., 4, 4] from [..., 3, 3] and [..., 3]."""
    top = torch.cat([rotation, position[..., None]], dim=-1)
    bottom = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=top.dtype, device=top.device)
    return torch.cat([top, bottom.expand(*top.shape[:-2], 1, 4)], dim=-2)
