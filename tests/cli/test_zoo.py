"""The command that lists and prints the policies of the zoo."""

import json

import pytest
import yaml
from cli.commands import assert_refused

from marl_lanes.cli.main import main
from marl_lanes.zoo.index import INDEX_FILE, read_index


@pytest.mark.usefixtures("small_zoo")
def test_every_policy_is_listed(capsys):
    assert main(["zoo"]) == 0
    _, *rows = (row.split() for row in capsys.readouterr().out.splitlines())
    measured = ["99.95", "1.027", "zoo:paper", "paper"]
    assert rows == [
        ["zoo:paper", "changer", *measured],
        ["zoo:adversary", "follower", *measured],
    ]


@pytest.mark.parametrize("name", ["paper", "zoo:paper"])
def test_all_that_is_known_of_one_is_printed(capsys, small_zoo, name):
    assert main(["zoo", name]) == 0
    index = json.loads((small_zoo / INDEX_FILE).read_text(encoding="utf-8"))
    assert yaml.safe_load(capsys.readouterr().out) == index["paper"]


def test_the_shipped_ones_are_printed(capsys):
    for name, entry in read_index().items():
        assert main(["zoo", name]) == 0
        assert yaml.safe_load(capsys.readouterr().out) == entry


@pytest.mark.usefixtures("small_zoo")
def test_another_name_is_refused(capsys, tmp_path):
    message = "zoo best: no such policy in the zoo; allowed: zoo:paper, zoo:adversary"
    assert_refused(capsys, tmp_path, ["zoo", "best"], message)
