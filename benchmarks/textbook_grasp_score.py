"""The baseline of `bench_grasp_score.py`: the same numbers by automatic differentiation alone.

PyTorch's own operations throughout: autograd through the chain of link poses, batched products for
the palm, `grid_sample` for the field, the network as it was trained.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pointsdf_cli.models.grasp_features import GraspFeatures
from pointsdf_cli.models.grasp_score import GeometryGrasps
from pointsdf_cli.models.hand_sweep import HandSweep


class TextbookScore:
    """log h of the grasps of one object, as `GeometryGrasps` gives it."""

    def __init__(self, grasps: GeometryGrasps) -> None:
        model = grasps._model
        assert model.network.inputs == "geometry"
        self._network, self._sweep, self._body = model.network, model.sweep, grasps.body
        self._features = GraspFeatures(model.sweep, model.robot.preshape_ranges)
        grid = grasps._field
        x, y, z = (torch.arange(cells + 1) for cells in grid._cells)
        nodes = torch.cartesian_prod(x, y, z).float()
        low, step = torch.tensor(grid._low), 1.0 / torch.tensor(grid._inverse)
        values = grid(low + nodes * step).reshape(len(x), len(y), len(z))
        self._values = values.permute(2, 1, 0).contiguous()[None, None]
        self._low, self._scale = low, 2.0 / (step * (torch.tensor(values.shape) - 1))

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        """log h [B]."""
        palm = T_world_palm.float()
        local = _palm_points(self._sweep, preshape.float())
        points = torch.baddbmm(palm[:, None, :3, 3], local, palm[:, :3, :3].transpose(1, 2))
        place = ((points - self._low) * self._scale - 1.0).reshape(1, -1, 1, 1, 3)
        distance = torch.nn.functional.grid_sample(
            self._values, place, padding_mode="border", align_corners=True
        ).reshape(points.shape[:-1])
        features = self._features.assemble(preshape, palm, self._body, points, distance)
        network = self._network
        return torch.nn.functional.logsigmoid(network.calibration(network(features)))


def _palm_points(sweep: HandSweep, preshape: Tensor) -> Tensor:
    """[B, P, 3] in the palm frame, in the order of `HandSweep.in_world`."""
    count, stages = len(preshape), sweep.config.stages
    q = sweep._rest[:, None].expand(-1, count).index_copy(0, sweep._preshape, preshape.T)
    closing = q[sweep._closing, None] + sweep._advance.T[:, :, None]
    closing = closing.clamp(sweep._lower[:, None, None], sweep._upper[:, None, None])
    swept = q[:, None].expand(-1, stages, -1).index_copy(0, sweep._closing, closing)
    rotation, position = sweep._chain(swept.flatten(1))

    def placed(link: Tensor, points: Tensor, grasps: slice) -> Tensor:
        turn, shift = rotation[link][..., grasps], position[link][..., grasps]
        return (turn * points[:, None, :, None]).sum(2) + shift

    moving = placed(sweep._moving_link, sweep._moving, slice(None))
    still = placed(sweep._still_link, sweep._still, slice(0, count)).permute(2, 0, 1)
    moved = moving.unflatten(2, (stages, count)).permute(3, 2, 0, 1).flatten(1, 2)
    return torch.cat([moved, still, sweep.region.expand(count, -1, -1)], dim=1)
