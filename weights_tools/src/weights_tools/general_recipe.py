"""Recipes for the training of a general network: TOML files with ``kind = "general"``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from weights_tools.errors import InputError
from weights_tools.general import GeneralArchitecture
from weights_tools.recipe import build, check_limits, read_toml
from weights_tools.sensor import Sensor

KIND = "general"
"""The value of the key ``kind``, which distinguishes these recipes from those of one formation."""


@dataclass(frozen=True)
class SimulationRecipe:
    """A range of times of a large-eddy simulation."""

    file: str
    """Path in the folder of the simulations."""
    first: int
    last: int
    """First and last time step."""
    share: float
    """Relative frequency with which the simulation is selected."""
    split: str = "train"
    """``train`` or ``validation``."""
    droplets_per_cm3: tuple[float, float] = (50.0, 600.0)
    """Range of the droplet number concentration, which is distributed uniformly in its
    logarithm."""


@dataclass(frozen=True)
class SceneRecipe:
    """Frequencies and ranges from which scenes are drawn."""

    seed: int = 1
    paper: float = 0.35
    """Fraction of scenes with the Sun, the surface and the formation of Sde-Chen et al. (2021)."""
    isolated: float = 0.65
    """Fraction of scenes with a single cloud; the others are squares of the field."""
    varied: float = 0.6
    """Fraction of the clouds that are zoomed, stretched, leaning, and drier or moister."""
    resized: float = 0.45
    """Fraction of the clouds on larger or smaller voxels."""
    generated: float = 0.08
    """Fraction of the clouds from the generator of ``deepct``."""
    generated_clouds: int = 256
    """Number of different clouds of the generator."""
    sun_zenith_deg: float = 70.0
    """Largest zenith angle of the Sun."""
    view_zenith_deg: float = 70.0
    """Largest zenith angle of views in random directions."""
    random_views: int = 16
    """Number of views in random directions, in addition to the 32 views along a track."""
    validation: int = 96
    """Number of validation scenes."""


@dataclass(frozen=True)
class StreamRecipe:
    """The pool of rendered scenes and their use."""

    chunk: int = 40
    """Number of scenes in a file of the pool."""
    chunks: int = 400
    """Largest number of files of the training pool; the oldest are then replaced."""
    uses: float = 40.0
    """Number of times that a scene is used on average before the training waits for new ones."""
    pointing_pixels: float = 0.2
    """Standard deviation of the pointing error of each camera along rows and columns (pixels)."""


@dataclass(frozen=True)
class GeneralTrainingRecipe:
    """Settings of the optimisation."""

    seed: int = 1
    minutes: float = 60.0
    """Duration of the training; ``--minutes`` overrides it."""
    batch: int = 32
    """Number of scenes in a batch of at most ``views_per_batch / batch`` views each."""
    views_per_batch: int = 384
    """Upper limit of the number of images in a batch."""
    learning_rate: float = 3e-3
    """Maximum learning rate of AdamW, for all parameters but the kernels."""
    muon_learning_rate: float = 0.01
    """Maximum learning rate of Muon for the kernels."""
    warmup: float = 0.03
    """Fraction of the training during which the learning rate increases; it then decreases to 0
    along a cosine."""
    frozen: float = 0.3
    """Fraction of the training after which the batch normalisations use and keep their running
    statistics; those of a network with which the training starts are always kept. The statistics of
    a batch depend on its formation and on the crop, so that the network would otherwise be trained
    with other scales than those with which it is used."""
    leak: float = 0.03
    """Slope of the last ReLU below zero at the beginning of the training; it decreases to 0."""
    relative: tuple[float, float] = (0.3, 1.0)
    """Weight of epsilon in the loss at the beginning and at the end."""
    squared: tuple[float, float] = (1.0, 0.4)
    """Weight of the squared error by cloud at the beginning and at the end."""
    turn: tuple[float, float] = (0.3, 0.7)
    """Fractions of the training between which these weights change linearly."""
    uncertainty: float = 0.1
    """Weight of the squared error of the uncertainty."""
    crop: int = 22
    """Rows and columns around the cloud that a step uses; 0 uses all. GPUs use all."""
    cropped: float = 0.85
    """Fraction of the steps that are cropped."""
    report_minutes: float = 5.0
    """Time between two evaluations of the validation scenes, which are saved."""


@dataclass(frozen=True)
class GeneralScalingRecipe:
    """Scale factors for which the numbers in the network are of order 1."""

    input_scale: float = 100.0
    """Network input = radiance (1/sr) x input_scale."""
    output_scale: float = 50.0
    """Extinction (1/km) = network output x output_scale."""
    surface_albedo: float = 0.05
    """The radiance of the surface in the images is replaced by that of a surface of this albedo."""


@dataclass(frozen=True)
class GeneralRecipe:
    """All settings of the training of a general network."""

    kind: str
    simulations: tuple[SimulationRecipe, ...]
    network: GeneralArchitecture = field(default_factory=GeneralArchitecture)
    scaling: GeneralScalingRecipe = field(default_factory=GeneralScalingRecipe)
    scenes: SceneRecipe = field(default_factory=SceneRecipe)
    stream: StreamRecipe = field(default_factory=StreamRecipe)
    training: GeneralTrainingRecipe = field(default_factory=GeneralTrainingRecipe)
    sensor: Sensor = field(default_factory=Sensor)

    def resolved(self) -> dict[str, Any]:
        """All settings, including those with default values, as plain values."""
        return asdict(self)

    def split(self, name: str) -> tuple[SimulationRecipe, ...]:
        """The simulations of a split."""
        return tuple(each for each in self.simulations if each.split == name)


def is_general_recipe(path: str | Path) -> bool:
    """Whether a file is a recipe for a general network.

    Raises :class:`InputError` for a file that is missing or not TOML.
    """
    return read_toml(Path(path)).get("kind") == KIND


def load_general_recipe(path: str | Path) -> GeneralRecipe:
    """Read a recipe from a TOML file.

    Raises :class:`InputError` for a file that is missing or not TOML, an unknown or missing key,
    and a value of the wrong type or out of range.
    """
    path = Path(path)
    recipe = build(GeneralRecipe, read_toml(path), path)
    _check(recipe, path)
    return recipe


def _check(recipe: GeneralRecipe, path: Path) -> None:
    if recipe.kind != KIND:
        raise InputError(path, f"kind is {recipe.kind!r}", f'make it "{KIND}"')
    scenes, stream, training = recipe.scenes, recipe.stream, recipe.training
    shares = ("paper", "isolated", "varied", "resized", "generated")
    ramp_start, ramp_end = training.turn
    limits = [
        *((f"scenes.{name}", 0.0 <= getattr(scenes, name) <= 1.0, "0 to 1") for name in shares),
        ("scenes.sun_zenith_deg", 0.0 <= scenes.sun_zenith_deg <= 80.0, "0 to 80"),
        ("scenes.view_zenith_deg", 0.0 <= scenes.view_zenith_deg <= 75.0, "0 to 75"),
        ("scenes.random_views", scenes.random_views >= 8, "at least 8"),
        ("scenes.generated_clouds", scenes.generated_clouds >= 1, "at least 1"),
        ("scenes.validation", scenes.validation >= 1, "at least 1"),
        ("scaling.input_scale", recipe.scaling.input_scale > 0.0, "positive"),
        ("scaling.output_scale", recipe.scaling.output_scale > 0.0, "positive"),
        ("scaling.surface_albedo", 0.0 <= recipe.scaling.surface_albedo <= 1.0, "0 to 1"),
        ("stream.chunk", stream.chunk >= 1, "at least 1"),
        ("stream.chunks", stream.chunks >= 1, "at least 1"),
        ("stream.uses", stream.uses >= 1.0, "at least 1"),
        ("stream.pointing_pixels", stream.pointing_pixels >= 0.0, "0 or more"),
        ("training.minutes", training.minutes > 0.0, "positive"),
        ("training.batch", training.batch >= 2, "at least 2 (batch norm)"),
        ("training.views_per_batch", training.views_per_batch >= 80, "at least 80"),
        ("training.learning_rate", training.learning_rate > 0.0, "positive"),
        ("training.muon_learning_rate", training.muon_learning_rate > 0.0, "positive"),
        ("training.warmup", 0.0 < training.warmup < 1.0, "between 0 and 1"),
        ("training.frozen", 0.0 <= training.frozen <= 1.0, "0 to 1"),
        ("training.leak", 0.0 <= training.leak < 1.0, "at least 0 and below 1"),
        ("training.turn", 0.0 <= ramp_start < ramp_end <= 1.0, "two ascending numbers of 0 to 1"),
        ("training.crop", 0 <= training.crop <= 32, "0 to 32"),
        ("training.cropped", 0.0 <= training.cropped <= 1.0, "0 to 1"),
        ("training.report_minutes", training.report_minutes > 0.0, "positive"),
        ("network.levels", recipe.network.levels == 32, "32"),
        ("network.virtual_views", 1 <= recipe.network.virtual_views <= 256, "1 to 256"),
        ("network.planes", 1 <= recipe.network.planes <= 64, "1 to 64"),
        ("network.width", 1 <= recipe.network.width <= 4096, "1 to 4096"),
        ("network.layers", 2 <= recipe.network.layers <= 64, "2 to 64"),
    ]
    for index, each in enumerate(recipe.simulations):
        few, many = each.droplets_per_cm3
        limits += [
            (f"simulations[{index}].split", each.split in ("train", "validation"), "a split"),
            (f"simulations[{index}].share", each.share > 0.0, "positive"),
            (f"simulations[{index}].droplets_per_cm3", 0.0 < few <= many, "ascending"),
            (f"simulations[{index}].first", 0 <= each.first <= each.last, "at most last"),
        ]
    for split in ("train", "validation"):
        limits.append(("simulations", bool(recipe.split(split)), f"at least one with {split}"))
    check_limits(limits, path)
