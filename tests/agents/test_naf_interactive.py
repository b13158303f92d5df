"""The training program with two actions: the best saved model, and what the report is of."""

import json
import re

import numpy as np
import pytest
from naf_program import TINY, UNRECORDED, assert_same_weights, run_program, weights
from omegaconf import OmegaConf
from programs import BUSY

from marl_lanes import load_scenario
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.training.checkpoint import load_checkpoint

pytestmark = pytest.mark.training

INTERACTIVE = """
action: {longitudinal: {}}
followers: {mix: {adversarial: 1.0}}
observation:
  features: [speed, acceleration, lateral_deviation, yaw, yaw_rate, curvature,
             car_following_acceleration, target_follower_gap, phase]
"""


def test_interactive_is_learned(tmp_path):
    """Two actions; the best saved model, of which the report is, and the run goes on from it."""
    (tmp_path / "two.yaml").write_text(BUSY + INTERACTIVE, encoding="utf-8")
    options = ("scenario=two.yaml", "evaluation.criterion=success_rate", UNRECORDED, "output=run")
    code, out, err = run_program(*TINY, *options, folder=tmp_path)
    assert code == 0, err[-3000:]
    assert {path.name for path in tmp_path.iterdir()} == {"two.yaml", "run"}
    run = tmp_path / "run"
    assert OmegaConf.load(run / "config.yaml").recipe == "interactive"
    choice = json.loads((run / "choice.json").read_text(encoding="utf-8"))
    values = choice["success_rate"]
    assert list(values) == sorted(path.name for path in (run / "checkpoints").glob("step_*.pt"))
    assert values[choice["chosen"]] == max(values.values())
    assert_same_weights(weights(run), weights(run, choice["chosen"]))
    result = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    assert re.search(
        rf"mean_episode_reward +{re.escape(format(result['mean_episode_reward'], '.5g'))}\n", out
    )
    scenario = load_scenario(tmp_path / "two.yaml")
    final = load_checkpoint(run / "checkpoints" / "final.pt", scenario)
    maneuvers = run_maneuvers(scenario, greedy_policy(final.network), 3, seed=1_000_000)
    rewards = [one.episode_reward for one in maneuvers]
    assert result["mean_episode_reward"] == pytest.approx(np.mean(rewards), rel=1e-9)
