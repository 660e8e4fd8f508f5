"""Training of a network, which can be interrupted at any time and resumed."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, Callable

import torch
from torch import Tensor

from weights_tools.checkpoint import load_checkpoint, save_checkpoint
from weights_tools.curves import best_epoch, write_picture
from weights_tools.dataset import Dataset, Samples
from weights_tools.distributed import Processes
from weights_tools.errors import InputError
from weights_tools.lift import lift_of
from weights_tools.metrics import LEAST_CLOUD, mass_error, relative_error
from weights_tools.model import Network
from weights_tools.neighbours import Neighbours
from weights_tools.optimizer import Optimizers
from weights_tools.recipe import LossRecipe, Recipe, TrainingRecipe, completed
from weights_tools.sensor import Sensor
from weights_tools.shift import Shifter
from weights_tools.start import start as start_from
from weights_tools.table import write_table

LAST = "last.pt"
"""Checkpoint of the last complete epoch, from which a training is resumed."""
BEST = "best.pt"
"""Checkpoint of the epoch with the smallest epsilon on the validation clouds."""

EPOCHS_PER_PICTURE = 10
"""Number of epochs after which the figure of the learning curves is updated."""

TYPICAL = 128
"""Number of clouds from whose images the first statistics of a network are taken that starts from a
weights file."""

_VALIDATION_NOISE = -1


class Training:
    """A training run in its own folder, in its state after some epoch.

    Random numbers depend on the seed, the epoch and the order of their use in the epoch only, so
    that a resumed run is identical to an uninterrupted one.
    """

    def __init__(
        self,
        recipe: Recipe,
        data: Dataset,
        folder: Path,
        processes: Processes,
        start: Path | None = None,
    ) -> None:
        """Resume the run in ``folder``, or begin a new one, with the parameters of ``start`` if it
        is given: a checkpoint of a network of the same kind, or a weights file
        (``NAME.safetensors``), also of fewer bands and without the effective radius.

        Raises :class:`InputError` for a checkpoint of another recipe, data set or network, and if
        a batch has fewer samples than there are processes.
        """
        self.recipe, self.data, self.folder = recipe, data, folder
        self.processes, self.device = processes, processes.device
        self._check_processes()
        torch.manual_seed(recipe.training.seed)
        channels = recipe.network.channels(len(data.image_geometry), data.levels)
        self.network = Network(channels, lift_of(_layout(recipe, data)))
        self.network.to(self.device, memory_format=torch.channels_last)
        self.layers = processes.layers(self.network)
        muon_share = recipe.training.muon_learning_rate / recipe.training.learning_rate
        self.optimizers = Optimizers(self.network, muon_share)
        self.shifter = None
        limits = recipe.training
        shifts = limits.shift_voxels, limits.shift_levels, limits.pointing_pixels
        if any(shifts):
            self.shifter = Shifter(data.image_geometry, data.voxel_spacing_km, *shifts)
        self.neighbours = None
        if self.shifter is not None and recipe.training.neighbours:
            self.neighbours = Neighbours(data.train, self.shifter, recipe.training.neighbours)
        noisy = validation_images(data, recipe.sensor, recipe.training.seed)
        self.validation = Samples(data.validation.volumes, noisy)
        self.epoch = 0
        self.progress = 0.0
        self.elapsed_s = 0.0
        self.history: list[dict[str, float]] = []
        self.started_from: dict[str, Any] | None = None
        """The training metadata of the network from which this training started."""
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / LAST).exists():
            self._resume(load_checkpoint(folder / LAST))
        elif start is not None:
            self._start(start)
        if processes.agreed(self.epoch) != [self.epoch]:
            remedy = "use a folder that all processes can access"
            raise InputError(folder, "is not the folder of the first process", remedy)

    def run(self, minutes: float | None, report: Callable[[str], None]) -> None:
        """Train to the last epoch of the recipe, or for ``minutes`` in total if that is sooner.

        The learning rate follows whichever of the two is nearer to its end. The training may end
        earlier if the recipe has a patience.
        """
        if self.epoch:
            report(f"resuming after epoch {self.epoch}")
        while not self.ended:
            start = time.monotonic()
            loss = self._train_epoch(minutes, start)
            scores = self.scores() if self.processes.first else (0.0, 0.0, 0.0)
            spent = time.monotonic() - start
            epsilon, delta, radius_error, spent = self.processes.agreed(*scores, spent)
            self.epoch += 1
            self.elapsed_s += spent
            row = {
                "epoch": self.epoch,
                "loss": loss,
                "validation_epsilon": epsilon,
                "validation_delta": delta,
                "learning_rate": self.optimizers.learning_rate,
                "minutes": self.elapsed_s / 60.0,
            }
            radius = ""
            if self.recipe.network.effective_radius:
                row["validation_radius_error"] = radius_error
                radius = f"radius error {radius_error:.3f} um  "
            self.history.append(row)
            if self.processes.first:
                self._save()
            report(
                f"epoch {self.epoch}/{self.recipe.training.epochs}  loss {loss:.5f}  "
                f"validation epsilon {epsilon:.4f} delta {delta:+.4f}  {radius}"
                f"learning rate {row['learning_rate']:.2e}  {row['minutes']:.1f} min"
            )
        if self.epoch < self.recipe.training.epochs and self.progress < 1.0:
            report(f"ended: no smaller epsilon since epoch {best_epoch(self.history)}")

    @property
    def ended(self) -> bool:
        """Whether the limit of epochs, of time or of patience is reached."""
        training = self.recipe.training
        if self.epoch >= training.epochs or self.progress >= 1.0:
            return True
        if training.patience == 0 or not self.history:
            return False
        return self.epoch - best_epoch(self.history) >= training.patience

    def scores(self) -> tuple[float, float, float]:
        """Mean epsilon, mean delta and mean error of the effective radius (um; 0 if the network
        does not estimate it) over the validation clouds, with a fixed noise."""
        volumes = self.estimate(self.validation.radiance)
        epsilon, delta = scores(volumes["extinction"], self.validation.extinction)
        radius = volumes.get("effective_radius")
        return epsilon, delta, 0.0 if radius is None else radius_error(radius, self.validation)

    def estimate(self, radiance: Tensor) -> dict[str, Tensor]:
        """The outputs ``[n, z, y, x]`` by name (1/km; um) from noisy images
        ``[n, view, row, col]``."""
        self.network.eval()
        scaling, names = self.recipe.scaling, self.recipe.network.outputs
        with torch.no_grad():
            batches = radiance.split(self.recipe.training.batch)
            outputs = [self.network.layers(self._input(batch)).cpu() for batch in batches]
        self.network.train()
        scales = {"effective_radius": scaling.effective_radius_scale}
        parts = torch.cat(outputs).split(self.data.levels, 1)
        return {
            name: part * scales.get(name, scaling.output_scale) for name, part in zip(names, parts)
        }

    def _train_epoch(self, minutes: float | None, start: float) -> float:
        training, samples = self.recipe.training, self.data.train
        generator = _generator(training.seed, self.epoch)
        order = torch.randperm(len(samples), generator=generator)
        batches = _batches(order, training.batch)
        total = 0.0
        for step, batch in enumerate(batches):
            progress = (self.epoch + step / len(batches)) / training.epochs
            if minutes is not None:
                (spent,) = self.processes.agreed(time.monotonic() - start)
                progress = max(progress, (self.elapsed_s + spent) / (60.0 * minutes))
            self.progress = max(self.progress, min(progress, 1.0))
            total += self._step(batch, learning_rate(training, self.progress), generator)
        return self.processes.mean(total / len(batches))

    def _step(self, batch: Tensor, rate: float, generator: torch.Generator) -> float:
        images, truth = self._batch(batch, generator)
        self.optimizers.zero_grad()
        reduced = self.recipe.training.reduced_precision
        with torch.autocast(self.device.type, torch.bfloat16, enabled=reduced):
            outputs = self.layers(images, self.recipe.training.leak)
        # Weighted by the size of the share, so that the mean over processes is that over the batch.
        weight = len(truth) * self.processes.count / len(batch)
        loss = weight * loss_of(self.recipe.loss, truth, outputs.float())
        loss.backward()
        self.optimizers.step(rate)
        return loss.item()

    def _batch(self, batch: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """The input of the first layer, and the scaled volumes, of the share of a batch."""
        volumes, radiance = self.data.train.volumes[batch], self.data.train.radiance[batch]
        if self.shifter is not None:
            volumes, radiance = self.shifter.draw(volumes, radiance, generator)
        if self.neighbours is not None:
            volumes, radiance = self.neighbours.draw(volumes, radiance, generator)
        rows, cols = self._crop(radiance, generator)
        volumes = volumes[..., rows, cols]
        mine = self.processes.share(len(batch))
        noisy = sensed(radiance, self.data, self.recipe.sensor, generator)
        images = self._input(noisy[mine], rows, cols)
        scaling = self.recipe.scaling
        truth = volumes[mine] / scaling.output_scale
        if truth.ndim == 5:
            truth[:, 1] /= scaling.effective_radius_scale
        return images, truth.to(self.device)

    def _crop(self, images: Tensor, generator: torch.Generator) -> tuple[slice, slice]:
        """The rows and columns that this step uses."""
        training = self.recipe.training
        if training.crop == 0 or self.progress >= training.crop_until:
            return slice(None), slice(None)
        limit = training.crop_shift
        shifts = torch.randint(-limit, limit + 1, (2,), generator=generator).tolist()
        rows, cols = (
            _part(length, training.crop, shift) for length, shift in zip(images.shape[2:], shifts)
        )
        return rows, cols

    def _input(
        self, radiance: Tensor, rows: slice = slice(None), cols: slice = slice(None)
    ) -> Tensor:
        """The input of the first layer for noisy images, restricted to some rows and columns."""
        scaled = radiance.to(self.device) * self.recipe.scaling.input_scale
        lifted = self.network.lifted(scaled)[..., rows, cols]
        return lifted.contiguous(memory_format=torch.channels_last)

    def _check_processes(self) -> None:
        size = self.recipe.training.batch
        smallest = min(map(len, _batches(torch.arange(len(self.data.train)), size)))
        if smallest < self.processes.count:
            problem = f"has batches of {smallest} samples for {self.processes.count} processes"
            raise InputError("the training", problem, "start fewer, or make training.batch larger")

    def _save(self) -> None:
        checkpoint: dict[str, Any] = {
            "epoch": self.epoch,
            "model_state_dict": {
                name: values.cpu().contiguous()
                for name, values in self.network.state_dict().items()
            },
            "optimizer_state_dict": self.optimizers.state_dict(),
            "progress": self.progress,
            "elapsed_s": self.elapsed_s,
            "history": self.history,
            "recipe": self.recipe.resolved(),
            "metadata": self._metadata(),
            "started_from": self.started_from,
        }
        if best_epoch(self.history) == self.epoch:
            save_checkpoint(self.folder / BEST, checkpoint)
        save_checkpoint(self.folder / LAST, checkpoint)
        write_table(self.history, self.folder)
        if self.ended or self.epoch % EPOCHS_PER_PICTURE == 0:
            write_picture(self.history, self.folder)

    def _metadata(self) -> dict[str, Any]:
        metadata = _metadata(self.recipe, self.data, self.history[-1])
        if self.started_from is not None:
            metadata["configuration"]["started_from"] = self.started_from
        return metadata

    def _start(self, path: Path) -> None:
        if path.suffix.lower() == ".safetensors":
            typical = torch.arange(min(TYPICAL, len(self.data.train)))
            images, volumes = self._batch(typical, _generator(self.recipe.training.seed, 0))
            metadata = {**_layout(self.recipe, self.data), **_outputs(self.recipe)}
            self.started_from = start_from(self.network, path, metadata, images, volumes)
            return
        checkpoint = load_checkpoint(path)
        recipe = self.recipe.resolved()
        remedy = "start from a checkpoint of a training with the same [network] and [scaling]"
        theirs = completed(checkpoint["recipe"]) if "recipe" in checkpoint else {}
        if any(theirs.get(part) != recipe[part] for part in ("formation", "network", "scaling")):
            raise InputError(path, "is not of a network like that of the recipe", remedy)
        self.network.load_state_dict(checkpoint["model_state_dict"])
        self.started_from = checkpoint["metadata"]["training"]

    def _resume(self, checkpoint: dict[str, Any]) -> None:
        path = self.folder / LAST
        remedy = "resume with the same recipe and data, or train in another folder"
        if "metadata" not in checkpoint:
            raise InputError(path, "is not a checkpoint of this program", remedy)
        if completed(checkpoint["recipe"]) != self.recipe.resolved():
            raise InputError(path, "was trained by another recipe", remedy)
        if checkpoint["metadata"]["training"]["identity"] != self.data.identity:
            raise InputError(path, "was trained on other data", remedy)
        self.network.load_state_dict(checkpoint["model_state_dict"])
        self.optimizers.load_state_dict(checkpoint["optimizer_state_dict"])
        self.epoch = checkpoint["epoch"]
        self.progress = checkpoint["progress"]
        self.elapsed_s = checkpoint["elapsed_s"]
        self.history = checkpoint["history"]
        self.started_from = checkpoint.get("started_from")


def validation_images(data: Dataset, sensor: Sensor, seed: int) -> Tensor:
    """The images of the validation clouds with the fixed noise that is used for the scores."""
    return sensed(data.validation.radiance, data, sensor, _generator(seed, _VALIDATION_NOISE))


def sensed(radiance: Tensor, data: Dataset, sensor: Sensor, generator: torch.Generator) -> Tensor:
    """Noisy images ``[n, view, row, col]``. Each band has a sensor of its own, whose exposure fits
    the brightest pixel of the band."""
    bands = radiance.unflatten(1, (len(data.wavelengths_um), -1))
    return sensor.sense(bands, generator).flatten(1, 2)


def _batches(order: Tensor, size: int) -> list[Tensor]:
    # A small last batch is left out, as its statistics would degrade the batch normalisation.
    return [batch for batch in order.split(size) if 2 * len(batch) > size] or [order]


def _part(length: int, crop: int, shift: int) -> slice:
    """``crop`` of ``length`` lines, ``shift`` lines from the centre as far as there is room."""
    start = min(max((length - crop) // 2 + shift, 0), max(length - crop, 0))
    return slice(start, start + crop)


def learning_rate(training: TrainingRecipe, progress: float) -> float:
    """The learning rate at a fraction of the training: it increases linearly and decreases along a
    cosine."""
    if progress < training.warmup:
        return training.learning_rate * (0.01 + 0.99 * progress / training.warmup)
    fall = (progress - training.warmup) / (1.0 - training.warmup)
    return training.learning_rate * 0.5 * (1.0 + math.cos(math.pi * fall))


def loss_of(recipe: LossRecipe, truth: Tensor, outputs: Tensor) -> Tensor:
    """The loss for a batch of scaled extinction ``[n, z, y, x]``, or ``[n, 2, z, y, x]`` with the
    product of the extinction and the effective radius. ``outputs`` are those of the network: the
    extinction, followed by its uncertainty if the network estimates it, and by the effective radius
    if there is a product."""
    truth, product = truth.unbind(1) if truth.ndim == 5 else (truth, None)
    estimate, *further = outputs.split(truth.shape[1], 1)
    radius = further.pop() if product is not None else None
    difference = estimate - truth
    loss = recipe.squared * difference.square().mean()
    squares = truth.square().sum((1, 2, 3)).clamp_min(LEAST_CLOUD)
    if recipe.squared_by_cloud:
        by_cloud = difference.square().sum((1, 2, 3)) / squares
        loss = loss + recipe.squared_by_cloud * by_cloud.mean()
    if recipe.relative:
        amounts = truth.sum((1, 2, 3)).clamp_min(LEAST_CLOUD)
        epsilon = difference.abs().sum((1, 2, 3)) / amounts
        loss = loss + recipe.relative * epsilon.mean()
    for uncertainty in further:
        # Detached, so that the uncertainty term has no effect on the extinction.
        missed = (uncertainty - difference.detach().abs()).square().sum((1, 2, 3))
        loss = loss + recipe.uncertainty * (missed / squares).mean()
    if radius is not None:
        amounts = truth.sum((1, 2, 3)).clamp_min(LEAST_CLOUD)
        missed = (truth * radius - product).abs().sum((1, 2, 3))
        loss = loss + recipe.effective_radius * (missed / amounts).mean()
    return loss


def radius_error(estimate: Tensor, samples: Samples) -> float:
    """The mean over clouds of the mean absolute error of an effective radius ``[n, z, y, x]`` (um),
    weighted by the true extinction."""
    extinction, product = samples.volumes.double().unbind(1)
    missed = (extinction * estimate.double() - product).abs().sum((1, 2, 3))
    return (missed / extinction.sum((1, 2, 3))).mean().item()


def scores(estimate: Tensor, truth: Tensor) -> tuple[float, float]:
    """Mean epsilon and mean delta over clouds ``[n, z, y, x]``."""
    return relative_error(truth, estimate).mean().item(), mass_error(truth, estimate).mean().item()


def _generator(seed: int, epoch: int) -> torch.Generator:
    return torch.Generator().manual_seed((seed * 1_000_003 + epoch) % 2**63)


def _layout(recipe: Recipe, data: Dataset) -> dict[str, Any]:
    """The geometry of images and voxels, in the form used in weights files."""
    geometry, levels = data.geometry, data.manifest["levels"]
    wavelengths = data.wavelengths_um
    dx, dy, dz = data.voxel_spacing_km
    levels = {"bottom_km": levels["bottom_km"], "count": data.levels, "spacing_km": dz}
    return {
        "view_geometry": {
            "sun_zenith_deg": geometry.sun_zenith_deg,
            "sun_azimuth_deg": geometry.sun_azimuth_deg,
            "view_zenith_deg": list(geometry.view_zenith_deg),
            "view_azimuth_deg": list(geometry.view_azimuth_deg),
            "pixel_km": list(geometry.pixel_km),
            "camera_distance_km": list(geometry.camera_distance_km),
        },
        "wavelength_um": list(wavelengths) if len(wavelengths) > 1 else wavelengths[0],
        # The cameras of a data set are pointed at the centre of its samples.
        "target_altitude_km": levels["bottom_km"] + 0.5 * data.levels * dz,
        "image_layout": recipe.network.image_layout(levels),
        "horizontal_spacing_km": [dx, dy],
        "levels": levels,
    }


def _outputs(recipe: Recipe) -> dict[str, Any]:
    """The outputs and the scales, in the form used in weights files."""
    scales = asdict(recipe.scaling)
    if not recipe.network.effective_radius:
        del scales["effective_radius_scale"]
    return {"outputs": recipe.network.outputs, **scales}


def _metadata(recipe: Recipe, data: Dataset, row: dict[str, float]) -> dict[str, Any]:
    """The metadata of the weights, without those of the layers."""
    scores = {"epsilon": row["validation_epsilon"], "delta": row["validation_delta"]}
    if recipe.network.effective_radius:
        scores["radius_error"] = row["validation_radius_error"]
    return {
        **_layout(recipe, data),
        "formation": data.formation,
        **_outputs(recipe),
        "training": {
            "data": data.name,
            "identity": data.identity,
            "samples": len(data.train),
            "seed": recipe.training.seed,
        },
        "scores": scores,
        "configuration": recipe.resolved(),
    }
