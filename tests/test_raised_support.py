"""Things on a tray, in a box, on a pedestal: each by itself, and what they stand on apart."""

from __future__ import annotations

import numpy as np
import pytest
import scenes
import trimesh

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.raised_support import BAND, raised_support
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.planning.labelled_view import WORKSPACE, LabelledView, label_view
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.seen_obstacles import seen_obstacles
from pointsdf_cli.planning.table_top import look_at_table, table_height
from pointsdf_cli.viz.shading import look_at

ABOVE = look_at((1.2, -0.1, 0.95), (0.6, 0.0, 0.05))
FLOOR = 0.02


def lifted(thing: trimesh.Trimesh, height: float) -> trimesh.Trimesh:
    thing.apply_translation((0.0, 0.0, height))
    return thing


def bin_walls(height: float = 0.09) -> list[trimesh.Trimesh]:
    """A bin of 40 by 30 cm with a floor 2 cm thick."""
    x, y, thick = 0.4, 0.3, 0.01
    return [
        scenes.box((x, y, FLOOR), (0.6, 0.0)),
        scenes.box((x, thick, height), (0.6, y / 2)),
        scenes.box((x, thick, height), (0.6, -y / 2)),
        scenes.box((thick, y, height), (0.6 + x / 2, 0.0)),
        scenes.box((thick, y, height), (0.6 - x / 2, 0.0)),
    ]


def labelled(*things: trimesh.Trimesh) -> LabelledView:
    depth = scenes.seen(scenes.table(), *things, pose=ABOVE)
    return label_view(scenes.cloud(depth, ABOVE), "a", WORKSPACE)


@pytest.mark.parametrize("height", [0.02, 0.1])
def test_a_can_on_a_tray_or_a_pedestal_is_an_object_by_itself(height: float) -> None:
    side = (0.4, 0.3) if height < 0.05 else (0.2, 0.2)
    can = lifted(scenes.can(0.033, 0.12, (0.6, 0.0)), height)
    found = labelled(scenes.box((*side, height), (0.6, 0.0)), can)
    first, second = found.listed
    assert first.size == pytest.approx((0.066, 0.066, 0.12), abs=0.012)
    assert second.label in found.objects.supports
    assert found.objects.raised[first.label] == pytest.approx(height, abs=0.003)
    views = [(found, first.label)]
    assert table_height(views) == pytest.approx(0.0, abs=0.003)
    assert table_height(views, carried=True) == pytest.approx(height, abs=0.003)
    # The plane of the evidence is the tray's.
    n, d = np.split(found.plane_in_camera(first.label), [3])
    foot = (np.linalg.inv(ABOVE) @ [0.6, 0.0, height, 1.0])[:3]
    assert n @ foot == pytest.approx(d[0], abs=0.003)


def test_a_sheet_that_stands_on_a_tray_is_a_thing() -> None:
    """Seen exactly, it has no width."""
    level = np.stack(np.meshgrid(np.arange(0, 0.3, 0.0025), np.arange(0, 0.3, 0.0025)), axis=-1)
    tray = np.concatenate([level.reshape(-1, 2), np.full((level[..., 0].size, 1), 0.02)], axis=1)
    side = np.stack(np.meshgrid(np.arange(0.1, 0.2, 0.0025), np.arange(0.02, 0.1, 0.0025)), -1)
    sheet = np.insert(side.reshape(-1, 2), 1, 0.15, axis=1)
    points = np.concatenate([tray, sheet])
    found = raised_support(points, points[:, 2], np.array([1.2, 0.1, 0.9]))
    assert found is not None
    assert found.height == pytest.approx(0.02)
    above = points[:, 2] > 0.02 + BAND
    np.testing.assert_array_equal(found.part, above.astype(int))


def test_walls_of_a_bin_belong_to_the_bin() -> None:
    can = lifted(scenes.can(0.033, 0.1, (0.52, -0.05)), FLOOR)
    box = lifted(scenes.box((0.06, 0.08, 0.05), (0.68, 0.06)), FLOOR)
    found = labelled(*bin_walls(), can, box)
    places = sorted(tuple(np.round(thing.centre[:2], 1)) for thing in found.listed)
    assert len(found.listed) == 3, places
    bin_itself = found.listed[-1]
    assert bin_itself.size[:2] == pytest.approx((0.41, 0.31), abs=0.02)
    assert {thing.label for thing in found.listed[:2]} == set(found.objects.raised)


def test_what_carries_nothing_is_one_object() -> None:
    """A wide box; a bowl, whose wall rises around its floor; a toy of wide wings and a body."""
    (box,) = labelled(scenes.box((0.2, 0.2, 0.05), (0.6, 0.0))).listed
    assert box.size == pytest.approx((0.2, 0.2, 0.05), abs=0.012)
    (bowl,) = labelled(scenes.bowl((0.6, 0.0), radius=0.13, height=0.06)).listed
    assert bowl.size[0] == pytest.approx(0.26, abs=0.02)
    wings = lifted(scenes.box((0.06, 0.26, 0.01), (0.6, 0.0)), 0.03)
    toy = labelled(wings, scenes.box((0.24, 0.04, 0.07), (0.6, 0.0)))
    assert not toy.objects.raised


def test_a_pedestal_is_solid_down_to_the_table() -> None:
    """Its far side is not seen."""
    can = lifted(scenes.can(0.033, 0.12, (0.6, 0.0)), 0.2)
    depth = scenes.seen(scenes.table(), scenes.box((0.22, 0.22, 0.2), (0.6, 0.0)), can, pose=ABOVE)
    top = look_at_table([scenes.cloud(depth, ABOVE)], ["a"], None, np.zeros(0))
    obstacles, _ = seen_obstacles(top, load_model(asset_path("weights/pointsdf_plan")))
    within = [[0.65, 0.06, 0.05], [0.53, -0.06, 0.05], [0.53, 0.08, 0.15]]
    inside = np.zeros(3, dtype=bool)
    for one in obstacles:
        inside |= SignedDistance(one.vertices, one.faces)(within) < 0.001
    assert inside.all()


def test_the_hand_may_reach_into_a_bin() -> None:
    """A reconstruction, or one hull, would fill it."""
    can = lifted(scenes.can(0.033, 0.12, (0.55, 0.0)), FLOOR)
    depth = scenes.seen(scenes.table(), *bin_walls(), can, pose=ABOVE)
    top = look_at_table(
        [scenes.cloud(depth, ABOVE)], ["a"], None, np.zeros(0), target=TargetChoice(number=1)
    )
    obstacles, _ = seen_obstacles(top, load_model(asset_path("weights/pointsdf_plan")))
    free = [[0.65, 0.0, 0.06], [0.55, 0.09, 0.06], [0.7, -0.08, 0.05]]
    solid = [[0.67, 0.03, 0.012], [0.62, 0.148, 0.06], [0.405, 0.03, 0.06]]
    inside = np.zeros(6, dtype=bool)
    for one in obstacles:
        inside |= SignedDistance(one.vertices, one.faces)([*free, *solid]) < 0.001
    assert inside.tolist() == [False] * 3 + [True] * 3


def test_a_frame_around_things_is_its_seen_parts() -> None:
    """Without a floor of its own it has no level surface; a bottle stands 5 mm from its wall."""
    can, bottle = scenes.can(0.033, 0.12, (0.52, -0.04)), scenes.can(0.035, 0.19, (0.68, 0.105))
    depth = scenes.seen(scenes.table(), *bin_walls()[1:], can, bottle, pose=ABOVE)
    top = look_at_table([scenes.cloud(depth, ABOVE)], ["a"], None, np.zeros(0))
    ((view, _),) = top.labelled
    assert len(view.listed) == 3
    places = {tuple(np.round(one.centre[:2], 1)) for one in view.listed}
    assert {(0.5, 0.0), (0.7, 0.1)} < places
    obstacles, _ = seen_obstacles(top, load_model(asset_path("weights/pointsdf_plan")))
    free = np.array([[0.6, 0.0, 0.06], [0.52, 0.05, 0.06], [0.6, -0.1, 0.05]])
    solid = np.array([[0.6, -0.148, 0.06], [0.402, 0.03, 0.06]])
    inside = np.zeros(5, dtype=bool)
    for one in obstacles:
        inside |= SignedDistance(one.vertices, one.faces)([*free, *solid]) < 0.001
    assert inside.tolist() == [False] * 3 + [True] * 2
