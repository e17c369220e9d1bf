"""Two processes under torchrun train the same network as one does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_train_state
from pointsdf_cli.io.labels import Labels, write_labels
from pointsdf_cli.io.views import Views, write_views
from pointsdf_cli.models.surroundings import Surroundings
from pointsdf_cli.training import sdf_loop
from pointsdf_cli.training.distributed import Workers
from pointsdf_cli.training.sdf_data import Batch
from pointsdf_cli.training.sdf_progress import TrainResult


@pytest.fixture(scope="module")
def spheres(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Views and labels of three spheres."""
    folder = tmp_path_factory.mktemp("spheres")
    rng = np.random.default_rng(0)
    for number, radius in enumerate((0.03, 0.05, 0.08)):
        directions = rng.normal(size=(4, 1000, 3))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        directions[..., 2] = -np.abs(directions[..., 2])
        poses = np.tile(np.eye(4), (4, 1, 1))
        poses[:, 2, 3] = 1.5
        clouds = (radius * directions + [0.0, 0.0, 1.5]).astype(np.float32)
        digest = f"{number:064d}"
        views = Views(clouds, poses, np.eye(3), (640, 480), 0.0, "ball.ply", digest)
        write_views(folder / "views" / f"{number}.h5", views, seed=0)
        points = rng.uniform(-2 * radius, 2 * radius, (2000, 3))
        sdf = np.linalg.norm(points, axis=1) - radius
        labels = Labels(points.astype(np.float32), sdf.astype(np.float32), "ball.ply", digest)
        write_labels(folder / "labels" / f"{number}.h5", labels, seed=0)
    return folder


def train(data: Path, out: Path, processes: int, *more: str) -> subprocess.CompletedProcess[str]:
    """`rgrasp train-sdf` for three steps, in this many processes."""
    launcher = [
        sys.executable, "-m", "torch.distributed.run", "--standalone",
        "--nproc-per-node", str(processes), "--module", "pointsdf_cli.cli.main",
    ]  # fmt: skip
    alone = [sys.executable, "-m", "pointsdf_cli.cli.main"]
    arguments = [
        "train-sdf", "--views", data / "views", "--labels", data / "labels", "--out", out,
        "--batch-size", 4, "--queries", 16, "--steps", 3, "--validate-every", 3,
        "--held-out", 0.34, "--threads", 1, "--precision", "float32", "--json", *more,
    ]  # fmt: skip
    return subprocess.run(
        [*(launcher if processes > 1 else alone), *map(str, arguments)],
        env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_two_processes_train_what_one_trains(spheres: Path, tmp_path: Path) -> None:
    one = train(spheres, tmp_path / "one", 1)
    two = train(spheres, tmp_path / "two", 2)
    assert one.returncode == two.returncode == 0, one.stderr + two.stderr
    # One result, from the first process alone.
    results = [json.loads(run.stdout) for run in (one, two)]
    first, second = (result["best"] for result in results)
    assert second["train_loss"] == pytest.approx(first["train_loss"], rel=1e-4)
    assert second["object_loss"] == pytest.approx(first["object_loss"], rel=1e-3)
    weights = [read_train_state(tmp_path / name)["model"] for name in ("one", "two")]
    for name, tensor in weights[0].items():
        torch.testing.assert_close(weights[1][name], tensor, rtol=1e-3, atol=2e-4)
    refused = train(spheres, tmp_path / "three", 2, "--batch-size", "3")
    assert refused.returncode != 0
    assert "cannot be divided" in refused.stderr


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_stopped_training_is_not_taken_for_done(
    cli: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    spheres: Path,
    tmp_path: Path,
    name: str,
    code: int,
) -> None:
    real = sdf_loop.train_sdf

    def interrupted(*arguments: Any, **options: Any) -> TrainResult:
        os.kill(os.getpid(), getattr(signal, name))
        return real(*arguments, **options)

    monkeypatch.setattr(sdf_loop, "train_sdf", interrupted)
    options = (
        "train-sdf", "--views", spheres / "views", "--labels", spheres / "labels",
        "--out", tmp_path / "ckpt", "--batch-size", 4, "--queries", 16, "--steps", 3,
        "--held-out", 0.34, "--threads", 1, "--precision", "float32", "--json",
    )  # fmt: skip
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may ignore it
    try:
        stopped = cli(*options)
    finally:
        signal.signal(signal.SIGINT, before)
    assert stopped.code == code
    assert json.loads(stopped.out)["finished"] is False
    assert "--resume continues at step 0" in stopped.err
    monkeypatch.setattr(sdf_loop, "train_sdf", real)
    assert cli(*options, "--resume").code == 0


def test_shares_make_up_the_batch() -> None:
    rows = [torch.arange(6.0).reshape(6, 1) for _ in range(9)]
    batch = Batch(*rows[:5], around=Surroundings(*rows[5:]))
    shares = [Workers(rank, 3).share(batch) for rank in range(3)]
    assert torch.equal(torch.cat([share.cloud for share in shares]), batch.cloud)
    assert torch.equal(torch.cat([share.around.plane for share in shares]), batch.around.plane)
    with pytest.raises(InputError, match="divided"):
        Workers(0, 4).share(batch)
