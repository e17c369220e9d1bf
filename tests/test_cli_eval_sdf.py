"""`rgrasp eval-sdf` on three shapes of known form, with a network that never finds anything."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import run_cli
from test_cli_mesh import constant_network

from pointsdf_cli.assets import asset_path
from pointsdf_cli.geometry.metrics import Score
from pointsdf_cli.training.evaluate_sdf import (
    PARTIAL_HULL,
    TRUTH_HULL,
    best_median_worst,
    convex_hull,
)
from pointsdf_cli.training.sdf_table import (
    ScoredView,
    objects_csv,
    statistic,
    summarise,
    table_lines,
)

VIEWS, SAMPLES = 2, 2000
# The hull of the fixture's torus (0.04, 0.012): a tube's half circles around a flat disc.
TORUS_VOLUME = 2 * math.pi**2 * 0.04 * 0.012**2
TORUS_HULL = TORUS_VOLUME / 2 + 2 * 0.012 * math.pi * 0.04**2 + 4 / 3 * math.pi * 0.012**3


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("networks")
    return constant_network(folder / "blind", 0.1), constant_network(folder / "full", -0.1)


@pytest.fixture
def views(mesh_folder: Path, tmp_path: Path) -> Path:
    out = tmp_path / "views"
    options = ("--views", VIEWS, "--jobs", 1, "--quiet")
    assert run_cli("render", "--meshes", mesh_folder, "--out", out, *options).code == 0
    return out


def evaluate(views: Path, meshes: Path, out: Path, *options: object) -> tuple[int, str, str]:
    result = run_cli(
        "eval-sdf", "--views", views, "--meshes", meshes, "--out", out, "--samples", SAMPLES,
        "--resolution", 32, "--quiet", *options,
    )  # fmt: skip
    return result.code, result.out, result.err


def test_failures_count_and_baselines_are_as_computed_by_hand(
    networks: tuple[Path, Path], views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "table.json"
    code, _, err = evaluate(
        views, mesh_folder, out, "--checkpoint", networks[0], "--checkpoint", networks[1],
        "--jobs", 1, "--gallery", 1,
    )  # fmt: skip
    assert code == 0, err
    table = json.loads(out.read_text())["table"]
    assert set(table) == {"blind", "full", PARTIAL_HULL, TRUTH_HULL}

    blind = table["blind"]
    assert (blind["failures"], blind["views"], blind["objects"]) == (6, 6, 3)
    assert (blind["iou"]["mean"], blind["normals"]["mean"]) == (0, 0)
    sides = [(0.1, 0.1, 0.1), (0.1, 0.06, 0.04), (0.104, 0.104, 0.024)]
    diagonals = [math.hypot(*side) for side in sides]
    assert blind["chamfer"]["mean"] == pytest.approx(np.mean(diagonals), rel=0.01)

    # Ball and box are their own hulls.
    expected = (1 + 1 + TORUS_VOLUME / TORUS_HULL) / 3
    assert table[TRUTH_HULL]["iou"]["mean"] == pytest.approx(expected, abs=0.02)
    assert 0.1 < table[PARTIAL_HULL]["iou"]["mean"] < 0.9
    assert table["full"]["failures"] == 0
    assert 0 < table["full"]["iou"]["mean"] < 0.5

    rows = list(csv.DictReader((tmp_path / "table.csv").open()))
    assert len(rows) == 4 * 3
    assert {row["object"] for row in rows} == {"ball", "box", "torus"}
    assert (tmp_path / "table.png").stat().st_size > 10_000


def test_the_same_numbers_in_any_number_of_processes(
    networks: tuple[Path, Path], views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    tables = []
    for jobs in (1, 2):
        out = tmp_path / f"{jobs}.json"
        options = ("--checkpoint", networks[1], "--jobs", jobs, "--gallery", 0, "--count", 1)
        assert evaluate(views, mesh_folder, out, *options)[0] == 0
        tables.append(json.loads(out.read_text())["table"])
    assert tables[0] == tables[1]


def test_apart_and_published_rows(
    networks: tuple[Path, Path], views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "table.json"
    code, text, err = evaluate(
        views, mesh_folder, out, "--checkpoint", networks[0], "--jobs", 1, "--gallery", 0,
        "--apart", "torus", "--beside", "ycb",
    )  # fmt: skip
    assert code == 0, err
    result = json.loads(out.read_text())
    assert result["table"]["blind"]["objects"] == 2
    assert result["apart"]["blind"]["objects"] == 1
    assert result["table"][TRUTH_HULL]["iou"]["mean"] == pytest.approx(1, abs=0.01)
    assert "0.570 (0.288)" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--apart", "teapot"], "ball, box, torus"),
        (["--beside", "imagenet"], "graspdb, ycb"),
        (["--resolution", 48], "32, 64"),
        (["--count", -1], "x>=0"),
    ],
)
def test_a_wrong_option_is_one_message(
    options: list[object],
    message: str,
    networks: tuple[Path, Path],
    views: Path,
    mesh_folder: Path,
    tmp_path: Path,
) -> None:
    code, _, err = evaluate(
        views, mesh_folder, tmp_path / "t.json", "--checkpoint", networks[0], *options
    )
    assert code == 2
    assert message in err


def test_views_of_another_mesh_are_refused(
    networks: tuple[Path, Path], views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    (mesh_folder / "ball.ply").write_bytes((mesh_folder / "torus.ply").read_bytes())
    code, _, err = evaluate(
        views, mesh_folder, tmp_path / "t.json", "--checkpoint", networks[0], "--jobs", 1,
        "--gallery", 0,
    )  # fmt: skip
    assert code == 2
    assert "another version of ball.ply" in err


def test_what_is_advised_for_a_damaged_view_works(
    networks: tuple[Path, Path], views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    with h5py.File(views / "ball.h5") as file:
        place = file["cloud"].id.get_chunk_info(0).byte_offset
    with (views / "ball.h5").open("r+b") as damaged:
        damaged.seek(place + 3000)
        damaged.write(bytes(200))
    words = ("--checkpoint", networks[0], "--jobs", 1, "--gallery", 0, "--count", 1)
    out = tmp_path / "table.json"
    code, _, err = evaluate(views, mesh_folder, out, *words)
    assert code == 2
    assert "ball.h5" in err
    assert "--force" in err
    assert out.exists()
    assert evaluate(views, mesh_folder, out, *words, "--skip-bad", "--force")[0] == 0


def test_missing_views_say_how_to_make_them(
    networks: tuple[Path, Path], mesh_folder: Path, tmp_path: Path
) -> None:
    code, _, err = evaluate(
        tmp_path / "nowhere", mesh_folder, tmp_path / "t.json", "--checkpoint", networks[0]
    )
    assert code == 2
    assert "rgrasp render" in err


def scored(name: str, view: int, iou: float, failed: bool = False) -> ScoredView:
    return ScoredView("net", name, view, Score(iou, 0.001, 0.9, failed))


def test_interval_draws_objects_not_views() -> None:
    """Two objects of 50 equal views: the mean's distribution is that of two draws of a coin."""
    values, groups = np.repeat([0.0, 1.0], 50), np.repeat([0, 1], 50)
    result = statistic(values, groups, seed=0)
    assert (result.mean, result.median) == (0.5, 0.5)
    assert (result.low, result.high) == (0, 1)
    # As many objects as views: the interval of the mean is ±1.96·σ/√n.
    values = np.random.default_rng(0).normal(0.5, 0.1, 400)
    result = statistic(values, np.arange(400), seed=0)
    assert result.high - result.low == pytest.approx(2 * 1.96 * 0.1 / 20, rel=0.1)
    assert result.deviation == pytest.approx(values.std(ddof=1))


def test_one_object_has_no_interval() -> None:
    table = summarise([scored("mug", 0, 0.8), scored("mug", 1, 0.6)])
    assert np.isnan([table["net"]["iou"]["low"], table["net"]["iou"]["high"]]).all()
    assert table_lines(table)[1].split()[:5] == ["net", "0.700", "(0.141)", "0.700", "–"]


def test_summary_and_csv_keep_failures_in_the_average() -> None:
    rows = [scored("mug", 0, 0.8), scored("mug", 1, 0.0, failed=True), scored("can", 0, 0.4)]
    table = summarise(rows)["net"]
    assert table["iou"]["mean"] == pytest.approx(0.4)
    assert (table["views"], table["objects"], table["failures"]) == (3, 2, 1)
    lines = list(csv.DictReader(objects_csv(rows).splitlines()))
    assert [(line["object"], line["failures"]) for line in lines] == [("mug", "1"), ("can", "0")]
    assert float(lines[0]["iou_mean"]) == pytest.approx(0.4)


def test_gallery_takes_the_ends_and_the_middle_without_repeats() -> None:
    rows = [scored(f"thing{k}", v, k / 10 + v / 100) for k in range(9) for v in range(3)]
    chosen = best_median_worst(rows, 2)
    assert [note for note, _ in chosen] == ["best"] * 2 + ["median"] * 2 + ["worst"] * 2
    assert [v.object_name for _, v in chosen[:2]] == ["thing8", "thing7"]
    assert [v.object_name for _, v in chosen[4:]] == ["thing0", "thing1"]
    assert chosen[2][1].object_name == "thing4"


def test_hull_is_closed_and_outward() -> None:
    import trimesh

    cube = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    mesh = trimesh.Trimesh(*convex_hull(cube), process=True)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(8, rel=0.05)
    assert convex_hull(cube * [1, 1, 0]) is None


@pytest.mark.parametrize(
    ("command", "weights"),
    [(("eval-sdf", "--views", "v", "--meshes", "m"), "pointsdf"),
     (("eval-gs", "--grasps", "g"), "grasp_geometry")],
)  # fmt: skip
def test_a_table_takes_no_name_of_what_goes_beside_it(
    command: tuple, weights: str, tmp_path: Path
) -> None:
    out = tmp_path / "table.png"
    for folder, schema in (("v", "views"), ("g", "grasps"), ("m", "")):
        (tmp_path / folder).mkdir()
        if schema:
            with h5py.File(tmp_path / folder / "ball.h5", "w") as file:
                file.attrs["schema"] = schema
    (tmp_path / "m" / "ball.ply").touch()
    command = tuple(str(tmp_path / word) if len(word) == 1 else word for word in command)
    checkpoint = asset_path(f"weights/{weights}")
    result = run_cli(*command, "--checkpoint", checkpoint, "--out", out)
    assert result.code == 2
    assert "written beside the table" in result.err
    assert not out.exists()
