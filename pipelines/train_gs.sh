#!/usr/bin/env bash
# Success networks and Figure 3, from grasps to the table.
#   pipelines/train_gs.sh GRASPS WORK
# GRASPS    folder that `rgrasp collect-grasps` wrote
# WORK      folder for checkpoints, figure3.json and figure3.png
# VARIANTS  which networks, in this order; those that WORK has already finished from the
#           same grasps, reconstruction and options are kept:
#           "geometry pointsdf-fixed pointsdf-scratch voxelcnn-fixed voxelcnn-scratch"
# SDF       reconstruction to build on (the bundled one), VOXELCNN  a trained VoxelCNN, without
#           which voxelcnn-fixed is left out; THREADS and JOBS (0: those that idle) may be set.
# ROBOT     the robot of the grasps, by name or YAML: "panda"
# CACHE     folder of the network's features (GRASPS-cache)
# TABLE     no: train only, without the table of held-out grasps
# OPTIONS   more options of train-gs, for all: "--epochs 1"
# WORK/pointsdf-scratch is what assets/weights/grasp_scratch holds; pipelines/learn_grasps.sh makes
# the others.
set -euo pipefail
trap "exit 130" INT TERM # what was stopped is not finished
grasps=${1:?usage: pipelines/train_gs.sh GRASPS WORK}
work=${2:?usage: pipelines/train_gs.sh GRASPS WORK}
variants=${VARIANTS:-geometry pointsdf-fixed pointsdf-scratch voxelcnn-fixed voxelcnn-scratch}
common=(--grasps "$grasps" --threads "${THREADS:-0}" --jobs "${JOBS:-0}")
[ -z "${CACHE:-}" ] || common+=(--cache "$CACHE")
[ -z "${ROBOT:-}" ] || common+=(--robot "$ROBOT")

mkdir -p "$work"
rows=()
for variant in $variants; do
    out=$work/$variant
    options=(--half) sdf=
    case $variant in
    geometry) sdf=${SDF:-} ;;
    pointsdf-fixed | pointsdf-fine-tuned)
        options+=(--encoder pointsdf --mode "${variant#pointsdf-}")
        sdf=${SDF:-}
        ;;
    voxelcnn-fixed)
        if [ -z "${VOXELCNN:-}" ]; then
            echo "voxelcnn-fixed is left out: VOXELCNN names no trained VoxelCNN" >&2
            continue
        fi
        options+=(--encoder voxelcnn)
        sdf=$VOXELCNN
        ;;
    # Encoders overfit a few hundred objects soon: few epochs, whose rate falls to nothing.
    pointsdf-scratch | voxelcnn-scratch)
        options+=(--encoder "${variant%-scratch}" --mode scratch --epochs 20 --patience 6 --batch-size 64)
        ;;
    *)
        echo "no variant $variant" >&2
        exit 2
        ;;
    esac
    [ -z "$sdf" ] || options+=(--sdf "$sdf")
    # Grasps by name and size, the reconstruction by its weights: a network of others, or of other
    # options, is trained anew.
    asked="$variant ${options[*]} ${OPTIONS:-} $(
        find -H "$grasps" -name '*.h5' -printf '%P %s\n' | sort | cat - ${sdf:+"$sdf/model.safetensors"} |
            sha256sum
    )"
    before=$(cat "$out.asked" 2>/dev/null || true)
    if [ ! -e "$out/finished" ] || [ "$asked" != "$before" ]; then
        again=--force
        [ -f "$out/train_state.pt" ] && [ "$asked" = "$before" ] && again=--resume
        rm -f "$out/finished"
        [ "$again" = --resume ] || rm -f "$out/train_state.pt" # it is of other grasps
        printf '%s\n' "$asked" >"$out.asked"
        rgrasp train-gs "${common[@]}" --out "$out" "${options[@]}" ${OPTIONS:-} "$again"
        touch "$out/finished"
    fi
    rows+=(--checkpoint "$out")
done
[ "${TABLE:-yes}" != no ] || exit 0
rgrasp eval-gs "${common[@]}" "${rows[@]}" --out "$work/figure3.json" --force
