"""Share of an object's pixels that a real camera loses, by side and distance from the silhouette.

    python benchmarks/lost_strips.py CAPTURES MESHES [--seed 0]    # as real_depth.py

For each object of a capture with label.png, and for the sensor `structured-light` in the same
scene: pixels of the label without a depth within 10 mm of the registered scan. Ten seconds.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from registered import Registered, registered_objects

from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.geometry.arrays import Mask

DISTANCES = (0, 2, 4, 8, 12, 16)
"""Distances from the silhouette along the row [px] that bound the bins."""
ACCURATE = 0.01
"""Largest error [m] of a depth that counts as the surface's."""


@leave_with_message()
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    every = registered_objects(options.captures, options.meshes)
    objects = [one for one in every if one.label is not None]
    if not objects:
        raise InputError("holds no capture with label.png", where=options.captures)
    bins = "".join(f"{f'{a}–{b}':>7}" for a, b in pairwise(DISTANCES))
    print(f"{'px from the silhouette':48}{bins}")
    for one in objects:
        for name, side, shares in losses(one, options.seed):
            print(f"{one.name:32}{name:10}{side:6}" + "".join(f"{s:7.2f}" for s in shares))


def losses(one: Registered, seed: int) -> list[tuple[str, str, list[float]]]:
    """Name of the depth image, side of the object, and the share lost in each bin."""
    camera, depth = one.view()
    window = (0, camera.width, 0, camera.height)
    hit = MeshCaster(one.mesh.vertices, one.mesh.faces, camera).cast_window(
        one.T_camera_mesh, window=window
    )
    label = np.asarray(Image.open(one.folder / "label.png")) == one.label
    shown = label & np.isfinite(hit.depth)
    simulated = one.simulated(np.where(shown, hit.depth, 0.0), seed)
    found = []
    for name, image in (("measured", depth), ("simulated", simulated)):
        lost = np.abs(image - hit.depth) > ACCURATE
        for side in ("left", "right"):
            away = _from_side(shown, side)
            found.append((name, side, [_share(lost, shown, away, *b) for b in pairwise(DISTANCES)]))
    return found


def _from_side(shown: Mask, side: str) -> NDArray[np.int64]:
    """Number of the object's pixels [h, w] from the silhouette's side up to each of its pixels."""
    step = 1 if side == "left" else -1
    ordered = shown[:, ::step]
    columns = np.arange(shown.shape[1])
    before = np.maximum.accumulate(np.where(ordered, -1, columns), axis=1)
    return (columns - before)[:, ::step]


def _share(lost: Mask, shown: Mask, away: NDArray[np.int64], low: int, high: int) -> float:
    """Share lost of the pixels farther than `low` and at most `high` px from the side."""
    here = shown & (away > low) & (away <= high)
    return float(lost[here].mean()) if here.any() else float("nan")


if __name__ == "__main__":
    main()
