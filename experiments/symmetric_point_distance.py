"""Distances of hidden surface to observed points, before and after turning about the found axis.

    python experiments/symmetric_point_distance.py PACK [--pattern GLOB] [--views N] [--sideways W]

PACK is what `train-sdf` packed. For label points at most 2 mm inside each object's surface: the
distance to the nearest observed point, and that of its symmetric point (`models/revolution.py`).
Printed in mm by object, medians and 80% quantiles over its views. Then, among points farther than
0.08 network units from every observed point: the share whose symmetric points are within 0.05 of
one and truly on the surface (right), or within 0.05 but not on it (wrong). 0.5 s an object.
"""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from pointsdf_cli.models.revolution import (
    places,
    revolution_axis,
    surface_normals,
    symmetric_points,
)
from pointsdf_cli.training.presets import SIDEWAYS
from pointsdf_cli.training.sdf_pack import read_pack

INSIDE = 0.002
POINTS = 400
HIDDEN, NEAR, ON = 0.08, 0.05, 0.02
"""Distances in network units: query to observed points, symmetric point to observed points, and
symmetric point to the true surface."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pack", type=Path)
    parser.add_argument("--pattern", default="*")
    parser.add_argument("--views", type=int, default=10)
    parser.add_argument("--sideways", type=float, default=SIDEWAYS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    pack = read_pack(options.pack)
    names = pack.names
    rows = []
    for number, name in enumerate(names):
        if not fnmatch(name, options.pattern):
            continue
        views = np.flatnonzero(pack.object_of_view == number)[: options.views]
        labels = slice(pack.label_start[number], pack.label_start[number + 1])
        places_m, sdf = pack.points[labels], pack.sdf[labels]
        just_inside = np.flatnonzero((sdf < 0) & (sdf > -INSIDE))[:POINTS]
        to_network = pack.to_network[views]
        everywhere = np.einsum("vij,nj->vni", to_network[:, :, :3], places_m)
        everywhere = (everywhere + to_network[:, None, :, 3]).astype(np.float32)
        x = torch.from_numpy(everywhere[:, just_inside])
        cloud = torch.from_numpy(pack.clouds[views].astype(np.float32))
        camera = torch.from_numpy(pack.cameras[views])
        neighbours = torch.from_numpy(pack.neighbours[views].astype(np.int64))
        points = cloud[:, : neighbours.shape[1]]
        normals = surface_normals(points, neighbours, cloud, camera)
        axis = revolution_axis(points, normals, camera, options.sideways)
        symmetric, _ = symmetric_points(x, axis, cloud, places(cloud, axis))
        before, after = (torch.cdist(p, cloud).amin(-1).numpy() for p in (x, symmetric))
        at_symmetric = np.stack(
            [
                sdf[cKDTree(known).query(there)[1]] * scale
                for known, there, scale in zip(
                    everywhere, symmetric.numpy(), pack.scale[views], strict=True
                )
            ]
        )
        hidden = before > HIDDEN
        if not hidden.any():
            continue
        near = after[hidden] < NEAR
        on = np.abs(at_symmetric[hidden]) < ON
        mm = 1000.0 / pack.scale[views][:, None]
        row = [float(np.quantile(d * mm, q)) for d in (before, after) for q in (0.5, 0.8)]
        rows.append(row + [float((near & on).mean()), float((near & ~on).mean())])
        print(f"{name:40} {_line(rows[-1])}")
    if rows:
        print(f"{len(rows)} objects, distances' medians: {_line(list(np.median(rows, axis=0)))}")
        right, wrong = np.mean(rows, axis=0)[4:]
        print(f"means: right {right:.2f}, wrong {wrong:.2f}")


def _line(row: list[float]) -> str:
    return (
        f"seen {row[0]:5.1f} ({row[1]:5.1f})  turned {row[2]:5.1f} ({row[3]:5.1f})  "
        f"hidden: right {row[4]:.2f} wrong {row[5]:.2f}"
    )


if __name__ == "__main__":
    main()
