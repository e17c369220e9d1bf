"""Encoding of a cloud by the best of several samplings.

With a sensor's errors a network's answer depends on the points that it reads: of one sampling in
twenty it makes a thin shell or nothing, where others of the same cloud give a body. The object lies
behind the points that were seen of it. So the best of several encodings is the one with most of the
space close behind these points inside.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from pointsdf_cli.geometry.cloud_sampling import all_but_every, systematic_sample
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.models.normalise import NetworkFrame, network_frame
from pointsdf_cli.models.processor import one_thread, run_in_parallel
from pointsdf_cli.models.shape_model import Encoding, ShapeModel
from pointsdf_cli.models.surroundings import surroundings_of

SAMPLINGS = 4
"""Samplings of a cloud. The first is of all points."""
LEFT_OUT = 5
"""Sampling k leaves out every fifth point, from point k − 1 on, whatever the seed."""
FEWEST = 30
"""Clouds of fewer points are sampled once."""
ENOUGH = 0.6
"""Share inside from which no further sampling is tried."""
DEPTHS = (0.05, 0.1)
"""Distances behind the seen points [network units]."""
CHECKED = 192
"""Seen points behind which the space is checked."""


class Sampling(NamedTuple):
    """A cloud as a network read it: the network's frame, and the encoding in it."""

    frame: NetworkFrame
    encoding: Encoding


def best_sampling(
    model: ShapeModel,
    points: NDArray[np.float64],
    evidence: ViewEvidence,
    tries: int,
    rng: np.random.Generator,
) -> Sampling:
    """The sampling with the largest share inside close behind the points, the first of equals.

    Args:
        model: Network in evaluation mode.
        points: [N, 3], camera frame, m.
        evidence: Observed space around the object.
        tries: Number of samplings, at most 1 + `LEFT_OUT`.
        rng: Random generator.
    """
    with one_thread():
        first = _read(model, points, evidence, rng)
        if tries == 1 or len(points) < FEWEST or not model.gives_distances:
            return first
        share = _inside_behind(model, first, points)
    if share >= ENOUGH:
        return first
    parts = [points[all_but_every(points[:, :2], LEFT_OUT, k)] for k in range(tries - 1)]
    seeds = rng.spawn(len(parts))

    def tried(part: NDArray[np.float64], own: np.random.Generator) -> tuple[float, Sampling]:
        sampling = _read(model, part, evidence, own)
        return _inside_behind(model, sampling, points), sampling

    others = run_in_parallel([partial(tried, *each) for each in zip(parts, seeds, strict=True)])
    return max([(share, first), *others], key=lambda found: found[0])[1]


@torch.no_grad()
def _read(
    model: ShapeModel, points: NDArray[np.float64], evidence: ViewEvidence, rng: np.random.Generator
) -> Sampling:
    """A sampling of the points, and its encoding."""
    frame = network_frame(points)
    count = max(model.cloud_size, min(len(points), model.most_points))
    cloud = points[systematic_sample(points[:, :2], count, rng)]
    device = next(model.parameters()).device
    seen = float_tensor(frame.to_network(cloud), device)[None]
    camera = float_tensor(frame.to_network(np.zeros(3)), device)[None]
    around = surroundings_of([evidence], [frame], device)
    return Sampling(frame, model.encode(seen, camera, surroundings=around))


@torch.no_grad()
def _inside_behind(model: ShapeModel, sampling: Sampling, points: NDArray[np.float64]) -> float:
    """Share that is inside of places at `DEPTHS` behind evenly chosen points of [N, 3]."""
    chosen = points[np.linspace(0, len(points) - 1, min(CHECKED, len(points))).astype(int)]
    rays = chosen / np.maximum(np.linalg.norm(chosen, axis=1, keepdims=True), 1e-9)
    seen = sampling.frame.to_network(chosen)
    places = np.concatenate([seen + depth * rays for depth in DEPTHS])
    device = sampling.encoding.embedding.device
    values = model.decode(sampling.encoding, float_tensor(places, device)[None])
    return float((values < 0).float().mean())


def float_tensor(array: NDArray[np.float64], device: torch.device) -> torch.Tensor:
    """The array on the device, float32."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(device)
