"""What commands share: modules of the user, outputs that cannot be written."""

import json
import re
import sys
from pathlib import Path

import pytest
from cli.commands import CROSSPLAY, FOLLOWERS

from marl_lanes.cli import arguments
from marl_lanes.cli.arguments import check_outputs, check_trajectories, import_modules
from marl_lanes.cli.main import main


def test_a_module_of_ones_own_registers_followers(capsys, folder):
    text = (
        "import numpy as np\n"
        "from marl_lanes import register_follower\n"
        "register_follower('brakes', lambda seen: np.full(len(seen), -3.0))\n"
    )
    (folder / "my_followers.py").write_text(text, encoding="utf-8")
    command = [*CROSSPLAY, "damped-prior", "--followers", "neutral", "brakes"]
    command += ["--scenario", "quick.yaml", "--json", "table.json"]
    before = list(sys.path)
    try:
        assert main(command) == 2
        assert "brakes" in capsys.readouterr().err
        assert main([*command, "--import", "my_followers"]) == 0
    finally:
        sys.modules.pop("my_followers", None)
    assert sys.path == before
    pairs = json.loads((folder / "table.json").read_text(encoding="utf-8"))["pairs"]
    braking = [pair["statistics"]["mean_max_follower_braking_all"]["value"] for pair in pairs]
    assert braking[1] > 2.5
    assert braking[1] != braking[0]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent", "--import absent: No module named 'absent'"),
        ("../x", "--import ../x: must be the dotted name of a module"),
    ],
)
def test_another_module_is_refused(name, message):
    before = list(sys.path)
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        import_modules(["json", name])
    assert str(caught.value) == message
    assert sys.path == before


def test_outputs_that_cannot_be_written_are_refused(tmp_path):
    check_outputs(None)
    check_outputs(tmp_path / "new" / "x.json", [tmp_path / "new" / "x.png", tmp_path / "x.svg"])
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match=r"^--json .*: must be a file, not a folder$"):
        check_outputs(tmp_path)
    for figure in (tmp_path, tmp_path / "x.xyz"):
        with pytest.raises(ValueError, match="must be a file that ends in"):
            check_outputs(None, [tmp_path / "x.png", figure])


def test_a_figure_needs_matplotlib(capsys, folder, monkeypatch):
    monkeypatch.setattr(arguments, "find_spec", lambda _: None)
    assert main([*FOLLOWERS, "--figure", str(folder / "x.png")]) == 2
    assert "pip install 'marl-lanes[train]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rows.csv", "--trajectories rows.csv: must end in .parquet"),
        ("deep.parquet", "--trajectories deep.parquet: must be a file, not a folder"),
    ],
)
def test_a_file_of_trajectories_that_cannot_be_written(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep.parquet").mkdir()
    with pytest.raises(ValueError, match=re.escape(message)):
        check_trajectories(Path(name))
    check_trajectories(Path("new.parquet"))
    check_trajectories(None)
