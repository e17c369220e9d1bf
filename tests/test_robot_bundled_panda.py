"""The bundled Panda: its maker's numbers, its jaws, and grasps that suit them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from conftest import run_cli
from planning_worlds import AroundObject, CylinderField, NearPalm

from pointsdf_cli.assets import asset_path, bundled_robots
from pointsdf_cli.choices import TOP
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import rotation_vector, transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.models.checkpoint_kinds import bundled_success
from pointsdf_cli.models.grasp_score import load_grasp_model
from pointsdf_cli.planning.plan_artifact import plan_of
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.reasons import few_grasps
from pointsdf_cli.planning.seeds import SeedConfig
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.target import Target
from pointsdf_cli.planning.variables import Variables
from pointsdf_cli.robot.check import check_robot
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.jaws import jaws_of
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.simulation.heuristic import HeuristicConfig, draw_preshape, hand_of
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.simulation.world import World


@pytest.fixture(scope="module")
def panda() -> RobotDescription:
    return load_robot("panda")


def hand_pose(robot: RobotDescription, arm: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and position of the hand's link."""
    q = torch.tensor([*arm, 0.04, 0.04], dtype=torch.float64)
    rotation, position = Kinematics(robot)(q)
    link = robot.tree.links.index("panda_hand")
    return rotation[link].numpy(), position[link].numpy()


def test_it_is_found_by_its_name_and_others_are_not(panda: RobotDescription) -> None:
    assert panda.name == "panda"
    assert load_robot("lbr4_allegro").name == load_robot().name == "lbr4_allegro"
    with pytest.raises(InputError) as caught:
        load_robot("pandas")
    assert "lbr4_allegro, lbr4_barrett, panda, ur5e_2f85" in str(caught.value)


def test_a_folder_of_its_name_does_not_hide_a_bundled_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "panda").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_robot("panda").name == "panda"


def test_limits_and_speeds_are_the_makers(panda: RobotDescription) -> None:
    lower = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    upper = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    assert panda.hard_lower[:7].tolist() == lower
    assert panda.hard_upper[:7].tolist() == upper
    assert panda.velocity[:7].tolist() == [2.175] * 4 + [2.61] * 3
    assert panda.effort[:7].tolist() == [87.0] * 4 + [12.0] * 3
    assert panda.hard_upper[7:].tolist() == [0.04, 0.04]


def test_forward_kinematics_are_those_of_the_dh_table(panda: RobotDescription) -> None:
    # d1 0.333, d3 0.316, d5 0.384, flange 0.107; a4 0.0825, a5 -0.0825, a7 0.088 m.
    down = np.diag([1.0, -1.0, -1.0])
    # Stretched: all of d1, d3, d5 up, the flange hangs down a7 ahead, the hand turned by 45°.
    rotation, position = hand_pose(panda, [0, 0, 0, 0, 0, 0, np.pi / 4])
    assert position == pytest.approx([0.088, 0, 0.333 + 0.316 + 0.384 - 0.107], abs=1e-8)
    assert np.allclose(rotation, down)
    # Elbow and wrist at right angles: the forearm level.
    rotation, position = hand_pose(panda, [0, 0, 0, -np.pi / 2, 0, np.pi / 2, np.pi / 4])
    ahead, above = 0.0825 + 0.384 + 0.088, 0.333 + 0.316 + 0.0825 - 0.107
    assert position == pytest.approx([ahead, 0, above], abs=1e-8)
    assert np.allclose(rotation, down)


def test_all_links_are_where_another_description_has_them(
    panda: RobotDescription, tmp_path: Path
) -> None:
    data = pytest.importorskip("pybullet_data", reason="PyBullet's robots are not installed")
    folder = tmp_path / "other"
    shutil.copytree(Path(data.getDataPath()) / "franka_panda", folder)
    shutil.copy(asset_path("robots/panda.yaml"), folder)
    other = load_robot(folder / "panda.yaml")
    for q in np.random.default_rng(0).uniform(panda.lower, panda.upper, (10, 9)):
        ours, theirs = (Kinematics(robot)(torch.from_numpy(q)) for robot in (panda, other))
        for i, link in enumerate(panda.tree.links):
            k = other.tree.links.index(link)
            assert np.allclose(ours[0][i], theirs[0][k], atol=1e-5)
            assert np.allclose(ours[1][i], theirs[1][k], atol=1e-5)


def test_it_passes_its_check(panda: RobotDescription) -> None:
    found = check_robot(panda)
    assert found.findings == ()
    assert found.reached > 0.95
    assert run_cli("robot", "check", "panda", "--json").code == 0


def test_its_jaws_open_eight_centimetres_and_the_allegro_has_none(panda: RobotDescription) -> None:
    jaws = jaws_of(panda)
    assert jaws is not None
    assert jaws.opening == pytest.approx(0.08, abs=1e-6)
    # The pads are the last 2 cm of fingers that stand 4.6 cm out of the palm.
    assert 0.02 < jaws.pads[0] < jaws.middle < jaws.pads[1] < 0.048
    assert jaws_of(load_robot()) is None


def standing_box(size: tuple[float, float, float]) -> np.ndarray:
    """Points on all faces of a box at (0.55, 0), its sides along x and y turned by 0.4 rad."""
    line = np.linspace(-0.5, 0.5, 9)
    grid = np.stack(np.meshgrid(line, line, line), -1).reshape(-1, 3)
    shell = grid[np.abs(grid).max(axis=1) > 0.49] * size
    c, s = np.cos(0.4), np.sin(0.4)
    return shell @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + (0.55, 0.0, size[2] / 2)


def test_preshapes_put_the_narrow_side_between_the_pads(panda: RobotDescription) -> None:
    hand, rng = hand_of(panda), np.random.default_rng(0)
    cloud = standing_box((0.05, 0.14, 0.12))
    jaws = hand.jaws
    assert jaws is not None
    kinds = set()
    for _ in range(40):
        preshape = draw_preshape(
            cloud, np.array([1.4, 0, 0.7]), np.zeros(3), hand, HeuristicConfig(), rng
        )
        palm = preshape.T_world_palm
        local = (cloud - palm[:3, 3]) @ palm[:3, :3]
        kinds.add(preshape.kind)
        # Across the jaws 5 cm and not 14, in front of the palm and as deep as the pads.
        assert np.ptp(local[:, 2]) < 0.08
        assert -0.02 < local[:, 0].min() < jaws.pads[1] < local[:, 0].max()
        assert (preshape.joints >= 0.039).all()
        if preshape.kind == TOP:
            # Of the two turns that hold alike the one that the wrist has at home.
            assert palm[:3, 2] @ jaws.home_z > -0.2
    assert kinds == {"side", "top"}


@pytest.mark.parametrize("there", ["whole", "hand"])
def test_one_jaw_takes_the_other_along(panda: RobotDescription, there: str) -> None:
    pytest.importorskip("pybullet")
    from pointsdf_cli.simulation.world import World

    with World(panda) as world:
        world.reset(None, None, panda.configuration(panda.home[:7], np.full(2, 0.04)), there)
        columns = panda.closing_columns
        world.joints.drive_at([-0.1, 0.1], columns, [20.0, 5.0])  # the second pulls the other way
        world.step(48)
        first, second = world.joints.state()[0][columns]
        assert first < 0.036
        assert first == pytest.approx(second, abs=5e-4)


def test_a_can_is_planned_for(panda: RobotDescription) -> None:
    can, rest = (0.55, 0.0, 0.1), np.array([0.04, 0.04])
    target = Target(
        CylinderField(0.025, 0.2, can),
        np.array(can) - 0.12,
        np.array(can) + 0.12,
        NearPalm((can[0] - 0.04, 0.0, 0.12), (1.0, 0.0, 0.0), rest, width=0.08),
        AroundObject(can, 0.04, rest),
    )
    few = SynthesisConfig(rounds=1, seeds=SeedConfig(palms=12, seeds=4))
    plan = plan_of(Planner(panda, PlannerConfig(synthesis=few)).search(target))
    assert plan.status == "ok", plan.sentence
    assert plan.link_clearance_object.min() >= 0.001
    local = plan.T_world_palm[:3, :3].T @ (np.array(can) - plan.T_world_palm[:3, 3])
    assert 0.0 < local[0] < 0.06
    assert abs(local[2]) < 0.02
    assert np.array_equal(plan.trajectory[0], panda.home)


def test_each_bundled_robot_has_success_weights_of_its_own() -> None:
    folders = {
        "lbr4_allegro": "grasp_geometry", "lbr4_barrett": "barrett_geometry",
        "panda": "panda_geometry", "ur5e_2f85": "ur5e_geometry",
    }  # fmt: skip
    assert set(folders) == set(bundled_robots())
    for name, folder in folders.items():
        robot = load_robot(name)
        found = bundled_success(robot)
        assert found is not None
        assert found.name == folder
        model = load_grasp_model(robot=robot)
        assert model.robot.name == name
        assert model.learned_from is not None
        assert model.learned_from >= 200
        assert (found / "model.safetensors").stat().st_size < 450_000
        assert not (found / "train_state.pt").exists()


def test_few_grasps_are_not_passed_over_in_silence() -> None:
    (said,) = few_grasps(20)
    assert "20 grasps" in said
    assert few_grasps(1000) == []
    assert few_grasps(None) == []  # older weights do not say


@pytest.mark.parametrize(("torque", "turns"), [(0.075, False), (0.1, True)])
def test_rubber_pads_resist_torsion(panda: RobotDescription, torque: float, turns: bool) -> None:
    """A ball of 3 cm between the jaws, without gravity. Rubber of 1.5 MPa pressed by 20 N touches
    it in a disc of 6.1 mm (Hertz): two pads resist 2 · 3π/16 · 6.1 mm · 0.6 · 20 N = 0.086 N m."""
    rotation, position = hand_pose(panda, panda.home[:7].tolist())
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    ball = prepare_object(LoadedMesh("ball", made.vertices, made.faces, "0", "none"))
    with World(panda) as world:
        between = transform(np.eye(3), rotation @ [0, 0, 0.1035] + position)
        world.reset(ball, between, panda.home)
        world.set_gravity([0, 0, 0])
        closing = panda.closing_columns
        world.joints.drive_at(panda.closing_speeds, closing, panda.effort[closing])
        for _ in range(round(1.5 / world.physics.step)):
            world.step()
        before = world.object.pose()
        for _ in range(round(0.5 / world.physics.step)):
            world._bullet.applyExternalTorque(
                world.object.body, -1, (torque * rotation[:, 1]).tolist(), world._bullet.WORLD_FRAME
            )
            world.step()
        after = world.object.pose()
    angle = float(np.linalg.norm(rotation_vector((after @ before.T)[None, :3, :3])))
    assert angle > 0.5 if turns else angle < 0.01


@pytest.mark.parametrize("link", ["panda_link7", "panda_hand"])
def test_a_camera_belongs_to_the_arm(panda: RobotDescription, tmp_path: Path, link: str) -> None:
    """The success network reads the hand's surface: with another hand it says so."""
    camera = f"""<link name="camera"><collision><geometry><box size="0.02 0.09 0.02"/></geometry>
      </collision></link><joint name="mount" type="fixed"><parent link="{link}"/>
      <child link="camera"/><origin xyz="0.06 0 0.03"/></joint></robot>"""
    text = panda.urdf.read_text().replace("</robot>", camera)
    (tmp_path / "panda.urdf").write_text(text)
    shutil.copy(asset_path("robots/panda.yaml"), tmp_path)
    robot = load_robot(tmp_path / "panda.yaml")
    if link == "panda_link7":
        assert load_grasp_model(robot=robot).robot.name == "panda"
    else:
        with pytest.raises(InputError, match="other shapes of the hand"):
            load_grasp_model(robot=robot)


def test_no_link_stands_out_of_its_shapes(panda: RobotDescription) -> None:
    """The maker's meshes, as PyBullet ships them: at most 5 mm outside of the primitives."""
    data = pytest.importorskip("pybullet_data", reason="PyBullet is not installed")
    folder = Path(data.getDataPath()) / "franka_panda" / "meshes"
    names = {f"panda_link{k}": f"link{k}" for k in range(8)} | {"panda_hand": "hand"}
    for link, name in names.items():
        file = folder / "visual" / f"{name}.obj"
        if not file.is_file():  # two links have only the other one
            file = folder / "collision" / f"{name}.obj"
        mesh = trimesh.load(file, force="mesh")
        points, _ = trimesh.sample.sample_surface(mesh, 1500, seed=0)
        outside = np.full(len(points), np.inf)
        for shape in panda.tree.shapes[link]:
            inside = trimesh.proximity.signed_distance(shape.as_mesh(), points)
            outside = np.minimum(outside, -inside)
        assert outside.max() < 0.005, (link, outside.max())


def test_both_jaws_are_one_variable(panda: RobotDescription) -> None:
    """The gripper has one motor: a plan with two widths could not be executed."""
    variables = Variables(panda)
    assert variables.count == 8
    rng = np.random.default_rng(0)
    x = rng.uniform(variables.lower, variables.upper, (20, 8))
    q = variables.configuration(x)
    np.testing.assert_array_equal(q[:, -1], q[:, -2])
    np.testing.assert_array_equal(variables.of(q), x)
    leaf = torch.tensor(x, requires_grad=True)
    weights = rng.standard_normal(q.shape)
    (variables.configuration_tensor(leaf) * torch.from_numpy(weights)).sum().backward()
    assert leaf.grad is not None
    np.testing.assert_allclose(variables.derivatives(weights), leaf.grad.numpy())
    open_hand = np.array([[0.04, 0.02]])
    np.testing.assert_allclose(variables.coupled(open_hand), [[0.04, 0.04]])
    drawn = panda.configuration(panda.home[panda.arm], np.array([0.03, 0.01]))
    np.testing.assert_allclose(drawn[-2:], [0.03, 0.03])
