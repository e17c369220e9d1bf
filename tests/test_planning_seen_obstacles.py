"""Other things as obstacles: hulls of what was seen, and reconstructions, which have a back."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scenes import box, cloud, seen, table

from pointsdf_cli.assets import asset_path
from pointsdf_cli.geometry.box import strictly_inside
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.seen_obstacles import KEPT_OFF, hulls, seen_obstacles
from pointsdf_cli.planning.seen_parts import convex_parts, thickened, with_foot
from pointsdf_cli.planning.table_top import TableTop, look_at_table
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.shading import look_at

ROBOT = load_robot()
LOW_CAMERA = look_at((1.3, 0.0, 0.13), (0.6, 0.0, 0.07))
FRONT, BEHIND = (0.72, 0.06), (0.52, -0.02)


def block(centre: tuple[float, float, float], half: float) -> np.ndarray:
    """Points 5 mm apart in a cube."""
    axis = np.arange(-half, half + 1e-9, 0.005)
    return np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3) + centre


def test_a_hull_encloses_its_points_and_reaches_down_to_the_table() -> None:
    things = np.concatenate([block((0.6, 0.2, 0.16), 0.03), block((0.6, -0.2, 0.2), 0.03)])
    found = hulls(things)
    assert len(found) == 2
    inside = np.zeros(len(things), dtype=bool)
    for hull in found:
        assert hull.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        solid = trimesh.Trimesh(hull.vertices, hull.faces)
        distance = trimesh.proximity.signed_distance(solid, things[::7])
        inside[::7] |= distance > -1e-6
    assert inside[::7].all()


def test_a_corner_of_walls_leaves_the_table_free() -> None:
    """Its convex hull would fill the corner."""
    rng = np.random.default_rng(0)
    back = rng.random((40_000, 3)) * (1.0, 0.01, 0.5) + (0.2, 0.5, 0.0)
    side = rng.random((40_000, 3)) * (0.01, 1.0, 0.5) + (0.2, -0.5, 0.0)
    shelf = rng.random((40_000, 3)) * (1.0, 0.3, 0.01) + (0.2, 0.2, 0.45)
    room = (0.21, -0.5, 0.0), (1.2, 0.5, 0.44)
    found = hulls(np.concatenate([back, side, shelf]), free=lambda x: strictly_inside(x, *room))
    assert len(found) < 30  # flat walls are not divided
    free = np.array([[0.6, 0.0, 0.1], [0.6, 0.3, 0.1], [0.9, 0.4, 0.3]])
    filled = np.array([[0.65, 0.505, 0.25], [0.205, 0.05, 0.25], [0.65, 0.35, 0.455]])
    inside = np.zeros(6, dtype=bool)
    for hull in found:
        solid = SignedDistance(hull.vertices, hull.faces)
        inside |= solid(np.concatenate([free, filled])) < 0
    assert not inside[:3].any()
    assert inside[3:].all()


def test_parts_reach_down_to_where_a_camera_saw_through() -> None:
    board = block((0.6, 0.2, 0.16), 0.03)
    whole = with_foot(board, lambda x: np.zeros(len(x), dtype=bool))
    assert whole[:, 2].min() == 0.0
    floating = with_foot(board, lambda x: x[:, 2] < 0.08)
    assert floating[:, 2].min() == pytest.approx(0.08, abs=0.02)
    below = with_foot(board - (0.0, 0.0, 0.2), lambda x: np.zeros(len(x), dtype=bool))
    assert below[:, 2].min() == pytest.approx(-0.07)  # points of an uneven table stay inside


def test_convex_things_are_not_divided() -> None:
    nowhere = convex_parts(block((0.6, 0.2, 0.1), 0.1), lambda x: np.zeros(len(x), dtype=bool))
    assert len(nowhere) == 1
    assert trimesh.convex.convex_hull(nowhere[0]).volume == pytest.approx(0.2**3, rel=1e-6)


def test_the_hand_may_reach_below_the_board_of_a_shelf() -> None:
    """Seen from the front, with a back wall: what the camera looked through is free."""
    at, pose = (0.7, 0.0), look_at((-0.1, 0.2, 0.5), (0.65, 0.0, 0.15))
    sides = [box((0.3, 0.02, 0.4), (at[0], side)) for side in (-0.4, 0.4)]
    board, back = box((0.3, 0.82, 0.02), at), box((0.02, 0.82, 0.4), (0.86, 0.0))
    board.apply_translation((0.0, 0.0, 0.38))
    can = box((0.06, 0.06, 0.15), (0.62, 0.1))
    view = cloud(seen(table(), *sides, board, back, can, pose=pose), pose)
    top = look_at_table([view], ["view"], None, np.zeros(0))
    for network in (None, load_model(None, "cpu")):
        found, _ = seen_obstacles(top, network)
        free = np.array([[0.56, 0.2, 0.3], [0.62, 0.0, 0.25], [0.65, -0.2, 0.15], [0.75, 0.3, 0.1]])
        assert not holds(found, free).any()
        solid = np.array([[0.7, 0.0, 0.395], [0.6, -0.3, 0.395], [0.7, 0.39, 0.2], [0.85, 0, 0.1]])
        assert holds(found, solid).all()


@pytest.mark.parametrize("sides", [(0.05, 0.05, 0.0), (0.05, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_flat_groups_are_thick_enough_for_distances(sides: tuple[float, ...]) -> None:
    """One side of a box, exactly seen, is flat; coal crashed on its hull."""
    points = np.random.default_rng(0).random((400, 3)) * sides + [0.6, 0.1, 0.1]
    thick = thickened(points)
    assert np.ptp(thick, axis=0) == pytest.approx(np.array(sides) + 0.001, abs=0.0025)
    (sheet,) = hulls(points * (1.0, 1.0, 0.0))
    assert sheet.hull.computeVolume() > 1e-10
    assert sheet.is_solid


def test_seen_things_take_no_name_that_an_obstacle_has() -> None:
    top = TableTop((), block((0.6, 0.0, 0.05), 0.03), (), 0.0)
    (one,), _ = seen_obstacles(top, None)
    assert one.name == "seen_1"
    (other,), _ = seen_obstacles(top, None, ["seen_1", "post"])
    assert other.name == "seen_2"
    assert Environment((one, other)).obstacles == (one, other)


@pytest.fixture(scope="module")
def two_boxes() -> TableTop:
    """A box that is seen whole, and one of 8 × 10 × 14 cm whose front alone is seen: the camera
    stands lower than its top, and the first box hides a part."""
    things = (table(), box((0.05, 0.06, 0.1), FRONT), box((0.08, 0.1, 0.14), BEHIND))
    view = cloud(seen(*things, pose=LOW_CAMERA, noise=0.0), LOW_CAMERA)
    in_front = TargetChoice(place=np.array([*FRONT, 0.05]))
    return look_at_table([view], ["view"], ROBOT, ROBOT.home, target=in_front)


HIDDEN = np.array([[*BEHIND, 0.07], [BEHIND[0] - 0.03, BEHIND[1], 0.07], [*BEHIND, 0.02]])
"""Places in the second box: its middle, 1 cm before its back, and near the table."""


def test_a_reconstructed_obstacle_holds_what_the_camera_cannot_see(two_boxes: TableTop) -> None:
    hull, _ = seen_obstacles(two_boxes, None)
    assert not holds(hull, HIDDEN).any()
    whole, seconds = seen_obstacles(two_boxes, load_model(None, "cpu"))
    assert holds(whole, HIDDEN).all()
    assert seconds > 0
    # The box in front is the object, and no obstacle; nor is the space between the two.
    free = np.array([[*FRONT, 0.05], [0.62, 0.02, 0.05], [BEHIND[0], BEHIND[1] + 0.12, 0.05]])
    assert not holds(whole, free).any()


def test_obstacles_are_little_larger_than_the_things(two_boxes: TableTop) -> None:
    whole, _ = seen_obstacles(two_boxes, load_model(None, "cpu"))
    volume = sum(trimesh.Trimesh(one.vertices, one.faces).volume for one in whole)
    grown = np.prod(np.array([0.08, 0.1, 0.14]) + 2 * KEPT_OFF)
    assert 0.8 * grown < volume < 1.8 * grown


def holds(obstacles: tuple[Obstacle, ...], points: np.ndarray) -> np.ndarray:
    """Mask of the points [N, 3] that lie in an obstacle."""
    inside = np.zeros(len(points), dtype=bool)
    for one in obstacles:
        inside |= SignedDistance(one.vertices, one.faces)(points) < 0
    return inside


def test_a_mug_is_an_obstacle_without_holes() -> None:
    scene = read_cloud(asset_path("clouds/table.ply"))
    top = look_at_table([scene], ["scene"], ROBOT, ROBOT.home)
    found, _ = seen_obstacles(top, load_model(None, "cpu"))
    bodies = [trimesh.Trimesh(one.vertices, one.faces) for one in found]
    # A box and a mug; its handle is a body of its own. A wall, a floor and a cavity that is open
    # above are a ball in topology.
    large = [body for body in bodies if body.volume > 1e-4]
    assert [body.euler_number for body in large] == [2, 2]
    assert all(body.is_watertight for body in large)
