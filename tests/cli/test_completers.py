"""What the shell offers for an argument."""

from pathlib import Path

import pytest

from marl_lanes import list_scenarios
from marl_lanes.cli import completers
from marl_lanes.cli.policies import UNTRAINED
from marl_lanes.zoo.index import read_index


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("rush.yaml").touch()
    Path("runs").mkdir()


def test_names_and_files_are_offered():
    zoo = [f"zoo:{name}" for name in read_index()]
    assert list(completers.scenarios("ru")) == [*list_scenarios(), "runs/", "rush.yaml"]
    assert list(completers.policies("runs")) == [*UNTRAINED, *zoo, "runs/"]
    assert list(completers.zoo("")) == zoo
    offered = list(completers.followers("neu"))
    assert {"neutral", "brake-checker", "learned:"} <= set(offered)
    assert [one for one in offered if "zoo" in one] == []
    after = [one for one in completers.followers("learned:ru") if one.startswith("learned:")]
    assert after == ["learned:", *(f"learned:{name}" for name in (*zoo, "runs/", "rush.yaml"))]


def test_fields_of_a_training_are_offered():
    offered = list(completers.overrides(""))
    assert {"recipe=fast", "collector=multi", "scenario=", "loss.gamma=", "--help"} <= set(offered)
    assert [one for one in offered if one.startswith(("defaults", "scenario=p"))] == []
    assert "scenario=paper" in list(completers.overrides("scenario=p"))


def test_files_are_offered_from_their_folder(monkeypatch, tmp_path):
    Path("runs/one").mkdir()
    Path("runs/one.pt").touch()
    Path("runs/.hidden").touch()
    assert list(completers.files("runs/")) == ["runs/one/", "runs/one.pt"]
    assert list(completers.files("runs/on")) == ["runs/one/", "runs/one.pt"]
    assert list(completers.files("runs/.h")) == ["runs/.hidden"]
    assert list(completers.files("absent/x")) == []
    assert list(completers.files("~nobody-of-this-name/x")) == []
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert list(completers.files("~/ru")) == ["~/runs/", "~/rush.yaml"]
    assert f"{tmp_path.as_posix()}/runs/" in list(completers.files(f"{tmp_path.as_posix()}/"))
