"""What a recording shows: its labels, its scenarios and seeds, and what does not fit."""

import pytest
from cli.commands import QUICK

from marl_lanes import load_scenario
from marl_lanes.cli import tracks as module
from marl_lanes.cli.tracks import Track, make_tracks
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.file import make_trajectory, write_trajectory
from marl_lanes.trajectory.metadata import Metadata

DEFAULTS = {"scenario": None, "seed": None, "road": None, "maneuver": None, "last_time": None}


@pytest.fixture
def driven(tmp_path, monkeypatch):
    """A folder with files, and every road that would be driven: scenario, name, seed, road, end."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
    calls = []

    def drive(source, seed, road, last_time):
        calls.append((source.scenario, source.name, seed, road, last_time))
        return recording(source.scenario, source.name, seed, road)

    monkeypatch.setattr(module, "_drive", drive)
    return calls


def recording(scenario, name, seed, *roads):
    rows = new_rows(len(roads))
    rows["road"] = roads
    return make_trajectory(Metadata(scenario, seed, name), [rows])


def make(policies, followers=None, **options):
    return make_tracks(policies, followers, **{**DEFAULTS, **options})


def test_a_policy_is_driven_on_its_scenario(driven):
    (track,) = make(["tuned-cascade"], scenario="quick.yaml", seed=7, road=3, last_time=20.0)
    ((scenario, *rest),) = driven
    assert (scenario.name, *rest) == ("quick", "tuned-cascade", 7, 3, 20.0)
    assert (track.label, track.road) == ("tuned-cascade", 3)
    make(["random"])
    assert (driven[-1][0].name, *driven[-1][1:]) == ("paper", "random", 0, 0, None)


def test_every_policy_meets_every_kind_of_follower(driven):
    found = make(["random@dense", "tuned-cascade"], ["neutral", "adversarial"])
    assert [track.label for track in found] == [
        "random@dense, neutral followers",
        "random@dense, adversarial followers",
        "tuned-cascade, neutral followers",
        "tuned-cascade, adversarial followers",
    ]
    assert [call[0].name for call in driven] == ["dense", "dense", "paper", "paper"]
    assert [dict(call[0].followers.mix) for call in driven[:2]] == [
        {"neutral": 1.0},
        {"adversarial": 1.0},
    ]


def test_one_policy_among_several_followers_is_not_named(driven):
    found = make(["tuned-cascade"], ["neutral", "cooperative"])
    assert [track.label for track in found] == ["neutral followers", "cooperative followers"]
    assert len(driven) == 2


def test_a_recorded_road_is_read(driven, tmp_path):
    scenario = make(["random"])[0].trajectory.scenario
    driven.clear()
    write_trajectory(tmp_path / "rows.parquet", recording(scenario, "mine", 5, 2, 4))
    (track,) = make(["rows.parquet"])
    assert (track.label, track.road) == ("mine", 2)
    assert make(["rows.parquet"], road=4)[0].rows["road"].tolist() == [4]
    assert driven == []
    found = make(["rows.parquet", "random"], seed=5)
    assert [track.label for track in found] == ["rows", "random"]
    with pytest.raises(ValueError, match=r"road = 3: must be one of \[2, 4\]"):
        make(["rows.parquet"], road=3)


@pytest.mark.usefixtures("driven")
def test_a_trajectory_without_rows_is_refused(tmp_path):
    scenario = make(["random"])[0].trajectory.scenario
    write_trajectory(tmp_path / "rows.parquet", recording(scenario, "mine", 5))
    with pytest.raises(ValueError, match=r"rows\.parquet: has no rows"):
        make(["rows.parquet"])


@pytest.mark.parametrize(
    ("policies", "options", "message"),
    [
        (["random", "none.pt"], {}, "checkpoint none.pt: cannot be read"),
        (["random"], {"scenario": "nope"}, "scenario 'nope': no such scenario"),
        (["random"], {"followers": ["nope"]}, "nope"),
        (["random"], {"followers": ["neutral", "neutral"]}, "must be given once"),
        (["random"], {"maneuver": 10}, "--maneuver 10: must be 0 to 9"),
        (["random", "random"], {}, "POLICY random: must be given once"),
        (["@dense"], {}, "POLICY @dense: must be CHANGER or CHANGER@SCENARIO"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_driven(driven, policies, options, message):
    with pytest.raises(ValueError, match=message):
        make(policies, **options)
    assert driven == []


def test_a_label_is_a_part_of_a_files_name():
    track = Track("runs/a@dense, learned:b followers", recording, 0)
    assert track.file_label == "runs_a@dense_learned_b_followers"


@pytest.mark.usefixtures("driven")
def test_files_of_two_policies_never_have_one_name(tmp_path):
    names = ["x/a.parquet", "a.parquet", "x_a.parquet"]
    (tmp_path / "x").mkdir()
    for name in names:
        write_trajectory(tmp_path / name, recording(load_scenario("paper"), "random", 0, 0))
    with pytest.raises(ValueError, match=r"^x_a: its files would have the names of those of x/a$"):
        make(names)
    assert len(make(names[:2])) == 2
