from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Optional, Protocol, Union, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import disjoint_base

from ._fields import infer as infer

_Path = Union[str, PathLike[str]]
_Point = tuple[float, float, float]
_Floats = NDArray[np.float32]
_Marks = NDArray[np.bool_]
_Ends = tuple[int, int]
# Numbers of a tuple, a list or an array.
_Numbers = Union[Sequence[float], NDArray[Any]]
_Progress = Union[bool, Callable[[dict[str, Any]], object]]
_Extinction = Union[ArrayLike, "Cloud", "Estimate", "Reconstruction", _Path]
_Mask = Union[ArrayLike, "Carved", "Reconstruction", _Path]
_Images = Union[ArrayLike, "Observation", _Path]

class _WithCoordinates(Protocol):
    @property
    def coords(self) -> Any: ...

# A grid, or what has one.
_Grid = Union["Grid", "Cloud", "Estimate", "Carved", "Reconstruction", _WithCoordinates, _Path]
_Views = Union["Views", Sequence["View"]]

__all__ = [
    "Carved",
    "Cloud",
    "DeepctError",
    "Estimate",
    "Exposure",
    "Figure",
    "Grid",
    "Light",
    "Lineage",
    "Network",
    "Observation",
    "Page",
    "Reconstruction",
    "Renderer",
    "Rendering",
    "Scores",
    "Sensed",
    "Sensor",
    "View",
    "Views",
    "camera_from_ecef",
    "carve",
    "generate_cloud",
    "hybrid",
    "import_cloud",
    "infer",
    "invert",
    "plot",
    "read_cloud",
    "read_images",
    "read_mask",
    "read_volume",
    "render",
    "score",
    "sense",
    "set_threads",
    "view",
]

__version__: str

class DeepctError(Exception): ...

def set_threads(count: Optional[int] = None) -> None: ...

@final
class Grid:
    def __new__(
        cls, shape: _Numbers, spacing: _Numbers, origin: _Numbers = (0.0, 0.0, 0.0)
    ) -> Grid: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Grid: ...
    @staticmethod
    def from_file(path: _Path) -> Grid: ...
    @property
    def shape(self) -> tuple[int, int, int]: ...
    @property
    def spacing(self) -> _Point: ...
    @property
    def origin(self) -> _Point: ...
    @property
    def center(self) -> _Point: ...
    @property
    def x(self) -> NDArray[np.float64]: ...
    @property
    def y(self) -> NDArray[np.float64]: ...
    @property
    def z(self) -> NDArray[np.float64]: ...
    def _repr_html_(self) -> str: ...

@final
class Lineage:
    def __new__(
        cls,
        *,
        time: Optional[float] = None,
        units: str = "",
        calendar: str = "",
        history: str = "",
    ) -> Lineage: ...
    def then(self, step: str) -> Lineage: ...
    @property
    def time(self) -> Optional[float]: ...
    @property
    def units(self) -> str: ...
    @property
    def calendar(self) -> str: ...
    @property
    def history(self) -> str: ...
    def _repr_html_(self) -> str: ...

@final
class Cloud:
    def __new__(
        cls,
        grid: _Grid,
        *,
        extinction: Optional[ArrayLike] = None,
        liquid_water_content: Optional[ArrayLike] = None,
        effective_radius: Optional[ArrayLike] = None,
        effective_variance: Optional[ArrayLike] = None,
        lineage: Optional[Lineage] = None,
    ) -> Cloud: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Cloud: ...
    @property
    def grid(self) -> Grid: ...
    @property
    def extinction(self) -> _Floats: ...
    @property
    def liquid_water_content(self) -> Optional[_Floats]: ...
    @property
    def effective_radius(self) -> Optional[_Floats]: ...
    @property
    def effective_variance(self) -> Optional[_Floats]: ...
    @property
    def lineage(self) -> Lineage: ...
    def to_netcdf(
        self, path: _Path, *, title: str = "Cloud", overwrite: bool = False
    ) -> None: ...
    def to_xarray(self) -> Any: ...
    def _repr_html_(self) -> str: ...

def generate_cloud(
    grid: Optional[_Grid] = None,
    *,
    kind: Literal["cumulus", "field"] = "cumulus",
    seed: int = 1,
    **settings: Any,
) -> Cloud: ...
def read_cloud(path: _Path, *, allow_implausible: bool = False) -> Cloud: ...
def import_cloud(
    path: Union[_Path, Any],
    *,
    time: int = 0,
    crop: Optional[_Numbers] = None,
    droplets: Optional[float] = None,
    air_density: Union[float, str, None] = None,
    variable: Optional[str] = None,
    axes: Optional[str] = None,
    spacing: Union[_Numbers, Literal["file"]] = (0.05, 0.05, 0.04),
    base: Optional[float] = None,
    levels: Optional[int] = None,
    units: Mapping[str, str] = {},
    allow_implausible: bool = False,
) -> Cloud: ...

@final
class Light:
    def __new__(
        cls,
        *,
        sun_zenith_deg: float = 30.0,
        sun_azimuth_deg: float = 45.0,
        sun: Optional[_Numbers] = None,
        solar_irradiance: float = 1.0,
        wavelength: float = 0.672,
        air: bool = False,
        gas_optical_depth: Optional[float] = None,
        surface_albedo: float = 0.05,
        surface_altitude_km: float = 0.0,
        wind_speed: Optional[float] = None,
        periodic: bool = False,
        phase: Literal["hg", "mie", "isotropic"] = "hg",
        extinction: Literal["geometric", "mie"] = "geometric",
        asymmetry: float = 0.86,
        single_scattering_albedo: float = 1.0,
        distribution: Literal["gamma", "lognormal"] = "gamma",
        bandwidth: float = 0.0,
        effective_variance: Optional[float] = None,
        effective_radius: Optional[float] = None,
        assumed: Sequence[str] = (),
    ) -> Light: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Light: ...
    @property
    def sun(self) -> tuple[float, float]: ...
    @property
    def assumed(self) -> list[str]: ...
    def replace(self, **values: Any) -> Light: ...
    def extinction_per_water(self, effective_radius: ArrayLike) -> tuple[_Floats, _Floats]: ...
    def to_dict(self) -> dict[str, Union[float, bool, str]]: ...
    @property
    def sun_zenith_deg(self) -> float: ...
    @property
    def sun_azimuth_deg(self) -> float: ...
    @property
    def solar_irradiance(self) -> float: ...
    @property
    def wavelength(self) -> float: ...
    @property
    def air(self) -> bool: ...
    @property
    def gas_optical_depth(self) -> Optional[float]: ...
    @property
    def surface_albedo(self) -> float: ...
    @property
    def surface_altitude_km(self) -> float: ...
    @property
    def wind_speed(self) -> Optional[float]: ...
    @property
    def periodic(self) -> bool: ...
    @property
    def phase(self) -> Literal["hg", "mie", "isotropic"]: ...
    @property
    def extinction(self) -> Literal["geometric", "mie"]: ...
    @property
    def asymmetry(self) -> float: ...
    @property
    def single_scattering_albedo(self) -> float: ...
    @property
    def distribution(self) -> Literal["gamma", "lognormal"]: ...
    @property
    def bandwidth(self) -> float: ...
    @property
    def effective_variance(self) -> Optional[float]: ...
    @property
    def effective_radius(self) -> Optional[float]: ...
    def _repr_html_(self) -> str: ...

def camera_from_ecef(
    position: _Numbers, latitude_deg: float, longitude_deg: float
) -> _Point: ...

@final
class View:
    def __new__(
        cls,
        *,
        target: _Numbers,
        position: Optional[_Numbers] = None,
        pixel_tangent: Optional[float] = None,
        direction: Optional[_Numbers] = None,
        pixel_km: Optional[float] = None,
        points: Optional[ArrayLike] = None,
        directions: Optional[ArrayLike] = None,
        size: _Numbers = (32, 32),
        shift: _Numbers = (0.0, 0.0),
    ) -> View: ...
    @staticmethod
    def perspective(
        position: _Numbers, target: _Numbers, pixel_tangent: float, size: _Numbers = (32, 32)
    ) -> View: ...
    @staticmethod
    def orthographic(
        zenith_deg: float,
        azimuth_deg: float,
        target: _Numbers,
        pixel_km: float,
        size: _Numbers = (32, 32),
        *,
        looks_up: bool = False,
    ) -> View: ...
    @staticmethod
    def lines_of_sight(
        points: ArrayLike, directions: ArrayLike, target: Optional[_Numbers] = None
    ) -> View: ...
    @property
    def zenith_deg(self) -> float: ...
    @property
    def azimuth_deg(self) -> float: ...
    @property
    def pixel_km(self) -> float: ...
    @property
    def target(self) -> _Point: ...
    @property
    def position(self) -> Optional[_Point]: ...
    @property
    def pixel_tangent(self) -> Optional[float]: ...
    @property
    def points(self) -> Optional[NDArray[np.float64]]: ...
    @property
    def directions(self) -> Optional[NDArray[np.float64]]: ...
    @property
    def direction(self) -> _Point: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def shift(self) -> tuple[float, float]: ...
    def part(self, first: _Numbers, size: _Numbers) -> View: ...
    def enlarged(self, first: _Numbers, size: _Numbers) -> View: ...
    def project(self, point: _Numbers) -> Optional[tuple[float, float]]: ...
    def ray(self, row: float, col: float) -> tuple[_Point, _Point]: ...
    def _repr_html_(self) -> str: ...

@final
class Views:
    def __new__(cls, views: Sequence[View]) -> Views: ...
    @staticmethod
    def load(name_or_path: _Path, target: _Numbers, size: _Numbers = (32, 32)) -> Views: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Views: ...
    @staticmethod
    def string_of_pearls(
        target: _Numbers,
        altitude_km: float = 600.0,
        arc_km: float = 100.0,
        first: int = -16,
        last: int = 15,
        *,
        track_azimuth_deg: float = 0.0,
        pixel_km: float = 0.05,
        size: _Numbers = (32, 32),
    ) -> Views: ...
    @property
    def zenith_deg(self) -> NDArray[np.float64]: ...
    @property
    def azimuth_deg(self) -> NDArray[np.float64]: ...
    @property
    def pixel_km(self) -> NDArray[np.float64]: ...
    @property
    def target(self) -> NDArray[np.float64]: ...
    @property
    def position(self) -> NDArray[np.float64]: ...
    @property
    def direction(self) -> NDArray[np.float64]: ...
    @property
    def size(self) -> list[tuple[int, int]]: ...
    def __len__(self) -> int: ...
    @overload
    def __getitem__(self, index: int, /) -> View: ...
    @overload
    def __getitem__(self, index: slice, /) -> Views: ...
    def __add__(self, other: _Views, /) -> Views: ...
    def __radd__(self, other: Sequence[View], /) -> Views: ...
    def __iter__(self) -> Iterator[View]: ...
    def _repr_html_(self) -> str: ...

@disjoint_base
class Observation:
    def __new__(
        cls,
        radiance: ArrayLike,
        views: _Views,
        light: Optional[Light] = None,
        *,
        standard_error: Optional[ArrayLike] = None,
        saturated: Optional[ArrayLike] = None,
        lineage: Optional[Lineage] = None,
    ) -> Observation: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Observation: ...
    @property
    def radiance(self) -> _Floats: ...
    @property
    def views(self) -> Views: ...
    @property
    def light(self) -> Light: ...
    @property
    def standard_error(self) -> Optional[_Floats]: ...
    @property
    def saturated(self) -> Optional[_Marks]: ...
    def replace(self, **parts: Any) -> Observation: ...
    @property
    def lineage(self) -> Lineage: ...
    def to_netcdf(
        self, path: _Path, *, title: str = "Images of a cloud", overwrite: bool = False
    ) -> None: ...
    def to_xarray(self) -> Any: ...
    def _repr_html_(self) -> str: ...

def read_images(path: _Path) -> Observation: ...

@final
class Rendering(Observation):
    def __new__(
        cls,
        radiance: ArrayLike,
        views: _Views,
        light: Optional[Light] = None,
        *,
        standard_error: Optional[ArrayLike] = None,
        saturated: Optional[ArrayLike] = None,
        samples_per_pixel: int,
        estimated_error: Optional[float] = None,
        lineage: Optional[Lineage] = None,
    ) -> Rendering: ...
    @property
    def samples_per_pixel(self) -> int: ...
    @property
    def estimated_error(self) -> Optional[float]: ...
    def _repr_html_(self) -> str: ...

def render(
    extinction: _Extinction,
    grid: Optional[_Grid] = None,
    views: Union[_Views, _Path, None] = None,
    light: Optional[Light] = None,
    *,
    solver: Literal["monte-carlo", "ordinates"] = "monte-carlo",
    samples: Optional[int] = None,
    noise: Optional[float] = None,
    seed: int = 1,
    effective_radius: Optional[ArrayLike] = None,
    trilinear: bool = False,
    similarity_after: Optional[int] = None,
    accuracy: Optional[float] = None,
    estimate_error: bool = True,
    progress: _Progress = False,
) -> Rendering: ...

@final
class Sensor:
    def __new__(
        cls,
        *,
        full_well: float,
        read_noise: float,
        dark_current: float,
        bits: int,
        exposure: float,
        pixel_pitch: float,
    ) -> Sensor: ...
    @staticmethod
    def preset(name: Literal["cmv4000"]) -> Sensor: ...
    @staticmethod
    def from_file(path: _Path) -> Sensor: ...
    @property
    def full_well(self) -> float: ...
    @property
    def read_noise(self) -> float: ...
    @property
    def dark_current(self) -> float: ...
    @property
    def bits(self) -> int: ...
    @property
    def exposure(self) -> float: ...
    @property
    def pixel_pitch(self) -> float: ...
    def _repr_html_(self) -> str: ...

@final
class Sensed:
    def __new__(
        cls,
        radiance: ArrayLike,
        noise: ArrayLike,
        saturated: ArrayLike,
        electrons_per_radiance: float,
    ) -> Sensed: ...
    @property
    def radiance(self) -> _Floats: ...
    @property
    def noise(self) -> _Floats: ...
    @property
    def saturated(self) -> _Marks: ...
    @property
    def electrons_per_radiance(self) -> float: ...
    def _repr_html_(self) -> str: ...

@final
class Exposure(Observation):
    def __new__(
        cls,
        radiance: ArrayLike,
        views: _Views,
        light: Optional[Light] = None,
        *,
        standard_error: Optional[ArrayLike] = None,
        saturated: Optional[ArrayLike] = None,
        electrons_per_radiance: float,
        lineage: Optional[Lineage] = None,
    ) -> Exposure: ...
    @property
    def electrons_per_radiance(self) -> float: ...
    def _repr_html_(self) -> str: ...

@overload
def sense(
    radiance: Observation,
    sensor: Union[Sensor, Literal["cmv4000"]] = "cmv4000",
    *,
    electrons_per_radiance: Optional[float] = None,
    standard_error: None = None,
    seed: int = 1,
) -> Exposure: ...
@overload
def sense(
    radiance: ArrayLike,
    sensor: Union[Sensor, Literal["cmv4000"]] = "cmv4000",
    *,
    electrons_per_radiance: Optional[float] = None,
    standard_error: Optional[ArrayLike] = None,
    seed: int = 1,
) -> Sensed: ...

@final
class Carved:
    def __new__(
        cls,
        grid: _Grid,
        mask: ArrayLike,
        thresholds: Optional[_Numbers] = None,
        *,
        lineage: Optional[Lineage] = None,
    ) -> Carved: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Carved: ...
    @property
    def grid(self) -> Grid: ...
    @property
    def mask(self) -> _Marks: ...
    @property
    def thresholds(self) -> Optional[_Floats]: ...
    @property
    def lineage(self) -> Lineage: ...
    def to_netcdf(
        self, path: _Path, *, title: str = "Voxels that may contain cloud", overwrite: bool = False
    ) -> None: ...
    def to_xarray(self) -> Any: ...
    def _repr_html_(self) -> str: ...

def read_mask(path: _Path) -> Carved: ...
def carve(
    radiance: _Images,
    views: Optional[_Views] = None,
    grid: Optional[_Grid] = None,
    *,
    threshold: Optional[float] = None,
    standard_error: Optional[ArrayLike] = None,
    saturated: Optional[ArrayLike] = None,
    agreement: float = 0.9,
) -> Carved: ...

@final
class Estimate:
    def __new__(
        cls,
        grid: _Grid,
        extinction: _Extinction,
        uncertainty: Optional[ArrayLike] = None,
        light: Optional[Light] = None,
        *,
        effective_radius: Optional[ArrayLike] = None,
        lineage: Optional[Lineage] = None,
    ) -> Estimate: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Estimate: ...
    @property
    def grid(self) -> Grid: ...
    @property
    def extinction(self) -> _Floats: ...
    @property
    def uncertainty(self) -> Optional[_Floats]: ...
    @property
    def effective_radius(self) -> Optional[_Floats]: ...
    @property
    def light(self) -> Optional[Light]: ...
    @property
    def lineage(self) -> Lineage: ...
    def to_netcdf(
        self, path: _Path, *, title: str = "Extinction", overwrite: bool = False
    ) -> None: ...
    def to_xarray(self) -> Any: ...
    def _repr_html_(self) -> str: ...

def read_volume(path: _Path) -> Estimate: ...

@final
class Network:
    def __new__(cls, weights: Union[_Path, bytes] = "general", *, force: bool = False) -> Network: ...
    @staticmethod
    def load(name_or_path: _Path = "general", *, force: bool = False) -> Network: ...
    @staticmethod
    def built_in() -> list[str]: ...
    @property
    def contents(self) -> bytes: ...
    @property
    def metadata(self) -> dict[str, Any]: ...
    def grid(self, views: _Views) -> Grid: ...
    def tiles(
        self, views: _Views, grid: _Grid, side: int
    ) -> list[tuple[_Ends, _Ends, Grid, Optional[tuple[_Ends, _Ends]]]]: ...
    def infer(
        self,
        radiance: Union[_Images, Sequence[Observation]],
        views: Optional[_Views] = None,
        light: Optional[Light] = None,
        *,
        mask: Optional[_Mask] = None,
        grid: Optional[_Grid] = None,
    ) -> _Floats: ...
    def image_statistics(
        self,
        radiance: _Images,
        views: Optional[_Views] = None,
        light: Optional[Light] = None,
        *,
        grid: Optional[_Grid] = None,
    ) -> dict[str, float]: ...
    def estimate(
        self,
        radiance: Union[_Images, Sequence[Observation]],
        views: Optional[_Views] = None,
        light: Optional[Light] = None,
        *,
        mask: Optional[_Mask] = None,
        grid: Optional[_Grid] = None,
    ) -> Estimate: ...
    def _repr_html_(self) -> str: ...

@final
class Renderer:
    def __new__(
        cls,
        grid: Grid,
        views: Union[_Views, _Path],
        light: Optional[Light] = None,
        *,
        mask: Optional[_Mask] = None,
        expected: _Extinction = 20.0,
        accuracy: Optional[float] = None,
        tolerance: Optional[float] = None,
        warm_start: bool = True,
    ) -> Renderer: ...
    @property
    def grid(self) -> Grid: ...
    @property
    def views(self) -> Views: ...
    @property
    def light(self) -> Light: ...
    @property
    def mask(self) -> _Marks: ...
    @property
    def expected(self) -> Union[float, _Floats]: ...
    @property
    def accuracy(self) -> Optional[float]: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def warm_start(self) -> bool: ...
    @property
    def shape(self) -> tuple[int, int, int]: ...
    @property
    def cells(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    def images(
        self, extinction: _Extinction, effective_radius: Optional[ArrayLike] = None
    ) -> _Floats: ...
    @overload
    def vjp(
        self, extinction: _Extinction, cotangent: ArrayLike, effective_radius: None = None
    ) -> _Floats: ...
    @overload
    def vjp(
        self, extinction: _Extinction, cotangent: ArrayLike, effective_radius: ArrayLike
    ) -> tuple[_Floats, _Floats]: ...
    def jvp(
        self,
        extinction: _Extinction,
        direction: ArrayLike,
        effective_radius: Optional[ArrayLike] = None,
    ) -> _Floats: ...
    def _repr_html_(self) -> str: ...

@final
class Reconstruction:
    def __new__(
        cls,
        grid: _Grid,
        extinction: _Extinction,
        mask: _Mask,
        history: list[dict[str, Any]],
        ending: str,
        light: Light,
        effective_radius: Optional[ArrayLike] = None,
        *,
        standard_errors: Optional[dict[str, ArrayLike]] = None,
        calibrations: Optional[list[list[dict[str, Any]]]] = None,
        lineage: Optional[Lineage] = None,
    ) -> Reconstruction: ...
    @property
    def grid(self) -> Grid: ...
    @property
    def extinction(self) -> _Floats: ...
    @property
    def mask(self) -> _Marks: ...
    @property
    def history(self) -> list[dict[str, Any]]: ...
    @property
    def ending(self) -> str: ...
    @property
    def light(self) -> Light: ...
    @property
    def effective_radius(self) -> Optional[_Floats]: ...
    @property
    def standard_errors(self) -> dict[str, _Floats]: ...
    @property
    def calibrations(self) -> list[list[dict[str, Any]]]: ...
    @property
    def lineage(self) -> Lineage: ...
    def to_netcdf(
        self, path: _Path, *, title: str = "Extinction by inversion", overwrite: bool = False
    ) -> None: ...
    def to_xarray(self) -> Any: ...
    def _repr_html_(self) -> str: ...

def invert(
    radiance: Union[_Images, Sequence[Observation]],
    views: Optional[_Views] = None,
    grid: Optional[_Grid] = None,
    light: Optional[Light] = None,
    *,
    init: Union[float, _Extinction, Literal["auto"]] = 0.01,
    mask: Optional[_Mask] = None,
    standard_error: Optional[ArrayLike] = None,
    saturated: Optional[ArrayLike] = None,
    truth: Optional[_Extinction] = None,
    progress: _Progress = False,
    **settings: Any,
) -> Reconstruction: ...
def hybrid(
    radiance: Union[_Images, Sequence[Observation]],
    views: Optional[_Views] = None,
    network: Union[Network, _Path, None] = None,
    light: Optional[Light] = None,
    *,
    grid: Optional[_Grid] = None,
    quick: bool = False,
    mask: Optional[_Mask] = None,
    standard_error: Optional[ArrayLike] = None,
    saturated: Optional[ArrayLike] = None,
    truth: Optional[_Extinction] = None,
    progress: _Progress = False,
    **settings: Any,
) -> Reconstruction: ...

@final
class Scores:
    def __new__(
        cls,
        *,
        relative_error: float,
        mass_error: float,
        root_mean_square_error: float,
        correlation: Optional[float] = None,
        truth_by_level: _Numbers,
        estimate_by_level: _Numbers,
        relative_error_by_level: _Numbers,
    ) -> Scores: ...
    @property
    def relative_error(self) -> float: ...
    @property
    def mass_error(self) -> float: ...
    @property
    def root_mean_square_error(self) -> float: ...
    @property
    def correlation(self) -> Optional[float]: ...
    @property
    def truth_by_level(self) -> NDArray[np.float64]: ...
    @property
    def estimate_by_level(self) -> NDArray[np.float64]: ...
    @property
    def relative_error_by_level(self) -> NDArray[np.float64]: ...
    def _repr_html_(self) -> str: ...

def score(truth: _Extinction, estimate: _Extinction) -> Scores: ...

@final
class Figure:
    def __new__(cls, png: bytes, svg: str, pdf: bytes) -> Figure: ...
    @property
    def png(self) -> bytes: ...
    @property
    def svg(self) -> str: ...
    @property
    def pdf(self) -> bytes: ...
    def save(self, path: _Path, *, overwrite: bool = False) -> None: ...
    def _repr_png_(self) -> bytes: ...

def plot(
    what: Union[_Extinction, _Images, Carved, _Path],
    truth: Union[_Extinction, _Path, None] = None,
    *,
    grid: Optional[_Grid] = None,
    through: Optional[_Point] = None,
    title: Optional[str] = None,
    out: Optional[_Path] = None,
    overwrite: bool = False,
) -> Figure: ...

@final
class Page:
    def __new__(cls, html: str) -> Page: ...
    @property
    def html(self) -> str: ...
    def save(self, path: _Path, *, overwrite: bool = False) -> None: ...
    def open(self) -> Path: ...
    def _repr_html_(self) -> str: ...

def view(
    what: Union[_Extinction, _Images, Carved, _Path],
    truth: Union[_Extinction, _Path, None] = None,
    *,
    grid: Optional[_Grid] = None,
    title: Optional[str] = None,
    out: Optional[_Path] = None,
    overwrite: bool = False,
) -> Page: ...
