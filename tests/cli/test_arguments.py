"""What commands share: modules of the user."""

import json
import sys

from cli.commands import CROSSPLAY

from marl_lanes.cli.main import main


def test_a_module_of_ones_own_registers_followers(capsys, folder):
    text = (
        "import numpy as np\n"
        "from marl_lanes import register_follower\n"
        "register_follower('brakes-here', lambda seen: np.full(len(seen), -3.0))\n"
    )
    (folder / "my_followers.py").write_text(text, encoding="utf-8")
    command = [*CROSSPLAY, "damped-prior", "--followers", "neutral", "brakes-here"]
    command += ["--scenario", "quick.yaml", "--json", "table.json"]
    before = list(sys.path)
    try:
        assert main(command) == 2
        assert "brakes-here" in capsys.readouterr().err
        assert main([*command, "--import", "my_followers"]) == 0
    finally:
        sys.modules.pop("my_followers", None)
    assert sys.path == before
    pairs = json.loads((folder / "table.json").read_text(encoding="utf-8"))["pairs"]
    braking = [pair["statistics"]["mean_max_follower_braking_all"]["value"] for pair in pairs]
    assert braking[1] > 2.5
    assert braking[1] != braking[0]
