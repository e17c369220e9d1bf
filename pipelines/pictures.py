"""Pictures of docs/ that show a model and no result: python pipelines/pictures.py DIR."""

from __future__ import annotations

import sys
from pathlib import Path

from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.viz.sheets import noise_picture, save_figure

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = Path(sys.argv[1])
    save_figure(noise_picture(DepthNoise()), folder / "depth_noise.png", dpi=75)
