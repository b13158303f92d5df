"""The base of all structures of mu: the columns that a formula reads, and the slope of the cost."""

import pytest
import torch

from marl_lanes.naf.structure import Mu

FEATURES = ["yaw", "speed", "curvature", "time"]


class Ratio(Mu):
    needs = ("curvature", "speed")

    def forward(self, observation, normalised):  # noqa: ARG002
        curvature, speed = self.read(observation)
        return curvature / speed


def test_a_formula_reads_its_columns_in_the_order_of_its_needs():
    observation = torch.randn(5, 3, 4)
    mu = Ratio("ratio", FEATURES)
    assert mu.columns == [2, 1]
    assert torch.equal(mu(observation, None), observation[..., 2:3] / observation[..., 1:2])


def test_a_column_that_is_needed_and_missing_is_named():
    message = "mu 'ratio' needs the feature 'curvature', got yaw, speed"
    with pytest.raises(ValueError, match=message):
        Ratio("ratio", ["yaw", "speed"])
    assert Mu("plain", []).columns == []
    assert Mu("plain", []).inside_box


def test_the_slope_is_the_sign_of_the_action():
    observation = torch.tensor([[0.0, 2.0, 3.0, 0.0], [0.0, 2.0, -3.0, 0.0], [0.0, 2.0, 0.0, 0.0]])
    action, slope = Ratio("ratio", FEATURES).act(observation, observation)
    assert action.tolist() == [[1.5], [-1.5], [0.0]]
    assert slope.tolist() == [[1.0], [-1.0], [0.0]]
