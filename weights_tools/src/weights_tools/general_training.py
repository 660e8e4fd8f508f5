"""Training of a general network on scenes that are made at the same time."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable

import torch
from torch import Tensor

from weights_tools.checkpoint import load_checkpoint, save_checkpoint
from weights_tools.errors import InputError
from weights_tools.general import GeneralNetwork, with_extremes
from weights_tools.general_file import (
    GeneralDescription,
    GeneralWeights,
    load_general,
    write_general_weights,
)
from weights_tools.general_recipe import GeneralRecipe, GeneralTrainingRecipe
from weights_tools.general_step import Step
from weights_tools.metrics import mass_error, relative_error
from weights_tools.planes import on_planes
from weights_tools.scenes import CLOUDCT_10, PEARLS_32_DEG
from weights_tools.stream import Batches, Pool, validation_chunks, wait_for
from weights_tools.surface import above_surface
from weights_tools.table import write_table

LAST, BEST, WEIGHTS = "last.pt", "best.pt", "best.safetensors"
"""Checkpoint to resume from; checkpoint and weights file with the smallest epsilon."""

PEARLS = len(PEARLS_32_DEG)
VALIDATION_VIEWS = {
    "cloudct_10": (True, CLOUDCT_10),
    "pearls_32": (True, tuple(range(PEARLS))),
    "any_8": (False, tuple(range(PEARLS, PEARLS + 8))),
    "any_3": (False, tuple(range(PEARLS, PEARLS + 3))),
}
"""The formations of the scores: whether they apply to the scenes in the light of the paper only,
and the indices of the views. The last two are in random directions."""

_EVALUATED = 16
_VALIDATION_NOISE = 5
_SMOOTHING = 0.02


@dataclass(frozen=True)
class Generators:
    """How the scenes are made."""

    recipe_path: Path
    simulations: Path
    count: int = 1
    """Number of processes; with 0, chunks must be written by other programs."""
    renderer: str = "auto"
    paths: int = 512
    """Number of photon paths of a pixel, for the Monte Carlo program of this package."""
    small: bool = False
    pool: Path | None = None
    """Folder of the scenes; without it, a folder in that of the training."""


class GeneralTraining:
    """A training run in its own folder.

    It can be interrupted at any time and resumed. A training that has reached its end begins a new
    cycle of the learning rate if it is resumed with a longer duration.
    """

    def __init__(
        self,
        recipe: GeneralRecipe,
        folder: Path,
        generators: Generators,
        device: torch.device,
        report: Callable[[str], None],
        start: Path | None = None,
    ) -> None:
        """Resume the run in ``folder``, or begin a new one, with the parameters of the checkpoint
        or weights file ``start`` if it is given.

        Raises :class:`InputError` for a checkpoint of another recipe or network.
        """
        self.recipe, self.folder, self.device, self.report = recipe, folder, device, report
        self._generators = generators
        torch.manual_seed(recipe.training.seed)
        torch.backends.cudnn.benchmark = device.type == "cuda"
        self.network = GeneralNetwork(recipe.network)
        self.steps = 0
        self.samples = 0
        self.elapsed_s = 0.0
        self.cycle_start_s = 0.0
        """Duration of the training before the current cycle of the learning rate."""
        self.progress = 0.0
        self.history: list[dict[str, float]] = []
        folder.mkdir(parents=True, exist_ok=True)
        checkpoint = load_checkpoint(folder / LAST) if (folder / LAST).exists() else None
        if checkpoint is not None:
            self._resume(checkpoint)
        elif start is not None:
            self._start(start)
        self.network.to(device, memory_format=torch.channels_last).train()
        settings = recipe.training
        muon_share = settings.muon_learning_rate / settings.learning_rate
        self.step = Step(self.network, muon_share, report)
        if checkpoint is not None:
            self.step.optimizers.load_state_dict(checkpoint["optimizer_state_dict"])
        self._pool_folder = pool = generators.pool or folder / "pool"
        self.pool = Pool(pool, "train", recipe.stream.chunks, device)
        self.validation = Pool(pool, "validation", validation_chunks(recipe), device)

    def run(self, minutes: float) -> None:
        """Train for ``minutes`` in total, including the parts before an interruption."""
        if self.progress >= 1.0 and 60.0 * minutes > self.elapsed_s:
            self.cycle_start_s, self.progress = self.elapsed_s, 0.0
            self.report("a new cycle of the learning rate begins")
        processes = self._start_generators()
        try:
            self._train(minutes, lambda: _check_alive(processes))
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait()

    def scores(self) -> dict[str, float]:
        """For each formation of the validation, the mean epsilon and delta, and the sum of the
        estimated absolute errors divided by that of the actual ones."""
        result = {}
        generator = torch.Generator(self.device).manual_seed(_VALIDATION_NOISE)
        self.network.eval()
        for name, (paper, views) in VALIDATION_VIEWS.items():
            scenes = self.validation.paper if paper else self.validation.all
            if not len(scenes):
                continue
            with torch.no_grad():
                parts = [self._score(part, views, generator) for part in scenes.split(_EVALUATED)]
            values = torch.cat(parts).double()
            epsilon, delta, expected, found = values.mean(0).tolist()
            result[f"{name}_epsilon"], result[f"{name}_delta"] = epsilon, delta
            result[f"{name}_uncertainty"] = expected / max(found, 1e-9)
        self.network.train()
        return result

    def _score(self, scenes: Tensor, views: tuple[int, ...], generator: torch.Generator) -> Tensor:
        chosen = torch.tensor(views, device=self.device).expand(len(scenes), -1)
        truth, radiance, geometry, _ = self.validation.take(scenes, chosen)
        images = self.recipe.sensor.sense(radiance, generator, normal=True)
        scaling = self.recipe.scaling
        above = above_surface(images, geometry, scaling.surface_albedo)
        scaled = above * scaling.input_scale
        planes = on_planes(scaled, geometry, self.recipe.network.heights)
        with torch.autocast(self.device.type, torch.bfloat16):
            outputs = self.network(planes, geometry).float() * scaling.output_scale
        estimate, uncertainty = outputs.chunk(2, 1)
        total = truth.sum((1, 2, 3))
        found = (estimate - truth).abs().sum((1, 2, 3)) / total
        expected = uncertainty.sum((1, 2, 3)) / total
        errors = relative_error(truth, estimate), mass_error(truth, estimate)
        return torch.stack([*errors, expected.double(), found.double()], 1)

    def _train(self, minutes: float, alive: Callable[[], None]) -> None:
        settings, stream = self.recipe.training, self.recipe.stream
        self.report("waiting for the first scenes")
        self.validation.update()
        wait_for(self.validation, self.recipe.scenes.validation, alive)
        wait_for(self.pool, 1, alive)
        cropping = self.device.type == "cpu" and settings.crop > 0
        batches = Batches(self.recipe, self.pool, cropping, settings.seed + self.steps)
        if self.steps:
            self.report(f"resuming after {self.steps} steps")
        else:
            self._evaluate(math.nan)
        before, start, reported = self.elapsed_s, time.monotonic(), time.monotonic()
        loss: Tensor | None = None
        while self.progress < 1.0:
            if not self.network.frozen and self.progress >= settings.frozen:
                self.step.freeze()
            batch = batches.draw()
            loss = self._smoothed(loss, self._step(batch, settings))
            self.steps += 1
            self.samples += len(batch.truth)
            now = time.monotonic()
            self.elapsed_s = before + now - start
            length = 60.0 * minutes - self.cycle_start_s
            progress = (self.elapsed_s - self.cycle_start_s) / length if length > 0.0 else 1.0
            self.progress = max(self.progress, min(progress, 1.0))
            if now - reported > 60.0 * settings.report_minutes or self.progress >= 1.0:
                self.pool.update()
                self._evaluate(float(loss))
                reported = time.monotonic()
            if self.samples > stream.uses * self._available():
                wait_for(self.pool, self.pool.rendered + 1, alive)

    def _available(self) -> int:
        """The number of scenes that this run and those before it have rendered."""
        return max(self.pool.rendered, self.recipe.stream.chunk * (self._newest() + 1))

    def _newest(self) -> int:
        return max(self.pool.numbers, default=-1)

    def _step(self, batch: Any, settings: GeneralTrainingRecipe) -> Tensor:
        leak = settings.leak * (1.0 - self.progress)
        relative, squared = loss_weights(settings, self.progress)
        weights = (leak, relative, squared, settings.uncertainty)
        return self.step.run(batch, general_rate(settings, self.progress), weights)

    @staticmethod
    def _smoothed(before: Tensor | None, loss: Tensor) -> Tensor:
        # Without reading the value, for which the processor would have to wait for the GPU.
        return loss.clone() if before is None else before.lerp(loss, _SMOOTHING)

    def _evaluate(self, loss: float) -> None:
        scores = self.scores()
        row = {
            "step": self.steps,
            "minutes": self.elapsed_s / 60.0,
            "samples": self.samples,
            "scenes": self.pool.rendered,
            "loss": loss,
            "learning_rate": self.step.optimizers.learning_rate,
            **scores,
        }
        self.history.append(row)
        names = [name for name in VALIDATION_VIEWS if f"{name}_epsilon" in scores]
        found = "  ".join(
            f"{name} {scores[f'{name}_epsilon']:.4f} {scores[f'{name}_delta']:+.3f}"
            for name in names
        )
        rate = self.samples / max(self.elapsed_s, 1e-9)
        self.report(
            f"{row['minutes']:.1f} min  step {self.steps}  {rate:.1f} samples/s  "
            f"{len(self.pool)} scenes  loss {loss:.4f}  epsilon, delta: {found}"
        )
        self._save()

    def _save(self) -> None:
        checkpoint: dict[str, Any] = {
            "general": vars(self.recipe.network),
            "description": vars(self._description()),
            "model_state_dict": {
                name: values.detach().cpu().contiguous()
                for name, values in self.network.state_dict().items()
            },
            "steps": self.steps,
            "samples": self.samples,
            "elapsed_s": self.elapsed_s,
            "cycle_start_s": self.cycle_start_s,
            "progress": self.progress,
            "frozen": self.network.frozen,
            "history": self.history,
            "recipe": self.recipe.resolved(),
        }
        if mean_epsilon(self.history[-1]) <= min(map(mean_epsilon, self.history)):
            save_checkpoint(self.folder / BEST, checkpoint)
            self._export()
        state = self.step.optimizers.state_dict()
        save_checkpoint(self.folder / LAST, {**checkpoint, "optimizer_state_dict": state})
        write_table(self.history, self.folder)
        self._picture()

    def _export(self) -> None:
        weights = GeneralWeights(self.network, self._description())
        try:
            write_general_weights(self.folder / WEIGHTS, weights)
        except ImportError:
            # `weights_tools export` writes the file where safetensors is installed.
            return

    def _picture(self) -> None:
        try:
            from weights_tools.general_curves import write_picture
        except ImportError:
            # A machine with a GPU may have no matplotlib.
            return
        write_picture(self.history, self.folder)

    def _description(self) -> GeneralDescription:
        row = self.history[-1]
        names = [name for name in VALIDATION_VIEWS if f"{name}_delta" in row]
        delta = sum(row[f"{name}_delta"] for name in names) / len(names)
        files = sorted({each.file for each in self.recipe.split("train")})
        recipe = self.recipe.resolved()
        return GeneralDescription(
            input_scale=self.recipe.scaling.input_scale,
            output_scale=self.recipe.scaling.output_scale,
            surface_albedo=self.recipe.scaling.surface_albedo,
            training={
                "data": ", ".join(files),
                "identity": f"scenes of seed {self.recipe.scenes.seed}",
                "samples": self.samples,
                "seed": self.recipe.training.seed,
            },
            scores={"epsilon": mean_epsilon(row), "delta": delta},
            configuration=_plain(recipe),
        )

    def _start(self, path: Path) -> None:
        weights = load_general(path)
        network, scale = weights.network, weights.description.input_scale
        if scale != self.recipe.scaling.input_scale:
            remedy = "make scaling.input_scale the same"
            raise InputError(path, f"is of a network with the input_scale {scale}", remedy)
        if self.recipe.network.extremes:
            network = with_extremes(network)
        if network.architecture != self.recipe.network:
            problem = f"has the architecture {vars(network.architecture)}"
            raise InputError(path, problem, "make [network] of the recipe the same")
        self.network.load_state_dict(network.state_dict())
        self.network.frozen = True
        self.report(f"starting from {path}")

    def _resume(self, checkpoint: dict[str, Any]) -> None:
        path = self.folder / LAST
        remedy = "resume with the same recipe, or train in another folder"
        if "general" not in checkpoint:
            raise InputError(path, "is not a checkpoint of a general network", remedy)
        if checkpoint["general"] != vars(self.recipe.network):
            raise InputError(path, "is of another [network]", remedy)
        self.network.load_state_dict(checkpoint["model_state_dict"])
        self.network.frozen = checkpoint["frozen"]
        for name in ("steps", "samples", "elapsed_s", "cycle_start_s", "progress", "history"):
            setattr(self, name, checkpoint[name])

    def _start_generators(self) -> list[subprocess.Popen[bytes]]:
        own = self._generators
        command = [sys.executable, "-m", "weights_tools", "scenes", str(own.recipe_path)]
        command += ["--simulations", str(own.simulations), "--out", str(self._pool_folder)]
        command += ["--renderer", own.renderer, "--paths", str(own.paths)]
        command += ["--parent", str(os.getpid())]
        if own.small:
            command.append("--small")
        processes = []
        for rank in range(own.count):
            with open(self.folder / f"generator-{rank}.log", "ab") as log:
                part = ["--part", f"{rank}/{own.count}"]
                processes.append(subprocess.Popen(command + part, stdout=log, stderr=log))
        return processes


def _check_alive(processes: list[subprocess.Popen[bytes]]) -> None:
    ended = [process for process in processes if process.poll() is not None]
    if ended:
        problem = f"ended with status {ended[0].returncode}"
        raise InputError("a generator of scenes", problem, "see generator-*.log in the folder")


def mean_epsilon(row: dict[str, float]) -> float:
    """The mean epsilon over the formations of the validation."""
    values = [row[f"{name}_epsilon"] for name in VALIDATION_VIEWS if f"{name}_epsilon" in row]
    return sum(values) / len(values)


def general_rate(settings: GeneralTrainingRecipe, progress: float) -> float:
    """The learning rate at a fraction of the training: it increases linearly and decreases along a
    cosine to zero."""
    rise = min(1.0, 0.02 + progress / settings.warmup)
    return settings.learning_rate * rise * 0.5 * (1.0 + math.cos(math.pi * progress))


def loss_weights(settings: GeneralTrainingRecipe, progress: float) -> tuple[float, float]:
    """The weights of epsilon and of the squared error at a fraction of the training."""
    first, last = settings.turn
    share = min(1.0, max(0.0, (progress - first) / (last - first)))
    (relative, final_relative), (squared, final_squared) = settings.relative, settings.squared
    return (
        relative + share * (final_relative - relative),
        squared + share * (final_squared - squared),
    )


def small(recipe: GeneralRecipe) -> GeneralRecipe:
    """The recipe for a test run of seconds: few small batches, few scenes."""
    return replace(
        recipe,
        scenes=replace(recipe.scenes, validation=2, generated=0.0, random_views=8),
        stream=replace(recipe.stream, chunk=2, chunks=4, uses=1e6),
        training=replace(recipe.training, batch=4, views_per_batch=80, report_minutes=0.2),
    )


def _plain(value: Any) -> Any:
    """Plain values with lists in the place of tuples, as JSON has them."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, (list, tuple)) else value
