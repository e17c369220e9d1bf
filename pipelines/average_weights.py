"""Average two checkpoints of `pointsdf-ray`, one trained on from the other.

    python pipelines/average_weights.py BEFORE AFTER OUT [--share 0.5]

A network that is trained on for another kind of view forgets some of the first. The mean of both
keeps most of each (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models"). Inputs that
BEFORE lacks count as zero there. OUT gets AFTER's config, and half precision.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_checkpoint, write_checkpoint
from pointsdf_cli.models.registry import load_model, model_from_checkpoint


def average(before: Path, after: Path, out: Path, share: float) -> None:
    """Write (1 − share) · before + share · after.

    Raises:
        InputError: A share outside 0 to 1, or a checkpoint that cannot be used.
    """
    if not 0 <= share <= 1:
        raise InputError(f"a share of {share}", where="--share", allowed="0 to 1")
    checkpoint = read_checkpoint(after)
    first, second = model_from_checkpoint(checkpoint), model_from_checkpoint(checkpoint)
    first.begin_with(load_model(before))
    old, new = first.state_dict(), second.state_dict()
    weights = {
        name: (1 - share) * old[name] + share * value if value.is_floating_point() else value
        for name, value in new.items()
    }
    config = checkpoint.config | {"averaged": {"share": share, "with": "started_from"}}
    write_checkpoint(out, config=config, weights=weights, half=True)


def main() -> None:
    """Parse the arguments and average."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--share", type=float, default=0.5)
    options = parser.parse_args()
    average(options.before, options.after, options.out, options.share)


if __name__ == "__main__":
    main()
