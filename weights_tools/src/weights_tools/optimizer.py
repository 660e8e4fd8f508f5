"""Optimizers: Muon for the kernels, Adam for all other parameters."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

MOMENTUM = 0.95
"""Weight of the previous mean gradient in the moving mean of Muon."""

COEFFICIENTS = (3.4445, -4.7750, 2.0315)
"""Coefficients of the quintic ``a X + b X X'X + c X X'X X'X``, which brings singular values close
to 1 (Jordan et al. 2024)."""

ITERATIONS = 5


class Muon(torch.optim.Optimizer):
    """Steps along the orthogonal matrix nearest to the moving mean of the gradient.

    A kernel is treated as the matrix ``[out, in * 9]``. The step is the same for all its singular
    vectors, so that features of few clouds are learned as fast as those of all clouds (K. Jordan
    et al. 2024, "Muon: an optimizer for hidden layers in neural networks", with Nesterov momentum).
    """

    def __init__(self, kernels: list[Tensor], learning_rate: float) -> None:
        super().__init__(kernels, {"lr": learning_rate})

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:
        for group in self.param_groups:
            for kernel in group["params"]:
                if kernel.grad is None:
                    continue
                state = self.state[kernel]
                if not state:
                    state["mean_gradient"] = torch.zeros_like(kernel)
                mean = state["mean_gradient"].lerp_(kernel.grad, 1.0 - MOMENTUM)
                ahead = kernel.grad.lerp(mean, MOMENTUM)
                direction = nearest_orthogonal(ahead.flatten(1)).view_as(kernel)
                rate = group["lr"]
                if isinstance(rate, Tensor):
                    kernel.sub_(direction * rate)
                else:
                    kernel.add_(direction, alpha=-rate)


def nearest_orthogonal(matrix: Tensor) -> Tensor:
    """A matrix with the singular vectors of ``matrix`` and singular values between about 0.7
    and 1.2, from the Newton-Schulz iteration."""
    tall = matrix.shape[0] > matrix.shape[1]
    result = matrix.T if tall else matrix
    result = result / result.norm().clamp_min(1e-12)
    a, b, c = COEFFICIENTS
    for _ in range(ITERATIONS):
        square = result @ result.T
        result = a * result + (b * square + c * square @ square) @ result
    return result.T if tall else result


class Optimizers:
    """The optimizers of a network: Adam alone, or Adam together with Muon for the kernels."""

    def __init__(
        self,
        network: nn.Module,
        muon_share: float,
        betas: tuple[float, float] = (0.9, 0.999),
        capturable: bool = False,
    ) -> None:
        """``muon_share`` is the learning rate of Muon divided by that of Adam; with 0, Adam
        optimises the kernels as well. ``betas`` are the weights of the moving means of Adam. With
        ``capturable``, the learning rates are tensors, so that :meth:`apply` can be part of a CUDA
        graph."""
        kernels = [part for part in network.parameters() if part.ndim == 4]
        others = [part for part in network.parameters() if part.ndim != 4]
        self._rates = [1.0]
        settings: dict[str, Any] = {"betas": betas, "capturable": capturable}
        if muon_share == 0.0:
            self._all: list[torch.optim.Optimizer] = [
                torch.optim.Adam(network.parameters(), **settings)
            ]
        else:
            self._all = [torch.optim.Adam(others, **settings), Muon(kernels, muon_share)]
            self._rates.append(muon_share)
        self._capturable = capturable
        if capturable:
            self._use_tensors()

    @property
    def learning_rate(self) -> float:
        """The learning rate of Adam in the last step."""
        return float(self._all[0].param_groups[0]["lr"])

    def zero_grad(self) -> None:
        for optimizer in self._all:
            optimizer.zero_grad()

    def step(self, learning_rate: float) -> None:
        """Take one step; ``learning_rate`` is that of Adam."""
        self.set_rate(learning_rate)
        self.apply()

    def set_rate(self, learning_rate: float) -> None:
        """Set the learning rate of the following steps; it is that of Adam."""
        for optimizer, factor in zip(self._all, self._rates):
            for group in optimizer.param_groups:
                if isinstance(group["lr"], Tensor):
                    group["lr"].fill_(factor * learning_rate)
                else:
                    group["lr"] = factor * learning_rate

    def apply(self) -> None:
        """Take one step with the learning rate that was set."""
        for optimizer in self._all:
            optimizer.step()

    def _use_tensors(self) -> None:
        for optimizer in self._all:
            for group in optimizer.param_groups:
                device = group["params"][0].device
                group["lr"] = torch.tensor(float(group["lr"]), device=device)

    def state_dict(self) -> dict[str, Any]:
        """The state of each optimizer, by its number."""
        return {str(at): optimizer.state_dict() for at, optimizer in enumerate(self._all)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for at, optimizer in enumerate(self._all):
            optimizer.load_state_dict(state[str(at)])
            # The state may be that of a training on another kind of device.
            for group in optimizer.param_groups:
                group["lr"] = float(group["lr"])
                if "capturable" in group:
                    group["capturable"] = self._capturable
            for parameter, values in optimizer.state.items():
                if "step" in values:
                    place = parameter.device if self._capturable else "cpu"
                    values["step"] = values["step"].to(place)
        if self._capturable:
            self._use_tensors()
