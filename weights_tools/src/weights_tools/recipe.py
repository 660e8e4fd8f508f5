"""Recipes: TOML files that say how one set of weights is trained."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

from weights_tools.errors import InputError
from weights_tools.model import constant_channels, growing_channels
from weights_tools.sensor import Sensor

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class NetworkRecipe:
    """The shape of the network."""

    layers: int = 33
    width: int = 0
    """Channels between the layers; 0 lets them grow by the paper's rule."""
    planes: int = 0
    """Horizontal planes that the images are laid on, in the middles of as many equal parts of
    the levels; 0 lets the images enter as the cameras took them."""
    uncertainty: bool = False
    """Whether the last layer also gives, after the extinction of each voxel, its expected
    absolute error."""

    @property
    def outputs(self) -> list[str]:
        """What the last layer gives, each with a channel for every level."""
        return ["extinction", "uncertainty"] if self.uncertainty else ["extinction"]

    def channels(self, views: int, levels: int) -> list[int]:
        """Channels before, between and after the layers."""
        inputs = views * max(self.planes, 1)
        if self.width == 0:
            channels = growing_channels(inputs, levels, self.layers)
        else:
            channels = constant_channels(inputs, levels, self.layers, self.width)
        return [*channels[:-1], len(self.outputs) * levels]

    def image_layout(self, levels: dict[str, float]) -> str | dict[str, Any]:
        """How the images become channels, as a file of weights tells it."""
        if self.planes == 0:
            return "camera"
        height = levels["count"] * levels["spacing_km"] / self.planes
        altitudes = [levels["bottom_km"] + (part + 0.5) * height for part in range(self.planes)]
        return {"planes": {"altitudes_km": altitudes}}


@dataclass(frozen=True)
class ScalingRecipe:
    """Factors that bring the network's numbers near 1."""

    input_scale: float = 10.0
    """Network input = radiance (1/sr) x this."""
    output_scale: float = 10.0
    """Extinction (1/km) = network output x this."""


@dataclass(frozen=True)
class LossRecipe:
    """What is minimised: a sum of terms, by their weights; the paper's is the first alone.

    ``squared`` is the mean over voxels of the squared error of the scaled extinction. The
    others are means over clouds, in which a small or thin cloud counts as much as a large
    one: ``squared_by_cloud`` of the sum of squared errors over the sum of squares, and
    ``relative`` of epsilon. ``uncertainty`` counts where the network tells one: the sum of the
    squares by which it misses the error that was made, over the sum of squares of the
    extinction. What is expected of an absolute error makes it least.
    """

    squared: float = 1.0
    squared_by_cloud: float = 0.0
    relative: float = 0.0
    uncertainty: float = 0.1


@dataclass(frozen=True)
class TrainingRecipe:
    """How the weights are found."""

    seed: int = 1
    epochs: int = 100
    batch: int = 32
    learning_rate: float = 2e-3
    """The largest of Adam; it rises from 0 to this and falls to 0 along a cosine."""
    muon_learning_rate: float = 0.0
    """The largest of Muon, which moves the kernels; 0 leaves them to Adam."""
    warmup: float = 0.1
    """Share of the training in which the learning rate rises."""
    leak: float = 0.0
    """Slope of the last ReLU below zero while training: what was missed can still be found."""
    shift_voxels: int = 0
    """Largest horizontal shift of a cloud and its images, along x and along y."""
    shift_levels: int = 0
    """Largest vertical shift."""
    pointing_pixels: float = 0.0
    """Standard deviation of where each camera looks, along rows and along columns."""
    neighbours: float = 0.0
    """Share of the clouds that get another one beside them, as in a field; wants shifts."""
    crop: int = 0
    """Rows and columns, near the middle, that a step takes of a batch; 0 takes all."""
    crop_shift: int = 3
    """Farthest that a crop is off the middle along rows and along columns."""
    crop_until: float = 0.8
    """Share of the training after which nothing is cropped any more."""
    patience: int = 0
    """Epochs without a smaller epsilon on the validation clouds that end the training; 0 lets
    it go on to its last epoch."""
    reduced_precision: bool = True
    """Convolutions in bfloat16 while training (never when scores are taken)."""


@dataclass(frozen=True)
class Recipe:
    """All that a training depends on, but for the data and the machine."""

    formation: str
    network: NetworkRecipe = field(default_factory=NetworkRecipe)
    scaling: ScalingRecipe = field(default_factory=ScalingRecipe)
    loss: LossRecipe = field(default_factory=LossRecipe)
    training: TrainingRecipe = field(default_factory=TrainingRecipe)
    sensor: Sensor = field(default_factory=Sensor)

    def resolved(self) -> dict[str, Any]:
        """Every setting, the defaults included, as plain values."""
        return asdict(self)


def completed(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings of a checkpoint; those that it is too old to know have their defaults, with
    which a training is what it was without them."""
    defaults = Recipe(settings["formation"]).resolved()
    tables = {key: table for key, table in defaults.items() if isinstance(table, dict)}
    return {**settings, **{key: {**table, **settings[key]} for key, table in tables.items()}}


def load_recipe(path: str | Path) -> Recipe:
    """The recipe in a TOML file.

    Raises :class:`InputError` for a file that is missing or not TOML, an unknown key,
    and a value of a wrong type or out of range.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise InputError(path, problem.strerror or "cannot be read", "name a recipe") from None
    except ValueError as problem:
        raise InputError(path, f"is not TOML ({problem})", "correct it") from None
    recipe = _build(Recipe, table, path, "")
    _check(recipe, path)
    return recipe


def _build(kind: type, table: dict[str, Any], path: Path, prefix: str) -> Any:
    types = get_type_hints(kind)
    for key in table:
        if key not in types:
            remedy = f"the keys are {', '.join(sorted(types))}"
            raise InputError(path, f"has an unknown key {prefix}{key}", remedy)
    required = {"formation"} & set(types)
    for key in required - set(table):
        raise InputError(path, f"has no key {prefix}{key}", 'give it, for example "cloudct-10"')
    values = {
        key: _value(types[key], value, path, f"{prefix}{key}") for key, value in table.items()
    }
    try:
        return kind(**values)
    except ValueError as problem:
        raise InputError(path, f"[{prefix.rstrip('.')}]: {problem}", "correct it") from None


def _value(kind: type, value: Any, path: Path, key: str) -> Any:
    if is_dataclass(kind):
        if not isinstance(value, dict):
            raise InputError(path, f"{key} is not a table", f"write [{key}]")
        return _build(kind, value, path, f"{key}.")
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        problem = f"{key} is {value!r}, which is not of type {kind.__name__}"
        raise InputError(path, problem, "correct it")
    return value


def _check(recipe: Recipe, path: Path) -> None:
    training, loss = recipe.training, recipe.loss
    limits = (
        ("network.layers", recipe.network.layers >= 1, "at least 1"),
        ("network.width", recipe.network.width >= 0, "0 or more"),
        ("network.planes", recipe.network.planes >= 0, "0 or more"),
        ("scaling.input_scale", recipe.scaling.input_scale > 0.0, "positive"),
        ("scaling.output_scale", recipe.scaling.output_scale > 0.0, "positive"),
        ("training.epochs", training.epochs >= 1, "at least 1"),
        ("training.batch", training.batch >= 2, "at least 2 (batch norm)"),
        ("training.learning_rate", training.learning_rate > 0.0, "positive"),
        ("training.muon_learning_rate", training.muon_learning_rate >= 0.0, "0 or more"),
        ("training.warmup", 0.0 < training.warmup < 1.0, "between 0 and 1"),
        ("training.leak", 0.0 <= training.leak < 1.0, "at least 0 and below 1"),
        ("training.patience", training.patience >= 0, "0 or more"),
        ("training.crop", training.crop >= 0, "0 or more"),
        ("training.crop_shift", training.crop_shift >= 0, "0 or more"),
        ("training.crop_until", 0.0 <= training.crop_until <= 1.0, "between 0 and 1"),
        ("training.shift_voxels", training.shift_voxels >= 0, "0 or more"),
        ("training.shift_levels", training.shift_levels >= 0, "0 or more"),
        ("training.pointing_pixels", training.pointing_pixels >= 0.0, "0 or more"),
        ("training.neighbours", 0.0 <= training.neighbours <= 1.0, "between 0 and 1"),
        (
            "training.neighbours",
            training.neighbours == 0.0 or training.shift_voxels + training.shift_levels > 0,
            "0 where nothing is shifted",
        ),
        ("loss", min(getattr(loss, term.name) for term in fields(loss)) >= 0.0, "not negative"),
        (
            "loss",
            max(loss.squared, loss.squared_by_cloud, loss.relative) > 0.0,
            "not zero for all of the extinction",
        ),
    )
    for key, holds, rule in limits:
        if not holds:
            raise InputError(path, f"{key} is out of range", f"make it {rule}")
