"""The wheel: built, installed elsewhere, and run from there."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import time
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

from pointsdf_cli import __version__

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
    assert "rgrasp = pointsdf_cli.cli.main:program" in entry_points.read_text()


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


def test_the_source_distribution_holds_what_is_needed_to_build_test_and_cite(
    tmp_path: Path,
) -> None:
    build = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", tmp_path]
    subprocess.run([*map(str, build), str(REPOSITORY)], check=True, capture_output=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        names = {name.partition("/")[2] for name in tar.getnames()}
    needed = {
        "LICENSE", "THIRD-PARTY.md", "CITATION.cff", "CHANGELOG.md", "constraints.txt",
        "constraints-min.txt", "pipelines/paper.sh", "pipelines/Snakefile", "tests/conftest.py",
        "docs/method.md", "assets/robots/lbr4_allegro.yaml",
        "assets/weights/pointsdf_ray/model.safetensors",
        "assets/weights/pointsdf_plan/model.safetensors",
        "assets/weights/pointsdf_real/config.json",
    }  # fmt: skip
    assert needed <= names, needed - names
    assert not any(name.startswith((".venv", ".work", "demo/", "paper-")) for name in names)


def test_the_versions_agree() -> None:
    cited = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == __version__
    assert f"## {__version__}" in (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")


def test_every_dependency_is_noticed_and_pinned_at_both_ends() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    notices = (REPOSITORY / "THIRD-PARTY.md").read_text(encoding="utf-8").lower()

    def pins(file: str) -> dict[str, str]:
        lines = (REPOSITORY / file).read_text(encoding="utf-8").lower().splitlines()
        found = (line.partition("==") for line in lines if "==" in line)
        return {name.replace("_", "-"): version for name, _, version in found}

    newest, oldest = pins("constraints.txt"), pins("constraints-min.txt")
    for text in project["dependencies"]:
        name, _, least = text.partition(",")[0].partition(">=")
        assert name in notices, f"{name} is not in THIRD-PARTY.md"
        assert name in newest, f"{name} is not in constraints.txt"
        assert name in oldest, f"{name} is not in constraints-min.txt"
        if name != "torch":  # its older builds bring gigabytes of CUDA along
            assert f"{oldest[name]}.".startswith(f"{least}."), (name, least, oldest[name])


def test_the_shell_completes_commands(tmp_path: Path) -> None:
    home = {**os.environ, "HOME": str(tmp_path), "SHELL": "/bin/bash"}
    code = "import sys; sys.argv[0] = 'rgrasp'; from pointsdf_cli.cli.main import main; main()"
    asked = {"_RGRASP_COMPLETE": "complete_bash", "COMP_WORDS": "rgrasp ren", "COMP_CWORD": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=home | asked, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["render"]
    install = f'"{sys.executable}" -c "{code}" --install-completion'
    subprocess.run(["bash", "-c", f"{install}; true"], env=home, check=True, capture_output=True)
    assert "complete" in (tmp_path / ".bash_completions" / "rgrasp.sh").read_text()
