"""The league: its pool, who meets whom, its ratings, an interruption, and what it refuses."""

import shutil
import signal

import pytest
import torch
from adversary_program import (
    FOLDER,
    INPUTS,
    PAPER,
    PHASE_FILES,
    SECTION,
    TINY,
    is_same,
    names,
    pairs,
    prepare,
    read_json,
    rows,
    weights,
)
from programs import load_program, replaced, run_main

from marl_lanes.envs.followers import load_follower
from marl_lanes.training.checkpoint import load_checkpoint
from marl_lanes.training.config import ConfigError
from marl_lanes.training.learner import Learner
from marl_lanes.training.opponents import prioritise

torch.set_num_threads(1)

SMALL = [
    *TINY,
    *(f"hardening.{option}" for option in SECTION),
    "generations=2",
    "followers=[adversarial]",
    "held_out=[late-yielder]",
    "+guests.other=actor.pt",
    "+guests.mpc=mpc",
    "continues=true",
    # Models that have learned so little differ in this alone.
    "hardening.evaluation.criterion=mean_max_follower_braking_all",
    "follower.evaluation.criterion=mean_max_follower_braking_all",
    "follower.evaluation.record=false",
    "hardening.evaluation.record=false",
]
LEARNED = ["follower_1", "changer_1", "follower_2", "changer_2"]
CHANGERS = ["changer_0", "changer_1", "changer_2"]
GUESTS = ["other", "mpc"]
FOLLOWERS = ["adversarial", "follower_1", "follower_2", "late-yielder"]
pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(FOLDER / "league.py")


@pytest.fixture(scope="module")
def league(program, tmp_path_factory):
    """Two generations, interrupted while the first changer learned, and resumed."""
    folder = prepare(tmp_path_factory.mktemp("league"))
    collect, phases = Learner.collect, []

    def interrupted(learner):
        if learner.run.path.name == "changer_1" and learner.transitions > 20:
            signal.raise_signal(signal.SIGINT)
        phases.append(learner.run.path.name)
        return collect(learner)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Learner, "collect", interrupted)
        out, _ = run_main(program, folder, *SMALL)
    assert "interrupted; continue with resume=run" in out
    assert set(phases) == {"follower_1", "changer_1"}
    # What a phase left that was killed at its beginning; the run goes on from its folder alone.
    (folder / "run" / "follower_2" / "checkpoints").mkdir(parents=True)
    (folder / "busy.yaml").unlink()
    (folder / "changer.pt").unlink()
    (folder / "actor.pt").unlink()
    stamp = (folder / "run" / "follower_1" / "resume.pt").stat().st_mtime_ns
    out, _ = run_main(program, folder, "resume=run")
    assert (folder / "run" / "follower_1" / "resume.pt").stat().st_mtime_ns == stamp
    return folder / "run", out


def test_the_run_folder_is_complete(league):
    run, _ = league
    reports = {f"{name}.{kind}" for name in ("ratings", "crossplay") for kind in ("svg", "png")}
    reports |= {"ratings.json", "ratings.csv", "crossplay.json", "matches.json", "pool"}
    assert names(run) == {*INPUTS, *LEARNED, *reports, "guest_other.pt"}
    assert names(run / "pool") == {f"{name}.pt" for name in LEARNED}
    for name in LEARNED:
        more = {"choice.json", "opponents.json"}
        assert names(run / name) == {*PHASE_FILES, *more} - {"trajectories"}
        final = run / name / "checkpoints" / "final.pt"
        assert final.read_bytes() == (run / "pool" / f"{name}.pt").read_bytes()
        load = load_follower if name.startswith("follower") else load_checkpoint
        load(final, PAPER)


def test_every_changer_has_met_every_follower(league):
    run, out = league
    everybody = {(c, f) for c in (*CHANGERS, *GUESTS) for f in FOLLOWERS}
    assert set(pairs(run / "crossplay.json")) == everybody
    for held in read_json(run / "matches.json"):
        assert sum(map(sum, held["roads"])) == 4
        won = sum(road[0] for road in held["roads"]) / 4
        assert held["pair"]["statistics"]["success_rate"]["value"] == won
    table = rows(run / "ratings.csv")
    assert [row["player"] for row in table] == [
        *CHANGERS,
        *GUESTS,
        "adversarial",
        "follower_1",
        *FOLLOWERS[2:],
    ]
    assert [row["generation"] for row in table] == ["0", "1", "2", "", "", "", "1", "2", ""]
    held_out = [row["player"] for row in table if row["is_held_out"] == "True"]
    assert held_out == [*GUESTS, "late-yielder"]
    assert sum(float(row["rating"]) for row in table) == pytest.approx(0.0, abs=1e-6)
    assert all(row["player"] in out for row in table)


def test_whom_the_learner_loses_to_it_meets_more_often(league):
    run, _ = league
    found = pairs(run / "crossplay.json")
    assert read_json(run / "follower_1" / "opponents.json") == {"changer_0": 1.0}
    missed = [found[name, "follower_1"]["missed_rate"]["value"] for name in CHANGERS[:2]]
    met = read_json(run / "follower_2" / "opponents.json")
    assert list(met) == CHANGERS[:2]
    assert list(met.values()) == prioritise(missed, 1.0).tolist()
    won = [found["changer_1", name]["success_rate"]["value"] for name in FOLLOWERS[:3]]
    met = read_json(run / "changer_2" / "opponents.json")
    assert list(met) == FOLLOWERS[:3]
    assert list(met.values()) == prioritise(won, 1.0).tolist()


def test_each_learns_and_the_changer_goes_on_from_the_one_before(league):
    run, _ = league
    saved = {name: sorted((run / name / "checkpoints").glob("step_*.pt")) for name in LEARNED}
    for name in LEARNED:
        assert not is_same(weights(saved[name][0]), weights(saved[name][-1]))
    assert is_same(weights(run / "initial_changer.pt"), weights(saved["changer_1"][0]))
    assert is_same(weights(run / "pool" / "changer_1.pt"), weights(saved["changer_2"][0]))
    assert not is_same(weights(saved["follower_1"][0]), weights(saved["follower_2"][0]))


@pytest.mark.parametrize("continues", [True, False])
def test_a_new_changer_goes_on_or_begins_untrained(program, tmp_path, monkeypatch, continues):
    monkeypatch.chdir(prepare(tmp_path))
    begun = []
    monkeypatch.setattr(program, "changer_phase", lambda *given, **_: begun.append(given[2]()))
    monkeypatch.setattr(program.League, "_train", lambda *_: False)
    monkeypatch.setattr(program.Matches, "shares", lambda *_: (0.5, 0.5, 0.0))
    league = program.League(program.read(replaced([*SMALL, f"continues={continues}"])))
    league._add_changer(1)
    (network,) = begun
    first = load_checkpoint(tmp_path / "changer.pt", PAPER).network
    assert network.config == first.config
    assert is_same(network.state_dict(), first.state_dict()) == continues


def test_an_interruption_changes_nothing(program, league, tmp_path):
    """The same again without one, in the generation that was interrupted."""
    run, _ = league
    run_main(program, prepare(tmp_path), *SMALL, "generations=1")
    again = tmp_path / "run"
    for name in LEARNED[:2]:
        one, other = (folder / "pool" / f"{name}.pt" for folder in (again, run))
        assert is_same(weights(one), weights(other))
        for table in ("metrics.csv", "maneuvers.csv", "evaluations.csv", "choice.json"):
            assert (again / name / table).read_bytes() == (run / name / table).read_bytes()


def test_the_ratings_of_two_leagues_are_drawn_together(league, tmp_path, capsys):
    run, _ = league
    program = load_program(FOLDER / "ratings.py")
    files = [str(run / "ratings.json"), str(run / "ratings.json")]
    program.main([*files, "--figure", str(tmp_path / "both.svg")])
    assert (tmp_path / "both.svg").read_text(encoding="utf-8").count("late-yielder") == 1
    (tmp_path / "other.json").write_text('{"ratings": []}', encoding="utf-8")
    for bad, reason in (("gone.json", "cannot be read"), ("other.json", "num_maneuvers")):
        with pytest.raises(SystemExit) as caught:
            program.main([str(tmp_path / bad), "--figure", str(tmp_path / "x.png")])
        assert caught.value.code == 2
        err = capsys.readouterr().err
        assert len(err.splitlines()) == 1
        assert bad in err
        assert reason in err
    assert names(tmp_path) == {"both.svg", "other.json"}


def test_damaged_matches_are_refused(program, league, tmp_path, monkeypatch):
    run, _ = league
    shutil.copytree(run, tmp_path / "run")
    (tmp_path / "run" / "matches.json").write_text('[{"pair": 3}]', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"^resume = 'run': its matches\.json is damaged: remove"):
        program.League(program.read(["resume=run"]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["generations=0"], "generations = 0: must be greater than or equal to 1"),
        (["continues=maybe"], "continues = 'maybe': must be"),
        (["exponent=-1"], "exponent = -1: must be greater than or equal to 0"),
        (["followers=[]"], r"followers = \[\]: must have"),
        (["followers=[nobody]"], "followers.mix: 'nobody' has no policy; allowed: cooperative"),
        (["held_out=[learned]"], "followers.mix: 'learned' has no policy"),
        (["held_out=[adversarial]"], "'adversarial' must be once in followers and held_out"),
        (["followers=[a b]"], "followers.*'a b'"),
        (["+guests.more=mpc@paper"], "num_agents of its scenario must be 4"),
        (["+guests.more=mpc@busy.yaml"], "guests.more = 'mpc@busy.yaml': @SCENARIO must be a ship"),
        (["+guests.more=gone.pt"], r"guests\.more = 'gone.pt': .*gone.pt: cannot be read"),
        (["+guests.changer_1=actor.pt"], "'changer_1' must not be the name of another player"),
        (["+guests.late-yielder=actor.pt"], "'late-yielder' must not be the name of another"),
        (["hardening.collector.num_envs=0"], "hardening.collector.num_envs = 0: must be"),
        (["changer=gone.pt"], "changer = 'gone.pt': .*gone.pt: cannot be read"),
        (["changer=actor.pt"], "changer = 'actor.pt': .*not a checkpoint of the form"),
    ],
)
def test_what_is_refused_leaves_nothing_behind(program, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(prepare(tmp_path))
    before = names(tmp_path)
    with pytest.raises(ValueError, match=message) as caught:
        program.League(program.read(replaced([*SMALL, *options])))
    assert len(str(caught.value).splitlines()) == 1
    assert names(tmp_path) == before
