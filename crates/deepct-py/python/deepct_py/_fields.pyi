from os import PathLike
from typing import Any, Optional, Union

from . import Grid, Network

def infer(
    images: Any,
    network: Union[Network, str, PathLike[str]] = "general",
    *,
    grid: Optional[Grid] = None,
    carve: bool = False,
    side: int = 512,
) -> Any: ...
