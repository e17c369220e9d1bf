"""Metrics of a reconstruction against the truth (docs/method.md, "Table I"; Mescheder et al. 2019).

Volumetric IoU, Chamfer-L1 and normal consistency of two closed meshes in one frame. A failed
reconstruction is not skipped but scored as the worst: an average over successes alone would
flatter a method that gives up on hard objects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.open3d_core import o3d
from pointsdf_cli.geometry.signed_distance import SignedDistance, sample_surface

SAMPLES = 100_000
PADDING = 0.1


@dataclass(frozen=True)
class Score:
    """One reconstruction against the truth.

    Attributes:
        iou: Volume of the intersection over volume of the union, 0 to 1.
        chamfer: Chamfer-L1: half the sum of both directions' mean nearest distance, unsquared [m].
        normals: Normal consistency: half the sum of both directions' mean |n·n'|, 0 to 1.
        failed: There was no reconstruction; the other three are the worst values by convention.
    """

    iou: float
    chamfer: float
    normals: float
    failed: bool = False


class Shape:
    """A closed mesh with its precomputed samples and distances for comparisons.

    Args:
        vertices: [V, 3], m.
        faces: [F, 3], counter-clockwise seen from outside.
        rng: Draws the surface samples.
        samples: Surface points.

    Raises:
        InputError: The mesh has no faces or no area.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        rng: np.random.Generator,
        samples: int = SAMPLES,
    ) -> None:
        vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces)
        if len(faces) == 0 or not _has_area(vertices[faces]):
            raise InputError("an empty mesh cannot be compared", allowed="a closed surface")
        used = vertices[np.unique(faces)]
        self.low, self.high = used.min(axis=0), used.max(axis=0)
        points, normals = sample_surface(vertices, faces, samples, rng)
        # Neighbours one after the other visit the same nodes of the other shape's tree: twice as
        # fast where the surfaces meet, ten times where they lie apart.
        order = np.lexsort(np.floor((points - self.low) / (self.diagonal / 24)).T)
        self.points, self.normals = points[order], normals[order]
        self._tree = o3d.core.nns.NearestNeighborSearch(self.points)
        self._tree.knn_index()
        self._distance = SignedDistance(vertices, faces, threads=1)

    @property
    def diagonal(self) -> float:
        """The diagonal of the bounding box [m]."""
        return float(np.linalg.norm(self.high - self.low))

    def inside(self, points: Array) -> Mask:
        """Whether points [N, 3] are inside: [N]."""
        inside = ((points >= self.low) & (points <= self.high)).all(axis=1)
        inside[inside] = self._distance.inside(points[inside])
        return inside

    def nearest(self, points: Array) -> tuple[Array, NDArray]:
        """Distance [N] to, and index [N] of, the surface sample nearest to each point [N, 3]."""
        index, squared = self._tree.knn_search(np.ascontiguousarray(points), 1)
        return np.sqrt(squared.numpy()[:, 0]), index.numpy()[:, 0]


def _has_area(triangles: Array) -> bool:
    """Whether any of triangles [F, 3, 3] has an area."""
    sides = triangles[:, 1:] - triangles[:, :1]
    return bool(np.cross(sides[:, 0], sides[:, 1]).any())


def compare(
    prediction: Shape, truth: Shape, rng: np.random.Generator, samples: int = SAMPLES
) -> Score:
    """Score a reconstruction against the truth, both in one frame, in metres.

    Args:
        prediction: Reconstructed mesh.
        truth: True mesh.
        rng: Draws the points that the volumes are counted with.
        samples: Number of those.
    """
    forth, at_truth = truth.nearest(prediction.points)
    back, at_prediction = prediction.nearest(truth.points)
    accuracy = _mean_alignment(prediction.normals, truth.normals[at_truth])
    completeness = _mean_alignment(truth.normals, prediction.normals[at_prediction])
    return Score(
        iou=iou(prediction, truth, rng, samples),
        chamfer=float(forth.mean() + back.mean()) / 2,
        normals=(accuracy + completeness) / 2,
    )


def iou(prediction: Shape, truth: Shape, rng: np.random.Generator, samples: int = SAMPLES) -> float:
    """Volumetric IoU by points uniform in the union of both bounding boxes, padded by a tenth."""
    low, high = np.minimum(prediction.low, truth.low), np.maximum(prediction.high, truth.high)
    margin = PADDING / 2 * (high - low)
    points = rng.uniform(low - margin, high + margin, size=(samples, 3))
    inside, truly = prediction.inside(points), truth.inside(points)
    union = np.count_nonzero(inside | truly)
    return float(np.count_nonzero(inside & truly) / union) if union else 0.0


def failure(truth_diagonal: float) -> Score:
    """The score of no reconstruction at all.

    Args:
        truth_diagonal: Diagonal of the true mesh's bounding box [m]; it counts as the Chamfer
            distance.
    """
    return Score(iou=0.0, chamfer=truth_diagonal, normals=0.0, failed=True)


def _mean_alignment(a: Array, b: Array) -> float:
    return float(np.abs(np.einsum("ij,ij->i", a, b)).mean())
