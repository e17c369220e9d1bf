#!/usr/bin/env bash
# The pipeline end to end on a handful of objects, in under a minute; every stage's own checks hold.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

rgrasp objects make --out "$work/meshes" --count 6 --seed 1 --quiet
rgrasp render --meshes "$work/meshes" --out "$work/views" --views 20 --quiet
rgrasp label-sdf --views "$work/views" --meshes "$work/meshes" --out "$work/labels" --points 5000 --quiet
rgrasp info "$work"/views/*.h5 --quiet >/dev/null
rgrasp doctor --quiet
test "$(find "$work/labels" -name '*.h5' | wc -l)" = 6
# A second run finds everything there.
rgrasp render --meshes "$work/meshes" --out "$work/views" --views 20 --quiet --json | grep -q '"made": 0, "kept": 6'
echo "smoke: the pipeline holds"
