"""Files for the commands that compare."""

import pytest
import torch
from cli.commands import QUICK

from marl_lanes import load_scenario
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import make_network, save_checkpoint

torch.set_num_threads(1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two runs' changers, a follower's checkpoint and two quick scenarios."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.yaml").write_text(QUICK, encoding="utf-8")
    weak = "{action: {max_yaw_acceleration: 0.25}, " + QUICK[1:]
    (tmp_path / "weak.yaml").write_text(weak, encoding="utf-8")
    (tmp_path / "text.pt").write_text("hello\n", encoding="utf-8")
    torch.manual_seed(0)
    network = make_network(load_scenario("paper"), "damped")
    for name in ("runs/a/checkpoints/final.pt", "runs/a/checkpoints/step_7.pt", "b.pt"):
        save_checkpoint(tmp_path / name, network, "paper", 0)
    save_checkpoint(tmp_path / "weak.pt", make_network(load_scenario("weak.yaml"), "mlp"), "w", 0)
    driver = make_network(load_scenario("quick.yaml"), "mlp", role=FOLLOWER)
    for name in ("runs/rude/checkpoints/final.pt", "runs/kind/checkpoints/final.pt"):
        save_checkpoint(tmp_path / name, driver, "quick", 0)
    return tmp_path
