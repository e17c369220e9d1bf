"""The bundled demo clouds: one view each of a few generated objects, from 0.9 m away.

    python pipelines/demo_clouds.py assets/clouds

The objects are free of any licence but this project's, and were not among those trained on
(another seed).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.clouds import Cloud, write_cloud
from pointsdf_cli.objects.generate import make_object

SEED = 99
DISTANCE = 0.9
FAMILIES = ("spray_bottle", "mug", "power_drill")


def look_down(distance: float, tilt: float, turn: float) -> np.ndarray:
    """The pose of an object standing on the ground plane in a camera tilted down [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    spin = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    # World z up to camera y down, then the tilt about the camera's x.
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    c, s = np.cos(tilt), np.sin(tilt)
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return transform(pitch @ upright @ spin, [0, 0, distance])


def main() -> None:
    folder = Path(sys.argv[1])
    camera = CAMERAS["reference"]
    for index, family in enumerate(FAMILIES):
        made = make_object(SEED, index, [family])
        vertices = made.vertices - (made.vertices.min(axis=0) + made.vertices.max(axis=0)) / 2
        rng = np.random.default_rng([SEED, index])
        pose = look_down(DISTANCE, 0.5, 0.7 + 1.1 * index)
        patch = MeshCaster(vertices, made.faces, camera).cast(pose)
        depth = DepthNoise().apply(patch.depth, rng)
        points = camera.back_project(patch.u, patch.v, depth)
        if len(points) > 4000:
            points = points[rng.permutation(len(points))[:4000]]
        path = folder / f"{family}.ply"
        write_cloud(path, Cloud(points, frame="camera"))
        print(f"{path}: {len(points)} points, {np.ptp(points, axis=0).round(3)} m")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main()
