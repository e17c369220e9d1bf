"""Reports of the training of a reconstruction network."""

from __future__ import annotations

from dataclasses import dataclass


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
