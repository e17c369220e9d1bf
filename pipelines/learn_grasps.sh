#!/usr/bin/env bash
# The recipe of the bundled success weights, for any robot: grasps of the paper's heuristic, a first
# network, the solutions of a planner that uses it, and the network that learns from both.
#   pipelines/learn_grasps.sh MESHES WORK
# MESHES     folder of meshes to learn from
# WORK       folder for grasps/ and checkpoints; WORK/success/geometry is what is bundled
# HEURISTIC, PLANNED  numbers of executed grasps (3000 each)
# ROBOT      by name or YAML (lbr4_allegro); SDF  reconstruction network (the bundled one)
# OPTIONS    more options of train-gs: "--epochs 1"; JOBS  processes (0: all cores)
# Killed and started again, it continues.
set -euo pipefail
trap "exit 130" INT TERM
meshes=${1:?usage: pipelines/learn_grasps.sh MESHES WORK}
work=${2:?usage: pipelines/learn_grasps.sh MESHES WORK}
here=$(dirname "$0")
export ROBOT=${ROBOT:-lbr4_allegro} CACHE=$work/cache VARIANTS=geometry TABLE=no
sdf=()
[ -z "${SDF:-}" ] || sdf=(--checkpoint "$SDF")
collect=(--meshes "$meshes" --robot "$ROBOT" --push 2.5 --seed 0 --jobs "${JOBS:-0}" --no-pictures)

mkdir -p "$work"
rgrasp collect-grasps "${collect[@]}" --count "${HEURISTIC:-3000}" --out "$work/grasps/heuristic"
"$here/train_gs.sh" "$work/grasps/heuristic" "$work/first"
rgrasp collect-grasps "${collect[@]}" --count "${PLANNED:-3000}" --out "$work/grasps/planned" \
    --preshapes planned "${sdf[@]}" --grasp-checkpoint "$work/first/geometry"
"$here/train_gs.sh" "$work/grasps" "$work/success"
