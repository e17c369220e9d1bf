#!/usr/bin/env bash
# The recipe of the bundled reconstruction weights, from meshes to checkpoints. Every stage resumes.
#   pipelines/train_sdf.sh WORK [MESHES]
# WORK    folder for data and checkpoints (about 8 GB)
# MESHES  folder of free real meshes to add to the generated ones (may be left out)
# MODEL (pointsdf-ray), MINUTES (150), THREADS (0: those that idle) and OBJECTS (4400) may be set.
set -euo pipefail
work=${1:?usage: pipelines/train_sdf.sh WORK [MESHES]}
real=${2:-}
model=${MODEL:-pointsdf-ray}
objects=${OBJECTS:-4400}

mkdir -p "$work"
# Two halves of the generated objects at two distances, so that scale and perspective vary. They stand,
# and are seen from above the horizon, so that what is seen from below is believed closed.
for half in far:1.5:0 near:0.9:1; do
    IFS=: read -r name distance seed <<<"$half"
    rgrasp objects make --out "$work/meshes/$name" --count $((objects / 2)) --seed "$seed"
    rgrasp render --meshes "$work/meshes/$name" --out "$work/views/$name" --views 16 --distance "$distance" --above
    rgrasp label-sdf --views "$work/views/$name" --meshes "$work/meshes/$name" \
        --out "$work/labels/$name" --points 16000
done
# Half as many views of each generated object as there are, all of the real ones: of what the network
# is to see in the end, the real ones are nearer.
limits=(--views-per-object 8)
if [ -n "$real" ]; then
    rgrasp render --meshes "$real" --out "$work/views/real" --views 60 --skip-bad
    rgrasp label-sdf --views "$work/views/real" --meshes "$real" --out "$work/labels/real" \
        --points 24000 --skip-bad
    limits+=(--views-per-object real=60)
fi
resume=()
[ -f "$work/$model/train_state.pt" ] && resume=(--resume)
rgrasp train-sdf --views "$work/views" --labels "$work/labels" --out "$work/$model" --model "$model" \
    "${limits[@]}" --minutes "${MINUTES:-150}" --threads "${THREADS:-0}" --held-out 0.03 --seed 0 "${resume[@]}"
