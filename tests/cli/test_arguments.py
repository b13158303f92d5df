"""What commands share: modules of the user."""

import json
import re
import sys

import pytest
from cli.commands import CROSSPLAY

from marl_lanes.cli.arguments import import_modules
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
        ("../x", "--import '../x': must be the dotted name of a module"),
    ],
)
def test_another_module_is_refused(name, message):
    before = list(sys.path)
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        import_modules(["json", name])
    assert str(caught.value) == message
    assert sys.path == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 / 0\n", "ZeroDivisionError: division by zero (%s, line 1)"),
        ("\nraise SystemExit('no')\n", "SystemExit: no (%s, line 2)"),
        ("import missing\n", "No module named 'missing'"),
    ],
)
def test_what_a_module_raises_is_told(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "raising.py"
    file.write_text(text, encoding="utf-8")
    wanted = f"--import raising: {message.replace('%s', str(file))}"
    with pytest.raises(ValueError, match=f"^{re.escape(wanted)}$"):
        import_modules(["raising"])
