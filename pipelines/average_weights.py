"""The mean of the weights of several trainings that began with the same weights.

python pipelines/average_weights.py CHECKPOINT CHECKPOINT … OUT

Trainings of one network on other orders of the same data end in one valley, on different sides of
it; their mean lies deeper than any of them (Wortsman et al. 2022, "Model soups"). So two processor
cores that train by themselves for an hour give one better network.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from pointsdf_cli.io.checkpoints import read_checkpoint, write_checkpoint


def main(sources: list[Path], target: Path) -> None:
    """Write `target` with the first checkpoint's configuration, and of which it is the mean."""
    checkpoints = [read_checkpoint(source) for source in sources]
    first = checkpoints[0]
    for other in checkpoints[1:]:
        if other.config["model"] != first.config["model"]:
            raise SystemExit(f"{other.path} and {first.path} are different networks")
    weights = {
        name: torch.stack([c.weights[name].float() for c in checkpoints]).mean(0)
        for name in first.weights
    }
    others = [
        {key: c.config[key] for key in ("training", "progress", "best") if key in c.config}
        for c in checkpoints[1:]
    ]
    write_checkpoint(target, config={**first.config, "averaged_with": others}, weights=weights)
    print(f"{target}: the mean of {len(checkpoints)} checkpoints")


if __name__ == "__main__":
    if len(sys.argv) < 4:
        raise SystemExit(__doc__)
    *paths, out = map(Path, sys.argv[1:])
    main(paths, out)
