"""The mean of two checkpoints that learned from the same weights, or one from the other.

    python pipelines/average_weights.py FIRST SECOND SHARE OUT

OUT gets (1 − SHARE) · FIRST + SHARE · SECOND in half precision. Such a mean errs less than either
where a run specialised (Wortsman et al. 2022, "Model soups").
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.io.checkpoints import (
    read_checkpoint,
    require_checkpoint_place,
    write_checkpoint,
)

OF_A_RUN = ("training", "progress", "best", "data", "git_commit")
"""Entries of a checkpoint's configuration that describe its last run."""


@leave_with_message()
def main(first_path: Path, second_path: Path, given_share: str, out: Path) -> None:
    """Write the mean with the configuration of SECOND and, under `mean`, the first run.

    Raises:
        SystemExit: SHARE is not from 0 to 1, the networks are not of one kind and size, or OUT is
            a checkpoint already.
    """
    share = _share(given_share)
    require_checkpoint_place(out, replace=False)
    first, second = read_checkpoint(first_path), read_checkpoint(second_path)
    kinds = [{name: value.shape for name, value in one.weights.items()} for one in (first, second)]
    if kinds[0] != kinds[1]:
        raise InputError(f"has other weights than {first_path}", where=second_path)
    weights = {
        name: (1 - share) * first.weights[name].float() + share * value.float()
        if value.is_floating_point()
        else value
        for name, value in second.weights.items()
    }
    other = {name: first.config[name] for name in OF_A_RUN if name in first.config}
    config = dict(second.config) | {"mean": {"share_of_second_run": share, "first_run": other}}
    write_checkpoint(out, config=config, weights=weights, half=True)


def _share(given: str) -> float:
    try:
        share = float(given)
    except ValueError:
        share = math.nan
    if not 0.0 <= share <= 1.0:
        raise InputError(f"{given!r} is no share", where="SHARE", allowed="0 to 1")
    return share


if __name__ == "__main__":
    if len(sys.argv) != 5:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))
