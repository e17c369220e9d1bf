"""How far is what a view hides from what it shows, before and after turning about the axis found?

    python pipelines/twin_distance.py PACK [--pattern train/*cup*] [--views 10]

PACK is what `train-sdf` packed. For label points at most 2 mm inside each object's surface: the
distance to the nearest observed point, and that of the point's twin (`models/revolution.py`).
Printed in mm by object, medians and 80% quantiles over its views; 0.2 s an object.
"""

from __future__ import annotations

import argparse
import json
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import torch

from pointsdf_cli.models.revolution import places, revolution_axis, surface_normals, twins
from pointsdf_cli.training.sdf_pack import load_pack

INSIDE = 0.002
POINTS = 400


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pack", type=Path)
    parser.add_argument("--pattern", default="*")
    parser.add_argument("--views", type=int, default=10)
    options = parser.parse_args()
    torch.set_num_threads(1)
    names = json.loads((options.pack / "index.json").read_text(encoding="utf-8"))["names"]
    pack = load_pack(options.pack, tuple(names))
    medians = []
    for number, name in enumerate(names):
        if not fnmatch(name, options.pattern):
            continue
        views = np.flatnonzero(pack.object_of_view == number)[: options.views]
        labels = slice(pack.label_start[number], pack.label_start[number + 1])
        sdf = pack.sdf[labels]
        hidden = pack.points[labels][(sdf < 0) & (sdf > -INSIDE)][:POINTS]
        to_network = pack.to_network[views]
        x = np.einsum("vij,nj->vni", to_network[:, :, :3], hidden) + to_network[:, None, :, 3]
        x = torch.from_numpy(x.astype(np.float32))
        cloud = torch.from_numpy(pack.clouds[views].astype(np.float32))
        camera = torch.from_numpy(pack.cameras[views])
        neighbours = torch.from_numpy(pack.neighbours[views].astype(np.int64))
        points = cloud[:, : neighbours.shape[1]]
        axis = revolution_axis(points, surface_normals(points, neighbours, cloud, camera), camera)
        twin, _ = twins(x, axis, cloud, places(cloud, axis))
        unit = torch.from_numpy(pack.scale[views])[:, None] / 1000.0  # network units per mm
        before, after = (torch.cdist(p, cloud).amin(-1) / unit for p in (x, twin))
        row = [float(d.quantile(q)) for d in (before, after) for q in (0.5, 0.8)]
        medians.append(row)
        print(f"{name:40} seen {row[0]:5.1f} ({row[1]:5.1f})  turned {row[2]:5.1f} ({row[3]:5.1f})")
    if medians:
        middle = np.median(medians, axis=0)
        print(
            f"{len(medians)} objects, medians: seen {middle[0]:.1f} ({middle[1]:.1f}), "
            f"turned {middle[2]:.1f} ({middle[3]:.1f})"
        )


if __name__ == "__main__":
    main()
