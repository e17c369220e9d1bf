"""The picture of a training run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from pointsdf_cli.io.atomic import atomic_path


def draw_loss_curve(history: Sequence[Mapping[str, float]], path: Path | str) -> None:
    """`loss_figure` as a picture: .png, .pdf or .svg."""
    figure = loss_figure(history)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def loss_figure(history: Sequence[Mapping[str, float]]) -> Figure:
    """Losses and label IoU over training time.

    Args:
        history: One entry a validation, as `train_sdf` keeps them (at least one).
    """
    minutes = [entry["seconds"] / 60.0 for entry in history]
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    losses, overlap = figure.subplots(1, 2)
    for key, label in (
        ("train_loss", "training"),
        ("view_loss", "held-out views"),
        ("object_loss", "held-out objects"),
    ):
        losses.plot(minutes, [entry[key] for entry in history], label=label, marker=".")
    losses.set(xlabel="training time [min]", ylabel="loss", yscale="log")
    for key, label in (("view_iou", "held-out views"), ("object_iou", "held-out objects")):
        overlap.plot(minutes, [entry[key] for entry in history], label=label, marker=".")
    overlap.set(xlabel="training time [min]", ylabel="IoU on the labelled points")
    for axes in (losses, overlap):
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    return figure
