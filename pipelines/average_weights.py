"""The mean of two checkpoints of one architecture, of which the second learned from the first.

    python pipelines/average_weights.py BEFORE AFTER SHARE OUT

OUT gets (1 − SHARE) · BEFORE + SHARE · AFTER. Such a mean errs less than either where the second
run specialised (Wortsman et al. 2022, "Model soups").
"""

from __future__ import annotations

import sys
from pathlib import Path

from pointsdf_cli.io.checkpoints import read_checkpoint, write_checkpoint


def main(before: Path, after: Path, share: float, out: Path) -> None:
    """Write the mean with the configuration of AFTER, which then says what it is the mean of."""
    first, second = read_checkpoint(before), read_checkpoint(after)
    weights = {
        name: (1 - share) * first.weights[name].float() + share * value.float()
        if value.is_floating_point()
        else value
        for name, value in second.weights.items()
    }
    config = dict(second.config) | {"mean": {"share_of_last_run": share}}
    write_checkpoint(out, config=config, weights=weights)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
