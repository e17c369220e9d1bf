#!/usr/bin/env bash
# The pipeline end to end on a handful of objects, command by command and as the paper's script
# (killed and begun again), in four minutes or so; every stage's own checks hold.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

rgrasp objects make --out "$work/meshes" --count 6 --seed 1 --quiet
rgrasp render --meshes "$work/meshes" --out "$work/views" --views 20 --quiet
rgrasp label-sdf --views "$work/views" --meshes "$work/meshes" --out "$work/labels" --points 5000 --quiet
rgrasp train-sdf --views "$work/views" --labels "$work/labels" --out "$work/ckpt" --steps 3 \
    --batch-size 4 --held-out 0.2 --quiet >/dev/null
rgrasp mesh assets/clouds/mug.ply --out "$work/mug.ply" --resolution 64 --quiet >/dev/null
rgrasp plan assets/clouds/table.ply --out "$work/plan.h5" --trajectory "$work/motion.json" --no-picture --quiet >/dev/null
grep -q '"joint_names"' "$work/motion.json"
rgrasp eval-sdf --checkpoint assets/weights/pointsdf_ray --views "$work/views" \
    --meshes "$work/meshes" --out "$work/table.json" --count 1 --resolution 32 --samples 2000 --quiet >/dev/null
rgrasp info "$work"/views/*.h5 --quiet >/dev/null
rgrasp doctor --quiet
test "$(find "$work/labels" -name '*.h5' | wc -l)" = 6
# A second run finds everything there.
rgrasp render --meshes "$work/meshes" --out "$work/views" --views 20 --quiet --json | grep -q '"made": 0, "kept": 6'

# The paper's script, tiny, killed twice on the way: it carries on, and nothing is lost.
python pipelines/kill_test.py "$work/paper" --kills 2 --longest 40 >&2 || { cat "$work/paper.log" >&2; exit 1; }
for made in table1.json figure3.json trials/report.html; do test -s "$work/paper/$made"; done
echo "smoke: the pipeline holds"
