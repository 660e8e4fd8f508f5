"""Training by several processes, as ``torchrun`` starts them.

They hold the same network and take the same steps. Each draws the whole of every batch, so
that random numbers do not depend on how many there are, and learns from its share of it; batch
norms take their statistics over all shares. It is the training of one process, but for the
order of sums.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Callable

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from weights_tools.errors import InputError
from weights_tools.model import Network


@dataclass(frozen=True)
class Processes:
    """Those that train together, as one of them sees them; alone by default."""

    device: torch.device
    """What this one computes on."""
    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the one that takes scores, writes and prints."""
        return self.rank == 0

    def share(self, samples: int) -> slice:
        """The samples of a batch that are this process's; shares differ by one at most."""
        return slice(samples * self.rank // self.count, samples * (self.rank + 1) // self.count)

    def agreed(self, *values: float) -> list[float]:
        """The numbers that the first process gives, whatever the others do."""
        if self.count == 1:
            return list(values)
        numbers = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.broadcast(numbers, 0)
        return numbers.tolist()

    def mean(self, value: float) -> float:
        """The mean of what each process gives."""
        if self.count == 1:
            return value
        total = torch.tensor(value, dtype=torch.float64, device=self.device)
        dist.all_reduce(total)
        return total.item() / self.count

    def layers(self, network: Network) -> Callable[..., Tensor]:
        """:meth:`Network.layers`, whose gradients will be the means over all processes.

        Call it before parameters are given to an optimizer: norms of the network are replaced.
        """
        if self.count == 1:
            return network.layers
        for block in network.net.body:
            block.body[1] = SharedNorm(block.body[1])
        devices = [self.device] if self.device.type == "cuda" else None
        return DistributedDataParallel(_Layers(network), devices)


@contextmanager
def processes() -> Iterator[Processes]:
    """The processes that ``torchrun`` started this one among; it alone where nothing did.

    They talk by NCCL where there are GPUs, one for each, else by Gloo.

    Raises :class:`InputError` for fewer GPUs than processes on a machine.
    """
    rank, count, local = (_told(name) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK"))
    device, gpus = torch.device("cpu"), torch.cuda.device_count()
    if gpus:
        if local >= gpus:
            problem = f"want {local + 1} GPUs or more, of which there are {gpus}"
            raise InputError("the processes of this machine", problem, "start fewer with torchrun")
        device = torch.device("cuda", local)
        torch.cuda.set_device(device)
    if count <= 1:
        yield Processes(device)
        return
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Processes(device, rank, count)
    finally:
        dist.destroy_process_group()


def _told(name: str) -> int:
    """A number that ``torchrun`` tells the processes that it starts."""
    return int(os.environ.get(name, "0"))


class _Layers(nn.Module):
    """The layers of a network as a module of their own."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor, leak: float) -> Tensor:
        return self.network.layers(images, leak)


class SharedNorm(nn.BatchNorm2d):
    """Batch norm over the shares of all processes; PyTorch's own wants a GPU for each."""

    def __init__(self, norm: nn.BatchNorm2d) -> None:
        """With the parameters and statistics of ``norm``."""
        super().__init__(norm.num_features, norm.eps, norm.momentum)
        self.to(norm.weight.device)
        self.load_state_dict(norm.state_dict())

    def forward(self, images: Tensor) -> Tensor:
        if not self.training:
            return super().forward(images)
        axes = (0, 2, 3)
        values = images.float()
        pixels = torch.full((1,), values[:, 0].numel(), dtype=values.dtype, device=values.device)
        sums = _Total.apply(torch.cat([values.sum(axes), pixels]))
        mean, pixels = sums[:-1] / sums[-1], sums[-1].detach()
        centred = values - mean[:, None, None]
        variance = _Total.apply(centred.square().sum(axes)) / pixels
        with torch.no_grad():
            self.num_batches_tracked += 1
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * pixels / (pixels - 1.0), self.momentum)
        scale = self.weight * (variance + self.eps).rsqrt()
        return (centred * scale[:, None, None] + self.bias[:, None, None]).to(images.dtype)


class _Total(torch.autograd.Function):
    """The sum over all processes. What is made of it in all of them is what its gradient is."""

    @staticmethod
    def forward(context: Any, values: Tensor) -> Tensor:
        total = values.detach().clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(context: Any, gradient: Tensor) -> Tensor:
        total = gradient.clone(memory_format=torch.contiguous_format)
        dist.all_reduce(total)
        return total
