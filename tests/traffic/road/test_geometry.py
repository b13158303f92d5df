"""The road's curvature."""

import pytest

from marl_lanes.traffic.road.geometry import curvature_at
from marl_lanes.traffic.simulator import Simulator


def test_the_curvature_is_a_step_or_rises_and_falls_linearly():
    arcs = [
        {"start": 150.0, "end": 450.0, "radius": 500.0, "transition": 0.0},
        {"start": 550.0, "end": 850.0, "radius": -500.0, "transition": 100.0},
    ]
    found = Simulator("paper", overrides={"road": {"arcs": arcs}}, seed=0).parameters.arcs
    step = {149.99: 0.0, 150.0: 0.002, 449.99: 0.002, 450.0: 0.0}
    ramp = {549.0: 0.0, 550.0: 0.0, 575.0: -0.0005, 649.0: -0.00198, 650.0: -0.002, 750.0: -0.002}
    ramp |= {800.0: -0.001, 849.0: -0.00002, 850.0: 0.0, 999.0: 0.0}
    for place, curvature in (step | ramp).items():
        assert curvature_at(found, place) == pytest.approx(curvature, abs=1e-15), place
