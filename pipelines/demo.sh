#!/usr/bin/env bash
# A grasp planned on a real capture (RealSense, a bottle on a table), with its motion; bundled clouds
# completed by the bundled weights; objects made here, depth views of them, exact signed distances; pictures of all.
#   pipelines/demo.sh [DIR]      (about a minute; DIR defaults to demo/)
set -euo pipefail
out=$(realpath -m --relative-to="$(dirname "$0")/.." "${1:-demo}")
cd "$(dirname "$0")/.."

capture=assets/captures/mustard
rgrasp cloud "$capture/depth.png" --depth-scale 0.0001 --intrinsics "$capture/K.json" \
    --camera-pose "$capture/T_world_camera.json" --out "$out/bottle.ply" --force
rgrasp mesh "$out/bottle.ply" --segment auto --out "$out/bottle_mesh.ply" --force
rgrasp plan "$out/bottle.ply" --out "$out/plan.h5" --trajectory "$out/motion.json" --force
python pipelines/first_picture.py "$capture" "$out/bottle_mesh.ply" "$out/plan.h5" "$out/first.png"
rgrasp objects make --out "$out/meshes" --count 24 --seed 7 --sheet "$out/objects.png" --force
rgrasp render --meshes "$out/meshes" --out "$out/views" --views 50 --force
rgrasp label-sdf --views "$out/views" --meshes "$out/meshes" --out "$out/labels" --force
rgrasp report "$out" --pictures "$out" --force
for name in power_drill spray_bottle mug; do
    rgrasp mesh "assets/clouds/$name.ply" --out "$out/$name.ply" --picture "$out/$name.png" --force
done
echo
echo "Look at $out/first.png (from a real depth image to a grasp), $out/plan.png, $out/power_drill.png (a cloud and its reconstruction),"
echo "$out/views.png and $out/signed_distance.png, or open $out/report.html"
