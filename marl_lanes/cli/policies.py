"""The policy of a name, a checkpoint or a function of the user."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from marl_lanes.plugins import import_policy, names_function
from marl_lanes.zoo.index import PREFIX, find_entry

if TYPE_CHECKING:
    from marl_lanes.evaluation.benchmark import Training
    from marl_lanes.scenario import Scenario

UNTRAINED = (
    "tuned-cascade",
    "assertive-cascade",
    "anticipating-cascade",
    "quintic",
    "mpc",
    "cascade-prior",
    "damped-prior",
    "lane-keeping",
    "random",
)
"""Names of the policies without learning."""

TRAINED = f"a checkpoint, {PREFIX}NAME (marl-lanes zoo lists them), or MODULE:FUNCTION"
"""The other policies, for a command's help."""


def is_policy(name: str) -> bool:
    """Whether a name stands for a policy; a file that is there may still be no checkpoint."""
    is_named = name in UNTRAINED or name.startswith(PREFIX) or names_function(name)
    return is_named or Path(name).exists()


def make_policy(name: str, scenario: "Scenario", seed: int) -> Any:
    """The policy of this name; it must fit the scenario.

    Args:
        name: a name of UNTRAINED, the path of a checkpoint, zoo:NAME, or MODULE:FUNCTION, where no
            file has this name.
        scenario: the scenario that it drives on.
        seed: of the random policy's actions.

    Returns:
        A policy as ``run_maneuvers`` takes it.

    Raises:
        ValueError: the policy does not fit the scenario, or there is none of this name, or the
            file cannot be read or is no checkpoint.
    """
    from marl_lanes.evaluation import policies

    if name == "random":
        return policies.make_random_policy(scenario, seed)
    if name == "lane-keeping":
        return policies.make_lane_keeping_policy(scenario)
    if name == "tuned-cascade":
        return policies.make_tuned_cascade_policy(scenario)
    if name == "assertive-cascade":
        return policies.make_assertive_cascade_policy(scenario)
    if name == "anticipating-cascade":
        return policies.make_anticipating_cascade_policy(scenario)
    if name == "quintic":
        return policies.make_quintic_policy(scenario)
    if name == "mpc":
        return policies.make_mpc_policy(scenario)

    import torch

    from marl_lanes.naf.checkpoint import greedy_policy
    from marl_lanes.training.checkpoint import load_policy, make_network

    if name in UNTRAINED:
        torch.manual_seed(0)
        lateral = name.removesuffix("-prior")
        mu = lateral if scenario.action.longitudinal is None else f"{lateral}+idm"
        return greedy_policy(make_network(scenario, mu))
    if not is_policy(name):
        names = ", ".join(UNTRAINED)
        raise ValueError(
            f"checkpoint {name}: cannot be read: there is no such file; without learning: {names}; "
            f"trained: {PREFIX}NAME, of those that `marl-lanes zoo` lists"
        )
    if names_function(name) and not name.startswith(PREFIX) and not Path(name).exists():
        return import_policy(name, scenario)
    return greedy_policy(load_policy(Path(name), scenario).network)


def find_training(name: str) -> "Training | None":
    """What the policy of a name has learned from; None: nothing, or it is not known.

    Args:
        name: for which ``make_policy`` has made a policy.

    Raises:
        ValueError: a file of the checkpoint's finished run is damaged.
    """
    from marl_lanes.evaluation.benchmark import Training
    from marl_lanes.naf.checkpoint import read_content
    from marl_lanes.report.run_files import read_run
    from marl_lanes.training.run_folder import (
        CHECKPOINTS_FOLDER,
        EVALUATION_FILE,
        count_transitions,
    )

    if name in UNTRAINED:
        return None
    if name.startswith(PREFIX):
        return Training.model_validate(find_entry(name)["training"])
    path = Path(name)
    if not path.exists():
        return None
    content, run = read_content(path), path.resolve().parent.parent
    is_of_run = path.resolve().parent.name == CHECKPOINTS_FOLDER
    scenario, transitions = content["scenario"], content["transitions"]
    if not is_of_run or not (run / EVALUATION_FILE).is_file():
        return Training(scenario=scenario, transitions=transitions, seconds=None, command=None)
    files = read_run(run)
    transitions, demonstrations = count_transitions(run)
    return Training(
        scenario=scenario,
        transitions=transitions,
        demonstrations=demonstrations,
        seconds=files.seconds["seconds_training"],
        command=files.command,
    )
