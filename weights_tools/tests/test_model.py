"""Architectures, parameter names and sizes of the paper's networks."""

import pytest
import torch

from weights_tools.model import (
    Network,
    channels_of,
    constant_channels,
    growing_channels,
    network_from_state,
)


@pytest.mark.parametrize(("views", "layers", "parameters"), [(32, 33, 305_184), (10, 81, 695_122)])
def test_published_layouts_have_their_number_of_parameters(views, layers, parameters):
    network = Network(growing_channels(views, 32, layers))
    assert len(network.net.body) == layers
    assert network.convolution_parameters() == parameters


def test_channels_grow_by_two_until_there_are_enough():
    assert growing_channels(10, 32, 13) == [10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30, 32, 32, 32]
    assert growing_channels(32, 32, 3) == [32, 32, 32, 32]
    assert growing_channels(10, 32, 2) == [10, 12, 32]
    assert constant_channels(10, 32, 3, 48) == [10, 48, 48, 32]


def test_parameter_names_are_those_of_the_authors():
    names = set(Network([10, 12, 32]).state_dict())
    norm = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
    assert names == {
        f"net.body.{block}.body.{part}"
        for block in (0, 1)
        for part in ("0.weight", "0.bias", *(f"1.{name}" for name in norm))
    }


def test_initial_weights_are_xavier_normal_with_zero_biases():
    torch.manual_seed(0)
    convolution = Network([32, 32]).net.body[0].body[0]
    expected = (2.0 / (9 * 32 + 9 * 32)) ** 0.5
    assert convolution.weight.std().item() == pytest.approx(expected, rel=0.03)
    assert not convolution.bias.any()


def test_every_block_ends_in_a_relu_and_keeps_the_size():
    output = Network([3, 4, 5])(torch.randn(2, 3, 7, 11))
    assert output.shape == (2, 5, 7, 11)
    assert output.min() == 0.0


def test_a_leak_shows_what_the_last_relu_hides():
    torch.manual_seed(0)
    network, images = Network([3, 4, 5]).eval(), torch.randn(2, 3, 7, 11)
    plain, leaking = network(images), network.layers(images, 0.1)
    assert torch.equal(leaking.relu(), plain)
    assert torch.equal(leaking < 0.0, plain == 0.0)


def test_a_state_dict_tells_its_network():
    network = Network([3, 5, 4])
    assert channels_of(network.state_dict()) == [3, 5, 4]
    network_from_state(network.state_dict())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop("net.body.0.body.0.weight"), "no net.body.0.body.0.weight"),
        (lambda s: s.pop("net.body.1.body.1.running_var"), "running_var"),
        (lambda s: s.update({"net.body.1.body.0.weight": torch.ones(4, 6, 3, 3)}), "takes 6"),
        (
            lambda s: s.update({"net.body.0.body.0.weight": torch.ones(5, 3, 5, 5)}),
            "[out, in, 3, 3]",
        ),
        (lambda s: s.update({"net.body.1.body.0.bias": torch.full((4,), torch.nan)}), "not finite"),
        (lambda s: s.update({"more": torch.ones(1)}), "more"),
        (lambda s: s.clear(), "no parameter"),
    ],
)
def test_a_state_dict_of_another_network_is_refused(change, message):
    state = dict(Network([3, 5, 4]).state_dict())
    change(state)
    with pytest.raises(ValueError) as error:
        network_from_state(state)
    assert message in str(error.value)
