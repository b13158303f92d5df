"""What a trajectory is of: scenario, seed, policy, version."""

import json
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.scenario.messages import shown

FORMAT = 2
"""Number of the file's form; another number means other columns or another meaning."""


_FIELDS = (
    ("seed", int, "a whole number"),
    ("policy", str, "a text"),
    ("version", str, "a text"),
    ("scenario", dict, "a mapping"),
)


class TrajectoryError(ValueError):
    """A file that is no trajectory, or that cannot be used; the message says why."""


@dataclass(frozen=True)
class Metadata:
    """What a trajectory is of.

    Args:
        scenario: in full, as it was driven.
        seed: of the traffic.
        policy: name or file of the lane changers' policy.
        version: of marl-lanes.
    """

    scenario: Scenario
    seed: int
    policy: str
    version: str = field(default_factory=lambda: version("marl-lanes"))

    def dumps(self) -> str:
        """As JSON."""
        return json.dumps(
            {
                "format": FORMAT,
                "version": self.version,
                "scenario": self.scenario.model_dump(mode="json"),
                "seed": self.seed,
                "policy": self.policy,
            }
        )

    @classmethod
    def loads(cls, text: str | bytes) -> "Metadata":
        """From JSON.

        Raises:
            TrajectoryError: it is not that of a trajectory of this form.
        """
        try:
            fields: Any = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise TrajectoryError(f"metadata: not readable as JSON: {error}") from None
        if not isinstance(fields, dict):
            raise TrajectoryError("metadata: must be a mapping")
        found = fields.get("format")
        if found != FORMAT:
            raise TrajectoryError(
                f"metadata: format = {shown(found)}: must be {FORMAT}; record it again with this "
                "version"
            )
        for name, kind, wanted in _FIELDS:
            value = fields.get(name)
            if not isinstance(value, kind) or isinstance(value, bool):
                raise TrajectoryError(f"metadata: {name} = {shown(value)}: must be {wanted}")
        try:
            scenario = load_scenario(fields["scenario"])
        except ScenarioError as error:
            raise TrajectoryError(f"metadata: {error}") from None
        return cls(scenario, fields["seed"], fields["policy"], fields["version"])
