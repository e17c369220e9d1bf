"""Report on a checkpoint: contents, training, and loss curve."""

from __future__ import annotations

from pathlib import Path

from pointsdf_cli.io.checkpoints import has_train_state, read_checkpoint, read_train_state
from pointsdf_cli.io.describe import flattened
from pointsdf_cli.viz import html
from pointsdf_cli.viz.loss_curve import loss_figure


def checkpoint_report(path: Path, title: str) -> str:
    """HTML page about a checkpoint directory.

    Raises:
        InputError: There is no checkpoint, or it is damaged.
    """
    checkpoint = read_checkpoint(path)
    count = sum(tensor.numel() for tensor in checkpoint.weights.values())
    bits = {str(tensor.dtype).removeprefix("torch.") for tensor in checkpoint.weights.values()}
    size = f"{count:,} numbers in {len(checkpoint.weights)} tensors ({', '.join(bits)})."
    parts = [html.note(size)]
    # An exported checkpoint has no training state, and train-gs another history.
    history = read_train_state(path).get("history", []) if has_train_state(path) else []
    if history and "object_loss" in history[0]:
        parts += [html.heading("Training"), html.picture(loss_figure(history), "loss over time")]
    rows = [(name, _text(value)) for name, value in flattened(checkpoint.config).items()]
    return html.page(title, [*parts, html.heading("Configuration"), html.table(("", ""), rows)])


def _text(value: object) -> object:
    return ", ".join(map(str, value)) if isinstance(value, list) else value
