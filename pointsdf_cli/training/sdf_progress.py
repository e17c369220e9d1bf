"""Reports of the training of a reconstruction network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Progress:
    """Progress after a step.

    Attributes:
        step: Steps done.
        fraction: Share of the whole run that is done.
        loss: Mean training loss since the last report.
        clouds_per_second: Since the last report.
        seconds_left: Estimate.
        validation: Set right after a validation.
    """

    step: int
    fraction: float
    loss: float
    clouds_per_second: float
    seconds_left: float
    validation: dict[str, float] | None = None

    def describe(self) -> str:
        """Describe the progress in one line."""
        found = self.validation
        if found is not None:
            return (
                f"step {self.step}: held-out objects loss {found['object_loss']:.4f} "
                f"IoU {found['object_iou']:.4f}, held-out views loss {found['view_loss']:.4f} "
                f"IoU {found['view_iou']:.4f}"
            )
        return (
            f"step {self.step} ({self.fraction:.1%}): loss {self.loss:.4f}, "
            f"{self.clouds_per_second:.0f} clouds/s, {self.seconds_left / 60:.0f} min left"
        )


@dataclass(frozen=True)
class TrainResult:
    """Result of a run.

    Attributes:
        finished: False if it was stopped; `--resume` then carries on.
        step: Steps done.
        seconds: Training time, over all resumed parts.
        history: One entry a validation: step, seconds, train_loss, and the validation's numbers.
        best: The entry whose weights were kept.
    """

    finished: bool
    step: int
    seconds: float
    history: list[dict[str, float]]
    best: dict[str, float] | None

    def as_dict(self) -> dict[str, Any]:
        """Report for the user; without the history."""
        return {
            "finished": self.finished,
            "steps": self.step,
            "seconds": round(self.seconds, 1),
            "best": self.best,
        }
