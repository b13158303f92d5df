"""Networks to be saved, and files that are no checkpoints."""

import hashlib
import pickle
from pathlib import Path

import pytest
import torch

from marl_lanes import load_scenario
from marl_lanes.files import write_json
from marl_lanes.naf.checkpoint import FORMAT, CheckpointError
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import make_network, save_checkpoint
from marl_lanes.zoo.index import INDEX_FILE

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


def write_zoo(folder):
    """Write a zoo of the changer ``paper`` and the follower ``adversary``; returns its folder."""
    save_trained(folder / "paper.pt")
    torch.manual_seed(5)
    driver = make_network(PAPER, "mlp", [8], role=FOLLOWER)
    save_checkpoint(folder / "adversary.pt", driver, "paper", 5678)
    index = {}
    for name, role, transitions in (("paper", "changer", 1234), ("adversary", "follower", 5678)):
        success, ratio = ({"value": value, "low": None, "high": None} for value in (0.9995, 1.0271))
        training = {"scenario": "paper", "transitions": transitions, "seconds": 1.5}
        index[name] = {
            "description": f"The {role} of a test.",
            "role": role,
            "sha256": hashlib.sha256((folder / f"{name}.pt").read_bytes()).hexdigest(),
            "training": {**training, "command": "python agents/naf/train.py"},
            "rows": [
                {
                    "policy": "zoo:paper",
                    "task": "paper",
                    "num_maneuvers": 10_000,
                    "statistics": {"success_rate": success, "cost_ratio": ratio},
                }
            ],
        }
    write_json(folder / INDEX_FILE, index)
    return folder


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
