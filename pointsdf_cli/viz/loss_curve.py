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
    for axes, key, label in (
        (losses, "train_loss", "training"),
        (losses, "view_loss", "held-out views"),
        (losses, "object_loss", "held-out objects"),
        (overlap, "view_iou", "held-out views"),
        (overlap, "object_iou", "held-out objects"),
    ):
        axes.plot(minutes, [entry[key] for entry in history], label=label, marker=".")
    losses.set(ylabel="loss", yscale="log")
    overlap.set(ylabel="IoU on the labelled points")
    for axes in (losses, overlap):
        axes.set(xlabel="training time [min]")
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    return figure
