"""Scores of the baseline estimates."""

import os
import shutil

import pytest

from weights_tools.baselines import baselines, carved_masks
from weights_tools.dataset import load_dataset
from weights_tools.errors import InputError
from weights_tools.metrics import relative_error
from weights_tools.sensor import Sensor

DEEPCT = os.environ.get("DEEPCT") or shutil.which("deepct")


@pytest.fixture
def data(dataset_folder):
    return load_dataset(dataset_folder, "cloudct-10")


@pytest.mark.skipif(DEEPCT is None, reason="deepct is not on the PATH")
def test_the_answers_that_take_no_learning(data):
    answers = baselines(data, 1, Sensor(), DEEPCT)
    assert answers["zero"] == (1.0, 1.0)
    truth, mean = data.validation.extinction, data.train.extinction.mean(0)
    by_hand = [float(relative_error(cloud, mean)) for cloud in truth]
    assert answers["mean training cloud"][0] == pytest.approx(sum(by_hand) / 3)
    masks = carved_masks(data, data.validation.radiance, DEEPCT)
    assert masks.shape == truth.shape and set(masks.unique().tolist()) <= {0.0, 1.0}
    best, right_mass = (name for name in answers if name.startswith("carved mask filled with"))
    constant = float(best.split()[4])
    for other in (0.5 * constant, 2.0 * constant):
        assert float(relative_error(truth, other * masks).mean()) > answers[best][0] - 0.02
    assert abs(answers[right_mass][1]) < 1e-6


def test_a_program_that_is_missing_is_named(data, tmp_path):
    with pytest.raises(InputError, match="nowhere: No such file"):
        carved_masks(data, data.validation.radiance, str(tmp_path / "nowhere"))
