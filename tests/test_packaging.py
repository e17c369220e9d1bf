"""The wheel: built, installed elsewhere, and run from there."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A folder with nothing but the installed wheel, and the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder]
    subprocess.run([*map(str, build), str(REPOSITORY)], check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    site = folder / "site"
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "--target", site, wheel]
    subprocess.run([*map(str, install), "-q", "--no-index"], check=True, capture_output=True)
    return site, wheel


def run(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`rgrasp` from the installed wheel, away from the checkout."""
    code = (
        "import sys, pointsdf_cli; assert 'site' in pointsdf_cli.__file__, pointsdf_cli.__file__; "
        "from pointsdf_cli.cli.main import main; main()"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=site.parent,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_wheel_holds_the_assets_and_no_tests(installed: tuple[Path, Path]) -> None:
    names = zipfile.ZipFile(installed[1]).namelist()
    assert any(name.startswith("pointsdf_cli/assets/robots/") for name in names)
    assert not any(name.startswith("tests/") for name in names)


def test_help_and_doctor_run_from_the_wheel(installed: tuple[Path, Path]) -> None:
    helped = run(installed[0], "--help")
    assert helped.returncode == 0
    assert "render" in helped.stdout
    examined = run(installed[0], "doctor")
    assert examined.returncode == 0, examined.stdout + examined.stderr
    assert str(installed[0]) in examined.stdout  # it found its own assets, not the checkout's


def test_the_entry_point_is_named_rgrasp(installed: tuple[Path, Path]) -> None:
    (entry_points,) = installed[0].glob("rgrasp-*.dist-info/entry_points.txt")
    assert "rgrasp = pointsdf_cli.cli.main:main" in entry_points.read_text()


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['rgrasp', '--help']\n"
        "from pointsdf_cli.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'torch', 'numpy', 'open3d', 'trimesh', 'h5py', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    started = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert time.perf_counter() - started < 30  # hangs only; the 0.3 s are in the benchmarks
