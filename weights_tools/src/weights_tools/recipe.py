"""Recipes: TOML files with the settings for the training of one set of weights."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from weights_tools.errors import InputError
from weights_tools.files import read_file
from weights_tools.model import constant_channels, growing_channels
from weights_tools.sensor import Sensor

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class NetworkRecipe:
    """The architecture of the network."""

    layers: int = 33
    """Number of convolutional layers."""
    width: int = 0
    """Number of channels between the layers; with 0, they increase by the rule of the paper."""
    planes: int = 0
    """Number of horizontal planes onto which the images are resampled. They are at the centres of
    equal parts of the vertical range of the levels. With 0, the camera images are the input."""
    uncertainty: bool = False
    """Whether the last layer also estimates the absolute error of the extinction of each voxel;
    these channels follow those of the extinction."""
    effective_radius: bool = False
    """Whether the last layer also estimates the effective radius of each voxel, in its last
    channels."""

    @property
    def outputs(self) -> list[str]:
        """The quantities that the last layer estimates, each with one channel for every level."""
        further = {"uncertainty": self.uncertainty, "effective_radius": self.effective_radius}
        return ["extinction", *(name for name, is_output in further.items() if is_output)]

    def channels(self, images: int, levels: int) -> list[int]:
        """Numbers of channels before, between and after the layers, for the views of all bands."""
        inputs = images * max(self.planes, 1)
        if self.width == 0:
            channels = growing_channels(inputs, levels, self.layers)
        else:
            channels = constant_channels(inputs, levels, self.layers, self.width)
        return [*channels[:-1], len(self.outputs) * levels]

    def image_layout(self, levels: dict[str, float]) -> str | dict[str, Any]:
        """The assignment of images to input channels, in the form used in weights files."""
        if self.planes == 0:
            return "camera"
        height = levels["count"] * levels["spacing_km"] / self.planes
        altitudes = [levels["bottom_km"] + (part + 0.5) * height for part in range(self.planes)]
        return {"planes": {"altitudes_km": altitudes}}


@dataclass(frozen=True)
class ScalingRecipe:
    """Scale factors for which the numbers in the network are of order 1."""

    input_scale: float = 10.0
    """Network input = radiance (1/sr) x input_scale."""
    output_scale: float = 10.0
    """Extinction (1/km) = network output x output_scale."""
    effective_radius_scale: float = 10.0
    """Effective radius (um) = network output x effective_radius_scale."""


@dataclass(frozen=True)
class LossRecipe:
    """Weights of the terms of the loss function; that of the paper has the first term only.

    ``squared`` is the weight of the mean squared error of the scaled extinction over all voxels.
    The other terms are means over clouds, in which a small or thin cloud has the same weight as a
    large one. ``squared_by_cloud`` weights the sum of squared errors divided by the sum of squares
    of the extinction, and ``relative`` weights epsilon. ``uncertainty`` applies to networks that
    estimate it: the sum of squared differences between the estimated and the actual absolute error,
    divided by the sum of squares of the extinction. This term is smallest if the estimate is the
    expected absolute error. ``effective_radius`` applies to networks that estimate it: the mean
    absolute error of the scaled effective radius, weighted by the extinction.
    """

    squared: float = 1.0
    squared_by_cloud: float = 0.0
    relative: float = 0.0
    uncertainty: float = 0.1
    effective_radius: float = 1.0


@dataclass(frozen=True)
class TrainingRecipe:
    """Settings of the optimisation and of the data augmentation."""

    seed: int = 1
    epochs: int = 100
    batch: int = 32
    learning_rate: float = 2e-3
    """Maximum learning rate of Adam. The rate increases linearly to this value and decreases to 0
    along a cosine."""
    muon_learning_rate: float = 0.0
    """Maximum learning rate of Muon for the kernels; with 0, Adam optimises the kernels as well."""
    warmup: float = 0.1
    """Fraction of the training during which the learning rate increases."""
    leak: float = 0.0
    """Slope of the last ReLU below zero during training, so that a voxel with a negative value
    still has a gradient."""
    shift_voxels: int = 0
    """Maximum horizontal shift of a cloud and its images along x and along y (voxels)."""
    shift_levels: int = 0
    """Maximum vertical shift (levels)."""
    pointing_pixels: float = 0.0
    """Standard deviation of the pointing error of each camera along rows and columns (pixels)."""
    neighbours: float = 0.0
    """Fraction of the clouds beside which another cloud is placed, as in a field; requires a
    nonzero maximum shift."""
    crop: int = 0
    """Number of rows and columns near the centre that a step uses of a batch; 0 uses all."""
    crop_shift: int = 3
    """Maximum distance of a crop from the centre along rows and along columns (pixels)."""
    crop_until: float = 0.8
    """Fraction of the training after which the images are no longer cropped."""
    patience: int = 0
    """Number of epochs without a smaller epsilon on the validation clouds after which the training
    ends; with 0, it continues to the last epoch."""
    reduced_precision: bool = True
    """Whether convolutions are computed in bfloat16 during training (never for the scores)."""


@dataclass(frozen=True)
class Recipe:
    """All settings of a training. It otherwise depends on the data and the machine only."""

    formation: str
    network: NetworkRecipe = field(default_factory=NetworkRecipe)
    scaling: ScalingRecipe = field(default_factory=ScalingRecipe)
    loss: LossRecipe = field(default_factory=LossRecipe)
    training: TrainingRecipe = field(default_factory=TrainingRecipe)
    sensor: Sensor = field(default_factory=Sensor)

    def resolved(self) -> dict[str, Any]:
        """All settings, including those with default values, as plain values."""
        return asdict(self)


def completed(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings of a checkpoint, completed with the defaults of settings introduced later. The
    defaults correspond to the behaviour before these settings existed."""
    defaults = Recipe(settings["formation"]).resolved()
    tables = {key: table for key, table in defaults.items() if isinstance(table, dict)}
    return {**settings, **{key: {**table, **settings[key]} for key, table in tables.items()}}


def load_recipe(path: str | Path) -> Recipe:
    """Read a recipe from a TOML file.

    Raises :class:`InputError` for a file that is missing or not TOML, an unknown key,
    and a value of the wrong type or out of range.
    """
    path = Path(path)
    recipe = build(Recipe, read_toml(path), path)
    _check(recipe, path)
    return recipe


def read_toml(path: Path) -> dict[str, Any]:
    """The table of a TOML file. Raises :class:`InputError` if it is missing or not TOML."""
    content = read_file(path, "name a recipe")
    try:
        return tomllib.loads(content.decode("utf-8"))
    except ValueError as problem:
        raise InputError(path, f"is not TOML ({problem})", "correct it") from None


def build(kind: type, table: dict[str, Any], path: Path, prefix: str = "") -> Any:
    """A dataclass from a table of the file ``path``; ``prefix`` is the name of the table.

    Raises :class:`InputError` for an unknown or missing key, or a value of the wrong type.
    """
    types = get_type_hints(kind)
    for key in table:
        if key not in types:
            remedy = f"the keys are {', '.join(sorted(types))}"
            raise InputError(path, f"has an unknown key {prefix}{key}", remedy)
    for each in fields(kind):
        if each.name not in table and each.default is MISSING and each.default_factory is MISSING:
            example = ', for example "cloudct-10"' if each.name == "formation" else ""
            raise InputError(path, f"has no key {prefix}{each.name}", f"give it{example}")
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
        return build(kind, value, path, f"{key}.")
    if get_origin(kind) is tuple:
        return _values(get_args(kind), value, path, key)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        problem = f"{key} is {value!r}, which is not of type {kind.__name__}"
        raise InputError(path, problem, "correct it")
    return value


def _values(kinds: tuple[Any, ...], value: Any, path: Path, key: str) -> tuple[Any, ...]:
    """A list with values of the given types, or of any length if the second one is ``...``."""
    repeated = kinds[1:] == (...,)
    if not isinstance(value, list) or not (repeated or len(value) == len(kinds)):
        length = "" if repeated else f" of {len(kinds)} values"
        raise InputError(path, f"{key} is not a list{length}", "correct it")
    types = kinds[:1] * len(value) if repeated else kinds
    names = (f"{key}[{index}]" for index in range(len(value)))
    return tuple(_value(kind, each, path, name) for kind, each, name in zip(types, value, names))


def check_limits(limits: Iterable[tuple[str, bool, str]], path: Path) -> None:
    """Raise :class:`InputError` for the first key that does not hold its rule."""
    for key, holds, rule in limits:
        if not holds:
            raise InputError(path, f"{key} is out of range", f"make it {rule}")


def _check(recipe: Recipe, path: Path) -> None:
    training, loss = recipe.training, recipe.loss
    limits = (
        ("network.layers", 1 <= recipe.network.layers <= 256, "1 to 256"),
        ("network.width", 0 <= recipe.network.width <= 4096, "0 to 4096"),
        ("network.planes", 0 <= recipe.network.planes <= 64, "0 to 64"),
        ("scaling.input_scale", recipe.scaling.input_scale > 0.0, "positive"),
        ("scaling.output_scale", recipe.scaling.output_scale > 0.0, "positive"),
        (
            "scaling.effective_radius_scale",
            recipe.scaling.effective_radius_scale > 0.0,
            "positive",
        ),
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
    check_limits(limits, path)
