"""Distributed training by several processes started by `torchrun`: on several GPUs, or machines.

Every worker holds the whole network and processes its share of each batch; gradients are averaged
before each step, so that all take the same step. A batch depends on seed and step alone, so n
workers together train as one would (except for batch norm and dropout, which act on a share).

    torchrun --nproc-per-node 4 --no-python rgrasp train-sdf --device cuda …
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
import torch.distributed as dist
from torch import nn

from pointsdf_cli.errors import InputError
from pointsdf_cli.training.sdf_data import Batch

PATIENCE = timedelta(minutes=60)
"""Time limit for workers that wait for each other; long, because the first packs the data."""


@dataclass(frozen=True)
class Workers:
    """The processes of a run, as known to one of them; by default one process.

    Attributes:
        rank: Rank of this process, from 0.
        count: Number of processes.
        local_count: Number of processes of this machine.
    """

    rank: int = 0
    count: int = 1
    local_count: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and reports to the user."""
        return self.rank == 0

    def share(self, batch: Batch) -> Batch:
        """This worker's rows of a batch.

        Raises:
            InputError: The batch cannot be divided evenly.
        """
        if len(batch.cloud) % self.count:
            raise InputError(
                f"{len(batch.cloud)} clouds cannot be divided evenly among {self.count} processes",
                where="--batch-size",
                allowed=f"multiples of {self.count}, and as many training views",
            )
        rows = len(batch.cloud) // self.count
        return batch.rows(self.rank * rows, (self.rank + 1) * rows)

    def average_gradients(self, model: nn.Module) -> None:
        """Replace each gradient by its mean over all workers, in one exchange."""
        if self.count == 1:
            return
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
        dist.all_reduce(flat)
        flat /= self.count
        means = flat.split([gradient.numel() for gradient in gradients])
        for gradient, mean in zip(gradients, means, strict=True):
            gradient.copy_(mean.view_as(gradient))

    def mean(self, value: float) -> float:
        """The mean of a number over all workers."""
        return self._reduced(value, dist.ReduceOp.SUM) / self.count if self.count > 1 else value

    def most(self, value: float) -> float:
        """Maximum of a number over all workers."""
        return self._reduced(value, dist.ReduceOp.MAX) if self.count > 1 else value

    def wait(self) -> None:
        """Wait until all workers have arrived."""
        self.most(0.0)

    @contextmanager
    def first_before_others(self) -> Iterator[None]:
        """Let the first worker run a block alone, the others after it."""
        if not self.is_first:
            self.wait()
        yield
        if self.is_first:
            self.wait()

    def _reduced(self, value: float, how: dist.ReduceOp.RedOpType) -> float:
        on_gpu = dist.get_backend() == "nccl"
        tensor = torch.tensor(value, dtype=torch.float64, device="cuda" if on_gpu else "cpu")
        dist.all_reduce(tensor, how)
        return float(tensor)


ALONE = Workers()


@contextmanager
def join_workers(device: str) -> Iterator[tuple[Workers, str]]:
    """Join the workers that `torchrun` started; yields them and this worker's device.

    Without torchrun's environment variables there is one worker. `cuda` becomes this worker's GPU.

    Raises:
        InputError: Several workers and one numbered GPU, or fewer GPUs than workers.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1 or "RANK" not in os.environ:
        yield ALONE, device
        return
    local_rank = int(os.environ["LOCAL_RANK"])
    local_count = int(os.environ.get("LOCAL_WORLD_SIZE", count))
    if device.startswith("cuda"):
        if device != "cuda" or torch.cuda.device_count() < local_count:
            raise InputError(
                f"{local_count} processes and {torch.cuda.device_count()} GPUs",
                where=f"--device {device}",
                allowed="cuda, with a GPU for each process",
            )
        device = f"cuda:{local_rank}"
        torch.cuda.set_device(local_rank)
    dist.init_process_group("nccl" if device.startswith("cuda") else "gloo", timeout=PATIENCE)
    try:
        yield Workers(int(os.environ["RANK"]), count, local_count), device
    finally:
        dist.destroy_process_group()
