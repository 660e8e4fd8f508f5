"""Adaptation of a network to images of clouds that nobody knows.

The network estimates a cloud from some views of a scene; the discrete-ordinates solver computes the
images of this cloud for all views; and the difference from the images that were taken is a loss for
the parameters of the network. Two things prevent that it is reduced by wrong clouds or at the cost
of others:

- *Held-out views.* Some views of each scene are not part of the loss. The parameters with the
  least misfit of these views are kept, and the adaptation ends when it does not decrease any more.
  A general network is not given these views either, and each step leaves out one more, which the
  cloud nevertheless has to explain. A network of one formation needs all views as its input.
- *Rehearsal.* Synthetic clouds of many sizes and thicknesses, in the views and the light of the
  scenes, are estimated as before: the difference from the first estimates is part of the loss.
  And three tenths of the change of the parameters are undone in the end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Union

import numpy as np
import torch
from torch import Tensor, nn

from weights_tools.chain import Estimator
from weights_tools.errors import InputError
from weights_tools.files import read_file, weights_header
from weights_tools.formation import FormationEstimator, FormationWeights
from weights_tools.general_file import (
    GeneralWeights,
    load_general,
    parse_general_weights,
    write_general_weights,
)

Weights = Union[GeneralWeights, FormationWeights]

FEWEST = 4
"""Smallest number of views of a scene: one is held out, and the network needs three."""

ACCURACY = 0.03
"""Accuracy of the renderer, and relative error of its images in the misfit."""

DARK = 0.003
"""Error of all pixels in the misfit, over the brightest pixel of a scene."""

MARGIN = 1.5
"""The renderer is prepared for the first estimate times this factor."""

FOLDED = 0.3
"""Learning rate of the layers of a network of one formation over that of a general network: they
contain the normalisations, and their values are smaller."""

REHEARSED_AT_ONCE = 2
"""Synthetic clouds in a step."""

LEAST_DECREASE = 0.01
"""Smallest relative decrease of the misfit of the held-out views that counts."""

DECAY = (0.9, 0.99)
"""Decay rates of the means of Adam."""


@dataclass(frozen=True)
class Settings:
    """Settings of an adaptation."""

    minutes: float = 10.0
    """Maximum duration."""
    most_steps: int = 1_000_000
    """Maximum number of steps."""
    held_out: float = 0.2
    """Share of the views of a scene that are held out, at least one."""
    learning_rate: float = 3e-4
    warm_up: int = 20
    """Steps over which the learning rate rises."""
    rehearsal: float = 200.0
    """Weight of the rehearsal: of the squared difference from the first estimates, over their
    squares."""
    synthetic: int = 24
    """Number of synthetic clouds."""
    kept: float = 0.7
    """Share of the change of the parameters that is written: the last part of it does more harm to
    other clouds than good to these (Wortsman et al. 2022, "Robust fine-tuning")."""
    steps: int = 10
    """Steps for each scene between two evaluations of the held-out views."""
    patience: int = 8
    """Evaluations without a decrease of their misfit after which the adaptation ends."""
    seed: int = 1


class Scene:
    """The images of a scene, and what the adaptation derives from them once."""

    def __init__(
        self, name: str, observation: Any, weights: Weights, held_out: float, seed: int
    ) -> None:
        import deepct_py
        import deepct_py.torch

        self.name, self.light = name, observation.light
        views = observation.views
        if len(views) < FEWEST:
            problem = f"has {len(views)} views"
            raise InputError(name, problem, f"give images of at least {FEWEST} views")
        if self.light.phase == "mie" and self.light.effective_radius is None:
            problem = "does not state the effective radius of its droplets"
            raise InputError(name, problem, "write images whose light has one, or another phase")
        is_general = isinstance(weights, GeneralWeights)
        try:
            if is_general:
                self.estimator = Estimator(weights, views, self.light)
            else:
                self.estimator = FormationEstimator(weights, observation)
        except ValueError as problem:
            remedy = "give images of cameras that point at one target"
            if not is_general:
                remedy = "give images of the formation without missing pixels, or general weights"
            raise InputError(name, str(problem), remedy) from None
        self.views = views
        self.images = torch.from_numpy(np.nan_to_num(observation.radiance))
        self._weights = torch.from_numpy(_precision(observation))
        # The views at both ends of a formation determine most and are kept.
        random = np.random.default_rng(seed)
        count = min(max(1, round(held_out * len(views))), len(views) - FEWEST + 1)
        middle = np.argsort([view.zenith_deg for view in views])[: max(count, len(views) - 2)]
        held = np.sort(random.choice(middle, count, replace=False))
        self.held = torch.from_numpy(held)
        self.learned = torch.tensor([view for view in range(len(views)) if view not in held])
        # The views that the network sees; it sees no images with missing pixels.
        self._seen: Tensor | None = None
        if is_general:
            is_complete = np.isfinite(observation.radiance).all((1, 2))
            self._seen = self.learned[torch.from_numpy(is_complete)[self.learned]]
            if len(self._seen) < FEWEST - 1:
                problem = f"has {len(self._seen)} views without missing pixels to learn from"
                raise InputError(name, problem, f"give images of at least {FEWEST} such views")
        self._planes = self.planes(self.images, self._seen)
        carved = deepct_py.carve(observation, grid=self.estimator.grid).mask
        if not carved.any():
            raise InputError(name, "shows no cloud", "leave the file out")
        self.mask = torch.from_numpy(carved)
        with torch.no_grad():
            first = self.extinction()
        self._rendered = deepct_py.torch.Images(
            deepct_py.Renderer(
                self.estimator.grid,
                views,
                self.light,
                mask=carved,
                expected=MARGIN * first.numpy(),
                accuracy=ACCURACY,
            )
        )

    def planes(self, images: Tensor, seen: Tensor | None = None) -> Tensor:
        """The input of the network from the images of the views that it sees."""
        if seen is None:
            return self.estimator.planes(images[None])
        return self.estimator.planes(images[None, seen], seen)

    def extinction(self, random: np.random.Generator | None = None) -> Tensor:
        """The estimate from the views that the network sees; with random numbers and for a general
        network, from all but one of them."""
        if self._seen is None:
            return self.estimator.of_planes(self._planes)[0][0] * self.mask
        places = list(range(len(self._seen)))
        if random is not None and len(places) >= FEWEST:
            places.pop(int(random.integers(len(places))))
        planes, seen = self._planes[:, places], self._seen[places]
        return self.estimator.of_planes(planes, seen)[0][0] * self.mask

    def misfits(self, extinction: Tensor) -> Tensor:
        """Mean squared difference of the images over their error, by view."""
        difference = self._rendered(extinction) - self.images
        return (difference.square() * self._weights).mean((1, 2))


class Rehearsal:
    """Synthetic clouds in the views and the light of the scenes, with the first estimates."""

    def __init__(self, scenes: Sequence[Scene], count: int, seed: int) -> None:
        import deepct_py

        self._examples = []
        for number in range(count):
            scene = scenes[number % len(scenes)]
            estimator, random = scene.estimator, np.random.default_rng([seed, number])
            grid = estimator.grid
            voxel = grid.spacing[0]
            width = float(random.uniform(4.0, 22.0)) * voxel
            cloud = deepct_py.generate_cloud(
                grid, seed=seed + number, width_km=width, base_km=grid.origin[2]
            )
            thickness = float(10.0 ** random.uniform(-0.8, 0.3))
            rendered = deepct_py.render(
                thickness * cloud.extinction,
                grid,
                scene.views,
                scene.light,
                solver="ordinates",
                accuracy=0.05,
                estimate_error=False,
            )
            images = torch.from_numpy(deepct_py.sense(rendered, seed=seed + number).radiance)
            planes = scene.planes(images)
            with torch.no_grad():
                self._examples.append((estimator, planes, estimator.of_planes(planes)))

    def loss(self, random: np.random.Generator) -> Tensor:
        """Squared difference of some estimates from the first ones, over the squares of these."""
        count = min(REHEARSED_AT_ONCE, len(self._examples))
        losses = []
        for number in random.choice(len(self._examples), count, replace=False):
            estimator, planes, first = self._examples[number]
            now = estimator.of_planes(planes)
            difference = sum((a - b).square().sum() for a, b in zip(now, first))
            losses.append(difference / first[0].square().sum().clamp_min(1e-6))
        return torch.stack(losses).mean()


def adapt(
    weights: str | Path,
    images: Sequence[Path],
    output: Path,
    settings: Settings,
    report: Callable[[str], None],
) -> bool:
    """Write weights that are adapted to the images of some files.

    ``weights`` is a file or the name of built-in weights, general or of one formation. Nothing is
    written, and False returned, if the misfit of the held-out views does not decrease.

    Raises :class:`InputError` for weights and images that cannot be used.
    """
    import deepct_py

    start = time.monotonic()
    adapted = _weights(weights)
    network = adapted.network if isinstance(adapted, GeneralWeights) else adapted
    scenes = []
    for number, path in enumerate(images):
        try:
            observation = deepct_py.read_images(path)
        except (OSError, ValueError, deepct_py.DeepctError) as problem:
            reason = " ".join(str(problem).split()).removeprefix(f"{path}: ")
            raise InputError(path, reason, "give a file of images of deepct") from None
        scene = Scene(str(path), observation, adapted, settings.held_out, settings.seed + number)
        held = ", ".join(str(int(view)) for view in scene.held)
        report(
            f"{path}: {len(scene.views)} views, held out {held}; {int(scene.mask.sum())} voxels"
        )
        scenes.append(scene)
    rehearsal = Rehearsal(scenes, settings.synthetic, settings.seed)
    random = np.random.default_rng(settings.seed)
    rate = settings.learning_rate * (1.0 if isinstance(adapted, GeneralWeights) else FOLDED)
    optimizer = torch.optim.Adam(network.parameters(), rate, DECAY)
    between = settings.steps * len(scenes)

    def misfit_of_held_out() -> float:
        with torch.no_grad():
            found = [scene.misfits(scene.extinction())[scene.held].mean() for scene in scenes]
        return float(torch.stack(found).mean())

    first = least = misfit_of_held_out()
    before = kept = _copied(network)
    best = step = 0
    while True:
        is_late = time.monotonic() - start > 60.0 * settings.minutes or step >= settings.most_steps
        if step % between == 0 or is_late:
            misfit = misfit_of_held_out()
            if misfit < (1.0 - LEAST_DECREASE) * least:
                best, least, kept = step, misfit, _copied(network)
            minutes = (time.monotonic() - start) / 60.0
            report(f"{minutes:5.1f} min  step {step:5d}  misfit of the held-out views {misfit:.3f}")
            if is_late or step - best >= settings.patience * between:
                break
        scene = scenes[int(random.integers(len(scenes)))]
        for group in optimizer.param_groups:
            group["lr"] = rate * min(1.0, (step + 1) / settings.warm_up)
        loss = scene.misfits(scene.extinction(random))[scene.learned].mean()
        if settings.rehearsal > 0.0:
            loss = loss + settings.rehearsal * rehearsal.loss(random)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        step += 1
    network.load_state_dict(
        {name: torch.lerp(before[name], kept[name], settings.kept) for name in kept}, strict=False
    )
    last = misfit_of_held_out()
    if best == 0 or not last < first:
        report("the held-out views were never explained better: nothing is written")
        return False
    _write(output, adapted, {"scenes": len(scenes), "steps": best, "misfits": [first, last]})
    report(f"wrote {output}: misfit of the held-out views {first:.3f} -> {last:.3f} (step {best})")
    return True


def _copied(network: nn.Module) -> dict[str, Tensor]:
    """A copy of the values of a network, without the counters of its normalisations."""
    return {
        name: values.clone()
        for name, values in network.state_dict().items()
        if values.is_floating_point()
    }


def _weights(name_or_path: str | Path) -> Weights:
    """The weights of a file, or built-in ones."""
    import deepct_py

    path = Path(name_or_path)
    if str(name_or_path) in deepct_py.Network.built_in():
        contents = deepct_py.Network.load(name_or_path).contents
    elif path.suffix.lower() == ".safetensors":
        contents = read_file(path, "give a weights file, or the name of built-in weights")
    else:
        return load_general(path)
    header = weights_header(contents, path, "give a weights file of deepct")
    if header.get("network") == "general":
        return parse_general_weights(contents, path)
    return FormationWeights(contents, path)


def _precision(observation: Any) -> np.ndarray:
    """Inverse variance of each pixel for the misfit; 0 for those that are missing or saturated."""
    images = np.nan_to_num(observation.radiance)
    variance = (ACCURACY * images) ** 2 + (DARK * images.max()) ** 2
    if observation.standard_error is not None:
        variance = variance + observation.standard_error.astype(np.float64) ** 2
    usable = np.isfinite(observation.radiance)
    if observation.saturated is not None:
        usable &= ~observation.saturated
    return np.where(usable, 1.0 / variance, 0.0).astype(np.float32)


def _write(path: Path, weights: Weights, adaptation: dict[str, Any]) -> None:
    """Write the weights with a description of their adaptation. The scores are those of before."""
    is_general = isinstance(weights, GeneralWeights)
    before = vars(weights.description) if is_general else weights.header
    scores = {f"{name}_before_adaptation": value for name, value in before["scores"].items()}
    configuration = {**before["configuration"], "adaptation": adaptation}
    changes = {"scores": scores, "configuration": configuration}
    if is_general:
        description = replace(weights.description, **changes)
        write_general_weights(path, replace(weights, description=description))
    else:
        weights.write(path, changes)
