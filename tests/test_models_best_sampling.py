"""The best of several samplings of one cloud, with networks whose answers are known."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from pointsdf_cli.geometry.cloud_sampling import all_but_every
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.models.best_sampling import LEFT_OUT, SAMPLINGS, best_sampling
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.processor import one_thread
from pointsdf_cli.models.shape_model import Encoding, ShapeModel


@pytest.fixture(autouse=True)
def in_turn() -> Iterator[None]:
    """The networks below answer by the order in which they are asked."""
    with one_thread():
        yield


class HalfSpaces(ShapeModel):
    """Network whose encodings are solid behind a depth, `depths[k]` in the k-th one it is asked
    for: z > depth is inside, network frame."""

    cloud_size = 50
    most_points = 500

    def __init__(self, depths: list[float]) -> None:
        super().__init__()
        self.unused = nn.Parameter(torch.zeros(1))
        self.depths, self.sizes = depths, []

    def config(self) -> dict[str, Any]:
        return {}

    def encode(self, cloud: Tensor, camera: Tensor, *_: Any, **__: Any) -> Encoding:
        depth = self.depths[len(self.sizes)]
        self.sizes.append(cloud.shape[1])
        return Encoding(torch.full((1, 1), depth), {})

    def decode(self, encoding: Encoding, x: Tensor) -> Tensor:
        return encoding.embedding - x[..., 2]


def flat_cloud(count: int = 400) -> np.ndarray:
    """Points [count, 3] of a flat disc 1 m before the camera, which are at z = 0 of the network."""
    rng = np.random.default_rng(3)
    angle, radius = rng.uniform(0, 2 * np.pi, count), 0.05 * np.sqrt(rng.random(count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(count)], axis=1)


def chosen_depth(model: HalfSpaces, points: np.ndarray, tries: int = SAMPLINGS) -> float:
    """Depth of the encoding that is chosen."""
    found = best_sampling(model, points, ViewEvidence(), tries, np.random.default_rng(0))
    return float(found.encoding.embedding)


def test_an_empty_answer_gives_way_to_a_solid_one() -> None:
    model = HalfSpaces([9.0, 9.0, -0.1, 9.0])
    assert chosen_depth(model, flat_cloud()) == pytest.approx(-0.1)
    assert len(model.sizes) == 4
    assert model.sizes[0] == 400
    assert all(250 < size < 380 for size in model.sizes[1:])  # four fifths of the points


def test_a_solid_answer_is_read_once() -> None:
    model = HalfSpaces([-0.1])
    assert chosen_depth(model, flat_cloud()) == pytest.approx(-0.1)
    assert model.sizes == [400]


def test_of_half_solid_answers_the_most_solid_wins_and_the_first_of_equals() -> None:
    # Looked at 0.05 and 0.1 behind: inside at none, at one, at both of them.
    assert chosen_depth(HalfSpaces([0.2, 0.07, 0.2, 0.01]), flat_cloud()) == pytest.approx(0.01)
    assert chosen_depth(HalfSpaces([0.07, 0.08, 0.09, 0.2]), flat_cloud()) == pytest.approx(0.07)


@pytest.mark.parametrize(("count", "tries"), [(20, SAMPLINGS), (400, 1)])
def test_few_points_and_one_try_are_read_once(count: int, tries: int) -> None:
    model = HalfSpaces([9.0])
    assert chosen_depth(model, flat_cloud(count), tries) == pytest.approx(9.0)
    assert len(model.sizes) == 1


def test_the_frame_is_of_the_points_that_were_read() -> None:
    points = flat_cloud()
    solid_first = best_sampling(
        HalfSpaces([-0.1]), points, ViewEvidence(), SAMPLINGS, np.random.default_rng(0)
    )
    assert solid_first.frame.scale == network_frame(points).scale
    solid_later = best_sampling(
        HalfSpaces([9.0, -0.1, 9.0, 9.0]), points, ViewEvidence(), SAMPLINGS,
        np.random.default_rng(0),
    )  # fmt: skip
    part = points[all_but_every(points[:, :2], LEFT_OUT, 0)]
    assert solid_later.frame.scale == network_frame(part).scale


def test_each_point_is_left_out_once() -> None:
    plane = flat_cloud(103)[:, :2]
    parts = [all_but_every(plane, LEFT_OUT, first) for first in range(LEFT_OUT)]
    assert sorted(len(part) for part in parts) == [82, 82, 82, 83, 83]
    times = np.bincount(np.concatenate(parts), minlength=103)
    assert (times == LEFT_OUT - 1).all()
    assert all((np.diff(part) > 0).all() for part in parts)
