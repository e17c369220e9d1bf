"""Whole processes as a person at a terminal waits for them, in turn, in one run.

python benchmarks/bench_startup.py [--against TREE] [--rounds 3] [--only plan] [--imports FILE.md]

The first row is a bare interpreter; the ratios are to it. `--against` is another checkout (such as
`git worktree add ../before COMMIT`), whose commands run alternately with these; the last column is
the ratio of the medians. `--imports` writes instead a table of what each command imports and for
how long. Processor seconds say more than wall seconds where the machine is busy.
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
BOTTLE = "assets/clouds/spray_bottle.ply"
BARE = "bare interpreter"
COMMANDS = {
    BARE: "",
    "--help": "--help",
    "plan --help": "plan --help",
    "plan": f"plan {TABLE} --out {{}}/plan.h5 --force -q",
    "plan --no-picture": f"plan {TABLE} --out {{}}/p.h5 --force -q --no-picture",
    "mesh": f"mesh {MUG} --out {{}}/mesh.ply --force -q",
    "mesh --resolution 128": f"mesh {BOTTLE} --out {{}}/m.ply --force -q --resolution 128",
    "objects make, wrong count": "objects make --out {}/o --count -1",
    "objects fetch, wrong archive": "objects fetch none --out {}/o",
    "render, no such folder": "render --meshes none",
    "label-sdf, no such folder": "label-sdf --views none --meshes none --out {}/l",
    "train-sdf, no such folder": "train-sdf --views none --labels none --out {}/c",
    "eval-sdf, no such folder": "eval-sdf --checkpoint none --views none --meshes none",
    "calibrate, no such folder": "calibrate none --intrinsics kinect2 --robot-poses none.json",
    "cloud, no such image": "cloud none.png --intrinsics kinect2",
    "segment, no such cloud": "segment none.ply",
    "mesh, no such cloud": "mesh none.ply",
    "collect-grasps, no such folder": "collect-grasps --meshes none --out {}/g",
    "train-gs, no such folder": "train-gs --grasps none --encoder pointsdf --mode fixed --out {}/c",
    "eval-gs, no such folder": "eval-gs --grasps none --checkpoint none --out {}/t.json",
    "plan, no such robot": f"plan {TABLE} --out {{}}/no.h5 --robot none.yaml",
    "plan, no pose": "plan {}/lost.xyz --out {}/no.h5",
    "plan, millimetres": "plan {}/far.xyz --out {}/no.h5 --camera-pose 0,0,1,1,0,0,0",
    "plan, wrong unit": f"plan {TABLE} --out {{}}/no.h5 --unit furlong",
    "plan, no such weights": f"plan {TABLE} --out {{}}/no.h5 --checkpoint none",
    "serve, no token": "serve --host 0.0.0.0",
    "trial, no such robot": "trial --robot none.yaml",
    "info, no such file": "info none.h5",
    "report, no such folder": "report none",
    "robot check, no such robot": "robot check none.yaml",
    "view, no such file": "view none.h5",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="", help="Commands whose name begins so.")
    parser.add_argument("--imports", type=Path, metavar="FILE.md")
    options = parser.parse_args()
    names = [name for name in COMMANDS if name == BARE or name.startswith(options.only)]
    with tempfile.TemporaryDirectory() as folder:
        points = "\n".join(
            f"{k % 10 / 100} {k // 10 % 10 / 100} {0.8 + k / 1e4}" for k in range(99)
        )
        Path(folder, "lost.xyz").write_text(points)
        far = "\n".join(f"{k % 10 * 10} {k // 10 % 10 * 10} {800 + k / 10}" for k in range(99))
        Path(folder, "far.xyz").write_text(far)
        if options.imports:
            rows = [imports_row(name, typed(name, folder)) for name in names[1:]]
            head = "|command|all [ms]|most, without what they import [ms]|\n|---|---|---|\n"
            text = f"{machine()}\n\n{head}{''.join(rows)}"
            options.imports.write_text(text, encoding="utf-8")
            return
        trees = [HERE] if options.against is None else [HERE, options.against.resolve()]
        print(machine())
        measure(names, trees, options.rounds, folder)


def typed(name: str, folder: str) -> list[str]:
    """Arguments of a command; none for the bare interpreter."""
    return COMMANDS[name].replace("{}", folder).split()


def machine() -> str:
    """Processor, number of processors, load."""
    told = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    model = re.search(r"model name\s*:\s*(.*)", told)
    cores = len(os.sched_getaffinity(0))
    return f"{model[1] if model else '?'}, {cores} processors, load {os.getloadavg()[0]:.1f}"


def measure(names: list[str], trees: list[Path], rounds: int, folder: str) -> None:
    """Print wall and processor seconds of every command in every tree."""
    print(f"{'command':32} {'wall [s]':>9} {'processor [s]':>14} {'to bare':>8}   against")
    bare = 1.0
    for name in names:
        taken: dict[Path, list[tuple[float, float]]] = defaultdict(list)
        for _ in range(rounds):
            for tree in trees:
                taken[tree].append(seconds(tree, typed(name, folder)))
        wall, processor = ([median(t[k] for t in taken[tree]) for tree in trees] for k in (0, 1))
        bare = processor[0] if name == BARE else bare
        line = f"{name:32} {wall[0]:9.2f} {processor[0]:14.2f} {processor[0] / bare:7.0f}×"
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
    """A command's stderr, run from a tree; its exit code must be 0 or 2. Without words a bare
    interpreter."""
    # An installed package is compiled.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    program = ["-m", "pointsdf_cli.cli.main", *words] if words else ["-c", ""]
    done = subprocess.run(
        [sys.executable, *python, *program],
        cwd=tree,
        env=environment | {"PYTHONPATH": str(tree)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    if done.returncode not in (0, 2):
        raise SystemExit(f"{words}: exit code {done.returncode}\n{done.stderr}")
    return done.stderr


def imports_row(name: str, words: list[str]) -> str:
    """Row of the packages that a command spends most time importing."""
    own: dict[str, float] = defaultdict(float)
    told = run(HERE, words, "-X", "importtime")
    for line in re.finditer(r"import time:\s+(\d+) \|\s+\d+ \|\s+([\w.]+)", told):
        own[line[2].split(".")[0]] += int(line[1]) / 1000
    most = sorted(own.items(), key=lambda pair: -pair[1])[:6]
    listed = ", ".join(f"{package} {ms:.0f}" for package, ms in most)
    return f"|{name}|{sum(own.values()):.0f}|{listed}|\n"


if __name__ == "__main__":
    main()
