import numpy as np

from marl_lanes import load_scenario
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.trajectory.columns import COLUMNS, ROW, new_rows, set_bodies


def test_names_are_unique_and_every_column_is_explained():
    assert len({column.name for column in COLUMNS}) == len(COLUMNS)
    assert all(column.unit and column.meaning for column in COLUMNS)
    assert [column.name for column in COLUMNS] == list(ROW.names)


def test_every_term_of_both_rewards_has_a_column():
    names = set(ROW.names)
    assert set(CHANGER.reward_names) <= names
    assert {f"follower_{name}" for name in FOLLOWER.reward_names} <= names


def test_names_stand_in_the_order_of_their_codes():
    scenario = load_scenario("paper", {"followers": {"mix": {"neutral": 0.5, "mine": 0.5}}})
    named = {column.name: column.names(scenario) for column in COLUMNS if column.names}
    assert named["phase"][Phase.ABORTING] == "aborting"
    assert named["disposition"] == ("cooperative", "neutral", "adversarial", "mine")
    assert named["profile"] == ("normal", "aggressive", "defensive", "truck")
    assert set(named) == {"profile", "disposition", "fate", "phase", "outcome"}


def test_new_rows_lack_the_optional_values_alone():
    rows = new_rows(3)
    for column in COLUMNS:
        values = rows[column.name]
        if not column.is_optional:
            assert (values == 0).all(), column.name
        elif column.kind.startswith("f"):
            assert np.isnan(values).all(), column.name
        else:
            assert (values == NONE).all(), column.name


def test_bodies_are_those_of_the_profiles():
    rows = new_rows(3)
    rows["profile"] = [3, 0, 3]
    set_bodies(rows, load_scenario("paper", {"vehicle": {"length": 5.0}}))
    assert rows["length"].tolist() == [16.5, 5.0, 16.5]
    assert rows["width"].tolist() == [2.55, 1.8, 2.55]
