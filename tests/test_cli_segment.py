"""`rgrasp segment`: what stands on the table of the bundled cloud, numbered and drawn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pointsdf_cli.io.depth_images import read_mask
from tests import scenes

REPOSITORY = Path(__file__).resolve().parents[1]
TABLE = REPOSITORY / "assets" / "clouds" / "table.ply"


def test_three_things_stand_on_the_bundled_table(cli: Any, tmp_path: Path) -> None:
    picture = tmp_path / "scene.png"
    result = cli("segment", str(TABLE), "--picture", str(picture), "--json")
    assert result.code == 0, result.err
    things = json.loads(result.out)["objects"]
    assert len(things) == 3
    centres = np.array([thing["centre"] for thing in things])
    assert (centres[:, 2] > 0).all()
    assert (centres[:, 2] < 0.3).all()
    assert np.asarray(Image.open(picture)).std() > 1


def test_an_object_that_a_small_workspace_cuts_is_told(cli: Any, tmp_path: Path) -> None:
    depth = scenes.seen(scenes.table(), scenes.box((0.06, 0.4, 0.12), (0.6, 0.0)))
    files = [str(each) for each in scenes.write_scene(tmp_path, depth)]
    files += ["--camera-pose", str(tmp_path / "T.json")]
    small = ["--workspace", "0.2,-0.05,-0.05,1.6,0.9,0.6"]
    result = cli("segment", *files, *small, "--picture", str(tmp_path / "picture.png"))
    assert result.code == 0, result.err
    assert "object 1 goes on outside of the workspace" in result.err + result.out


def test_a_number_that_is_not_there_is_refused_with_those_that_are(
    cli: Any, tmp_path: Path
) -> None:
    wrong = cli("mesh", str(TABLE), "--segment", "auto", "--target", "9", "--out", "m.ply")
    assert wrong.code == 2
    assert "no object 9" in wrong.err
    assert "3 at 0.6" in wrong.err


def test_a_label_image_holds_the_numbers_and_is_read_as_masks(cli: Any, tmp_path: Path) -> None:
    boxes = [scenes.box((0.06, 0.06, 0.1), (0.6, y)) for y in (-0.12, 0.12)]
    depth = scenes.seen(scenes.table(), *boxes)
    given = scenes.write_scene(tmp_path, depth)
    labels = tmp_path / "labels.png"
    result = cli(
        "segment", *given, "--camera-pose", tmp_path / "T.json", "--labels", labels,
        "--picture", tmp_path / "scene.png", "--json",
    )  # fmt: skip
    assert result.code == 0, result.err
    found = json.loads(result.out)
    assert found["labels"] == str(labels)
    assert set(np.unique(np.asarray(Image.open(labels)))) == {0, 1, 2}
    world = np.zeros((*depth.shape, 3))
    v, u = np.nonzero(depth)
    world[v, u] = scenes.cloud(depth).points @ scenes.POSE[:3, :3].T + scenes.POSE[:3, 3]
    for thing in found["objects"]:
        mine = world[read_mask(f"{labels}:{thing['number']}")]
        assert len(mine) == thing["points"]
        assert np.abs(np.median(mine, axis=0)[1] - thing["centre"][1]) < 0.02
    again = cli(
        "mesh", *given, "--camera-pose", tmp_path / "T.json", "--mask", f"{labels}:2",
        "--out", tmp_path / "m.ply", "--resolution", "32",
    )  # fmt: skip
    assert again.code == 0, again.err


def test_labels_need_an_image_and_a_name_of_their_own(cli: Any, tmp_path: Path) -> None:
    labels = tmp_path / "labels.png"
    wrong = cli("segment", TABLE, "--picture", tmp_path / "p.png", "--labels", labels)
    assert wrong.code == 2
    assert "a cloud without an image" in wrong.err
    assert not labels.exists()
    same = cli("segment", TABLE, "--picture", labels, "--labels", labels)
    assert same.code == 2
    assert "the name of the picture" in same.err


def test_a_colour_image_needs_a_depth_image(cli: Any, tmp_path: Path) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / "color.png")
    words = "--color", tmp_path / "color.png", "--picture", tmp_path / "scene.png"
    run = cli("segment", TABLE, *words)
    assert run.code == 2
    assert "--color with a cloud" in run.err
    assert not (tmp_path / "scene.png").exists()
