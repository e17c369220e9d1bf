"""Clearance of a body from the whole object, seen and unseen.

python examples/avoid_the_unseen.py
"""

import numpy as np

from pointsdf_cli import complete, read_cloud

cloud = read_cloud("assets/clouds/mug.ply")
points, _ = cloud.in_camera_frame()
shape = complete(points)
# A ball of 2 cm that comes from behind, where the camera saw nothing.
centre, radius = shape.vertices.mean(axis=0), 0.02
for behind in (0.15, 0.10, 0.05):
    ball = centre + [0.0, 0.0, behind]
    distance = float(shape.sdf(ball)) - radius
    away = shape.gradient(ball)
    print(f"{behind:.2f} m behind: {1000 * distance:6.1f} mm free; away is {np.round(away, 2)}")
