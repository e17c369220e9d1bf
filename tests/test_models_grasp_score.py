"""Scores of one object: right frames, right gradients, calibrated numbers, bundled weights."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from grasp_worlds import camera_pose, seen_ball, side_palm

from pointsdf_cli.assets import bundled_robots
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.models.checkpoint_kinds import bundled_success
from pointsdf_cli.models.grasp_checkpoint import (
    other_training_reconstruction,
    read_grasp_checkpoint,
    reconstruction_to_plan_with,
    write_grasp_checkpoint,
)
from pointsdf_cli.models.grasp_features import GraspFeatures
from pointsdf_cli.models.grasp_prior import GraspPrior
from pointsdf_cli.models.grasp_score import GraspModel, load_grasp_model
from pointsdf_cli.models.grasp_success import EmbeddingNet, GeometryNet, grasp_numbers
from pointsdf_cli.models.hand_sweep import HandSweep
from pointsdf_cli.models.registry import build_model, default_checkpoint, load_model
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.kinematics import Kinematics

ROBOT = load_robot()
SWEEP = HandSweep(ROBOT)
CENTRE, RADIUS = np.array([0.6, 0.0, 0.04]), 0.04
POSE = camera_pose(CENTRE)
CLOUD = seen_ball(CENTRE, RADIUS, POSE, np.random.default_rng(0))


class Ball:
    """The exact distance to the ball."""

    def with_gradient(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = points - CENTRE
        length = np.linalg.norm(offset, axis=1)
        return length - RADIUS, offset / np.maximum(length, 1e-9)[:, None]


def model(network: EmbeddingNet | GeometryNet) -> GraspModel:
    prior = GraspPrior(
        torch.tensor([0.5, 0.5]),
        torch.eye(3).repeat(2, 1, 1),
        torch.zeros(2, 14),
        torch.eye(14).repeat(2, 1, 1),
        torch.tensor(ROBOT.preshape_ranges.copy()),
    )
    return GraspModel(network.eval(), prior, load_model(), ROBOT, SWEEP)


def embedding_model() -> GraspModel:
    torch.manual_seed(1)
    return model(EmbeddingNet(8))


def geometry_model() -> GraspModel:
    torch.manual_seed(1)
    return model(GeometryNet(GraspFeatures(SWEEP, ROBOT.preshape_ranges).size))


def configurations(count: int) -> torch.Tensor:
    """Whole arm-hand configurations near the ball: home, and the preshape, jittered."""
    rng = np.random.default_rng(5)
    q = ROBOT.configuration(
        ROBOT.home[ROBOT.arm] + rng.normal(size=(count, 7)) * 0.1,
        rng.uniform(*(0.8 * ROBOT.preshape_ranges.T), (count, 8)),
    )
    return torch.tensor(q)


@pytest.mark.parametrize("make", [embedding_model, geometry_model])
def test_gradients_reach_the_joints_through_the_palms_kinematics(make) -> None:  # type: ignore[no-untyped-def]
    kinematics = Kinematics(ROBOT)
    q = configurations(6)
    # The object is put where the palm is, so that what is differentiated is not saturated.
    palm = kinematics.palm(q).numpy()
    where = palm[0, :3, 3] + palm[0, :3, :3] @ [0.07, 0.0, 0.03]
    pose = camera_pose(where)
    cloud = seen_ball(where, RADIUS, pose, np.random.default_rng(0))
    shift = where - CENTRE

    class Moved(Ball):
        def with_gradient(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return super().with_gradient(points - shift)

    grasps = make().on(cloud, pose, Moved())

    def log_success(q: torch.Tensor) -> torch.Tensor:
        return grasps.log_success(q[:, ROBOT.preshape_columns], kinematics.palm(q)).double()

    (gradient,) = torch.autograd.grad(log_success(q.requires_grad_(True)).sum(), q)
    direction = torch.tensor(np.random.default_rng(7).normal(size=(5, *q.shape)))
    direction[..., ROBOT.joint_names.index("thumb_joint_2") :] = 0.0
    step = 5e-5
    for way in direction:
        with torch.no_grad():
            change = log_success(q + step * way) - log_success(q - step * way)
        slope, expected = change / (2 * step), (gradient * way).sum(1)
        scale = float(expected.abs().max())
        assert scale > 1e-3
        # Small, for the grid has kinks at its cells' borders and the network where a ReLU bends.
        assert torch.allclose(slope, expected, atol=0.05 * scale)


def test_the_published_input_is_the_palm_in_the_objects_frame() -> None:
    grasps = embedding_model().on(CLOUD, POSE)
    seen = []
    network = grasps._model.network
    original = network.forward
    network.forward = lambda numbers, *more: seen.append(numbers) or original(numbers, *more)  # type: ignore[method-assign]
    palm = side_palm(CENTRE, 0.03, RADIUS, 1.0)
    preshape = torch.zeros(1, 8)
    grasps.log_success(preshape, torch.tensor(palm)[None])
    in_camera = invert_transform(POSE) @ palm
    low, high = CLOUD.min(0), CLOUD.max(0)
    scale = 1 / (1.03 * (high - low).max())
    assert np.allclose(seen[0][0, 8:11], (in_camera[:3, 3] - (low + high) / 2) * scale, atol=1e-4)
    assert np.allclose(seen[0][0, 11:14], in_camera[:3, 0], atol=1e-5)
    assert np.allclose(seen[0][0, 14:17], in_camera[:3, 1], atol=1e-5)


def test_moving_camera_object_and_palm_together_changes_nothing() -> None:
    motion = transform([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.1, -0.3, 0.0])
    palm = torch.tensor(np.array([side_palm(CENTRE, g, RADIUS, 1.0) for g in (0.0, 0.02, 0.05)]))
    preshape = torch.tensor(ROBOT.preshape_ranges.mean(1)).repeat(3, 1)
    back = invert_transform(motion)

    class Moved(Ball):
        def with_gradient(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return super().with_gradient(apply_transform(back, points))

    for make in (embedding_model, geometry_model):
        here = make().on(CLOUD, POSE, Ball())
        there = make().on(CLOUD, motion @ POSE, Moved())
        moved = torch.tensor(motion) @ palm
        assert torch.allclose(
            here.log_success(preshape, palm), there.log_success(preshape, moved), atol=0.02
        )


def test_a_rotation_that_grows_through_half_a_turn_has_no_jump() -> None:
    angle = torch.linspace(3.0, 3.3, 50)
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    rows = [torch.cos(angle), -torch.sin(angle), zero, zero,
            torch.sin(angle), torch.cos(angle), zero, zero,
            zero, zero, one, zero, zero, zero, zero, one]  # fmt: skip
    numbers = grasp_numbers(torch.zeros(50, 8), torch.stack(rows, 1).unflatten(1, (4, 4)))
    assert (numbers[1:] - numbers[:-1]).abs().max() < 0.01


def test_averaged_members_are_what_each_says_alone() -> None:
    torch.manual_seed(0)
    network = GeometryNet(5, members=3, widths=(4,)).eval()
    x = torch.randn(7, 5)
    weights = network.hidden[0].weight
    for m, logits in enumerate(network.members(x)):
        h = torch.nn.functional.layer_norm(x @ weights[m], (4,))
        h = torch.nn.functional.gelu(h) @ network.leave.weight[m]
        assert torch.allclose(h.squeeze(1), logits, atol=1e-5)


def test_the_bundled_model_prefers_a_palm_at_the_object_to_one_far_away() -> None:
    grasps = load_grasp_model().on(CLOUD, POSE, Ball())
    rng = np.random.default_rng(0)
    found = {}
    for kind in ("side", "top"):
        preshape, palm = map(torch.tensor, grasps.sample(kind, 60, rng))
        near = grasps.log_success(preshape, palm).exp()
        away = palm.clone()
        away[:, :3, 3] -= 0.25 * palm[:, :3, 0]
        found[kind] = float(near.mean()), float(grasps.log_success(preshape, away).exp().mean())
        assert ((near > 0) & (near < 1)).all()
        assert (grasps.log_prior(preshape, palm) > grasps.log_prior(preshape, away)).all()
    assert found["side"][0] > 2 * found["side"][1]
    assert found["top"][0] > 2 * found["top"][1]


def test_the_networks_own_field_serves_where_none_is_given() -> None:
    bundled = load_grasp_model()
    exact, own = bundled.on(CLOUD, POSE, Ball()), bundled.on(CLOUD, POSE)
    preshape, palm = map(torch.tensor, exact.sample("side", 50, np.random.default_rng(1)))
    a, b = exact.log_success(preshape, palm), own.log_success(preshape, palm)
    assert float(np.corrcoef(a, b)[0, 1]) > 0.8


def test_narrower_ranges_of_a_robot_bound_samples_and_leave_scores() -> None:
    """Features are scaled as in training."""
    trained = load_grasp_model()
    middle = ROBOT.preshape_ranges.mean(axis=1, keepdims=True)
    narrow = middle + 0.1 * (ROBOT.preshape_ranges - middle)
    here = replace(trained, robot=replace(ROBOT, preshape_ranges=narrow)).on(CLOUD, POSE)
    preshape, palms = here.sample("side", 50, np.random.default_rng(0))
    assert (preshape >= narrow[:, 0] - 1e-6).all()
    assert (preshape <= narrow[:, 1] + 1e-6).all()
    asked = torch.from_numpy(preshape), torch.from_numpy(palms)
    torch.testing.assert_close(here.logit(*asked), trained.on(CLOUD, POSE).logit(*asked))


def test_bad_clouds_and_poses_are_refused() -> None:
    bundled = load_grasp_model()
    with pytest.raises(InputError, match="rigid"):
        bundled.on(CLOUD, 2 * POSE, Ball())
    with pytest.raises(InputError, match="cloud of shape"):
        bundled.on(CLOUD[:, :2], POSE, Ball())


def stored(folder: Path, mode: str = "fixed", frozen: Path | None = None) -> Path:
    made = embedding_model()
    encoder = build_model("voxelcnn") if mode == "scratch" else made.encoder
    weights = {f"network.{n}": t for n, t in made.network.state_dict().items()}
    if mode == "scratch":
        weights |= {f"encoder.{n}": t for n, t in encoder.state_dict().items()
                    if n.startswith(encoder.encoder_parts)}  # fmt: skip
    write_grasp_checkpoint(
        folder, network=made.network, encoder=encoder, weights=weights, prior=made.prior,
        frozen_from=frozen, mode=mode, robot=ROBOT, sweep=SWEEP, provenance={}, half=True,
    )  # fmt: skip
    return folder


def test_a_bundled_encoder_is_named_and_not_stored_again(tmp_path: Path) -> None:
    path = stored(tmp_path / "gs", frozen=default_checkpoint())
    config = json.loads((path / "config.json").read_text())
    assert config["encoder"]["checkpoint"] == "bundled:pointsdf_real"
    assert (path / "model.safetensors").stat().st_size < 300_000
    made, read = embedding_model(), load_grasp_model(path)
    palm = torch.tensor(side_palm(CENTRE, 0.02, RADIUS, 1.0))[None]
    a = made.on(CLOUD, POSE).log_success(torch.zeros(1, 8), palm)
    assert torch.allclose(a, read.on(CLOUD, POSE).log_success(torch.zeros(1, 8), palm), atol=0.02)


def test_a_trained_encoder_is_stored_without_its_decoder(tmp_path: Path) -> None:
    path = stored(tmp_path / "gs", mode="scratch")
    assert read_grasp_checkpoint(path).encoder.architecture == "voxelcnn"
    names = json.dumps(sorted(read_weights(path)))
    assert "encoder.to_embedding" in names
    assert "decoder" not in names


@pytest.mark.parametrize(
    "change",
    [
        lambda config: config.pop("robot"),
        lambda config: config["robot"].pop("preshape_joints"),
        lambda config: config.pop("mode"),
        lambda config: config.update(encoder="there"),
    ],
)
def test_a_damaged_description_is_one_message(
    tmp_path: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    path = stored(tmp_path / "gs", frozen=default_checkpoint())
    config = json.loads((path / "config.json").read_text())
    change(config)
    (path / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="no usable"):
        read_grasp_checkpoint(path)


def read_weights(path: Path) -> list[str]:
    from safetensors import safe_open

    with safe_open(path / "model.safetensors", "pt") as file:
        return list(file.keys())


def test_missing_and_exchanged_encoders_are_told(tmp_path: Path) -> None:
    encoder = tmp_path / "sdf"
    shutil.copytree(default_checkpoint(), encoder)
    path = stored(tmp_path / "gs", frozen=encoder)
    load_grasp_model(path)
    elsewhere = tmp_path / "moved"
    encoder.rename(elsewhere)
    with pytest.raises(InputError, match="encoder of its training is missing") as missing:
        load_grasp_model(path)
    assert "--sdf" in missing.value.message
    load_grasp_model(path, elsewhere)
    weights = (elsewhere / "model.safetensors").read_bytes()
    (elsewhere / "model.safetensors").write_bytes(weights[:-1] + b"\x01")
    with pytest.raises(InputError, match="other weights"):
        load_grasp_model(path, elsewhere)


def test_another_robot_and_another_kind_of_checkpoint_are_refused(tmp_path: Path) -> None:
    path = stored(tmp_path / "gs", frozen=default_checkpoint())
    gripper = load_robot(Path(__file__).parent / "robots" / "gripper.yaml")
    with pytest.raises(InputError, match="lbr4_allegro"):
        load_grasp_model(path, robot=gripper)
    with pytest.raises(InputError, match="pointsdf-ray"):
        load_grasp_model(default_checkpoint())


@pytest.mark.parametrize(
    ("was", "now"),
    [
        pytest.param("index_joint_1: 0.2\n", "index_joint_1: -0.2\n", id="a finger that opens"),
        pytest.param("palm, xyz: [0, 0, 0]", "palm, xyz: [0.02, 0, 0]", id="another palm frame"),
    ],
)
def test_another_hand_of_the_same_name_is_refused(tmp_path: Path, was: str, now: str) -> None:
    folder = load_robot().urdf.parent
    shutil.copytree(folder, tmp_path / "robot")
    file = tmp_path / "robot" / "lbr4_allegro.yaml"
    text = file.read_text(encoding="utf-8")
    assert was in text
    load_grasp_model(robot=load_robot(file))
    file.write_text(text.replace(was, now), encoding="utf-8")
    with pytest.raises(InputError, match="another hand"):
        load_grasp_model(robot=load_robot(file))


def test_world_points_reach_the_field_in_the_world() -> None:
    asked = []

    class Spy(Ball):
        def with_gradient(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            asked.append(points)
            return super().with_gradient(points)

    load_grasp_model().on(CLOUD, POSE, Spy())
    world = apply_transform(POSE, CLOUD)
    points = np.concatenate(asked)
    assert (points.min(0) <= world.min(0)).all()
    assert (points.max(0) >= world.max(0)).all()
    assert np.abs(points.mean(0) - CENTRE).max() < 0.1


def test_a_network_on_geometry_is_known_to_read_another_reconstruction() -> None:
    bundled = default_checkpoint().parent
    assert (
        other_training_reconstruction(bundled / "grasp_geometry", bundled / "pointsdf_plan") is None
    )
    other = other_training_reconstruction(bundled / "grasp_geometry", bundled / "pointsdf")
    assert str(other) == "bundled:pointsdf_plan"
    # Each bundled robot's plans read the network that its success weights were trained on.
    learned = {
        robot: reconstruction_to_plan_with(bundled_success(load_robot(robot))).name
        for robot in bundled_robots()
    }
    assert learned == {
        "lbr4_allegro": "pointsdf_plan", "lbr4_barrett": "pointsdf_plan", "panda": "pointsdf_plan",
        "ur5e_2f85": "pointsdf_plan",
    }  # fmt: skip
    assert reconstruction_to_plan_with(None) == default_checkpoint()
    assert reconstruction_to_plan_with(bundled / "grasp_scratch") == default_checkpoint()
    # One that brings its encoder along reads no field.
    assert other_training_reconstruction(bundled / "grasp_scratch", bundled / "pointsdf") is None
