"""Ship a trained checkpoint: its best weights in half precision, without the training state.

python pipelines/export_weights.py CHECKPOINT assets/weights/NAME
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.io.checkpoints import forget_train_state, read_checkpoint, write_checkpoint
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model

LARGEST = 15 * 2**20


@leave_with_message()
def main(source: Path, target: Path) -> None:
    """Write `target` and report how far half precision moves the distances.

    Raises:
        SystemExit: It would be the source, is too large, or is no reconstruction; it is not
            written then.
    """
    if target.resolve() == source.resolve():
        raise InputError("is the checkpoint itself, which would lose its precision", where=target)
    checkpoint = read_checkpoint(source)
    with TemporaryDirectory() as scratch:
        shipped = Path(scratch, "shipped")
        write_checkpoint(shipped, config=checkpoint.config, weights=checkpoint.weights, half=True)
        report = describe(source, shipped)
    write_checkpoint(target, config=checkpoint.config, weights=checkpoint.weights, half=True)
    forget_train_state(target)
    print(f"{target}: {report}")


def describe(source: Path, shipped: Path) -> str:
    """Compare a checkpoint with the same in half precision.

    Raises:
        InputError: That is too large, or they are no reconstruction.
    """
    size = sum(path.stat().st_size for path in shipped.iterdir())
    if size > LARGEST:
        raise InputError(
            f"has {size / 2**20:.1f} MiB in half precision, more than {LARGEST / 2**20:.0f}",
            where=source,
        )
    rng = np.random.default_rng(0)
    half_ball = rng.normal(size=(1000, 3))
    half_ball /= np.linalg.norm(half_ball, axis=1, keepdims=True)
    half_ball[:, 2] = -np.abs(half_ball[:, 2])
    cloud = 0.05 * half_ball + [0.0, 0.0, 1.5]
    x = rng.uniform(-0.07, 0.07, (5000, 3)) + [0.0, 0.0, 1.5]
    full, halved = (
        Reconstruction.from_cloud(load_model(path), cloud, np.zeros(3)).sdf(x)
        for path in (source, shipped)
    )
    moved = np.abs(full - halved)
    flipped = ((full < 0) != (halved < 0)).mean()
    return (
        f"{size / 2**20:.1f} MiB; on a ball of 10 cm the distances moved by "
        f"{moved.mean() * 1e6:.0f} µm on average, {flipped:.2%} of the signs changed"
    )


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
