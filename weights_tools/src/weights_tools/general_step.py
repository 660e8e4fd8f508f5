"""One step of the optimisation of a general network, and its loss.

On a GPU, a step consists of several hundred short operations, which the processor cannot start as
fast as the GPU executes them. For each size of a batch, they are therefore recorded once as a CUDA
graph and then started together. If the recording fails, the operations are started one by one. The
speed on a GPU has not been measured yet.
"""

from __future__ import annotations

from typing import Callable

import torch
from torch import Tensor

from weights_tools.general import GeneralNetwork
from weights_tools.metrics import LEAST_CLOUD
from weights_tools.optimizer import Optimizers
from weights_tools.stream import Batch
from weights_tools.views import Views

BETAS = (0.9, 0.98)
"""Weights of the moving means of Adam."""

EAGER_STEPS = 20
"""Number of steps before the first recording, in which the optimiser creates its state."""


class Step:
    """Steps of a network in training mode."""

    def __init__(
        self,
        network: GeneralNetwork,
        muon_share: float,
        report: Callable[[str], None],
    ) -> None:
        """``muon_share`` is the learning rate of Muon divided by that of Adam."""
        self.network, self.report = network, report
        self.device = next(network.parameters()).device
        self.recording = self.device.type == "cuda"
        self.optimizers = Optimizers(network, muon_share, BETAS, capturable=self.recording)
        # The leak, and the weights of epsilon, of the squared error and of the uncertainty.
        self._weights = torch.zeros(4, device=self.device)
        self._recorded: dict[tuple[int, ...], tuple[torch.cuda.CUDAGraph, Batch, Tensor]] = {}
        if self.recording:
            # All steps run on one stream, and the graphs share their memory.
            self._stream = torch.cuda.Stream(self.device)
            self._memory = torch.cuda.graph_pool_handle()
        self._steps = 0
        for parameter in network.parameters():
            parameter.grad = torch.zeros_like(parameter)

    def run(self, batch: Batch, rate: float, weights: tuple[float, float, float, float]) -> Tensor:
        """Take one step with a learning rate; ``weights`` are the leak and the weights of epsilon,
        of the squared error and of the uncertainty. Returns the loss before the step."""
        self.optimizers.set_rate(rate)
        # Without a copy from the host, which would wait for all previous steps.
        for place, value in zip(self._weights, weights):
            place.fill_(value)
        self._steps += 1
        if not self.recording:
            return self._operations(batch)
        if self._steps <= EAGER_STEPS:
            return self._on_stream(batch)
        key = tuple(batch.planes.shape)
        if key not in self._recorded:
            try:
                self._recorded[key] = self._record(batch)
            except RuntimeError as problem:
                self.recording = False
                self._recorded.clear()
                reason = " ".join(str(problem).split())[:200]
                self.report(f"the steps are not recorded as CUDA graphs ({reason})")
                return self._operations(batch)
        graph, inputs, loss = self._recorded[key]
        for target, source in zip(_tensors(inputs), _tensors(batch)):
            target.copy_(source)
        graph.replay()
        return loss

    def freeze(self) -> None:
        """Use and keep the running statistics of the batch normalisations in all further steps."""
        self.network.frozen = True
        self.network.train()
        if self.recording:
            self._recorded.clear()

    def _on_stream(self, batch: Batch) -> Tensor:
        current = torch.cuda.current_stream(self.device)
        self._stream.wait_stream(current)
        with torch.cuda.stream(self._stream):
            loss = self._operations(batch)
        current.wait_stream(self._stream)
        return loss

    def _record(self, batch: Batch) -> tuple[torch.cuda.CUDAGraph, Batch, Tensor]:
        copies = [tensor.clone() for tensor in _tensors(batch)]
        inputs = Batch(copies[0], Views(*copies[2:]), copies[1])
        torch.cuda.synchronize(self.device)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self._memory, stream=self._stream):
            loss = self._operations(inputs)
        return graph, inputs, loss

    def _operations(self, batch: Batch) -> Tensor:
        gradients = [parameter.grad for parameter in self.network.parameters()]
        torch._foreach_zero_(gradients)
        kind = self.device.type
        leak, relative, squared, uncertainty = self._weights.unbind()
        # Without the cache of converted parameters, which a graph must not share with other steps.
        with torch.autocast(kind, torch.bfloat16, cache_enabled=not self.recording):
            outputs = self.network(batch.planes, batch.views, leak.to(torch.bfloat16))
        loss = general_loss(outputs.float(), batch.truth, relative, squared, uncertainty)
        loss.backward()
        self.optimizers.apply()
        return loss.detach()


def general_loss(
    outputs: Tensor, truth: Tensor, relative: Tensor, squared: Tensor, uncertainty: Tensor
) -> Tensor:
    """The loss of a batch of scaled extinction ``[n, z, y, x]``: the mean over the scenes of

    - epsilon, with the weight ``relative``;
    - the sum of squared errors divided by the sum of squares of the extinction (``squared``);
    - the squared error of the estimated absolute error, divided by the same sum (``uncertainty``),
      which has no effect on the extinction.
    """
    estimate, expected = outputs.chunk(2, 1)
    volume = (1, 2, 3)
    difference = estimate - truth
    squares = truth.square().sum(volume).clamp_min(LEAST_CLOUD)
    amounts = truth.sum(volume).clamp_min(LEAST_CLOUD)
    missed = (expected - difference.detach().abs()).square().sum(volume)
    by_scene = (
        relative * difference.abs().sum(volume) / amounts
        + squared * difference.square().sum(volume) / squares
        + uncertainty * missed / squares
    )
    return by_scene.mean()


def _tensors(batch: Batch) -> list[Tensor]:
    return [batch.planes, batch.truth, *vars(batch.views).values()]
