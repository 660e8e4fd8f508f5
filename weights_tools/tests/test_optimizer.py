"""Muon compared with the singular value decomposition."""

import pytest
import torch

from weights_tools.model import Network
from weights_tools.optimizer import Muon, Optimizers, nearest_orthogonal


@pytest.mark.parametrize("shape", [(48, 432), (432, 48), (32, 32), (1, 9)])
def test_singular_values_come_near_to_one_and_vectors_stay(shape):
    torch.manual_seed(2)
    u, values, v = torch.linalg.svd(torch.randn(shape), full_matrices=False)
    matrix = u @ torch.linspace(10.0, 1.0, len(values)).diag() @ v
    found = u.T @ nearest_orthogonal(matrix) @ v.T
    values = found.diagonal()
    assert values.min() > 0.5 and values.max() < 1.3
    assert (found - values.diag()).abs().max() < 1e-4


def test_a_first_step_goes_down_along_all_singular_vectors():
    torch.manual_seed(3)
    kernel = torch.randn(8, 2, 3, 3, requires_grad=True)
    start = kernel.detach().clone()
    target = torch.randn_like(kernel)
    muon = Muon([kernel], 0.01)
    (kernel * target).sum().backward()
    muon.step()
    moved = (kernel.detach() - start).flatten(1)
    u, _, v = torch.linalg.svd(target.flatten(1), full_matrices=False)
    along = -(u.T @ moved @ v.T).diagonal()
    assert along.min() > 0.005 and along.max() < 0.013


def test_kernels_are_muons_and_the_rest_is_adams():
    network = Network([3, 4, 2])
    optimizers = Optimizers(network, 4.0)
    network(torch.randn(4, 3, 6, 6)).square().sum().backward()
    before = {name: values.clone() for name, values in network.named_parameters()}
    optimizers.step(1e-3)
    assert optimizers.learning_rate == 1e-3
    for name, values in network.named_parameters():
        moved = (values - before[name]).flatten(1) if values.ndim == 4 else values - before[name]
        if values.ndim == 4:
            largest = torch.linalg.matrix_norm(moved.detach(), 2).item()
            assert largest == pytest.approx(4e-3, rel=0.4)
        else:
            assert moved.abs().max() <= 1e-3 * 1.01
    others = Optimizers(network, 0.0).state_dict()
    assert set(others) == {"0"} and set(optimizers.state_dict()) == {"0", "1"}


def test_the_learning_rate_of_muon_may_be_a_tensor():
    torch.manual_seed(4)
    kernels = [torch.randn(4, 2, 3, 3, requires_grad=True)]
    kernels.append(kernels[0].detach().clone().requires_grad_())
    for kernel, rate in zip(kernels, (0.03, torch.tensor(0.03))):
        optimizer = Muon([kernel], 0.01)
        optimizer.param_groups[0]["lr"] = rate
        kernel.square().sum().backward()
        optimizer.step()
    torch.testing.assert_close(*kernels)


def test_a_state_from_a_gpu_is_loaded_on_the_processor():
    network = Network([2, 4, 3])
    optimizers = Optimizers(network, 3.0, (0.9, 0.98))
    network(torch.rand(2, 2, 6, 6)).sum().backward()
    optimizers.step(1e-3)
    state = optimizers.state_dict()
    for part in state.values():
        for group in part["param_groups"]:
            group["lr"] = torch.tensor(float(group["lr"]))
    state["0"]["param_groups"][0]["capturable"] = True
    again = Optimizers(network, 3.0, (0.9, 0.98))
    again.load_state_dict(state)
    again.step(1e-3)
    assert again.learning_rate == 1e-3
