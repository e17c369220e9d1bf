"""Pictures of docs/ that show a model and no result: python pipelines/pictures.py DIR."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.viz.sheets import save_figure


def noise_picture(path: Path) -> None:
    """Deviation against depth, and a tilted plane at 1.5 m measured with it, seen from the side."""
    noise, rng = DepthNoise(), np.random.default_rng(0)
    figure = Figure(figsize=(10, 3.4))
    law, side = figure.subplots(1, 2)
    depth = np.linspace(0.5, 4.0, 200, dtype=np.float32)
    law.plot(depth, 1e3 * noise.deviation(depth), label="σ(z) = σ₀·(z / 1.5 m)²")
    law.plot(1.5, 1e3 * noise.sigma, "o", label=f"σ₀ = {1e3 * noise.sigma:g} mm at 1.5 m")
    law.set(xlabel="depth z [m]", ylabel="deviation [mm]")
    law.legend(fontsize=8)
    across = np.linspace(-0.05, 0.05, 400, dtype=np.float32)
    true = (1.5 + 0.3 * across).astype(np.float32)
    side.plot(100 * across, 1e3 * (true - 1.5), "k", lw=1, label="true plane")
    side.plot(100 * across, 1e3 * (noise.apply(true, rng) - 1.5), ".", ms=2, label="measured")
    side.set(xlabel="across the image [cm]", ylabel="depth − 1.5 m [mm]")
    side.legend(fontsize=8)
    save_figure(figure, path, dpi=75)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    noise_picture(Path(sys.argv[1]) / "depth_noise.png")
