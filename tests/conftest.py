"""Shared fixtures: small meshes with known geometry, the CLI in this process, the real meshes."""

from __future__ import annotations

import io
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import trimesh

REPOSITORY = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SOFTWARE_GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]


@dataclass(frozen=True)
class CliResult:
    """What a run of `rgrasp` left behind."""

    code: int
    out: str
    err: str


def run_cli(*arguments: object) -> CliResult:
    """Run `rgrasp` in this process through its real entry point; a traceback fails the test."""
    from pointsdf_cli.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["rgrasp", *map(str, arguments)]
    code = 0
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as leave:
            code = leave.code if isinstance(leave.code, int) else 0 if leave.code is None else 1
        finally:
            sys.argv = before
    return CliResult(code, out.getvalue(), err.getvalue())


@pytest.fixture
def cli() -> Callable[..., CliResult]:
    return run_cli


@pytest.fixture
def box_mesh() -> trimesh.Trimesh:
    """A box of 8 × 6 × 4 cm about the origin."""
    return trimesh.creation.box((0.08, 0.06, 0.04))


@pytest.fixture
def mesh_folder(tmp_path: Path) -> Path:
    """Three closed meshes of known shape: a ball, a box, a torus, each about 10 cm."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    trimesh.creation.icosphere(subdivisions=3, radius=0.05).export(folder / "ball.ply")
    trimesh.creation.box((0.1, 0.06, 0.04)).export(folder / "box.ply")
    trimesh.creation.torus(0.04, 0.012).export(folder / "torus.ply")
    return folder


@pytest.fixture
def processor_read_anew() -> Iterator[None]:
    """The processor's description is read in the test, and again after it."""
    from pointsdf_cli.models.processor import cpu_features

    cpu_features.cache_clear()
    yield
    cpu_features.cache_clear()


@pytest.fixture(scope="session")
def shared_meshes() -> Path:
    """The folder of real meshes, where this machine has it."""
    folder = Path(os.environ.get("RGRASP_MESHES", REPOSITORY.parent / "shared" / "meshes"))
    if not (folder / "manifest.csv").is_file():
        pytest.skip(f"no real meshes at {folder} (set RGRASP_MESHES to a folder that has them)")
    return folder


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = os.environ.get("RGRASP_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip("no Chromium here (apt-get install chromium, or set RGRASP_BROWSER)")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(
            executable_path=path, args=[*SOFTWARE_GL, "--enable-unsafe-swiftshader"]
        )
        yield started
        started.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page that fails the test if anything is written to its console as an error."""
    opened, errors = browser.new_page(viewport={"width": 800, "height": 600}), []
    opened.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    opened.on("pageerror", lambda error: errors.append(str(error)))
    yield opened
    opened.close()
    assert not errors, errors
