"""`collect-grasps`: attempts a second on 1 and 2 jobs, and one process's memory over 1000 attempts.

    python benchmarks/bench_collect.py [--meshes DIR] [--count N] [--attempts N]

The rates are of the whole command, from mesh files to finished files, without pictures: all
attempts, and those that were executed. Convex pieces are cut beforehand, so that it is the
simulator that is measured. Both runs must write the same data. The first 40 grasps of it that were
executed are carried out again, by the hand alone as collected, and by the whole arm as a trial has
it, whose cost is the baseline. Memory is the resident size of a process that makes attempt after
attempt with object after object, read every 100. About three minutes on two quiet cores.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.io.grasps import Grasps, read_grasps
from pointsdf_cli.io.meshes import artifact_path, find_meshes, load_mesh
from pointsdf_cli.io.view_evidence import evidence_arrays
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.attempt import AttemptConfig
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.sim_object import prepare_object


def collect(meshes: Path, out: Path, count: int, jobs: int) -> float:
    """Seconds of one `rgrasp collect-grasps` process, imports and all."""
    command = [sys.executable, "-m", "pointsdf_cli.cli.main", "collect-grasps", "--no-pictures"]
    command += ["--meshes", str(meshes), "--out", str(out), "--count", str(count), "-q"]
    started = time.perf_counter()
    subprocess.run([*command, "--jobs", str(jobs)], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def counts(folder: Path) -> tuple[int, int, int]:
    """Attempts, executed, held, over the files of a folder."""
    files = [read_grasps(path)[0] for path in sorted(folder.rglob("*.h5"))]
    return (
        sum(len(grasps) for grasps in files),
        sum(int(grasps.executed.sum()) for grasps in files),
        sum(int((grasps.label == 1).sum()) for grasps in files),
    )


def same(first: Path, second: Path) -> bool:
    """Whether two folders hold equal grasps."""
    names = [path.relative_to(first) for path in sorted(first.rglob("*.h5"))]
    for name in names:
        one, two = read_grasps(first / name)[0], read_grasps(second / name)[0]
        arrays, others = _arrays(one), _arrays(two)
        if arrays.keys() != others.keys():
            return False
        for field, values in arrays.items():
            is_float = values.dtype.kind == "f"
            if not np.array_equal(values, others[field], equal_nan=is_float):
                return False
    return bool(names)


def _arrays(grasps: Grasps) -> dict[str, np.ndarray]:
    """Fields of grasps, with the evidence of their views as arrays."""
    fields = {name: np.asarray(value) for name, value in vars(grasps).items() if name != "evidence"}
    return fields | evidence_arrays(grasps.evidence, len(grasps))


def carried_out(
    folder: Path, files: list[Path], root: Path, most: int = 40
) -> tuple[int, float, float, int]:
    """Executed grasps done again: how many, CPU seconds of the hand alone and of the whole arm,
    and how many labels differ."""
    paths = {artifact_path(mesh, root, folder).with_suffix(".h5"): mesh for mesh in files}
    config = AttemptConfig()
    attempters = [Attempter(load_robot(), one) for one in (config, config.with_the_whole_arm())]
    seconds, differ, done = [0.0, 0.0], 0, 0
    for path in sorted(folder.rglob("*.h5")):
        grasps, _ = read_grasps(path)
        item = prepare_object(load_mesh(paths[path]))
        for row in np.flatnonzero(grasps.executed)[: max(1, most // len(files)) + 1]:
            if done == most:
                break
            held = []
            for k, attempter in enumerate(attempters):
                started = time.process_time()
                held.append(attempter.replay(item, grasps, int(row)).held)
                seconds[k] += time.process_time() - started
            differ += held[0] != held[1]
            done += 1
    for attempter in attempters:
        attempter.close()
    return done, seconds[0], seconds[1], differ


def resident() -> float:
    """Memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(meshes: list[Path], attempts: int) -> list[float]:
    """Resident size [MB] after every 100 of `attempts`, 20 an object in turn."""
    attempter = Attempter(load_robot(), AttemptConfig())
    sizes, done = [], 0
    for number, path in enumerate(itertools.cycle(meshes)):
        if number >= len(meshes) and not done:
            raise SystemExit("no mesh can be grasped: nothing to measure")
        try:
            item = prepare_object(replace(load_mesh(path), name=path.stem))
            attempter.check(item)
            for index in range(20):
                attempter.attempt(item, index)
                done += 1
                if done % 100 == 0:
                    sizes.append(resident())
        except InputError:
            continue
        if done >= attempts:
            break
    attempter.close()
    return sizes or [resident()]


@leave_with_message()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--meshes", type=Path, help="a folder of meshes; default: 16 generated")
    parser.add_argument("--count", type=int, default=160, help="executed grasps a run")
    parser.add_argument("--attempts", type=int, default=1000, help="of the memory's run")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        meshes = options.meshes
        if meshes is None:
            meshes = folder / "meshes"
            command = [sys.executable, "-m", "pointsdf_cli.cli.main", "objects", "make", "-q"]
            command += ["--out", str(meshes), "--count", "16", "--seed", "0"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        files = find_meshes(meshes)
        started = time.perf_counter()
        for path in files:
            try:
                prepare_object(load_mesh(path))
            except InputError:
                continue
        cut = time.perf_counter() - started
        seconds = {
            jobs: collect(meshes, folder / f"jobs{jobs}", options.count, jobs) for jobs in (1, 2)
        }
        made, executed, held = counts(folder / "jobs1")
        equal = same(folder / "jobs1", folder / "jobs2")
        again, hand, whole, differ = carried_out(folder / "jobs1", files, meshes)
        sizes = memory(files, options.attempts)
    result = {
        "meshes": len(files),
        "attempts": made,
        "executed": executed,
        "held": held,
        "convex pieces, where not cached [s]": cut,
        "1 job: attempts [1/s]": made / seconds[1],
        "1 job: executed [1/s]": executed / seconds[1],
        "2 jobs: attempts [1/s]": made / seconds[2],
        "2 jobs: executed [1/s]": executed / seconds[2],
        "1 → 2 jobs": seconds[1] / seconds[2],
        "1 and 2 jobs write equal data": equal,
        "carried out again": again,
        "the hand alone [s of a core a grasp]": hand / max(1, again),
        "the whole arm [s of a core a grasp]": whole / max(1, again),
        "the whole arm / the hand alone": whole / hand if again else float("nan"),
        "labels that differ": differ,
        "memory after 100 attempts [MB]": sizes[0],
        "memory at the end [MB]": sizes[-1],
        "largest memory [MB]": max(sizes),
        "load before [processes]": os.getloadavg()[0],
    }
    for key, value in result.items():
        print(f"{key:38} {value:10.2f}" if isinstance(value, float) else f"{key:38} {value!s:>10}")
    if options.json:
        options.json.write_text(json.dumps(result | {"memory [MB]": sizes}, indent=1))


if __name__ == "__main__":
    main()
