"""Objects a second on one core: the default mix, and each family by itself.

    python benchmarks/bench_objects.py [--count 400] [--per-family 8] [--json FILE]

Everything is pinned to one core. The mix is timed with its files written, as `rgrasp objects make`
does; families are timed without. CPU seconds stand beside wall seconds, because a machine that is
busy with something else slows the wall clock only. About a minute.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from statistics import median

from pointsdf_cli.objects.families import FAMILIES
from pointsdf_cli.objects.generate import make_object
from pointsdf_cli.objects.store import make_objects


def time_mix(count: int) -> dict[str, float]:
    """Objects a second of the default mix, files and all."""
    with tempfile.TemporaryDirectory() as folder:
        wall, cpu = time.perf_counter(), time.process_time()
        make_objects(Path(folder), count, seed=0, jobs=1)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {"per_second": count / wall, "per_cpu_second": count / cpu}


def time_family(name: str, count: int) -> dict[str, float]:
    """Milliseconds an object of one family, and its faces."""
    seconds, faces = [], []
    for index in range(count):
        started = time.process_time()
        made = make_object(0, index, [name])
        seconds.append(time.process_time() - started)
        faces.append(len(made.faces))
    return {
        "ms_mean": 1e3 * sum(seconds) / count,
        "ms_worst": 1e3 * max(seconds),
        "faces": median(faces),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--per-family", type=int, default=8)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    make_object(0, 0)
    mix = time_mix(options.count)
    families = {name: time_family(name, options.per_family) for name in FAMILIES}
    print(f"{'family':<16}{'ms':>8}{'worst':>8}{'faces':>8}")
    for name, row in sorted(families.items(), key=lambda item: -item[1]["ms_mean"]):
        print(f"{name:<16}{row['ms_mean']:>8.1f}{row['ms_worst']:>8.1f}{row['faces']:>8.0f}")
    print(
        f"default mix of {len(FAMILIES)} families, files written: "
        f"{mix['per_second']:.0f} objects/s by the wall, {mix['per_cpu_second']:.0f} by CPU time"
    )
    if options.json:
        options.json.write_text(json.dumps({"mix": mix, "families": families}, indent=1) + "\n")


if __name__ == "__main__":
    main()
