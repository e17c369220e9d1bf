"""Ship a trained checkpoint: its best weights in half precision, without the training state.

python pipelines/export_weights.py CHECKPOINT assets/weights/NAME
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pointsdf_cli.io.checkpoints import read_checkpoint, write_checkpoint
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model

LARGEST = 15 * 2**20


def main(source: Path, target: Path) -> None:
    """Write `target` and report how far half precision moves the distances."""
    checkpoint = read_checkpoint(source)
    write_checkpoint(target, config=checkpoint.config, weights=checkpoint.weights, half=True)
    size = sum(path.stat().st_size for path in target.iterdir())
    if size > LARGEST:
        raise SystemExit(f"{target} has {size / 2**20:.1f} MiB, more than {LARGEST / 2**20:.0f}")
    rng = np.random.default_rng(0)
    half_ball = rng.normal(size=(1000, 3))
    half_ball /= np.linalg.norm(half_ball, axis=1, keepdims=True)
    half_ball[:, 2] = -np.abs(half_ball[:, 2])
    cloud = 0.05 * half_ball + [0.0, 0.0, 1.5]
    x = rng.uniform(-0.07, 0.07, (5000, 3)) + [0.0, 0.0, 1.5]
    full, shipped = (
        Reconstruction.from_cloud(load_model(path), cloud, np.zeros(3)).sdf(x)
        for path in (source, target)
    )
    moved = np.abs(full - shipped)
    flipped = ((full < 0) != (shipped < 0)).mean()
    print(
        f"{target}: {size / 2**20:.1f} MiB; on a ball of 10 cm the distances moved by "
        f"{moved.mean() * 1e6:.0f} µm on average, {flipped:.2%} of the signs changed"
    )


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
