"""Epsilon and delta compared with sums calculated by hand."""

import pytest
import torch

from weights_tools.metrics import mass_error, relative_error
from weights_tools.training import scores


def volumes(*values):
    return torch.tensor(values).reshape(len(values), 2, 1, 2)


def test_scores_by_hand():
    truth = volumes([1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 5.0, 0.0])
    estimate = volumes([1.0, 1.0, 5.0, 1.0], [1.0, 0.0, 5.0, 0.0])
    # |0| + |1| + |2| + |3| = 6 of 10; 1 of 5. (10 - 8) / 10; (5 - 6) / 5.
    assert relative_error(truth, estimate).tolist() == pytest.approx([0.6, 0.2])
    assert mass_error(truth, estimate).tolist() == pytest.approx([0.2, -0.2])
    assert scores(estimate, truth) == pytest.approx((0.4, 0.0))


def test_nothing_found_scores_one():
    truth = volumes([1.0, 2.0, 3.0, 4.0])
    assert scores(torch.zeros_like(truth), truth) == (1.0, 1.0)
