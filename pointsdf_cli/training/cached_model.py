"""Shape networks of a worker process, each loaded once."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pointsdf_cli.io.checkpoints import WEIGHTS
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel


def load_cached(checkpoint: Path) -> ShapeModel:
    """`load_model`, once while the weights' file stays the same."""
    weights = checkpoint / WEIGHTS
    return _loaded(checkpoint, weights.stat().st_mtime_ns if weights.is_file() else 0)


@lru_cache(maxsize=4)
def _loaded(checkpoint: Path, written: int) -> ShapeModel:
    return load_model(checkpoint)
