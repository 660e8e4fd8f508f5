"""Training with several processes started by ``torchrun``.

All processes hold the same network and take the same steps. Each process draws every complete
batch, so that the random numbers do not depend on the number of processes, and computes the
gradients of its share. Batch normalisation uses the statistics of all shares. The training is
therefore that of a single process except for the order of summation.
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
    """The processes of a training, described for one of them; by default it is the only one."""

    device: torch.device
    """The device of this process."""
    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the process that computes the scores, writes and prints."""
        return self.rank == 0

    def share(self, samples: int) -> slice:
        """The share of a batch for this process; the sizes of the shares differ by at most one."""
        return slice(samples * self.rank // self.count, samples * (self.rank + 1) // self.count)

    def agreed(self, *values: float) -> list[float]:
        """The numbers passed by the first process; those of the other processes are ignored."""
        if self.count == 1:
            return list(values)
        numbers = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.broadcast(numbers, 0)
        return numbers.tolist()

    def mean(self, value: float) -> float:
        """The mean of the values passed by all processes."""
        if self.count == 1:
            return value
        total = torch.tensor(value, dtype=torch.float64, device=self.device)
        dist.all_reduce(total)
        return total.item() / self.count

    def layers(self, network: Network) -> Callable[..., Tensor]:
        """:meth:`Network.layers` with gradients averaged over all processes.

        Call it before the parameters are passed to an optimizer, because it replaces the batch
        normalisation layers of the network.
        """
        if self.count == 1:
            return network.layers
        for block in network.net.body:
            block.body[1] = SharedNorm(block.body[1])
        devices = [self.device] if self.device.type == "cuda" else None
        return DistributedDataParallel(_Layers(network), devices)


@contextmanager
def processes() -> Iterator[Processes]:
    """The processes started by ``torchrun``, or a single process without ``torchrun``.

    They communicate through NCCL if there are GPUs, one for each process, and otherwise through
    Gloo.

    Raises :class:`InputError` if a machine has GPUs, but fewer than processes.
    """
    rank, count, local = (_told(name) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK"))
    device, gpus = torch.device("cpu"), torch.cuda.device_count()
    if gpus:
        if local >= gpus:
            problem = f"require at least {local + 1} GPUs, but only {gpus} are available"
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
    """A number that ``torchrun`` passes to its processes in the environment."""
    return int(os.environ.get(name, "0"))


class _Layers(nn.Module):
    """The layers of a network as a separate module."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor, leak: float) -> Tensor:
        return self.network.layers(images, leak)


class SharedNorm(nn.BatchNorm2d):
    """Batch normalisation over the shares of all processes.

    ``torch.nn.SyncBatchNorm`` requires a GPU for each process.
    """

    def __init__(self, norm: nn.BatchNorm2d) -> None:
        """Copy the parameters and statistics of ``norm``."""
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
    """The sum over all processes; its gradient is summed over all processes as well."""

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
