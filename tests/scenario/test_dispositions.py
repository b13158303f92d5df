"""The names of dispositions, as scenarios take them."""

from marl_lanes.scenario import load_scenario
from marl_lanes.scenario.dispositions import LEARNED, SCRIPTED


def test_a_scenario_knows_every_name_and_which_have_a_formula():
    mix = dict.fromkeys((*SCRIPTED, LEARNED), 1.0)
    followers = load_scenario("paper", {"followers": {"mix": mix}}).followers
    assert followers.external_names == (LEARNED,)
