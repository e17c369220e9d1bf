"""Options of `rgrasp mesh`, importable without the network."""

from __future__ import annotations

from dataclasses import dataclass

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.isosurface import IsosurfaceConfig


@dataclass(frozen=True)
class MeshChoices:
    """Meshing options.

    Attributes:
        resolution, smooth, exact: As in `mesh_reconstruction`.
        all_parts: Keep small loose parts too.
        precision: "auto", "bfloat16" or "float32".
        seed: Seed of the resampling of the cloud.
    """

    resolution: int = 128
    smooth: int = 25
    all_parts: bool = False
    exact: bool = False
    precision: str = "auto"
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.smooth <= 1000:
            raise InputError(f"{self.smooth} passes", where="--smooth", allowed="0 to 1000")
        IsosurfaceConfig(self.resolution)
