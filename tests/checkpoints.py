"""Networks to be saved, and files that are no checkpoints."""

import pickle
from pathlib import Path

import pytest
import torch

from marl_lanes import load_scenario
from marl_lanes.naf.checkpoint import FORMAT, CheckpointError
from marl_lanes.training.checkpoint import make_network, save_checkpoint

PAPER = load_scenario("paper")
LONGITUDINAL = load_scenario(
    "paper",
    {
        "action": {"longitudinal": {"max_acceleration": 1.5, "max_braking": 2.5}},
        "observation": {
            "features": [*PAPER.observation.features, "car_following_acceleration"],
        },
    },
)

OTHER_FILES = [
    b"",
    b"hello\n",
    b"broken",
    b"\x80\x02",
    b"PK\x03\x04 not a zip",
    bytes(range(256)),
    b"\x89PNG\r\n\x1a\n" * 20,
    pickle.dumps([1, 2, 3], protocol=2),
]


class Attack:
    """A pickle that makes a file when it is read carelessly."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return Path.touch, (self.target,)


def trained(mu="paper", scenario=PAPER):
    """A network whose weights are not the initial ones."""
    torch.manual_seed(3)
    network = make_network(scenario, mu, [8, 4])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return network


def save_trained(path):
    """Write a checkpoint of such a network; returns its path."""
    save_checkpoint(path, trained(), "paper", 1234)
    return path


def assert_runs_no_code(read, folder, save):
    """Assert that a file with code in it is refused, and the code not run."""
    target, file = folder / "made", folder / "evil.pt"
    content = {"format": FORMAT, "config": Attack(target)}
    if save == "pickle":
        file.write_bytes(pickle.dumps(content, protocol=2))
    else:
        torch.save(content, file)
    with pytest.raises(CheckpointError, match=r"evil\.pt"):
        read(file)
    assert not target.exists()
    # Read with trust, it would have been made.
    if save == "pickle":
        pickle.loads(file.read_bytes())  # noqa: S301
    else:
        torch.load(file, weights_only=False)
    assert target.exists()
