"""Simulated depth beside measured depth, and what it costs `render`.

    python benchmarks/sensor_errors.py YCB_MESHES [--scenes N] [--views N]

The bins of docs/method.md: simulated on random tables of YCB objects at about 1 m, by the camera
of YCB-Video, next to those measured on seven of its frames (Xtion). Then views per second of
processor time of `rgrasp render` with each sensor, in turn, and their ratio to the ideal sensor.
About a minute.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from sensor_scenes import (
    ANGLE_BINS,
    EDGE_BINS,
    MEASURED,
    MEASURED_MISSING_BY_ANGLE,
    MEASURED_SIGMA_BY_ANGLE,
    clutter,
    count_errors,
)

from pointsdf_cli.camera.sensor_presets import SENSORS, load_sensor
from pointsdf_cli.errors import leave_with_message
from pointsdf_cli.io.meshes import find_meshes, load_mesh

YCB_VIDEO = (
    *("002_master_chef_can", "004_sugar_box", "006_mustard_bottle", "007_tuna_fish_can"),
    *("009_gelatin_box", "011_banana", "019_pitcher_base", "021_bleach_cleanser", "024_bowl"),
    *("035_power_drill", "037_scissors", "040_large_marker", "052_extra_large_clamp"),
)
"""The objects of YCB-Video of which the meshes are closed."""


def row(name: str, measured: Sequence[float], simulated: Sequence[float], digits: int) -> str:
    """One line of pairs measured|simulated."""
    pairs = [f"{m:.{digits}f}|{s:.{digits}f}" for m, s in zip(measured, simulated, strict=True)]
    return f"{name:24}" + "".join(f"{pair:>12}" for pair in pairs)


def print_bins(meshes: list[Path], scenes: int, seed: int) -> dict[str, object]:
    """Measured and simulated bins of the sensor `structured-light`."""
    rng = np.random.default_rng(seed)
    loaded = [load_mesh(path) for path in meshes]
    tables = [clutter(loaded, rng) for _ in range(scenes)]
    counts = count_errors(load_sensor("structured-light"), tables, seed)
    edges = (f"< {EDGE_BINS[0]}", *map("{}–{}".format, EDGE_BINS, EDGE_BINS[1:]), "> 10")
    angles = map("{}–{}°".format, ANGLE_BINS, ANGLE_BINS[1:])
    print(f"{'px from the edge':24}" + "".join(f"{edge:>12}" for edge in edges))
    for name, shares in MEASURED.items():
        print(row(name, shares, counts.shares(name).tolist(), 2))
    print(f"{'incidence':24}" + "".join(f"{angle:>12}" for angle in angles))
    print(row("nothing returned", MEASURED_MISSING_BY_ANGLE, counts.missing().tolist(), 2))
    print(row("σ [mm] (MAD)", MEASURED_SIGMA_BY_ANGLE, counts.sigma().tolist(), 1))
    off = [np.abs(counts.shares(name) - shares).max() for name, shares in MEASURED.items()]
    off.append(np.abs(counts.missing() - MEASURED_MISSING_BY_ANGLE).max())
    quartiles = np.quantile(counts.bias, [0.1, 0.9])
    print(f"largest difference of a share: {max(off):.3f}")
    print(f"bias of {len(counts.bias)} objects, 10% to 90% [mm]: -2 to 2 | {quartiles.round(1)}")
    return {
        "shares": {name: counts.shares(name).tolist() for name in MEASURED},
        "missing by incidence": counts.missing().tolist(),
        "sigma by incidence [mm]": counts.sigma().tolist(),
        "largest difference": float(max(off)),
    }


def processor_seconds(*arguments: object) -> float:
    """Processor time of one `rgrasp` process, imports and all."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "pointsdf_cli.cli.main", *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def print_throughput(meshes: Path, views: int) -> dict[str, float]:
    """Views per second of processor time with each sensor."""
    count = len(find_meshes(meshes)) * views
    seconds = dict.fromkeys(SENSORS, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(2):
            for name in SENSORS:
                out = Path(folder, f"{name}{turn}")
                command = ["render", "--meshes", meshes, "--out", out, "--views", views]
                seconds[name] += processor_seconds(
                    *command, "--sensor", name, "--skip-bad", "-q", "-j", 1
                )
    rates = {name: 2 * count / spent for name, spent in seconds.items()}
    for name, rate in rates.items():
        print(f"render --sensor {name:18}{rate:8.0f} views/s, {rate / rates['ideal']:.0%} of ideal")
    return rates


@leave_with_message()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", type=Path, help="a folder of YCB meshes")
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument("--views", type=int, default=200, help="a mesh")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = find_meshes(options.meshes)
    known = [path for path in found if path.stem in YCB_VIDEO]
    result = print_bins(known or found, options.scenes, options.seed)
    result["views per second"] = print_throughput(options.meshes, options.views)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
