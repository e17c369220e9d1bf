"""Does the label of a grasp depend on the time step? Stored grasps carried out again, finer.

    python experiments/convergence.py --grasps grasps/ --meshes train/ [--count 300]
    python experiments/convergence.py --meshes train/ [--count 300]

With `--grasps`, executed attempts are drawn evenly by seed, and each is carried out as it was
collected, by the whole arm as in a trial, with half the time step, with half, two and five times
the solver's iterations, with half the step and half, two or five times the iterations, with
PyBullet's skin on all hulls, and with the object 0.1 mm aside: a label that this changes hangs on
less than any camera or mesh is good for.
Printed, for each: how many labels and causes differ from the stored ones, with the 95% interval of
the share, and how far the rise of grasps held both times differs; then how many labels differ
between any two. As collected, nothing may differ: that is the test of the replay, of grasps that
were collected with today's physics (it says so where they were not).

Without, whole attempts are made anew, as `collect-grasps` makes them: one scene of each of objects
drawn by seed, settled, seen, tried, and carried out if it can be, all with the other physics.
`--whole-arm` studies the trials' physics in place of the collection's.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.grasps import CAUSES, HELD, INVALID, LOST, read_grasps
from pointsdf_cli.io.hdf5 import artifacts_below, open_hdf5, options_of
from pointsdf_cli.io.meshes import artifact_path, find_meshes, load_mesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.attempt import SCENE_ATTEMPTS, AttemptConfig
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.simulation.verdict import Outcome

AS_COLLECTED = "as collected"
ASIDE = "0.1 mm aside"
"""The object so much off, physics as collected: what a label owes to luck, whatever the step."""
WHOLE = "the whole arm"
"""Attempt as in a trial: the arm is simulated too, its joints give way a little, at its own
step."""
SKIN = "with PyBullet's skin"
"""Hulls stand out by it, as they did until they were drawn in."""
FINER = {
    "half the step": (0.5, 1),
    "half the iterations": (1, 0.5),
    "half of both": (0.5, 0.5),
    "twice the iterations": (1, 2),
    "five times the iterations": (1, 5),
    "both": (0.5, 2),
    "five times and half": (0.5, 5),
}
"""Factors of the step and of the solver's iterations a step."""
VARIANTS = (AS_COLLECTED, ASIDE, WHOLE, SKIN, *FINER)


def variant(name: str, base: AttemptConfig) -> AttemptConfig:
    """Changes to the conditions of an attempt."""
    if name == WHOLE:
        return base.with_the_whole_arm()
    step, iterations = FINER.get(name, (1, 1))
    physics = base.physics
    if name == SKIN:
        return replace(base, physics=replace(physics, skin=0.0))
    return replace(
        base,
        physics=replace(
            physics, step=physics.step * step, iterations=round(physics.iterations * iterations)
        ),
    )


def chosen(folder: Path, count: int, seed: int) -> dict[Path, list[int]]:
    """`count` executed attempts of a folder of grasps, rows by file, every attempt as likely."""
    pool = []
    for path in artifacts_below(folder):
        pool += [(path, int(row)) for row in np.flatnonzero(read_grasps(path)[0].executed)]
    order = np.random.default_rng(seed).permutation(len(pool))[:count]
    rows: dict[Path, list[int]] = {}
    for path, row in sorted(pool[i] for i in order):
        rows.setdefault(path, []).append(row)
    return rows


def interval(changed: int, count: int) -> tuple[float, float]:
    """Wilson's 95% interval of a share."""
    z, share = 1.96, changed / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2)
    return max(0.0, middle - half), min(1.0, middle + half)


def label_of(outcome: Outcome) -> int:
    """As in a grasps file."""
    return (HELD if outcome.held else LOST) if outcome.valid else INVALID


def again(
    grasps_folder: Path,
    mesh_folder: Path,
    attempters: dict[str, Attempter],
    base: AttemptConfig,
    count: int,
    seed: int,
) -> dict[str, object]:
    """Stored grasps carried out with each physics; what changed, for `--json`.

    Raises:
        InputError: Nothing there was ever executed.
    """
    rows = chosen(grasps_folder, count, seed)
    count = sum(len(found) for found in rows.values())
    if not count:
        raise InputError("no executed grasps", where=grasps_folder)
    meshes = {
        artifact_path(mesh, mesh_folder, grasps_folder).with_suffix(".h5"): mesh
        for mesh in find_meshes(mesh_folder)
    }
    labels: dict[str, list[int]] = {name: [] for name in attempters}
    changed = dict.fromkeys(attempters, 0)
    causes = dict.fromkeys(attempters, 0)
    now_held = dict.fromkeys(attempters, 0)
    rises: dict[str, list[float]] = {name: [] for name in attempters}
    was_held, otherwise, physics = 0, 0, base.physics
    expected = json.loads(json.dumps(base.as_dict()))
    started = time.process_time()
    for path, found in rows.items():
        grasps, _ = read_grasps(path)
        with open_hdf5(path) as file:
            options = options_of(file)
        otherwise += any(options.get(key) != expected[key] for key in ("hand_alone", "physics"))
        aside = grasps.T_world_object.copy()
        aside[:, :2, 3] += 1e-4 / np.sqrt(2)
        moved = replace(grasps, T_world_object=aside)
        if path not in meshes:
            raise InputError(
                "is of a mesh that is not there",
                where=path,
                allowed=f"those of {mesh_folder}",
            )
        item = prepare_object(load_mesh(meshes[path]))
        for row in found:
            was_held += int(grasps.label[row] == HELD)
            for name, attempter in attempters.items():
                stored = moved if name == ASIDE else grasps
                outcome = attempter.replay(item, stored, row)
                labels[name].append(label_of(outcome))
                changed[name] += int(labels[name][-1] != grasps.label[row])
                causes[name] += outcome.cause != CAUSES[grasps.cause[row]]
                now_held[name] += outcome.held
                if outcome.held and grasps.label[row] == HELD:
                    rises[name].append(abs(outcome.lift_height - float(grasps.lift_height[row])))
    print(
        f"{count} executed grasps of {len(rows)} objects, {was_held} held; step 1/"
        f"{1 / physics.step:.0f} s, {physics.iterations} iterations; "
        f"{time.process_time() - started:.0f} CPU seconds"
    )
    if otherwise:
        print(f"{otherwise} of {len(rows)} objects were collected with other physics than that")
    result: dict[str, object] = {"count": count, "held": was_held}
    for name in attempters:
        low, high = interval(changed[name], count)
        rise = 1000 * float(np.median(rises[name])) if rises[name] else float("nan")
        print(
            f"{name:22} {changed[name]:3d} labels changed ({changed[name] / count:.1%}, "
            f"{low:.1%} to {high:.1%}), {causes[name]:3d} causes, {now_held[name]} held, "
            f"rise differs by {rise:.2f} mm in the median"
        )
        result[name] = {
            "labels changed": changed[name],
            "causes changed": causes[name],
            "held": now_held[name],
            "interval": [low, high],
            "median rise difference [mm]": rise,
        }
    print_pairs(labels)
    return result


def anew(
    mesh_folder: Path,
    attempters: dict[str, Attempter],
    base: AttemptConfig,
    count: int,
    seed: int,
) -> dict[str, object]:
    """Whole attempts with each physics; their labels, for `--json`."""
    meshes = find_meshes(mesh_folder)
    order = np.random.default_rng(seed).permutation(len(meshes))
    labels: dict[str, list[int]] = {name: [] for name in attempters}
    tried, executed, objects, physics = 0, 0, 0, base.physics
    started = time.process_time()
    for place in order:
        try:
            item = prepare_object(load_mesh(meshes[place]))
            for attempter in attempters.values():
                attempter.check(item)
                attempter.scene(item, 0)
        except InputError as error:
            print(error.message, file=sys.stderr)
            continue
        objects += 1
        for index in range(min(SCENE_ATTEMPTS, count - tried)):
            for name, attempter in attempters.items():
                labels[name].append(attempter.attempt(item, index).label)
            tried += 1
            executed += int(any(found[-1] in (HELD, LOST, INVALID) for found in labels.values()))
        if tried == count:
            break
    print(
        f"{tried} attempts with {objects} objects, {executed} executed; step 1/"
        f"{1 / physics.step:.0f} s, {physics.iterations} iterations; "
        f"{time.process_time() - started:.0f} CPU seconds"
    )
    print_pairs(labels)
    return {"count": tried, "executed": executed, "labels": labels}


def print_pairs(labels: dict[str, list[int]]) -> None:
    """Number of labels that differ between any two."""
    for first, second in itertools.combinations(labels, 2):
        differ = sum(a != b for a, b in zip(labels[first], labels[second], strict=True))
        count = len(labels[first])
        low, high = interval(differ, count)
        print(
            f"{first} | {second}: {differ} differ ({differ / count:.1%}, {low:.1%} to {high:.1%})"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--grasps", type=Path, help="without, whole attempts are made anew")
    parser.add_argument("--meshes", type=Path, required=True)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=VARIANTS)
    parser.add_argument("--whole-arm", action="store_true", help="of the trials' physics")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    base = AttemptConfig()
    if options.whole_arm:
        base = base.with_the_whole_arm()
    names = [name for name in options.variants if options.grasps or name != ASIDE]
    robot = load_robot()
    attempters = {name: Attempter(robot, variant(name, base)) for name in names}
    try:
        if options.grasps:
            found = again(
                options.grasps, options.meshes, attempters, base, options.count, options.seed
            )
        else:
            found = anew(options.meshes, attempters, base, options.count, options.seed)
    except InputError as error:
        print(error.message, file=sys.stderr)
        return 2
    finally:
        for attempter in attempters.values():
            attempter.close()
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
