"""Which thing can be taken first: one that is in reach and has free space around it."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import POSE, box, cloud, seen, table

from pointsdf_cli.errors import InputError
from pointsdf_cli.planning.labelled_view import WORKSPACE, label_view
from pointsdf_cli.planning.object_choice import Reach, TargetChoice
from pointsdf_cli.planning.plan_on_table import _first_good
from pointsdf_cli.planning.scene_input import parse_target
from pointsdf_cli.planning.table_top import look_at_table
from pointsdf_cli.planning.take_order import HAND_ROOM, free_share, take_order
from pointsdf_cli.robot.description import load_robot

POST = np.stack([np.zeros(10), np.zeros(10), np.linspace(0.0, 0.1, 10)], axis=1)


def test_free_directions_are_those_without_a_neighbour() -> None:
    # A wall 6 cm away from x = 0 on, from y = -6 to 6 cm: a quarter of all directions.
    y = np.linspace(-0.0599, 0.0599, 400)
    wall = np.stack([np.full(400, 0.06), y, np.full(400, 0.05)], axis=1)
    assert free_share(POST, wall) == pytest.approx(0.75)
    assert free_share(POST, np.concatenate([wall, -wall])) == pytest.approx(0.5)
    assert free_share(POST, wall * [(HAND_ROOM + 0.01) / 0.06, 1, 1]) == 1.0
    assert free_share(POST, np.zeros((0, 3))) == 1.0


def test_what_stands_free_goes_before_what_is_enclosed_and_what_is_far() -> None:
    enclosed, free, far = (0.6, -0.2), (0.6, 0.2), (0.3, 0.05)
    beside = [box((0.05, 0.05, 0.08), (0.6 + x, -0.2 + y)) for x, y in ((0, 0.1), (0, -0.1))]
    things = [box((0.06, 0.06, 0.12), place) for place in (enclosed, free, far)]
    scene = label_view(cloud(seen(table(), *things, *beside)), "view", WORKSPACE)
    turns = take_order(scene, reach=Reach(np.zeros(2), 0.5, 0.8))
    assert len(turns) == 5
    first, last = turns[0], turns[-1]
    np.testing.assert_allclose(first.item.centre[:2], free, atol=0.03)
    assert first.free == 1.0
    np.testing.assert_allclose(last.item.centre[:2], far, atol=0.03)
    assert not last.reached
    middle = next(turn for turn in turns if np.allclose(turn.item.centre[:2], enclosed, atol=0.03))
    assert middle.free < 0.8


def test_any_is_a_target_of_plans_only() -> None:
    assert parse_target("any") == TargetChoice(any=True)
    robot = load_robot()
    view = cloud(seen(table(), box((0.06, 0.06, 0.12), (0.6, 0.0))), POSE)
    with pytest.raises(InputError, match="does not name one object"):
        look_at_table([view], ["view"], robot, robot.home, target=TargetChoice(any=True))


def test_any_takes_the_first_good_grasp_or_the_best() -> None:
    success = {1: 0.3, 2: 0.5, 3: 0.4}
    objects: Any = [
        SimpleNamespace(item=SimpleNamespace(number=k), describe=lambda k=k: f"object {k}")
        for k in success
    ]
    tried: list[int] = []

    @dataclass(frozen=True)
    class Tried:
        answer: Any
        report: tuple[str, ...] = ()
        warnings: tuple[str, ...] = ()

    def attempt(choice: TargetChoice, warn: object = None) -> Any:
        tried.append(choice.number or 0)
        found = success[tried[-1]]
        plan = SimpleNamespace(status="ok", reason="", success_probability=found)
        return Tried(SimpleNamespace(plan=plan))

    def best(enough: float) -> float:
        tried.clear()
        return float(_first_good(objects, attempt, enough, None).answer.plan.success_probability)

    assert (best(0.9), tried) == (0.5, [1, 2, 3])
    assert (best(0.45), tried) == (0.5, [1, 2])
