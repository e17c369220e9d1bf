#!/usr/bin/env bash
# What rgrasp sees: objects made here, real depth views of them, exact signed distances, a picture.
#   pipelines/demo.sh [DIR]      (about a minute; DIR defaults to demo/)
set -euo pipefail
out=${1:-demo}

rgrasp objects make --out "$out/meshes" --count 24 --seed 7 --sheet "$out/objects.png" --force
rgrasp render --meshes "$out/meshes" --out "$out/views" --views 50 --force
rgrasp label-sdf --views "$out/views" --meshes "$out/meshes" --out "$out/labels" --force
rgrasp report "$out" --pictures "$out" --force
echo
echo "Look at $out/views.png, $out/signed_distance.png, $out/objects.png, or open $out/report.html"
