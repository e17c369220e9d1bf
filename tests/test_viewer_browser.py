"""The exported page and the served one in a real browser: they draw, the slider moves the robot."""

from __future__ import annotations

import io
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from plan_files import turning_plan_file

from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.artifact_scene import scene_of
from pointsdf_cli.viz.html_scene import scene_page
from pointsdf_cli.viz.scene import Part, Scene
from pointsdf_cli.viz.scene_sources import SceneOptions

ROBOT = load_robot()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("plan")
    return scene_of(turning_plan_file(folder, ROBOT), SceneOptions(ROBOT))


def pixels(page: Any, box: tuple[int, int, int, int] = (50, 160, 500, 520)) -> np.ndarray:
    """What is shown between left, top, right and bottom, [height, width, 3]."""
    image = Image.open(io.BytesIO(page.screenshot(timeout=90_000))).convert("RGB")
    return np.asarray(image.crop(box)).astype(int)


def test_the_exported_page_draws_and_its_slider_moves_the_robot(
    page: Any, scene: Scene, tmp_path: Path
) -> None:
    file, asked = tmp_path / "plan.html", []
    file.write_text(scene_page(scene), encoding="utf-8")
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_timeout(300)
    first = pixels(page)
    assert (np.ptp(first.reshape(-1, 3), axis=0) > 80).all()  # something is drawn
    page.focus("#frame")
    page.keyboard.press("End")
    page.wait_for_timeout(300)
    assert page.inner_text("#caption") == "2.00 s"
    last = pixels(page)
    moved = (np.abs(last - first).max(axis=2) > 40).mean()
    assert moved > 0.01
    page.get_by_label("robot").uncheck()
    page.wait_for_timeout(300)
    assert (np.abs(pixels(page) - last).max(axis=2) > 40).mean() > 0.01
    page.get_by_label("robot").check()
    page.keyboard.press("Tab")
    page.focus("#frame")
    page.keyboard.press("Home")
    page.wait_for_timeout(300)
    assert np.array_equal(pixels(page), first)
    page.click("#play")
    page.wait_for_function("document.getElementById('caption').textContent === '2.00 s'")
    assert asked == [file.as_uri()]  # nothing else was fetched


def test_a_translucent_part_keeps_its_colour(page: Any, tmp_path: Path) -> None:
    # A sheet of half opacity that fills the view: green, mixed half with the page's light grey.
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], dtype=float)
    sheet = Part(
        *("sheet", "mesh", "mesh", corners, np.array([[0, 1, 2], [0, 2, 3]])),
        colour=(0.0, 1.0, 0.0),
        opacity=0.5,
    )
    file = tmp_path / "sheet.html"
    file.write_text(scene_page(Scene("sheet", (sheet,))), encoding="utf-8")
    page.goto(file.as_uri())
    page.wait_for_timeout(300)
    red, green, blue = pixels(page, (390, 290, 410, 310)).reshape(-1, 3).mean(axis=0)
    assert green > 150
    assert abs(red - 122) < 6
    assert abs(blue - 123) < 6


def test_the_served_page_draws_and_its_slider_moves_the_robot(page: Any, scene: Scene) -> None:
    pytest.importorskip("viser", reason="viser is not installed (pip install '.[view]')")
    from pointsdf_cli.viz.viewer import Viewer

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free = probe.getsockname()[1]
    with Viewer(scene, port=free) as viewer:
        page.set_viewport_size({"width": 800, "height": 450})
        page.goto(f"http://localhost:{viewer.port}")
        slider = page.get_by_role("slider").first
        slider.wait_for(timeout=60_000)
        first = settled(page)
        slider.focus()
        page.keyboard.press("End")
        assert until(page, lambda: viewer.frame == scene.frames - 1)
        assert until(page, lambda: (np.abs(beside_panel(page) - first).max(axis=2) > 40).any())


def beside_panel(page: Any) -> np.ndarray:
    """The part of viser's page that neither its panel nor its notices cover."""
    return pixels(page, (240, 190, 460, 430))


def settled(page: Any) -> np.ndarray:
    """The same once something is drawn and rests; software rendering takes its time."""
    before = np.zeros(1)
    for _ in range(40):
        page.wait_for_timeout(500)
        now = beside_panel(page)
        if np.ptp(now) > 80 and np.array_equal(now, before):
            return now
        before = now
    pytest.fail("nothing was drawn")


def until(page: Any, holds: Callable[[], bool]) -> bool:
    """Whether something comes true within a while."""
    for _ in range(60):
        if holds():
            return True
        page.wait_for_timeout(250)
    return False
