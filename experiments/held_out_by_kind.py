"""Label IoU of held-out objects by kind of object.

    python experiments/held_out_by_kind.py PACK CHECKPOINT... [--held-out 0.03] [--seed 0]

PACK is what `train-sdf` packed. The objects are those that every checkpoint says were held out from
it; where one does not say, --held-out and --seed are that run's. Generated objects are named by
number and kind; all others are "scan". One column for each checkpoint, worst kind of the last
first; about half a minute a column.
"""

from __future__ import annotations

import argparse
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch

from pointsdf_cli.io.checkpoints import read_config
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.training.precision import autocast_dtype
from pointsdf_cli.training.sdf_data import predict, read_batch, split_views
from pointsdf_cli.training.sdf_loss import label_iou
from pointsdf_cli.training.sdf_pack import read_pack

QUERIES, BATCH = 1024, 32


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pack", type=Path)
    parser.add_argument("checkpoints", type=Path, nargs="+")
    parser.add_argument("--held-out", type=float, default=0.03)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    pack = read_pack(options.pack)
    names = pack.names
    said = [read_config(path).get("data", {}).get("held_out") for path in options.checkpoints]
    held = set.intersection(*[set(one or names) for one in said]) if any(said) else set()
    if any(said) and not held & set(names):
        raise SystemExit("no object of PACK was held out from every checkpoint")
    views = split_views(pack, options.held_out, options.seed, held).held_out_objects
    precision = autocast_dtype("auto", torch.device("cpu"))
    columns = []
    for checkpoint in options.checkpoints:
        network, ious = load_model(checkpoint), list[float]()
        for start in range(0, len(views), BATCH):
            chosen = views[start : start + BATCH]
            batch = read_batch(pack, chosen, QUERIES, np.random.default_rng([3, start]))
            with torch.no_grad(), torch.autocast("cpu", precision, enabled=precision is not None):
                ious += label_iou(predict(network, batch), batch.sdf).tolist()
        columns.append(np.array(ious))
    objects = [pack.names[i] for i in pack.object_of_view[views]]
    kinds = defaultdict(list)
    for row, name in enumerate(objects):
        generated = re.fullmatch(r"\d+_(\w+)", Path(name).name)
        kinds[generated[1] if generated else "scan"].append(row)
    for kind in sorted(kinds, key=lambda kind: columns[-1][kinds[kind]].mean()):
        rows = kinds[kind]
        scores = " ".join(f"{column[rows].mean():.2f}" for column in columns)
        print(f"{kind:22} {len({objects[i] for i in rows}):3d} objects  {scores}")
    means = " ".join(f"{column.mean():.3f}" for column in columns)
    print(f"{'all':22} {len(set(objects)):3d} objects  {means}")


if __name__ == "__main__":
    main()
