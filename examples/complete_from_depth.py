"""A depth image and a mask to a whole mesh, with what the image knows around the object:

python examples/complete_from_depth.py
"""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from pointsdf_cli import complete
from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.geometry.visibility import ViewEvidence, visibility_image

capture = Path("assets/captures/mustard")
K = np.array(json.loads((capture / "K.json").read_text()))
depth = np.asarray(Image.open(capture / "depth.png")) * 1e-4  # 0.1 mm a step
v, u = np.nonzero(depth)
points = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=1)
points *= depth[v, u, None]
# Your segmentation goes here; this box in the image holds the bottle.
mask = (u > 340) & (u < 520) & (v < 330) & (depth[v, u] < 0.48)
mine = points[mask][clean(points[mask]).kept]
around = visibility_image(mine, points[~mask], None, 1 / K[0, 0])
shape = complete(mine, evidence=ViewEvidence(around, None))
print(f"{len(mine)} points: {np.ptp(shape.vertices, axis=0) * 100} cm along the camera's axes")
