"""Libraries that load while Python imports other modules."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pointsdf_cli import preload

SCRIPT = """
from pathlib import Path
from pointsdf_cli.preload import preload
preload(("torch", "open3d")).join()
loaded = Path("/proc/self/maps").read_text()
assert "libtorch_cpu" in loaded and "libOpen3D" in loaded
import sys
assert "torch" not in sys.modules and "open3d" not in sys.modules
import open3d, torch
assert float(torch.ones(3).sum()) == 3.0
assert open3d.t.geometry.RaycastingScene() is not None
"""


def test_libraries_load_without_their_packages_and_the_packages_import_after_them() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True, timeout=120)


def test_a_package_that_is_not_there_is_left_to_its_import(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(preload.LIBRARIES, "no_such_package", "lib.so")
    preload.preload(["no_such_package"]).join(10)


def test_a_library_that_cannot_be_loaded_is_left_to_its_import(tmp_path: Path) -> None:
    (tmp_path / "broken.so").write_bytes(b"no library")
    preload._load([tmp_path / "broken.so"])
