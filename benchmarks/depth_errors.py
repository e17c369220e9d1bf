"""Loss of overlap by each kind of error of real depth, one exchanged at a time for the exact depth.

    python benchmarks/depth_errors.py CAPTURES MESHES [--checkpoint DIR]    # as real_depth.py

For each object of a capture with label.png the depth of its pixels is replaced by that of the
registered scan: in all pixels of the label, in those that returned a depth, in those that did not,
or but for the errors that are slower or faster than a number of pixels; or by what the sensor
`structured-light` would give. Prints IoU, mean of two samplings of the cloud. Three minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from real_depth import Case, completed, evidence_of, table_plane
from registered import Registered, registered_objects
from scipy import ndimage

from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.mask_edge import grown_mask
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.visibility import PLANE_BAND
from pointsdf_cli.models.registry import load_model

SPLITS = (2.0, 5.0, 10.0, 20.0)
"""Widths σ [px] that part slow errors from fast ones."""
LARGEST = 0.02
"""Pixels with larger errors [m] show something else."""
SAMPLINGS, SIMULATED = 2, 4


@leave_with_message()
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--checkpoint", type=Path)
    options = parser.parse_args()
    model = load_model(options.checkpoint)
    table: dict[str, list[float]] = {}
    for one in registered_objects(options.captures, options.meshes):
        if one.label is None:
            continue
        for name, case in variants(one):
            points = case.points[clean(case.points).kept]
            evidence = evidence_of(case, points)
            scores = [completed(model, case, points, evidence, k)[0] for k in range(SAMPLINGS)]
            table.setdefault(name, []).append(float(np.mean([score.iou for score in scores])))
    if not table:
        raise InputError("holds no capture with label.png", where=options.captures)
    for name, ious in table.items():
        each = " ".join(f"{iou:.3f}" for iou in ious)
        print(f"{name:36s}{each}  mean {np.mean(ious):.3f}")


def variants(one: Registered) -> Iterator[tuple[str, Case]]:
    """The object as measured, and with its errors exchanged; by their names."""
    camera, depth = one.view()
    points = _points(camera, depth)
    plane = table_plane(points[points[:, 2] < 1.6])
    above = np.zeros(depth.shape, dtype=bool)
    above[depth > 0] = points @ plane[:3] - plane[3] > PLANE_BAND
    label = np.asarray(Image.open(one.folder / "label.png")) == one.label
    mask = ndimage.binary_erosion(label, iterations=2)
    grown = grown_mask(mask, depth, camera.fx, above) & (depth > 0)
    caster = MeshCaster(one.mesh.vertices, one.mesh.faces, camera)
    hit = caster.cast_window(one.T_camera_mesh, window=(0, camera.width, 0, camera.height)).depth
    exact = np.where(np.isfinite(hit), hit, 0.0)

    def case(changed: Array, pixels: Mask, masked: Mask) -> Case:
        chosen = pixels[changed > 0]
        seen = _points(camera, changed)
        rays = camera.rays_of(masked & (changed <= 0))
        return Case(one.name, seen[chosen], seen[~chosen], plane, one.mesh, one.T_camera_mesh, rays)

    def masked(changed: Array) -> Case:
        """The object in another depth image, by the same mask."""
        grows = grown_mask(mask, changed, camera.fx, above | label) & (changed > 0)
        return case(changed, grows, mask)

    kept = grown.copy()
    kept[grown] = clean(points[grown[depth > 0]]).kept
    kept &= (exact > 0) & (np.abs(depth - exact) < LARGEST)
    others = np.where(grown & ~kept, 0.0, depth)
    yield "as measured", case(depth, grown, mask)
    yield "exact depth in the same pixels", case(np.where(kept, exact, others), kept, mask)
    error = np.where(kept, depth - exact, 0.0)
    for width_px in SPLITS:
        slow = _smoothed(error, kept, width_px)
        for name, remaining in (("slower", slow), ("faster", error - slow)):
            changed = np.where(kept, exact + remaining, others)
            yield f"errors {name} than {width_px:.0f} px", case(changed, kept, mask)
    full = label & (exact > 0)
    yield "exact depth in pixels without", masked(np.where(full & (depth <= 0), exact, depth))
    for seed in range(SIMULATED):
        simulated = one.simulated(np.where(full, exact, 0.0), seed)
        yield f"simulated, seed {seed}", masked(simulated)
    yield "exact depth in the label's pixels", case(np.where(full, exact, depth), full, full)


def _points(camera: Camera, depth: Array) -> Array:
    """Points [N, 3] of the pixels with depth, row by row."""
    rows, columns = np.nonzero(depth > 0)
    return camera.back_project(columns, rows, depth[rows, columns])


def _smoothed(values: Array, valid: Mask, width: float) -> NDArray[np.float64]:
    """Gaussian mean [h, w] of the valid pixels about each pixel."""
    weight = ndimage.gaussian_filter(valid.astype(float), width)
    smooth: NDArray[np.float64] = ndimage.gaussian_filter(values, width) / np.maximum(weight, 1e-6)
    return smooth


if __name__ == "__main__":
    main()
