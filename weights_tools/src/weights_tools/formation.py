"""Networks of one formation as differentiable functions of its images, from their weights files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from weights_tools.checkpoint import write_whole
from weights_tools.errors import InputError
from weights_tools.files import weights_header
from weights_tools.general import run_folded
from weights_tools.lift import lift_of, wavelengths_of

AGREEMENT = 1e-3
"""Largest difference from the estimate of ``deepct``, over the largest extinction."""

_REMEDY = "give a weights file of deepct"


class FormationWeights(nn.Module):
    """The folded layers of a network of one formation, as parameters, and their metadata."""

    def __init__(self, contents: bytes, path: str | Path) -> None:
        """From the contents of the weights file ``path``.

        Raises :class:`InputError` if they are not a weights file of one formation.
        """
        import deepct_py
        from safetensors.torch import load

        super().__init__()
        self.header = weights_header(contents, path, _REMEDY)
        try:
            # Checks all of the contents.
            self.reference = deepct_py.Network(contents)
        except (deepct_py.DeepctError, ValueError) as problem:
            raise InputError(path, " ".join(str(problem).split()), _REMEDY) from None
        if len(wavelengths_of(self.header)) > 1 or "effective_radius" in self.header["outputs"]:
            problem = "is of a network for several bands or of the effective radius"
            raise InputError(path, problem, "give weights for the extinction from one band")
        tensors = load(contents)
        self._names = sorted(tensors)
        self._values = nn.ParameterList(tensors[name] for name in self._names)

    @property
    def layers(self) -> dict[str, Tensor]:
        """The layers by the names of the weights file."""
        return dict(zip(self._names, self._values))

    def write(self, path: Path, changes: dict[str, Any]) -> None:
        """Write a weights file with some entries of the metadata replaced, atomically."""
        from safetensors.torch import save

        tensors = {name: values.detach().contiguous() for name, values in self.layers.items()}
        text = json.dumps({**self.header, **changes}, sort_keys=True, allow_nan=False)
        write_whole(path, save(tensors, {"deepct": text}))


class FormationEstimator:
    """Maps images ``[n, view, row, col]`` (1/sr) of the formation to extinction ``[n, z, y, x]``
    (1/km) on :attr:`grid`."""

    def __init__(self, weights: FormationWeights, observation: Any) -> None:
        """For the views of an observation of ``deepct_py``.

        Raises ``ValueError`` for images that ``deepct`` refuses, and for those whose estimate it
        computes otherwise, as their cameras are not exactly those of the formation.
        """
        import deepct_py

        self._weights = weights
        self._lift = lift_of(weights.header)
        try:
            self.grid = weights.reference.grid(observation.views)
            expected = weights.reference.infer(observation)
        except deepct_py.DeepctError as problem:
            raise ValueError(" ".join(str(problem).split())) from None
        with torch.no_grad():
            images = torch.from_numpy(observation.radiance)[None]
            found = self.of_planes(self.planes(images))[0][0].numpy()
        largest = AGREEMENT * max(float(expected.max()), 1.0)
        # Written so that missing pixels, with which nothing agrees, are refused.
        if found.shape != expected.shape or not np.abs(found - expected).max() < largest:
            raise ValueError(f"its cameras are not those of {weights.header['formation']}")

    def planes(self, images: Tensor) -> Tensor:
        """The input of :meth:`of_planes`, which does not depend on the parameters."""
        scaled = images * self._weights.header["input_scale"]
        return scaled if self._lift is None else self._lift(scaled)

    def of_planes(self, planes: Tensor) -> tuple[Tensor, Tensor]:
        """The extinction and its expected error (1/km), 0 if the network does not estimate it."""
        header = self._weights.header
        found = header["output_scale"] * run_folded(self._weights.layers, planes)
        if len(header["outputs"]) == 1:
            return found, torch.zeros_like(found)
        extinction, error = found.chunk(2, 1)
        return extinction, error
