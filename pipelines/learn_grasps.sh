#!/usr/bin/env bash
# The recipe of the bundled success weights, for any robot: grasps of the paper's heuristic, a first
# network, the solutions of a planner that uses it, and the network that learns from both.
#   pipelines/learn_grasps.sh MESHES WORK
# MESHES     folder of meshes to learn from
# WORK       folder for grasps/ and checkpoints; WORK/success is what is bundled
# HEURISTIC, PLANNED  numbers of executed grasps (3000 each)
# ROBOT      by name or YAML (lbr4_allegro); SDF  reconstruction network (the bundled one)
# OPTIONS    more options of train-gs: "--epochs 1"; JOBS  processes (0: all cores)
# Killed and started again, it continues.
set -euo pipefail
trap "exit 130" INT TERM
meshes=${1:?usage: pipelines/learn_grasps.sh MESHES WORK}
work=${2:?usage: pipelines/learn_grasps.sh MESHES WORK}
robot=(--robot "${ROBOT:-lbr4_allegro}")
sdf=() trained=()
[ -z "${SDF:-}" ] || sdf=(--checkpoint "$SDF") trained=(--sdf "$SDF")
collect=(--meshes "$meshes" --push 2.5 --seed 0 --jobs "${JOBS:-0}" --no-pictures)

# learn GRASPS OUT: finished once, and resumed if stopped.
learn() {
    [ ! -e "$2/finished" ] || return 0
    local again=--force
    [ ! -f "$2/train_state.pt" ] || again=--resume
    rgrasp train-gs --grasps "$1" --cache "$work/cache" --out "$2" --half --jobs "${JOBS:-0}" \
        "${robot[@]}" "${trained[@]}" ${OPTIONS:-} "$again"
    touch "$2/finished"
}

mkdir -p "$work"
rgrasp collect-grasps "${collect[@]}" "${robot[@]}" --count "${HEURISTIC:-3000}" --out "$work/grasps/heuristic"
learn "$work/grasps/heuristic" "$work/first"
rgrasp collect-grasps "${collect[@]}" "${robot[@]}" --count "${PLANNED:-3000}" --out "$work/grasps/planned" \
    --preshapes planned "${sdf[@]}" --grasp-checkpoint "$work/first"
learn "$work/grasps" "$work/success"
