"""Whether a test object stands among the training objects under any name, pose or unit.

    python pipelines/check_leaks.py --test DIR [--test DIR] --train DIR [--train DIR]

For every test mesh the most similar training meshes are found by a pose- and scale-free description
of their surfaces, then aligned by ICP. Prints the nearest of each, and exits with 1 if any pair is
closer than the threshold (mean distance of the aligned surfaces, where 1 is that of two samples of
one and the same surface).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from pointsdf_cli.geometry.same_shape import aligned_distance, descriptor, surface_points
from pointsdf_cli.io.meshes import find_meshes, load_mesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--test", type=Path, action="append", required=True)
    parser.add_argument("--train", type=Path, action="append", required=True)
    parser.add_argument("--candidates", type=int, default=5, help="aligned, for each test mesh")
    parser.add_argument("--threshold", type=float, default=1.15)
    options = parser.parse_args()

    def read(folders: list[Path]) -> tuple[list[Path], list[np.ndarray], np.ndarray]:
        files = [file for folder in folders for file in find_meshes(folder)]
        clouds = []
        for file in files:
            mesh = load_mesh(file)
            clouds.append(surface_points(mesh.vertices, mesh.faces, np.random.default_rng(0)))
        described = [descriptor(cloud, np.random.default_rng(1)) for cloud in clouds]
        return files, clouds, np.array(described)

    test_files, test_clouds, test_descriptors = read(options.test)
    train_files, train_clouds, train_descriptors = read(options.train)
    suspects = 0
    for file, cloud, described in zip(test_files, test_clouds, test_descriptors, strict=True):
        difference = np.abs(train_descriptors - described).mean(axis=1)
        nearest = np.argsort(difference)[: options.candidates]
        distances = [aligned_distance(cloud, train_clouds[k]) for k in nearest]
        best = int(np.argmin(distances))
        suspect = distances[best] < options.threshold
        suspects += suspect
        print(
            f"{'SAME? ' if suspect else '      '}{distances[best]:.4f}  {file.stem:32} "
            f"{train_files[nearest[best]]}"
        )
    print(f"{suspects} of {len(test_files)} test objects look like a training object")
    sys.exit(suspects > 0)


if __name__ == "__main__":
    main()
