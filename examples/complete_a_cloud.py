"""A partial cloud to a whole mesh and its signed distances: python examples/complete_a_cloud.py"""

import sys

import numpy as np
import trimesh

from pointsdf_cli import complete, read_cloud

path = sys.argv[1] if len(sys.argv) > 1 else "assets/clouds/mug.ply"
cloud = read_cloud(path)
points, T_frame_camera = cloud.in_camera_frame()  # m; x right, y down, z forward
shape = complete(points)

mesh = trimesh.Trimesh(shape.vertices, shape.faces)
print(
    f"{len(points)} points: a closed mesh of {len(mesh.faces)} faces, {mesh.volume * 1e6:.0f} cm³"
)
middle = mesh.bounds.mean(axis=0)
print(f"signed distance at the middle of its box: {1000 * shape.sdf(middle):.1f} mm")
print("gradient there:", np.round(shape.gradient(middle), 2))
