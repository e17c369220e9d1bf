"""Whether a test object stands among the training objects under any name, pose or unit.

    python pipelines/check_leaks.py --test DIR [--test DIR] --train DIR [--train DIR]

For every test mesh the most similar training meshes are found by a pose- and scale-free description
of their surfaces, then aligned by ICP. Prints the nearest of each, and exits with 1 if any pair is
closer than the threshold (mean distance of the aligned surfaces, where 1 is that of two samples of
one and the same surface), and with 2 where the folders cannot be read.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.errors import leave_with_message
from pointsdf_cli.geometry.signed_distance import sample_surface
from pointsdf_cli.io.meshes import UNITS, find_meshes, load_mesh

Points = NDArray[np.float64]

POINTS, COARSE_POINTS, PAIRS, BINS, ITERATIONS = 4000, 600, 20_000, 48, 40


@leave_with_message()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--test", type=Path, action="append", required=True)
    parser.add_argument("--train", type=Path, action="append", required=True)
    parser.add_argument("--candidates", type=int, default=5, help="aligned, for each test mesh")
    parser.add_argument("--threshold", type=float, default=1.15)
    parser.add_argument("--unit", choices=list(UNITS), default="m", help="of all meshes")
    options = parser.parse_args()

    def read(folders: list[Path]) -> tuple[list[Path], list[np.ndarray], np.ndarray]:
        files = [file for folder in folders for file in find_meshes(folder)]
        clouds = []
        for file in files:
            mesh = load_mesh(file, options.unit)
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


def descriptor(points: Points, rng: np.random.Generator) -> NDArray[np.float64]:
    """Pose- and scale-free description [BINS] of a sampled surface [N, 3].

    The distribution of distances between random point pairs (Osada et al. 2002, "D2"), as
    quantiles over the root mean square.
    """
    a, b = rng.integers(len(points), size=(2, PAIRS))
    distance = np.linalg.norm(points[a] - points[b], axis=1)
    quantiles = np.quantile(distance, (np.arange(BINS) + 0.5) / BINS)
    return quantiles / np.sqrt((distance**2).mean())


def surface_points(vertices: Points, faces: NDArray[np.int32], rng: np.random.Generator) -> Points:
    """Samples [POINTS, 3] of a surface, centred, with a root mean square radius of 1."""
    points, _ = sample_surface(vertices, faces, POINTS, rng)
    points = points - points.mean(axis=0)
    return points / np.sqrt((points**2).sum(axis=1).mean())


def aligned_distance(one: Points, other: Points) -> float:
    """The mean nearest distance between two normalised samples [N, 3] after the best alignment.

    Starts from the 24 ways to lay principal axes on principal axes, and turns about the first axis
    for round things; the best few starts are refined by rigid point-to-point ICP (no mirroring). In
    units of `spacing(other)`, so that two samples of one surface are about 1 apart.
    """
    tree, coarse_tree = scipy.spatial.cKDTree(other), scipy.spatial.cKDTree(other[:COARSE_POINTS])
    frame_one, frame_other = _axes(one), _axes(other)
    starts = [frame_other @ turn @ frame_one.T for turn in _turns()]
    few = one[:COARSE_POINTS]
    scores = [coarse_tree.query(few @ rotation.T)[0].mean() for rotation in starts]
    best = np.inf
    for start in np.argsort(scores)[:4]:
        rotation, shift = starts[start], np.zeros(3)
        for _ in range(ITERATIONS):
            moved = few @ rotation.T + shift
            target = other[tree.query(moved)[1]]
            rotation, shift = _fit(few, target)
        forth = tree.query(one @ rotation.T + shift)[0].mean()
        back = scipy.spatial.cKDTree(one @ rotation.T + shift).query(other)[0].mean()
        best = min(best, (forth + back) / 2)
    return float(best) / spacing(other)


def spacing(points: Points) -> float:
    """Mean distance between two samples of this surface, each as dense as this one.

    Measured between the two halves of the sample; nearest distances on a surface shrink with the
    square root of the density.
    """
    half = len(points) // 2
    nearest: Points = scipy.spatial.cKDTree(points[:half]).query(points[half:])[0]
    return float(nearest.mean() / np.sqrt(2))


def _axes(points: Points) -> Points:
    """Principal axes [3, 3] as columns, right-handed."""
    _, vectors = np.linalg.eigh(points.T @ points)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    return np.asarray(vectors)


def _turns() -> list[Points]:
    """The 24 rotations of the cube, and eight turns about each axis."""
    turns = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                turns.append(matrix)
    for axis in range(3):
        u, v = (k for k in range(3) if k != axis)
        for angle in np.arange(1, 8) * np.pi / 4:
            matrix = np.eye(3)
            matrix[u, u] = matrix[v, v] = np.cos(angle)
            matrix[u, v], matrix[v, u] = -np.sin(angle), np.sin(angle)
            turns.append(matrix)
    return turns


def _fit(source: Points, target: Points) -> tuple[Points, Points]:
    """The rotation and shift that take source to target with the least squares (Kabsch)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    flip = np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ flip @ u.T
    return rotation, b - rotation @ a


if __name__ == "__main__":
    main()
