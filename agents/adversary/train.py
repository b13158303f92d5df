"""Train a follower against a lane changer that does not learn; compare it with the scripted ones.

python agents/adversary/train.py changer=CHECKPOINT [scenario=NAME]
    [objective=adversarial|cooperative] [seed=N] [output=DIR] [resume=RUN]
    [--import MODULE] [any field of the config]
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field
from tqdm import tqdm

from marl_lanes.evaluation.crossplay import crossplay
from marl_lanes.evaluation.tables import format_crossplay
from marl_lanes.files import write_json
from marl_lanes.interplay import (
    MODEL,
    Grounds,
    InterplayConfig,
    Opponent,
    carry_out,
    follower_phase,
)
from marl_lanes.naf.checkpoint import PolicyNetwork, greedy_policy
from marl_lanes.scenario.dispositions import LEARNED, SCRIPTED
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.command_line import read_command_line, refusing
from marl_lanes.training.config import read_config
from marl_lanes.training.failures import ending

FOLDER = Path(__file__).parent


class AdversaryConfig(InterplayConfig):
    """Everything that defines a run."""

    objective: Literal["adversarial", "cooperative"] = Field(
        description="what the follower is paid for: adversarial or cooperative"
    )


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, evaluate, report."""
    with refusing():
        config = read(arguments)
        grounds, changer = prepare(config)
    with ending(grounds.output):
        phase = follower_phase(grounds, [Opponent(config.changer, changer, 1.0)], number=0)
        keep = grounds.keep_inputs
        if not carry_out(phase, grounds.output, is_begun=not grounds.is_new, keep_inputs=keep):
            print(f"interrupted; continue with resume={config.output}")
            return
        result = compare(config, grounds, changer)
        write_json(grounds.output / "evaluation.json", result)
    print(f"run folder: {config.output}\n\n{format_crossplay(result)}")


def read(arguments: Sequence[str] | None = None) -> AdversaryConfig:
    """The configuration of the command line and config.yaml."""
    fields = read_command_line(AdversaryConfig, FOLDER, str(__doc__), arguments)
    return read_config(AdversaryConfig, fields)


def prepare(config: AdversaryConfig) -> tuple[Grounds, PolicyNetwork]:
    """Scenarios and changer, checked; nothing is written."""
    grounds = Grounds(config, config.objective)
    return grounds, grounds.load_changer()


def compare(config: AdversaryConfig, grounds: Grounds, changer: PolicyNetwork) -> dict[str, Any]:
    """The changer among the learned followers, and among the scripted ones."""
    checkpoint = str(grounds.output / MODEL)
    followers: dict[str, dict[str, Any]] = {
        LEARNED: {"mix": {LEARNED: 1.0}, "learned": {"checkpoint": checkpoint}},
        **{name: {"mix": {name: 1.0}} for name in SCRIPTED},
    }
    number = config.follower.evaluation.final_num_maneuvers
    with tqdm(total=number * len(followers), unit="maneuver", desc="evaluating") as bar:
        result = crossplay(
            {"changer": (grounds.scenario, greedy_policy(changer))},
            followers,
            number,
            seed=config.follower.evaluation.seed,
            progress=lambda count: bar.update(count - bar.n),
        )
    checkpoints = {"changer": str(grounds.find_changer())}
    return {"objective": config.objective, "checkpoints": checkpoints, **result}


if __name__ == "__main__":
    main()
