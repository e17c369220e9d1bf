#!/usr/bin/env bash
# The recipe of the bundled reconstruction weights, from meshes to a checkpoint. Every stage resumes.
#   pipelines/train_sdf.sh WORK [MESHES]
# WORK    folder for data and checkpoints (about 12 GB)
# MESHES  folder of free real meshes to add to the generated ones (may be left out)
# MODEL (pointsdf-ray), MINUTES of each stage (240), THREADS (0: those that idle), OBJECTS (6000) and
# SEED (0) may be set. The checkpoint is WORK/MODEL.
set -euo pipefail
work=${1:?usage: pipelines/train_sdf.sh WORK [MESHES]}
real=${2:-}
model=${MODEL:-pointsdf-ray}
objects=${OBJECTS:-6000}
seed=${SEED:-0}
mkdir -p "$work"

# A focal length of 1067 px, as colour cameras have that depth is registered to.
echo '{"width": 640, "height": 480, "K": [[1067, 0, 319.5], [0, 1067, 239.5], [0, 0, 1]]}' >"$work/colour.json"
exact() { # views of the object alone, without errors: shapes are learned from these
    rgrasp render --meshes "$1" --out "$work/exact/$2" --views "$3" --distance "$4" --skip-bad --seed "$seed"
}
scenes() { # views of tables: a fifth exact, in the others masks and, in two of three, cameras err
    rgrasp render --meshes "$1" --out "$work/scenes/$2" --views "$3" --camera "$4" --scene table \
        --sensor ideal,structured-light,stereo --exact 0.2 --skip-bad --seed "$seed"
}
labels() {
    rgrasp label-sdf --views "$work/exact/$2" --meshes "$1" --out "$work/labels/$2" --points "$3" --skip-bad
}
for half in "far 1.5 0 xtion" "near 0.9 1 $work/colour.json"; do
    read -r name distance more camera <<<"$half" # the last takes a path with spaces whole
    rgrasp objects make --out "$work/meshes/$name" --count $((objects / 2)) --seed $((2 * seed + more))
    exact "$work/meshes/$name" "$name" 8 "$distance"
    labels "$work/meshes/$name" "$name" 16000
    scenes "$work/meshes/$name" "$name" 8 "$camera"
done
if [ -n "$real" ]; then
    exact "$real" real 60 1.5
    labels "$real" real 24000
    scenes "$real" real 40 realsense
fi

train() { # VIEWS OUT [options]
    local views=$1 out=$2 resume=()
    shift 2
    [ -f "$out/train_state.pt" ] && resume=(--resume)
    rgrasp train-sdf --views "$views" --labels "$work/labels" --out "$out" --model "$model" \
        --minutes "${MINUTES:-240}" --threads "${THREADS:-0}" --held-out 0.02 --seed "$seed" "$@" "${resume[@]}"
}
train "$work/exact" "$work/$model-exact"
train "$work/scenes" "$work/$model" --start-from "$work/$model-exact" --learning-rate 0.0008 --overlap-weight 0.5
