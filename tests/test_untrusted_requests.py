"""Requests and texts that would be larger, or do more, than they look."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.trees import tree_of_npz, tree_to_npz
from pointsdf_cli.service.body_parts import CloudBody
from pointsdf_cli.service.identity import bundled_digest, weights_digest
from pointsdf_cli.viz.segment_picture import segment_picture
from pointsdf_cli.viz.viewer import plain


@pytest.mark.parametrize(
    "points", [["x" * 1000, "a"], [[0, 0, "1"]], [[[0]], [[1]], [[2]]], [np.zeros((9, 9))] * 3]
)
def test_what_is_no_number_is_refused_before_it_becomes_an_array(points: list) -> None:
    with pytest.raises(ValueError, match="numbers"):
        CloudBody(points=points)


def test_numbers_of_lists_and_arrays_are_read() -> None:
    for points in ([[0, 1, 2.5]], np.array([[0, 1, 2.5]])):
        assert CloudBody(points=points).points.tolist() == [[0, 1, 2.5]]


def test_an_array_stands_in_a_tree_once() -> None:
    one = tree_of_npz(tree_to_npz([np.zeros(3), np.ones(3)]), "body")
    assert [part.tolist() for part in one] == [[0, 0, 0], [1, 1, 1]]
    text = b'[{"$array": "a0"}, {"$array": "a0"}]'
    packed = io.BytesIO()
    np.savez(packed, tree=np.frombuffer(text, np.uint8), a0=np.zeros(3))
    with pytest.raises(InputError, match="a0"):
        tree_of_npz(packed.getvalue(), "body")


def test_a_camera_far_away_is_refused() -> None:
    pose = np.eye(4)
    pose[0, 3] = 600
    body = CloudBody(points=np.zeros((60, 3)), T_world_camera=pose)
    with pytest.raises(InputError, match="600 m away"):
        body.cloud()


def test_bundled_weights_are_compared_by_content() -> None:
    assert weights_digest(None) == bundled_digest()
    assert len(bundled_digest()) == 64


def test_text_of_files_is_no_markup() -> None:
    assert "<" not in plain('<img src=q onerror="x">')
    assert "*" not in plain("**bold**")
    assert plain("a mug 3") == "a mug 3"


def test_a_point_near_the_lens_does_not_shrink_the_picture(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pixels = np.concatenate([rng.uniform(-1, 1, (2000, 2)), [[0.0, 300.0]]])
    depth, number = np.ones(2001), np.r_[np.ones(500, int), np.zeros(1501, int)]
    path = tmp_path / "segment.png"
    segment_picture(path, pixels, depth, number, [(1, (0.0, 0.0))])
    width, height = Image.open(path).size
    assert 0.9 < width / height < 1.1
