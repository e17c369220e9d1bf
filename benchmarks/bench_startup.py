"""Whole processes as a person at a terminal waits for them, in turn, in one run.

python benchmarks/bench_startup.py [--against TREE] [--rounds 3] [--imports]

`--against` is another checkout (such as `git worktree add ../before COMMIT`), whose commands run
alternately with these; the last column is the ratio of the medians. `--imports` lists instead what
each command imports and for how long. Processor seconds say more than wall seconds where the
machine is busy.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parents[1]
TABLE, MUG = "assets/clouds/table.ply", "assets/clouds/mug.ply"
COMMANDS = {
    "--help": ["--help"],
    "plan --help": ["plan", "--help"],
    "plan": ["plan", TABLE, "--out", "{}/plan.h5", "--force", "-q"],
    "plan --no-picture": ["plan", TABLE, "--out", "{}/p.h5", "--force", "-q", "--no-picture"],
    "mesh": ["mesh", MUG, "--out", "{}/mesh.ply", "--force", "-q"],
    "plan, no such robot": ["plan", TABLE, "--out", "{}/no.h5", "--robot", "none.yaml"],
    "plan, no pose": ["plan", "{}/lost.xyz", "--out", "{}/no.h5"],
    "plan, wrong unit": ["plan", TABLE, "--out", "{}/no.h5", "--unit", "furlong"],
    "plan, no such weights": ["plan", TABLE, "--out", "{}/no.h5", "--checkpoint", "none"],
    "mesh, no such cloud": ["mesh", "none.ply"],
    "serve, no token": ["serve", "--host", "0.0.0.0"],
    "robot check, no such robot": ["robot", "check", "none.yaml"],
    "trial, no such robot": ["trial", "--robot", "none.yaml"],
    "segment, no such cloud": ["segment", "none.ply"],
    "render, no such folder": ["render", "--meshes", "none"],
    "label-sdf, no such folder": [
        "label-sdf",
        "--views",
        "none",
        "--meshes",
        "none",
        "--out",
        "{}/l",
    ],
    "train-sdf, no such folder": [
        "train-sdf",
        "--views",
        "none",
        "--labels",
        "none",
        "--out",
        "{}/c",
    ],
    "collect-grasps, no such folder": ["collect-grasps", "--meshes", "none", "--out", "{}/g"],
    "view, no such file": ["view", "none.h5"],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--imports", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        points = "\n".join(
            f"{k % 10 / 100} {k // 10 % 10 / 100} {0.8 + k / 1e4}" for k in range(99)
        )
        Path(folder, "lost.xyz").write_text(points)
        if options.imports:
            for name, words in COMMANDS.items():
                print_imports(name, [word.format(folder) for word in words])
            return
        trees = [HERE] if options.against is None else [HERE, options.against.resolve()]
        measure(trees, options.rounds, folder)


def measure(trees: list[Path], rounds: int, folder: str) -> None:
    """Print wall and processor seconds of every command in every tree."""
    print(f"{'command':32} {'wall [s]':>9} {'processor [s]':>14}   {'wall, processor against':>24}")
    for name, words in COMMANDS.items():
        taken: dict[Path, list[tuple[float, float]]] = defaultdict(list)
        for _ in range(rounds):
            for tree in trees:
                taken[tree].append(seconds(tree, [word.format(folder) for word in words]))
        wall, processor = ([median(t[k] for t in taken[tree]) for tree in trees] for k in (0, 1))
        line = f"{name:32} {wall[0]:9.2f} {processor[0]:14.2f}"
        if len(trees) > 1:
            line += f"   {wall[0] / wall[1]:.2f} of {wall[1]:.2f} s, "
            line += f"{processor[0] / processor[1]:.2f} of {processor[1]:.2f} s"
        print(line, flush=True)


def seconds(tree: Path, words: list[str]) -> tuple[float, float]:
    """Wall and processor seconds of one process."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    run(tree, words)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, used


def run(tree: Path, words: list[str], *python: str) -> str:
    """A command's stderr, run from a tree; its exit code must be 0 or 2."""
    done = subprocess.run(
        [sys.executable, *python, "-m", "pointsdf_cli.cli.main", *words],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    if done.returncode not in (0, 2):
        raise SystemExit(f"{words}: exit code {done.returncode}\n{done.stderr}")
    return done.stderr


def print_imports(name: str, words: list[str]) -> None:
    """Print the packages that a command spends most time importing, without what they import."""
    own: dict[str, float] = defaultdict(float)
    told = run(HERE, words, "-X", "importtime")
    for line in re.finditer(r"import time:\s+(\d+) \|\s+\d+ \|\s+([\w.]+)", told):
        own[line[2].split(".")[0]] += int(line[1]) / 1000
    most = sorted(own.items(), key=lambda pair: -pair[1])[:8]
    told = ", ".join(f"{package} {ms:.0f}" for package, ms in most)
    print(f"{name:24} {sum(own.values()):6.0f} ms: {told}", flush=True)


if __name__ == "__main__":
    main()
