from os import PathLike
from typing import Any, Optional, Union, overload

from . import Estimate, Network, Observation, _Grid

@overload
def infer(
    images: Observation,
    network: Union[Network, str, PathLike[str]] = "general",
    *,
    grid: Optional[_Grid] = None,
    carve: bool = False,
    side: int = 512,
) -> Estimate: ...
@overload
def infer(
    images: Any,
    network: Union[Network, str, PathLike[str]] = "general",
    *,
    grid: Optional[_Grid] = None,
    carve: bool = False,
    side: int = 512,
) -> Any: ...
