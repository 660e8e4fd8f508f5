from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any, Literal, Optional, Union, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Point = tuple[float, float, float]

__version__: str

class DeepctError(Exception): ...

@final
class Grid:
    def __new__(
        cls, shape: tuple[int, int, int], spacing: _Point, origin: _Point = (0.0, 0.0, 0.0)
    ) -> Grid: ...
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

@final
class Cloud:
    @property
    def grid(self) -> Grid: ...
    @property
    def extinction(self) -> NDArray[np.float32]: ...
    @property
    def liquid_water_content(self) -> NDArray[np.float32]: ...
    @property
    def effective_radius(self) -> NDArray[np.float32]: ...
    @property
    def effective_variance(self) -> NDArray[np.float32]: ...

def generate_cloud(
    grid: Optional[Grid] = None,
    *,
    kind: Literal["cumulus", "field"] = "cumulus",
    seed: int = 1,
    **settings: Any,
) -> Cloud: ...

@final
class Light:
    def __new__(
        cls,
        *,
        sun_zenith_deg: float = 30.0,
        sun_azimuth_deg: float = 45.0,
        solar_irradiance: float = 1.0,
        wavelength: float = 0.672,
        air: bool = False,
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
    ) -> Light: ...
    @staticmethod
    def from_dataset(dataset: Any) -> Light: ...
    def replace(self, **values: Any) -> Light: ...
    def to_dict(self) -> dict[str, Union[float, bool, str]]: ...
    def __getattr__(self, name: str, /) -> Any: ...

def camera_from_ecef(
    position: _Point, latitude_deg: float, longitude_deg: float
) -> _Point: ...

@final
class View:
    @staticmethod
    def perspective(
        position: _Point, target: _Point, pixel_tangent: float, size: tuple[int, int] = (32, 32)
    ) -> View: ...
    @staticmethod
    def orthographic(
        zenith_deg: float,
        azimuth_deg: float,
        target: _Point,
        pixel_km: float,
        size: tuple[int, int] = (32, 32),
        *,
        looks_up: bool = False,
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
    def size(self) -> tuple[int, int]: ...
    @property
    def shift(self) -> tuple[float, float]: ...
    def part(self, first: tuple[int, int], size: tuple[int, int]) -> View: ...
    def project(self, point: _Point) -> Optional[tuple[float, float]]: ...
    def ray(self, row: float, col: float) -> tuple[_Point, _Point]: ...

@final
class Views:
    def __new__(cls, views: Sequence[View]) -> Views: ...
    @staticmethod
    def load(
        name_or_path: Union[str, PathLike[str]], target: _Point, size: tuple[int, int] = (32, 32)
    ) -> Views: ...
    @staticmethod
    def string_of_pearls(
        target: _Point,
        altitude: float = 600.0,
        arc: float = 100.0,
        first: int = -16,
        last: int = 15,
        *,
        track_azimuth_deg: float = 0.0,
        pixel_km: float = 0.05,
        size: tuple[int, int] = (32, 32),
    ) -> Views: ...
    @property
    def zenith_deg(self) -> NDArray[np.float64]: ...
    @property
    def azimuth_deg(self) -> NDArray[np.float64]: ...
    @property
    def pixel_km(self) -> NDArray[np.float64]: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> View: ...
    def __iter__(self) -> Iterator[View]: ...

@final
class Rendering:
    @property
    def radiance(self) -> NDArray[np.float32]: ...
    @property
    def standard_error(self) -> Optional[NDArray[np.float32]]: ...
    @property
    def samples_per_pixel(self) -> int: ...
    @property
    def light(self) -> Light: ...
    @property
    def estimated_error(self) -> Optional[float]: ...

def render(
    extinction: ArrayLike,
    grid: Grid,
    views: Union[Views, Sequence[View]],
    light: Optional[Light] = None,
    *,
    solver: Literal["monte-carlo", "ordinates"] = "monte-carlo",
    samples_per_pixel: Optional[int] = None,
    noise: Optional[float] = None,
    seed: int = 1,
    effective_radius: Optional[ArrayLike] = None,
    trilinear: bool = False,
    similarity_after: Optional[int] = None,
    accuracy: Optional[float] = None,
    estimate_error: bool = True,
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
    def from_file(path: Union[str, PathLike[str]]) -> Sensor: ...
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

@final
class Sensed:
    @property
    def radiance(self) -> NDArray[np.float32]: ...
    @property
    def noise(self) -> NDArray[np.float32]: ...
    @property
    def saturated(self) -> NDArray[np.bool_]: ...
    @property
    def electrons_per_radiance(self) -> float: ...

def sense(
    radiance: ArrayLike,
    sensor: Union[Sensor, Literal["cmv4000"], None] = None,
    *,
    electrons_per_radiance: Optional[float] = None,
    standard_error: Optional[ArrayLike] = None,
    seed: int = 1,
) -> Sensed: ...

@final
class Carved:
    @property
    def mask(self) -> NDArray[np.bool_]: ...
    @property
    def thresholds(self) -> NDArray[np.float32]: ...

def carve(
    radiance: ArrayLike,
    views: Union[Views, Sequence[View]],
    grid: Grid,
    *,
    threshold: Optional[float] = None,
    standard_error: Optional[ArrayLike] = None,
    saturated: Optional[ArrayLike] = None,
    agreement: Optional[float] = None,
) -> Carved: ...

@final
class Network:
    @staticmethod
    def load(
        name_or_path: Union[str, PathLike[str]] = "general", *, force: bool = False
    ) -> Network: ...
    @staticmethod
    def built_in() -> list[str]: ...
    @property
    def metadata(self) -> dict[str, Any]: ...
    def grid(self, views: Union[Views, Sequence[View]]) -> Grid: ...
    def infer(
        self,
        radiance: ArrayLike,
        views: Union[Views, Sequence[View]],
        light: Optional[Light] = None,
        *,
        mask: Optional[ArrayLike] = None,
        grid: Optional[Grid] = None,
    ) -> NDArray[np.float32]: ...
    def image_statistics(
        self,
        radiance: ArrayLike,
        views: Union[Views, Sequence[View]],
        light: Optional[Light] = None,
        *,
        grid: Optional[Grid] = None,
    ) -> dict[str, float]: ...
    def estimate(
        self,
        radiance: ArrayLike,
        views: Union[Views, Sequence[View]],
        light: Optional[Light] = None,
        *,
        mask: Optional[ArrayLike] = None,
        grid: Optional[Grid] = None,
    ) -> tuple[NDArray[np.float32], Optional[NDArray[np.float32]]]: ...

@final
class Reconstruction:
    @property
    def extinction(self) -> NDArray[np.float32]: ...
    @property
    def mask(self) -> NDArray[np.bool_]: ...
    @property
    def history(self) -> list[dict[str, Any]]: ...
    @property
    def ending(self) -> str: ...

def invert(
    radiance: ArrayLike,
    views: Union[Views, Sequence[View]],
    grid: Grid,
    light: Optional[Light] = None,
    *,
    start: Union[float, ArrayLike, Literal["auto"], None] = None,
    mask: Optional[ArrayLike] = None,
    standard_error: Optional[ArrayLike] = None,
    saturated: Optional[ArrayLike] = None,
    truth: Optional[ArrayLike] = None,
    **settings: Any,
) -> Reconstruction: ...
def hybrid(
    radiance: ArrayLike,
    views: Union[Views, Sequence[View]],
    network: Network,
    light: Optional[Light] = None,
    *,
    grid: Optional[Grid] = None,
    quick: bool = False,
    mask: Optional[ArrayLike] = None,
    standard_error: Optional[ArrayLike] = None,
    saturated: Optional[ArrayLike] = None,
    truth: Optional[ArrayLike] = None,
    **settings: Any,
) -> Reconstruction: ...

@final
class Scores:
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

def score(truth: ArrayLike, estimate: ArrayLike) -> Scores: ...
