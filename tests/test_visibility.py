"""Free, seen, unknown: states of rays around an object against geometry computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pointsdf_cli.geometry.visibility import SIZE, ViewEvidence, visibility_image
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.ray_evidence import image_coordinates
from pointsdf_cli.models.surroundings import (
    lower_plane,
    no_surroundings,
    plane_evidence,
    surroundings_of,
    transformed,
    visibility_evidence,
    without_evidence,
)

PITCH = 1 / 500


def patch(left: float, right: float, top: float, bottom: float, depth: float) -> np.ndarray:
    """Points [N, 3] of every pixel of a rectangle of tangents at a depth [m]."""
    x, y = np.meshgrid(np.arange(left, right, PITCH), np.arange(top, bottom, PITCH))
    return np.stack([x.ravel() * depth, y.ravel() * depth, np.full(x.size, depth)], axis=1)


OBJECT = patch(-0.05, 0.05, -0.05, 0.05, 1.0)
WALL = patch(0.054, 0.2, -0.2, 0.2, 2.0)
OCCLUDER = patch(-0.2, 0.2, -0.2, -0.054, 0.7)
VIEW = visibility_image(OBJECT, np.concatenate([WALL, OCCLUDER]), pitch=PITCH)


def cell(x: float, y: float) -> tuple[int, int]:
    left, top, width, height = VIEW.window
    return int((y - top) / height * SIZE), int((x - left) / width * SIZE)


def test_rays_are_free_up_to_what_was_seen_there_and_unknown_where_nothing_was() -> None:
    assert VIEW.seen[cell(0, 0)]
    assert VIEW.free[cell(0, 0)] == pytest.approx(1.0)
    assert not VIEW.seen[cell(0.08, 0.02)]
    assert VIEW.free[cell(0.08, 0.02)] == pytest.approx(2.0)
    # Behind an occluder nothing is known: the ray is free up to the occluder only.
    assert VIEW.free[cell(0, -0.08)] == pytest.approx(0.7)
    assert not VIEW.seen[cell(0, -0.08)]
    assert VIEW.free[cell(-0.08, 0.02)] == 0.0


def test_a_ray_that_ends_on_the_support_plane_is_free_all_along() -> None:
    table = patch(-0.2, 0.2, 0.054, 0.2, 1.0)
    plane = np.array([0.0, 0.0, -1.0, -1.0])  # the plane z = 1, its normal towards the camera
    known = visibility_image(OBJECT, table, plane, PITCH)
    unknown = visibility_image(OBJECT, table, None, PITCH)
    row, column = cell(0, 0.08)
    assert np.isinf(known.free[row, column])
    assert unknown.free[row, column] == pytest.approx(1.0)


def test_a_mask_shows_the_object_where_nothing_returned() -> None:
    rays = patch(-0.0795, -0.05, -0.05, 0.05, 1.0)[:, :2]
    masked = visibility_image(OBJECT, np.concatenate([WALL, OCCLUDER]), None, PITCH, rays)
    assert masked.seen[cell(-0.07, 0.0)]
    assert masked.free[cell(-0.07, 0.0)] == 0.0
    assert not VIEW.seen[cell(-0.07, 0.0)]
    # Nothing else changes.
    x = (np.arange(SIZE) + 0.5) / SIZE * VIEW.window[2] + VIEW.window[0]
    away = (x < -0.09) | (x > -0.04)
    assert np.array_equal(masked.seen[:, away], VIEW.seen[:, away])
    assert np.array_equal(masked.free[:, away], VIEW.free[:, away])


def test_the_pitch_is_estimated_where_it_is_not_known() -> None:
    guessed = visibility_image(OBJECT, np.concatenate([WALL, OCCLUDER]))
    assert np.array_equal(guessed.seen, VIEW.seen)
    assert np.array_equal(guessed.free, VIEW.free)


def evidence_at(points: np.ndarray, evidence: ViewEvidence) -> torch.Tensor:
    """The decoder's inputs about the visibility at points [Q, 3] of the camera frame."""
    frame = network_frame(OBJECT)
    around = surroundings_of([evidence], [frame], torch.device("cpu"))
    camera = torch.tensor(frame.to_network(np.zeros(3)), dtype=torch.float32)[None]
    x = torch.tensor(frame.to_network(points), dtype=torch.float32)[None]
    return visibility_evidence(image_coordinates(x, camera), camera, around)[0]


def test_the_decoder_reads_depths_and_distances_in_the_networks_units() -> None:
    frame = network_frame(OBJECT)
    places = np.array([[0, 0, 1.02], [0, 0, 0.98], [0.09, 0.02, 1.0], [-0.09, 0.02, 1.0]])
    known = evidence_at(places, ViewEvidence(VIEW))
    margin, to_free, to_seen, unknown = known[:, 0], known[:, 1], known[:, 2], known[:, -1]
    assert margin[0] == pytest.approx(-0.02 * frame.scale, abs=0.01)
    assert margin[1] == pytest.approx(0.02 * frame.scale, abs=0.01)
    assert margin[2] == 1.0  # seen through far beyond
    # The wall begins 4 mm beside the object; a cell is 2.8 mm wide.
    assert to_free[0] == pytest.approx(0.052 * frame.scale, abs=0.04)
    assert to_free[2] < 0 < to_free[0]
    assert to_seen[0] < 0 < to_seen[2]
    assert unknown.tolist() == pytest.approx([0, 0, 0, 1], abs=0.01)


def test_evidence_turns_mirrors_and_scales_with_the_view() -> None:
    frame = network_frame(OBJECT)
    plane = np.array([0.0, -1.0, 0.0, -0.05])
    around = surroundings_of([ViewEvidence(VIEW, plane)], [frame], torch.device("cpu"))
    camera = torch.tensor(frame.to_network(np.zeros(3)), dtype=torch.float32)[None]
    x = torch.rand(1, 50, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    turn = torch.tensor([[[0.6, -0.8, 0], [-0.8, -0.6, 0], [0, 0, 1.0]]])
    centre, scale = torch.tensor([[0.1, -0.05, 0.0]]), torch.tensor([1.25])

    def moved(points: torch.Tensor) -> torch.Tensor:
        return (points @ turn.transpose(1, 2) - centre) * 1.25

    after = transformed(around, turn, centre, scale)
    camera_after = moved(camera[None])[0]
    before = visibility_evidence(image_coordinates(x, camera), camera, around)
    now = visibility_evidence(image_coordinates(moved(x), camera_after), camera_after, after)
    inner = before[..., 0].abs() < 0.7  # beyond, depths are clipped
    assert torch.allclose(now[..., 0][inner], 1.25 * before[..., 0][inner], atol=1e-4)
    assert torch.allclose(now[..., 1:3], 1.25 * before[..., 1:3], atol=1e-4)
    heights = plane_evidence(x, x, around)[..., 0]
    assert torch.allclose(plane_evidence(moved(x), moved(x), after)[..., 0], 1.25 * heights)


def test_heights_are_above_the_support_plane() -> None:
    frame = network_frame(OBJECT)
    floor = ViewEvidence(None, np.array([0.0, -1.0, 0.0, -0.05]))  # y = 5 cm, y points down
    around = surroundings_of([floor], [frame], torch.device("cpu"))
    x = torch.tensor(frame.to_network(np.array([[0, 0.02, 1.0]])), dtype=torch.float32)[None]
    assert plane_evidence(x, x, around)[0, 0, 0] == pytest.approx(0.03 * frame.scale, abs=1e-5)
    assert plane_evidence(x, x, around)[0, 0, -2:].tolist() == [0.0, 1.0]


def test_what_is_left_out_reads_like_what_was_never_known() -> None:
    frame = network_frame(OBJECT)
    evidence = ViewEvidence(VIEW, np.array([0.0, -1.0, 0.0, -0.05]))
    known = surroundings_of([evidence], [frame], torch.device("cpu"))
    never = no_surroundings(1, torch.device("cpu"))
    lost = without_evidence(known, torch.tensor([False]), torch.tensor([False]))
    for before, after in zip(lost, never, strict=True):
        assert torch.equal(before, after)


SMALL = {
    "centres": (64, 32, 16, 8), "neighbours": (8, 8, 8, 4), "hidden": (8, 8, 8, 8),
    "channels": (8, 8, 16, 16), "width": 32, "blocks": 1, "local": 8, "heads": 1,
}  # fmt: skip


def test_a_lower_support_plane_is_lower_by_as_much() -> None:
    around = no_surroundings(2, torch.device("cpu"))
    around = around._replace(
        plane=torch.tensor([[0.0, -1.0, 0.0, -0.3], [0.0, -1.0, 0.0, -0.3]]),
        known=torch.tensor([[0.0, 1.0], [0.0, 0.0]]),
    )
    down = lower_plane(around, torch.tensor([0.2, 0.2]))
    # n points up and n·x = d, so a lower plane has a smaller d; one that is not known stays.
    assert torch.allclose(down.plane[:, 3], torch.tensor([-0.5, -0.3]))
    x = torch.tensor([[[0.0, 0.1, 0.0]]])
    cloud = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]]])
    first = down._replace(**{name: value[:1] for name, value in down._asdict().items()})
    assert plane_evidence(x, cloud, first)[0, 0, 0].item() == pytest.approx(0.4)


def test_dense_images_give_the_cells_that_a_search_of_every_pixel_gives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Thinning to one pixel a bin moves the silhouette by no more than a few cells' worth."""
    fine = PITCH / 4
    angle = np.arange(-0.15, 0.15, fine)
    x, y = np.meshgrid(angle, angle)
    tangents = np.stack([x.ravel(), y.ravel()], axis=1)
    inside = np.hypot(*tangents.T) < 0.05
    depth = np.where(inside, 1.0, 2.0)
    points = np.column_stack([tangents * depth[:, None], depth])
    thinned = visibility_image(points[inside], points[~inside], pitch=fine)
    monkeypatch.setattr(
        "pointsdf_cli.geometry.visibility._nearest_of_each_bin",
        lambda places, side: np.arange(len(places)),
    )
    exact = visibility_image(points[inside], points[~inside], pitch=fine)
    assert thinned.seen.sum() > 500
    assert (thinned.seen != exact.seen).sum() <= 8
    assert (thinned.free != exact.free).sum() <= 8
