#!/usr/bin/env bash
# Trains the reconstruction network on one GPU from an empty folder, with views made beside it.
#   pipelines/gpu/train.sh WORK [MESHES]
# WORK    folder for view files (about 5 GB for ten minutes of 16 cores); those there are used again
# MESHES  folder of free scans to add to the generated objects (may be left out); a WORK that was
#         begun with others, or without any, is refused
# MINUTES of training (10), SEED (0), DEVICE (cuda) and OPTIONS (more of learn.py: --force) may be
# set. The checkpoint is WORK/pointsdf-ray; one that is there stays, but with --force.
# A GPU needs CuPy too (pip install cupy-cuda12x); DEVICE=cpu is for trying it out.
set -euo pipefail
work=${1:?usage: pipelines/gpu/train.sh WORK [MESHES]}
minutes=${MINUTES:-10}
here=$(dirname "$0")
mkdir -p "$work"
python "$here/make_views.py" "$work/views" ${2:+--meshes "$2"} >"$work/views.log" 2>&1 &
maker=$!
python "$here/learn.py" "$work/views" "$work/pointsdf-ray" --minutes "$minutes" --seed "${SEED:-0}" \
    --device "${DEVICE:-cuda}" ${OPTIONS:-} &
learner=$!
trap 'kill $maker $learner 2>/dev/null || true' EXIT
wait -n $maker $learner || true
if kill -0 $learner 2>/dev/null; then
    echo "make_views.py ended: see $work/views.log" >&2
    tail -n 3 "$work/views.log" >&2
    exit 1
fi
wait $learner
