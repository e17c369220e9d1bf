"""Train `pointsdf-ray` on a GPU with the views that make_views.py makes meanwhile.

    python pipelines/gpu/learn.py VIEWS OUT --minutes M [--start-from CHECKPOINT] [--device cuda]

Loss, optimiser, schedule and averaging are those of `train-sdf`. A step is recorded once as a CUDA
graph and replayed: its 1500 small operations cost more to launch than to run. OUT is a checkpoint
as `train-sdf` writes it: of the averaged weights those with the lowest held-out loss, which is
measured every `--validate` minutes.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import kernels
import torch
from make_views import MOST_POINTS, SIZES
from recipe import ENDED, RECIPE
from torch import Tensor
from views_on_device import Symmetry, Views

from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.io.checkpoints import (
    forget_train_state,
    read_config,
    require_checkpoint_place,
    write_checkpoint,
)
from pointsdf_cli.io.provenance import git_commit
from pointsdf_cli.models.box_frame import box_around
from pointsdf_cli.models.neighbours import SEARCHES
from pointsdf_cli.models.pointsdf_ray import PointSDFRay
from pointsdf_cli.models.processor import fast_products, keep_large_allocations
from pointsdf_cli.models.registry import build_model, load_model
from pointsdf_cli.models.revolution import places
from pointsdf_cli.training.ema import WeightAverage
from pointsdf_cli.training.presets import settings
from pointsdf_cli.training.sdf_config import TrainConfig
from pointsdf_cli.training.sdf_data import Batch, predict
from pointsdf_cli.training.sdf_loop import finite
from pointsdf_cli.training.sdf_loss import label_iou, sdf_loss

FILES_AT_ONCE = 3
"""Files read together: eigenvectors of the normals of 16 fill the memory of a GPU."""
VALIDATION_QUERIES = 1500
REPORT_EVERY = 500
HELD_OUT = 1000
"""Most views that validate."""
REFRESH_EVERY = 10
"""Steps after which new views are drawn from."""


class RayWithSymmetry(PointSDFRay):
    """`pointsdf-ray` whose axes and boxes are given instead of found in every step."""

    symmetry: Symmetry

    def _symmetry(
        self, cloud: Tensor, camera: Tensor, centres: Tensor, neighbours: Tensor
    ) -> dict[str, Tensor]:
        axis, directions, alignment = self.symmetry
        with torch.autocast(cloud.device.type, enabled=False):
            box = box_around(cloud, axis, directions, alignment)
            known = {f"axis_{name}": value for name, value in axis._asdict().items()}
            known |= {f"box_{name}": value for name, value in box._asdict().items()}
            return known | {"places": places(cloud, axis)}

    def predict(self, batch: Batch, symmetry: Symmetry) -> Tensor:
        """Signed distances [B, Q] of a batch."""
        self.symmetry = symmetry
        return predict(self, batch)


class Training:
    """A run: network, optimiser and one step of it, recorded where the device is a GPU."""

    def __init__(
        self, model: RayWithSymmetry, views: Views, config: TrainConfig, device: torch.device
    ) -> None:
        self.model = model.to(device).train()
        self.views, self.config, self.device = views, config, device
        self._products = fast_products(device)
        on_gpu = device.type == "cuda"
        rate: Any = (
            torch.tensor(config.learning_rate, device=device) if on_gpu else config.learning_rate
        )
        self._optimiser = torch.optim.AdamW(
            model.parameters(), lr=rate, weight_decay=config.weight_decay, betas=(0.9, 0.98),
            fused=True, capturable=on_gpu,
        )  # fmt: skip
        self.average: WeightAverage[RayWithSymmetry] = WeightAverage(model, config.average)
        self.loss_sum = torch.zeros((), device=device)
        self.steps = 0
        self._graphs = {size: self._recorded(size) for size in views.sizes} if on_gpu else {}

    def _fast_products(self) -> torch.autocast:
        """Context of products in bfloat16 where the device is faster with it."""
        return torch.autocast(self.device.type, self._products, enabled=self._products is not None)

    def _operations(self, size: int) -> None:
        """One step but for the learning rate, with clouds of a size."""
        drawn = self.views.draw(self.config.batch_size, size)
        batch, symmetry = self.views.batch(drawn, self.config.queries, size=size)
        with self._fast_products():
            predicted = self.model.predict(batch, symmetry)
        loss = sdf_loss(self.config.loss, predicted, batch.sdf)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.config.clip)
        self._optimiser.step()
        self.loss_sum += loss.detach()

    def _recorded(self, size: int) -> torch.cuda.CUDAGraph:
        """A step as a graph; its first runs, which allocate memory, learn at a rate of 0."""
        self._set_rate(0.0)
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):
                self._optimiser.zero_grad(set_to_none=True)
                self._operations(size)
        torch.cuda.current_stream().wait_stream(side)
        # Without gradients before it, a backward pass writes them instead of adding to them.
        self._optimiser.zero_grad(set_to_none=True)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            self._operations(size)
        self.loss_sum.zero_()
        return graph

    def take_step(self, progress: float) -> None:
        """A step, `progress` ∈ [0, 1] of the way."""
        self._set_rate(self.config.rate(self.steps, progress))
        if self.steps % REFRESH_EVERY == 0:
            self.views.refresh()
        sizes = self.views.drawn_sizes()
        size = sizes[int(torch.randint(len(sizes), ()))]
        if self._graphs:
            self._graphs[size].replay()
        else:
            self._optimiser.zero_grad(set_to_none=True)
            self._operations(size)
        self.average.update(self.model, self.steps)
        self.steps += 1

    def _set_rate(self, rate: float) -> None:
        for group in self._optimiser.param_groups:
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(rate)
            else:
                group["lr"] = rate

    @torch.no_grad()
    def validate(self, held_out: Views) -> dict[str, float]:
        """Loss and overlap of the averaged weights, with evidence about the space and without: on
        the same clouds and queries each time."""
        device = torch.device(self.device)
        devices = [device] if device.type == "cuda" else []
        with torch.random.fork_rng(devices=devices):
            torch.manual_seed(0)
            return self._validated(held_out)

    def _validated(self, held_out: Views) -> dict[str, float]:
        numbers = {}
        for name, evidence in (("", True), ("_bare", False)):
            losses, overlaps = [], []
            for views, size in self._in_parts(held_out):
                batch, symmetry = held_out.batch(
                    views, VALIDATION_QUERIES, augment=False, evidence=evidence, size=size
                )
                with self._fast_products():
                    predicted = self.average.model.predict(batch, symmetry)
                losses += [sdf_loss(self.config.loss, predicted, batch.sdf)] * len(views)
                overlaps.append(label_iou(predicted, batch.sdf))
            numbers[f"object_loss{name}"] = float(torch.stack(losses).mean())
            numbers[f"object_iou{name}"] = float(torch.cat(overlaps).mean())
        return numbers

    @staticmethod
    def _in_parts(held_out: Views) -> Iterator[tuple[Tensor, int]]:
        """All views, each with the largest size of cloud that it has points for."""
        for size in held_out.sizes:
            views = held_out.of_size(size)
            for part in views.split(64) if len(views) else ():
                yield part, size


class Files:
    """View files that appear in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._read = folder, set[Path]()

    def add_to(self, views: Views) -> int:
        """Add some that are new; their number."""
        found = sorted(p for p in self._folder.glob("[0-9]*.npz") if p not in self._read)
        some = found[:FILES_AT_ONCE]
        self._read.update(some)
        if some:
            views.add(some)
        return len(some)


def _cloud_sizes(points: Sequence[int], recipe: Mapping[str, Any]) -> list[int]:
    """Sizes of the clouds in increasing order.

    Raises:
        InputError: The view files hold clouds of their own, and not of these sizes.
    """
    sizes = sorted(points)
    if recipe["samplings"] and (sizes[0] != SIZES[0] or not set(sizes) <= set(SIZES)):
        raise InputError(
            f"{', '.join(map(str, sizes))} points",
            where="--points",
            allowed=f"{SIZES[0]} and any of {', '.join(map(str, SIZES[1:]))}: the view files hold "
            "clouds of these sizes",
        )
    return sizes


def _keep_reading(files: Files, views: Views, over: threading.Event) -> None:
    """Add files as they appear, beside the training."""
    stream = torch.cuda.Stream() if views.device.type == "cuda" else None
    with torch.cuda.stream(stream):
        while not over.is_set() and views.count < views.capacity:
            if not files.add_to(views):
                over.wait(0.5)


class Run:
    """A training with its data and its checkpoint, as the command's options say.

    Raises:
        InputError: A checkpoint is there already, or too few views are and no more are made.
        RgraspError: The loss is no longer finite.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._options, device = options, torch.device(options.device)
        require_checkpoint_place(options.out, replace=options.force)
        self._best: dict[str, float] | None = None
        torch.manual_seed(options.seed)
        keep_large_allocations()
        if device.type == "cuda":
            SEARCHES["cuda"] = kernels.nearest
        arguments, config = settings("pointsdf-ray", "small", vars(options))
        if options.start_from is None:
            source = build_model("pointsdf-ray", arguments, seed=options.seed)
        else:
            source = load_model(options.start_from)
        model = RayWithSymmetry(**source.config() | {"most_points": max(options.points)})
        model.load_state_dict(source.state_dict())
        if not (options.views / RECIPE).exists():
            print(f"waiting for make_views.py to begin with {options.views}", flush=True)
        while not (options.views / RECIPE).exists():
            time.sleep(0.2)
        recipe = self._recipe()
        sizes = _cloud_sizes(options.points, recipe)
        like = device, model.sideways, sizes, recipe["samplings"]
        objects = recipe["objects"] + recipe["scans"] * recipe["shapes_per_scan"]
        self._views = Views(options.capacity, objects, *like)
        self._held_out = Views(HELD_OUT, recipe["validation"], *like)
        self._files = Files(options.views)
        self._wait_for_views()
        self._began = time.monotonic()
        self._training = Training(model, self._views, config, device)

    def _wait_for_views(self) -> None:
        folder, few = self._options.views, self._options.first_views
        held_files = Files(folder / "valid")
        print(f"waiting for {few} views in {folder}, and held-out ones", flush=True)
        while True:
            ended = (folder / ENDED).exists()  # before the files that it is the last of
            if held_files.add_to(self._held_out):
                continue
            if self._held_out.count and self._views.count >= few:
                break
            if self._files.add_to(self._views):
                continue
            if ended:
                raise InputError(
                    f"holds {self._views.count} views and {self._held_out.count} held-out ones, "
                    "and no more are made",
                    where=folder,
                    allowed="as many as --first-views, and at least one held out",
                )
            time.sleep(0.2)
        self._views.refresh()

    def finish(self) -> None:
        """Train until the time is over, and read new files meanwhile."""
        over = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            reader = pool.submit(_keep_reading, self._files, self._views, over)
            try:
                self._train(reader)
            finally:
                over.set()

    def _train(self, reader: Future[None]) -> None:
        training, validated, minutes = self._training, 0.0, 0.0
        while minutes < self._options.minutes:
            training.take_step(minutes / self._options.minutes)
            if training.steps % REPORT_EVERY == 0:
                loss = finite(float(training.loss_sum) / REPORT_EVERY, training.steps)
                training.loss_sum.zero_()
                if reader.done():
                    reader.result()  # raises what ended it
                print(f"step {training.steps}: loss {loss:.4f}, {self._views.count} views")
            minutes = (time.monotonic() - self._began) / 60
            if minutes - validated >= self._options.validate:
                self._save()
                validated = minutes
        self._save()

    def _recipe(self) -> dict[str, Any]:
        file = self._options.views / RECIPE
        return json.loads(file.read_text()) if file.exists() else {}

    def _save(self) -> None:
        """Validate the averaged weights and write them, unless better ones are there."""
        training, start = self._training, self._options.start_from
        seconds = round(time.monotonic() - self._began, 1)
        entry = {"step": training.steps, "seconds": seconds, **training.validate(self._held_out)}
        print(entry, flush=True)
        held_out_loss = finite(entry["object_loss"], training.steps)
        is_best = self._best is None or held_out_loss < self._best["object_loss"]
        self._best = entry if is_best else self._best
        config = {
            "architecture": training.model.architecture,
            "model": training.model.config(),
            "training": asdict(training.config),
            "progress": {"step": training.steps, "seconds": seconds},
            "best": self._best,
            "started_from": read_config(start) if start else None,
            "data": {"view_count": self._views.count, **self._recipe()},
            "git_commit": git_commit(),
        }
        weights = training.average.weights() if is_best else None
        forget_train_state(self._options.out)  # of a run that this one replaces
        write_checkpoint(self._options.out, config=config, weights=weights, half=True)


@leave_with_message()
def main() -> None:
    """Train until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("views", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, required=True)
    parser.add_argument("--start-from", type=Path)
    parser.add_argument("--batch-size", type=int, default=256)
    parser.add_argument("--queries", type=int, default=256)
    parser.add_argument("--points", type=int, nargs="+", default=[1000, 2000, 3000],
                        help="sizes of clouds, one of them in each step")  # fmt: skip
    parser.add_argument("--learning-rate", type=float, default=1.5e-3)
    parser.add_argument("--overlap-weight", type=float, default=0.5)
    parser.add_argument("--capacity", type=int, default=150_000, help="views, 42 kB each")
    parser.add_argument("--first-views", type=int, default=2000, help="views to wait for")
    parser.add_argument("--validate", type=float, default=2.0, help="minutes between validations")
    parser.add_argument("--force", action="store_true", help="replace a checkpoint")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if max(options.points) > MOST_POINTS:
        parser.error(f"--points: views hold at most {MOST_POINTS} points")
    Run(options).finish()


if __name__ == "__main__":
    main()
