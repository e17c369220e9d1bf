"""Neighbour searches against brute force and geometry that is known by hand."""

from __future__ import annotations

import gc
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from pykdtree.kdtree import KDTree

from pointsdf_cli.models import search_trees
from pointsdf_cli.models.neighbours import (
    TREE_FROM,
    farthest_point_order,
    gather,
    inverse_density,
    nearest_neighbours,
    squared_distances,
)


def _cloud(seed: int, batch: int, count: int) -> torch.Tensor:
    return torch.rand(batch, count, 3, generator=torch.Generator().manual_seed(seed)) - 0.5


def test_neighbours_on_a_line_are_the_adjacent_ones() -> None:
    line = torch.stack([torch.arange(10.0), torch.zeros(10), torch.zeros(10)], -1)[None]
    index = nearest_neighbours(torch.tensor([[[3.2, 0.0, 0.0]]]), line, 4)
    assert index[0, 0].tolist() == [3, 4, 2, 5]


@pytest.mark.parametrize("dimensions", [2, 3])
def test_many_queries_of_one_cloud_find_what_few_find(dimensions: int) -> None:
    cloud, queries = _cloud(3, 1, 400)[..., :dimensions], _cloud(4, 1, 2000)[..., :dimensions]
    many = nearest_neighbours(queries, cloud, 5)
    few = torch.cat(
        [nearest_neighbours(part, cloud, 5) for part in queries.split(TREE_FROM - 1, 1)], 1
    )
    assert torch.equal(many, few)


@pytest.mark.parametrize("inference", [False, True])
def test_a_cloud_that_was_moved_is_searched_where_it_is_now(inference: bool) -> None:
    """A tree stays with its points, and points may be changed in place."""
    with torch.inference_mode(inference):
        cloud, queries = _cloud(3, 1, 400) * 1.0, _cloud(4, 1, 200)
        before = nearest_neighbours(queries, cloud, 3)
        assert torch.equal(nearest_neighbours(queries, cloud, 3), before)
        cloud += 0.2
        assert torch.equal(nearest_neighbours(queries + 0.2, cloud, 3), before)


def test_a_tree_is_built_once_and_goes_with_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[int] = []

    def counted(points: np.ndarray) -> KDTree:
        built.append(len(points))
        return KDTree(points)

    monkeypatch.setattr(search_trees, "KDTree", counted)
    cloud, queries = _cloud(3, 1, 400), _cloud(4, 1, 200)
    gc.collect()
    kept = len(search_trees._TREES)
    for _ in range(3):
        nearest_neighbours(queries, cloud, 3)
    assert built == [400]
    assert len(search_trees._TREES) == kept + 1
    del cloud
    gc.collect()
    assert len(search_trees._TREES) == kept


def test_of_places_that_are_none_nothing_is_nearest() -> None:
    cloud, queries = _cloud(3, 1, 400), _cloud(4, 1, 200)
    for value in (torch.nan, torch.inf):
        queries[0, 7] = value
        with pytest.raises(ValueError, match="finite"):
            nearest_neighbours(queries, cloud, 3)
    cloud[0, 3, 1] = torch.nan
    with pytest.raises(ValueError, match="finite"):
        nearest_neighbours(_cloud(4, 1, 200), cloud, 3)
    with pytest.raises(ValueError, match="9 neighbours of 8 points"):
        nearest_neighbours(_cloud(4, 1, 200), _cloud(3, 1, 8), 9)


def test_searches_have_one_thread_whatever_is_asked_for_others() -> None:
    code = """
import os
import pointsdf_cli.models.search_trees
from threadpoolctl import threadpool_info
found = [p["num_threads"] for p in threadpool_info() if "pykdtree" in p["filepath"]]
print(os.environ["OMP_NUM_THREADS"], *found)
"""
    told = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"OMP_NUM_THREADS": "3"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert told[0] == "3"
    if len(told) == 1:
        pytest.skip("this pykdtree brings no OpenMP of its own")
    assert told[1:] == ["1"]


def test_squared_distances_of_a_3_4_5_triangle() -> None:
    a = torch.tensor([[[0.0, 0.0, 0.0]]])
    b = torch.tensor([[[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]])
    torch.testing.assert_close(squared_distances(a, b), torch.tensor([[[25.0, 0.0]]]))


def test_farthest_points_of_a_line_are_its_ends_then_its_middle() -> None:
    line = torch.stack([torch.linspace(0, 1, 101), torch.zeros(101), torch.zeros(101)], -1)[None]
    assert farthest_point_order(line, 3)[0].tolist() == [0, 100, 50]


def test_one_cloud_has_the_order_that_it_has_among_others() -> None:
    clouds = torch.randn(3, 1000, 3, generator=torch.Generator().manual_seed(5))
    together = farthest_point_order(clouds, 256)
    alone = [farthest_point_order(cloud[None], 256) for cloud in clouds]
    assert torch.equal(torch.cat(alone), together)


def test_farthest_points_are_nested_and_distinct() -> None:
    cloud = _cloud(0, 2, 300)
    long, short = farthest_point_order(cloud, 64), farthest_point_order(cloud, 16)
    assert torch.equal(long[:, :16], short)
    assert all(len(set(row.tolist())) == 64 for row in long)


def test_farthest_points_cover_what_random_ones_leave_out() -> None:
    cloud = _cloud(1, 1, 1000)
    chosen = gather(cloud, farthest_point_order(cloud, 64))
    radius = squared_distances(cloud, chosen).amin(-1).amax().sqrt()
    random_radius = squared_distances(cloud, cloud[:, :64]).amin(-1).amax().sqrt()
    assert radius < 0.8 * random_radius


def test_gather_takes_rows_of_its_own_cloud_and_sends_gradients_back() -> None:
    values = torch.arange(12.0).view(2, 3, 2).requires_grad_(True)
    index = torch.tensor([[[0, 2]], [[1, 1]]])
    picked = gather(values, index)
    assert picked[0, 0].tolist() == [[0.0, 1.0], [4.0, 5.0]]
    assert picked[1, 0].tolist() == [[8.0, 9.0], [8.0, 9.0]]
    picked.sum().backward()
    assert values.grad is not None
    assert values.grad[..., 0].tolist() == [[1.0, 0.0, 1.0], [0.0, 2.0, 0.0]]


def test_density_of_two_clusters_is_as_their_sizes() -> None:
    # Two far clusters of 30 and 10 equal points: densities stand as 3 to 1, inverses as 1 to 3.
    cloud = torch.cat([torch.zeros(30, 3), torch.full((10, 3), 9.0)])[None]
    inverse = inverse_density(cloud, bandwidth=0.1)[0]
    np.testing.assert_allclose(inverse[:30], 1.0 / 3.0, rtol=1e-5)
    np.testing.assert_allclose(inverse[30:], 1.0, rtol=1e-5)
