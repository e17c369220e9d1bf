"""Every family makes closed objects of household size; equal draws are equal, others differ."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.objects.families import FAMILIES, choose_families
from pointsdf_cli.objects.family import Draw
from pointsdf_cli.objects.finish import MOST_FACES
from pointsdf_cli.objects.generate import GeneratedObject, build, family_of, make_object

PER_FAMILY = 2


@pytest.fixture(scope="module")
def members() -> dict[str, list[GeneratedObject]]:
    return {name: [make_object(11, k, [name]) for k in range(PER_FAMILY)] for name in FAMILIES}


def euler_characteristic(vertices: np.ndarray, faces: np.ndarray) -> int:
    """V − E + F of a closed surface: 2 − 2·genus."""
    return len(vertices) - len(faces) * 3 // 2 + len(faces)


def ray_faults(vertices: np.ndarray, faces: np.ndarray, count: int = 200) -> int:
    """Rays along which the surface does not go in and out by turns, as where it overlaps itself.

    Crossings within 0.02 mm of one another count as one: that is how finely parts are joined.
    """
    rng = np.random.default_rng(0)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    through = low + rng.random((count, 3)) * (high - low)
    rays = np.concatenate([through - direction * np.linalg.norm(high - low), direction], axis=1)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor.from_numpy(faces.astype(np.uint32)),
    )
    hits = scene.list_intersections(o3d.core.Tensor.from_numpy(rays.astype(np.float32)))
    ray, distance = hits["ray_ids"].numpy(), hits["t_hit"].numpy()
    a, b, c = vertices.astype(float)[faces[hits["primitive_ids"].numpy()]].transpose(1, 0, 2)
    step = -np.sign(np.sum(np.cross(b - a, c - a) * direction[ray], axis=1))
    faults = 0
    for index in range(count):
        order = np.argsort(distance[ray == index])
        if not len(order):
            continue
        inside = np.cumsum(step[ray == index][order])
        settled = np.diff(distance[ray == index][order], append=np.inf) > 2e-5
        faults += bool((~np.isin(inside[settled], (0, 1))).any() or inside[-1] != 0)
    return faults


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_family_makes_closed_objects_of_household_size(
    name: str, members: dict[str, list[GeneratedObject]]
) -> None:
    for made in members[name]:
        mesh = trimesh.Trimesh(made.vertices, made.faces, process=True)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert len(mesh.split(only_watertight=False)) == 1
        extent = np.ptp(made.vertices, axis=0)
        assert 0.03 <= extent.max() <= 0.35
        assert extent.min() > 0.0008
        volume = enclosed_volume(made.vertices, made.faces)
        assert 1e-9 < volume <= extent.astype(float).prod()
        assert len(made.faces) <= MOST_FACES
        assert made.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)
        middle = (made.vertices.min(axis=0) + made.vertices.max(axis=0))[:2] / 2
        assert middle == pytest.approx((0, 0), abs=1e-6)
        genus = 1 - euler_characteristic(made.vertices, made.faces) / 2
        assert genus >= 0
        if FAMILIES[name].genus is not None:
            assert genus == FAMILIES[name].genus
        assert ray_faults(made.vertices, made.faces) <= 1


def test_no_two_objects_are_alike(members: dict[str, list[GeneratedObject]]) -> None:
    shapes = {made.vertices.tobytes() for family in members.values() for made in family}
    assert len(shapes) == PER_FAMILY * len(FAMILIES)
    for family in members.values():
        first, second = family
        assert first.parameters != second.parameters


def test_object_depends_on_seed_and_index_alone() -> None:
    before = make_object(3, 17)
    make_object(3, 16)
    again = make_object(3, 17)
    assert before.name == again.name
    assert before.parameters == again.parameters
    assert np.array_equal(before.vertices, again.vertices)
    assert np.array_equal(before.faces, again.faces)
    assert not np.array_equal(make_object(4, 17, [before.family]).vertices, before.vertices)
    # Restricting the families changes which object is made, not how.
    assert np.array_equal(make_object(3, 17, [before.family]).vertices, before.vertices)


@pytest.mark.parametrize("name", ["mug", "pitcher", "doughnut", "handle_bottle", "bucket"])
def test_things_with_one_handle_have_genus_one(
    name: str, members: dict[str, list[GeneratedObject]]
) -> None:
    for made in members[name]:
        assert euler_characteristic(made.vertices, made.faces) == 0


@pytest.mark.parametrize("name", ["bowl", "rim_cup", "tumbler", "tray", "mug"])
def test_vessels_are_hollow(name: str, members: dict[str, list[GeneratedObject]]) -> None:
    for made in members[name]:
        mesh = trimesh.Trimesh(made.vertices, made.faces)
        assert mesh.volume < 0.5 * mesh.convex_hull.volume
        # The middle of the opening is outside the material.
        extent = np.ptp(made.vertices, axis=0)
        assert mesh.volume < 0.5 * extent.prod()


@pytest.mark.parametrize("name", ["ball", "carton", "can", "soap", "die"])
def test_solid_things_fill_their_hull(name: str, members: dict[str, list[GeneratedObject]]) -> None:
    for made in members[name]:
        mesh = trimesh.Trimesh(made.vertices, made.faces)
        assert mesh.volume > 0.75 * mesh.convex_hull.volume


def test_ball_has_a_balls_volume() -> None:
    for seed in range(40):
        made = make_object(seed, 0, ["ball"])
        if made.parameters["form"] == "smooth":
            radius = float(made.parameters["radius"])
            break
    volume = enclosed_volume(made.vertices, made.faces)
    assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.02)


def test_wall_of_a_tumbler_is_as_thick_as_drawn() -> None:
    made = make_object(2, 0, ["tumbler"])
    wall = float(made.parameters["wall"])
    assert 0.0012 <= wall <= 0.005
    mesh = trimesh.Trimesh(made.vertices, made.faces)
    # A thin body's volume is nearly half its surface times its thickness.
    assert 2 * mesh.volume / mesh.area == pytest.approx(wall, rel=0.35)


def test_default_mix_follows_the_weights() -> None:
    choices = choose_families(None)
    count = 4000
    drawn = Counter(family_of(5, index, choices).name for index in range(count))
    total = sum(family.weight for family in choices)
    for family in choices:
        assert abs(drawn[family.name] - count * family.weight / total) < 6


def test_mix_holds_vessels_and_solids_in_balance() -> None:
    kinds: Counter[str] = Counter()
    for family in FAMILIES.values():
        kinds[family.kind] += family.weight  # type: ignore[assignment]
    total = sum(kinds.values())
    assert len(FAMILIES) >= 30
    assert 0.1 < kinds["vessel"] / total < 0.3
    assert (kinds["solid"] + kinds["round"]) / total > 0.35
    assert (kinds["flat"] + kinds["tool"]) / total > 0.15


def test_unknown_family_is_named_with_the_nearest() -> None:
    with pytest.raises(InputError, match="'mugg'") as caught:
        make_object(0, 0, ["mugg"])
    assert caught.value.hint == "--families mug"
    with pytest.raises(InputError):
        choose_families([])


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (0, -1)])
def test_negative_seed_or_index_is_refused(seed: int, index: int) -> None:
    with pytest.raises(InputError, match="-1"):
        make_object(seed, index)


def test_draw_records_what_was_drawn() -> None:
    draw = Draw(np.random.default_rng(0))
    height = draw.uniform("height", 0.1, 0.2)
    cap = draw.choice("cap", ("flat", "dome"))
    ribs = draw.integer("ribs", 2, 2)
    radius = draw.log_uniform("radius", 0.01, 0.02)
    assert draw.values == {"height": height, "cap": cap, "ribs": 2, "radius": radius}
    assert ribs == 2
    assert 0.1 <= height <= 0.2
    assert 0.01 <= radius <= 0.02
    with pytest.raises(ValueError, match="height"):
        draw.chance("height", 0.5)


def test_parameters_in_the_record_are_those_used() -> None:
    family = FAMILIES["wood_block"]
    for seed in range(60):
        draw = Draw(np.random.default_rng(seed))
        vertices, _ = build(family, draw)
        if draw.values["form"] == "cube":
            assert np.ptp(vertices, axis=0) == pytest.approx(draw.values["edge"], rel=0.02)
            return
    pytest.fail("no cube in sixty blocks")


def test_documentation_counts_the_families_of_every_kind() -> None:
    text = (Path(__file__).resolve().parents[1] / "docs" / "data.md").read_text()
    weight = sum(family.weight for family in FAMILIES.values())
    for kind in {family.kind for family in FAMILIES.values()}:
        members = [family for family in FAMILIES.values() if family.kind == kind]
        share = sum(family.weight for family in members) / weight
        row = next(line for line in text.splitlines() if line.startswith(f"|{kind}|"))
        assert row.endswith(f"|{len(members)}|{share:.0%}|")
    assert f"{len(FAMILIES)} families" in text


def test_the_first_object_of_the_program_is_as_any_other() -> None:
    # SciPy loads while it is built, and unions depend on which handles of parts are alive.
    code = (
        "import gc; gc.set_threshold(1_000_000, 20, 20)\n"
        "from pointsdf_cli.deferred import defer_unused; defer_unused()\n"
        "from pointsdf_cli.objects.generate import make_object\n"
        "first, again = (make_object(0, 0).vertices.tobytes() for _ in range(2))\n"
        "assert first == again\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
