"""The box of a partial cloud: against boxes that stand where they were put."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.box_frame import BOX_SIZE, GAPS, box_evidence, box_frame
from pointsdf_cli.models.registry import build_model
from pointsdf_cli.models.revolution import Axis, revolution_axis

CAMERA = torch.tensor([[0.0, 0.0, -5.0]])
HALF = np.array([0.2, 0.35, 0.12])


def turn(seed: int) -> np.ndarray:
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return rotation * np.sign(np.linalg.det(rotation))


def carton(rotation: np.ndarray, noise: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Points [1, N, 3] and normals of the faces that the camera sees, the carton at the origin."""
    rng = np.random.default_rng(0)
    points, normals = [], []
    for axis in range(3):
        normal = rotation[:, axis]
        normal = -normal if normal[2] > 0 else normal  # towards the camera, at −z
        flat = rng.uniform(-1, 1, (2000, 3)) * HALF
        flat[:, axis] = HALF[axis] * np.sign(normal @ rotation[:, axis])
        points.append(flat @ rotation.T)
        normals.append(np.broadcast_to(normal, flat.shape))
    noisy = np.concatenate(normals) + noise * rng.normal(size=(6000, 3))
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    cloud = np.concatenate(points)[None].astype("f4")
    return torch.from_numpy(cloud), torch.from_numpy(noisy[None].astype("f4"))


def frame_of(points: torch.Tensor, normals: torch.Tensor):
    axis = revolution_axis(points, normals, CAMERA)
    return box_frame(normals, points, CAMERA, axis), axis


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_cartons_faces_are_found(seed: int, noise: float) -> None:
    """Edges, their lengths, and where the three hidden faces lie."""
    rotation = turn(seed)
    box, _ = frame_of(*carton(rotation, noise))
    found = box.directions[0].numpy()
    along = np.abs(found @ rotation)
    assert along.max(axis=1) == pytest.approx(1, abs=1e-3)  # each direction is an edge's
    assert sorted(along.argmax(axis=1)) == [0, 1, 2]
    half = HALF[along.argmax(axis=1)]
    # The outermost of some thousand points lies 3e-4 from an edge; a direction that leans by one
    # degree reaches 0.35 · 0.017 further.
    off = 1e-3 if noise == 0 else 6e-3
    assert box.ends[0, :, 0].numpy() == pytest.approx(half, abs=off)
    assert box.ends[0, :, 1].numpy() == pytest.approx(-half, abs=off)
    facing = -found[:, 2]
    assert (facing > 0).all()
    assert (np.diff(facing) <= 0).all()


def test_a_query_reads_its_distance_from_the_box() -> None:
    box, axis = frame_of(*carton(np.eye(3)))
    x = torch.tensor([[[0.5, 0.0, 0.0], [0.0, 0.0, 0.1], [0.3, 0.45, 0.0], [0.0, 0.0, 0.32]]])
    overall = box_evidence(x, box, axis)[0, :, GAPS - 1]
    # Off a face, inside (0.02 from the nearest face), off an edge, behind. The outside of hidden
    # faces is measured from the inner end: half a percent of the points lie on the far edges.
    assert overall.numpy() == pytest.approx([0.3, -0.02, np.hypot(0.1, 0.1), 0.2], abs=6e-3)


def test_every_gap_is_the_distance_that_can_be_computed_by_hand() -> None:
    """From the near face, the far face, its inner end; then radius and ends about an axis."""
    points, normals = carton(np.eye(3))
    up = Axis(*(torch.tensor(v) for v in ([[0.0, 0, 1]], [[0.0, 0, 0]], [0.01], [1.0])))
    box = box_frame(normals, points, CAMERA, up)
    place = np.array([0.3, -0.1, 0.05], dtype="f4")
    evidence = box_evidence(torch.from_numpy(place)[None, None], box, up)[0, 0].numpy()

    directions = box.directions[0].numpy()
    half, along = np.abs(directions) @ HALF, directions @ place
    gaps = evidence[:GAPS]
    assert gaps[:3] == pytest.approx(along - half, abs=1e-3)
    assert gaps[3:6] == pytest.approx(-half - along, abs=1e-3)
    # Half a percent of the points lie beyond the inner ends, at most a hundredth of a side.
    assert (gaps[6:9] >= gaps[3:6]).all()
    assert gaps[6:9] == pytest.approx(-half - along, abs=8e-3)
    corner = np.hypot(0.2, 0.35)  # the carton's points that are furthest from the axis
    about = [np.hypot(0.3, 0.1) - corner, 0.05 - 0.12, -0.12 - 0.05, -0.12 - 0.05]
    assert gaps[9:13] == pytest.approx(about, abs=8e-3)
    assert evidence[GAPS : 2 * GAPS] == pytest.approx(np.tanh(gaps / 0.01), abs=1e-4)
    assert evidence[2 * GAPS : 3 * GAPS] == pytest.approx(np.tanh(gaps / 0.05), abs=1e-4)
    assert evidence[3 * GAPS :] == pytest.approx(box.trust[0].numpy())
    # All normals keep to the directions; a third of them to each; the size comes last.
    assert box.trust[0, :3].numpy() == pytest.approx([1 / 3] * 3, abs=1e-3)
    assert box.trust[0, 3:6].numpy() == pytest.approx([1 / 3] * 3, abs=1e-3)
    assert box.trust[0, 10:].numpy() == pytest.approx(2 * half, abs=1e-3)


def test_evidence_turns_with_the_camera_and_does_not_mind_a_mirror() -> None:
    """Training turns and mirrors views about the optical axis: the same numbers must come out."""
    points, normals = carton(turn(1), 0.05)
    x = torch.rand(1, 50, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    box, axis = frame_of(points, normals)
    seen = box_evidence(x, box, axis)
    c, s = np.cos(0.7), np.sin(0.7)
    for mirror in (1.0, -1.0):
        spin = torch.tensor([[c * mirror, s * mirror, 0], [-s, c, 0], [0, 0, 1]]).float()
        box, axis = frame_of(points @ spin, normals @ spin)
        again = box_evidence(x @ spin, box, axis)
        assert again.numpy() == pytest.approx(seen.numpy(), abs=2e-3)


def test_evidence_is_differentiable_everywhere() -> None:
    """Also inside, on the axis and on a face: the planner follows this gradient."""
    points, normals = carton(np.eye(3))
    box, _ = frame_of(points, normals)
    axis = Axis(*(torch.tensor(v) for v in ([[0.0, 0, 1]], [[0.0, 0, 0]], [0.01], [1.0])))
    x = torch.tensor([[[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.3, 0.45, 0.2], [0.11, 0.07, 0.03]]])
    box, axis = (type(v)(*(t.double() for t in v)) for v in (box, axis))
    x = x.double().requires_grad_(True)
    value = box_evidence(x, box, axis)
    assert value.shape == (1, 4, BOX_SIZE)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    assert torch.isfinite(gradient).all()
    smooth = x[:, 3:].detach().requires_grad_(True)
    assert torch.autograd.gradcheck(lambda at: box_evidence(at, box, axis), smooth)


def test_the_box_needs_the_axis() -> None:
    with pytest.raises(InputError, match="axis of revolution"):
        build_model("pointsdf-ray", {"box": True})
