"""Sweep of the closing hand: paths of points on its links in the palm frame, from a preshape.

The robot's description gives the closing joints and their speeds. All advance together, as in free
space. Each moving link is represented by its pad: points of its leading side, which touches first.
This works for any hand.

Derivatives are those of rigid bodies, in closed form: the gradients at all points beyond a joint
sum to one force and one moment, and the joint's derivative is their component along its axis. That
is several times faster than automatic differentiation through the chain of matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.hand_chain import HandChain
from pointsdf_cli.models.hand_points import Motion, box_grid, middles, pad_points
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.surface import robot_surface


@dataclass(frozen=True)
class SweepConfig:
    """Resolution of the closing motion.

    Attributes:
        stages: Number of stages of the closing motion, including the preshape.
        share: Time of the last stage, as a share of the longest closing time of a joint.
        points_per_link: Points along each link that closing does not move.
        grid: Points of the closing region along the palm's x, y and z.
        points_per_pad: 1 for the middle of each pad, 5 for points around it too.
        narrowest: Least width of the closing region along each axis [m]; without it the pads of
            two jaws would sweep a thin box.
    """

    stages: int = 8
    share: float = 0.9333
    points_per_link: int = 2
    grid: tuple[int, int, int] = (4, 4, 4)
    points_per_pad: int = 5
    narrowest: float = 0.06

    def __post_init__(self) -> None:
        counts = (self.stages - 1, self.points_per_link, *self.grid)
        if min(counts) < 1 or not 0 < self.share <= 1 or len(self.grid) != 3:
            raise InputError(f"{self}", allowed="stages ≥ 2, counts ≥ 1, share in (0, 1]")
        if self.points_per_pad not in (1, 5) or not 0 <= self.narrowest < 1:
            raise InputError(f"{self}", allowed="1 or 5 points_per_pad, narrowest in [0, 1)")


class JointAxes(NamedTuple):
    """Axes of the K preshape joints in the palm frame, at S stages of B grasps.

    Attributes:
        axis, origin: f4 [K, 3, S, B], direction and a point of each axis.
        free: f4 [K, S, B], 0 once closing has driven the joint to its limit.
    """

    axis: Tensor
    origin: Tensor
    free: Tensor


class HandSweep:
    """Swept points of one hand; differentiable in the preshape.

    Args:
        robot: The robot.
        config: Resolution.

    Attributes:
        region: f4 [G, 3], points of the box that the pads sweep, fixed in the palm frame.
        preshapes: f4 [K, 2], ranges of the preshape joints.
        pads_under: f4 [K, M], 1 where a preshape joint moves a pad.
    """

    def __init__(self, robot: RobotDescription, config: SweepConfig | None = None) -> None:
        self.config = config or SweepConfig()
        surface = {link: points for link, points in robot_surface(robot).items() if len(points)}
        self._chain = HandChain(robot, surface)
        count = len(robot.hand_joints)
        hand = slice(len(robot.arm_joints), None)
        names = list(robot.hand_joints)
        self._preshape = torch.tensor([names.index(name) for name in robot.preshape_joints])
        self._closing = torch.tensor([names.index(name) for name in robot.closing_joints])
        lower = torch.tensor(robot.lower[hand], dtype=torch.float32)
        upper = torch.tensor(robot.upper[hand], dtype=torch.float32)
        self._rest = torch.zeros(count).clamp(lower, upper)
        self._lower, self._upper = lower[self._closing], upper[self._closing]
        speed = torch.tensor(robot.closing_speeds.copy(), dtype=torch.float32)
        # Times from the middle preshape; joints that start elsewhere arrive earlier or later.
        self.preshapes = torch.tensor(robot.preshape_ranges.copy(), dtype=torch.float32)
        self._middle = torch.tensor(robot.preshape_ranges.mean(axis=1), dtype=torch.float32)
        start = self._rest.index_copy(0, self._preshape, self._middle)
        end = torch.where(speed > 0, self._upper, self._lower)
        duration = float(((end - start[self._closing]) / speed).max())
        times = torch.linspace(0.0, self.config.share * duration, self.config.stages)
        self._advance = times[:, None] * speed
        self._place_points(robot, surface, self._link_motion(start))
        self.region = torch.zeros(0, 3)
        with torch.no_grad():
            swept = self(self._middle[None])[1].reshape(-1, 3)
        self.region = box_grid(swept, self.config.grid, self.config.narrowest)

    def course(self) -> NDArray[np.float64]:
        """Mean position of the pads [S, 3] at each stage, from the middle preshape, palm frame [m].

        It identifies a hand.
        """
        with torch.no_grad():
            pads = self(self._middle[None])[1][0]
        return pads.double().mean(dim=1).numpy()

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of fixed points, and of moving points at each stage."""
        return len(self._still), len(self._moving)

    def __call__(self, preshape: Tensor) -> tuple[Tensor, Tensor]:
        """Points in the palm frame.

        Args:
            preshape: [B, K], float32.

        Returns:
            Points of links that do not move [B, P, 3], and pads [B, S, M, 3] at S stages.
        """
        points = self.in_world(preshape, torch.eye(4).expand(len(preshape), 4, 4))
        still, moving = self.sizes
        swept = self.config.stages * moving
        moved = points[:, :swept].unflatten(1, (self.config.stages, moving))
        return points[:, swept : swept + still], moved

    def in_world(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """Points in the world, the last axis the slowest in memory.

        Args:
            preshape: [B, K], float32.
            T_world_palm: [B, 4, 4], float32.

        Returns:
            [B, S M + P + G, 3]: pads stage by stage, still points, the closing region.
        """
        planes: Tensor = _Swept.apply(preshape, T_world_palm[:, :3], self)
        return planes.permute(2, 1, 0)

    def in_palm(self, preshape: Tensor, with_axes: bool) -> tuple[Tensor, JointAxes | None]:
        """Points [3, S M + P + G, B] in the palm frame, and the axes of the preshape's joints."""
        count, stages = len(preshape), self.config.stages
        still, moving = self.sizes
        q = self._rest[:, None].expand(-1, count).index_copy(0, self._preshape, preshape.T)
        wanted = q[self._closing, None] + self._advance.T[:, :, None]
        closing = wanted.clamp(self._lower[:, None, None], self._upper[:, None, None])
        swept = q[:, None].expand(-1, stages, -1).index_copy(0, self._closing, closing)
        rotation, position = self._chain(swept.flatten(1))
        points = preshape.new_empty(3, stages * moving + still + len(self.region), count)
        moved = _placed(rotation, position, self._moving_link, self._moving)
        points[:, : stages * moving].unflatten(1, (stages, moving)).copy_(
            moved.unflatten(2, (stages, count)).permute(1, 2, 0, 3)
        )
        first = slice(0, count)
        points[:, stages * moving : stages * moving + still] = _placed(
            rotation[..., first], position[..., first], self._still_link, self._still
        ).transpose(0, 1)
        points[:, stages * moving + still :] = self.region.T[:, :, None]
        if not with_axes:
            return points, None
        link = self._chain.moved_link[self._preshape]
        turn = rotation.index_select(0, link)
        axis = torch.einsum("kijn,kj->kin", turn, self._chain.axes[self._preshape])
        free = torch.ones(len(q), stages, count)
        free[self._closing] = closing.eq(wanted).float()
        origin = position.index_select(0, link).unflatten(2, (stages, count))
        return points, JointAxes(axis.unflatten(2, (stages, count)), origin, free[self._preshape])

    def joint_slopes(self, axes: JointAxes, points: Tensor, forces: Tensor) -> Tensor:
        """dL/d preshape [B, K] from dL/d points, both [3, S M + P + G, B] in the palm frame."""
        stages, (still, moving) = self.config.stages, self.sizes
        swept = stages * moving
        x, f = points[:, : swept + still], forces[:, : swept + still]
        moments = torch.stack(
            [x[a].mul(f[b]).addcmul_(x[b], f[a], value=-1) for a, b in ((1, 2), (2, 0), (0, 1))]
        )
        both = torch.stack([f, moments])  # [2, 3, S M + P, B]
        # Under each joint: [2, 3, S, K, B]. Still points belong to the first stage.
        under = self.pads_under @ both[:, :, :swept].unflatten(2, (stages, moving))
        if still:
            under[:, :, 0] += self._still_under @ both[:, :, swept:]
        force, moment = under.permute(0, 3, 1, 2, 4)  # each [K, 3, S, B]
        about = moment - torch.linalg.cross(axes.origin, force, dim=1)
        chosen = torch.where(self._slides[:, None, None, None], force, about)
        return ((axes.axis * chosen).sum(1) * axes.free).sum(1).T

    def _place_points(
        self,
        robot: RobotDescription,
        surface: Mapping[str, NDArray[np.float64]],
        ahead: Callable[[int], Motion],
    ) -> None:
        moved = set(robot.tree.links_moved_by(robot.closing_joints))
        shown = {k: link for k, link in enumerate(self._chain.links) if link in surface}
        per_pad, per_link = self.config.points_per_pad, self.config.points_per_link
        pads = {
            k: pad_points(surface[n], ahead(k), per_pad) for k, n in shown.items() if n in moved
        }
        still = {k: middles(surface[n], per_link) for k, n in shown.items() if n not in moved}
        if not pads:
            raise InputError(
                "no link with a shape moves when the hand closes",
                where=robot.name,
                allowed="closing_joints that move links with collision shapes",
            )
        self._moving, self._moving_link = _joined(pads)
        self._still, self._still_link = _joined(still)
        below = self._chain.below[self._preshape]
        self.pads_under = below[:, self._moving_link]
        self._still_under = below[:, self._still_link]
        self._slides = self._chain.slides[self._preshape]

    def _link_motion(self, start: Tensor) -> Callable[[int], Motion]:
        """Motion of a link's points, in its own frame, after a quarter of the closing from joint
        values [J]."""
        begin = self.config.stages // 4
        closing = start[self._closing] + self._advance[begin : begin + 2]
        closing = closing.clamp(self._lower, self._upper).T
        q = start[:, None].expand(-1, 2).index_copy(0, self._closing, closing)
        rotation, position = self._chain(q)

        def of_link(link: int) -> Motion:
            before, after = (
                (rotation[link, :, :, k].double().numpy(), position[link, :, k].double().numpy())
                for k in (0, 1)
            )

            def motion(point: NDArray[np.float64]) -> NDArray[np.float64]:
                moved = after[0] @ point + after[1] - before[0] @ point - before[1]
                return np.asarray(before[0].T @ moved)

            return motion

        return of_link


class _Swept(torch.autograd.Function):
    """`HandSweep.in_world` for autograd: [B, K] and [B, 3, 4] to [3, S M + P + G, B]."""

    @staticmethod
    def forward(ctx: Any, preshape: Tensor, palm: Tensor, sweep: HandSweep) -> Tensor:
        points, axes = sweep.in_palm(preshape, ctx.needs_input_grad[0])
        rows = palm.permute(1, 2, 0).contiguous()  # [3, 4, B]
        world = points.new_empty(points.shape)
        for out, row in zip(world, rows, strict=True):
            torch.addcmul(row[3], points[0], row[0], out=out)
            out.addcmul_(points[1], row[1]).addcmul_(points[2], row[2])
        ctx.sweep, ctx.axes = sweep, axes
        ctx.save_for_backward(points, rows)
        return world

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        points, rows = ctx.saved_tensors
        to_preshape = to_palm = None
        if ctx.axes is not None:
            turned = slope.new_empty(slope.shape)
            for j, out in enumerate(turned):
                torch.mul(slope[0], rows[0, j], out=out)
                out.addcmul_(slope[1], rows[1, j]).addcmul_(slope[2], rows[2, j])
            to_preshape = ctx.sweep.joint_slopes(ctx.axes, points, turned)
        if ctx.needs_input_grad[1]:
            to_palm = torch.stack(
                [torch.stack([*((s * x).sum(0) for x in points), s.sum(0)]) for s in slope]
            ).permute(2, 0, 1)
        return to_preshape, to_palm, None


def _joined(points: Mapping[int, NDArray[np.float64]]) -> tuple[Tensor, Tensor]:
    """Points f4 [P, 3] of links, by the links' numbers, and the link of each int [P]."""
    places = np.concatenate([np.zeros((0, 3)), *points.values()])
    links = [link for link, of_link in points.items() for _ in of_link]
    return torch.tensor(places, dtype=torch.float32), torch.tensor(links, dtype=torch.long)


def _placed(rotation: Tensor, position: Tensor, link: Tensor, points: Tensor) -> Tensor:
    """Points [P, 3] fixed to links [P], at poses [L, 3, 3, n] and [L, 3, n]: [P, 3, n]."""
    turn, x = rotation.index_select(0, link), points[:, None, :, None]
    placed = position.index_select(0, link).addcmul(turn[:, :, 0], x[:, :, 0])
    return placed.addcmul(turn[:, :, 1], x[:, :, 1]).addcmul(turn[:, :, 2], x[:, :, 2])
