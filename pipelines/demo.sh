#!/usr/bin/env bash
# A grasp planned on a real depth image (RealSense, a bottle on a table), with its motion; bundled
# clouds completed by the bundled weights; objects made here, depth views of them, exact signed
# distances; pictures of all.
#   pipelines/demo.sh [DIR]      (about a minute; DIR defaults to demo/)
set -euo pipefail
out=$(realpath -m --relative-to="$(dirname "$0")/.." "${1:-demo}")
cd "$(dirname "$0")/.."

capture=assets/captures/mustard
camera=(--intrinsics "$capture/K.json" --camera-pose "$capture/T_world_camera.json" --depth-scale 0.0001)
rgrasp plan "$capture/depth.png" "${camera[@]}" --out "$out/plan.h5" --trajectory "$out/motion.json" --force
rgrasp mesh "$capture/depth.png" "${camera[@]}" --segment auto --out "$out/bottle.ply" --force
python pipelines/first_picture.py "$capture" "$out/bottle.ply" "$out/plan.h5" "$out/first.png"
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
