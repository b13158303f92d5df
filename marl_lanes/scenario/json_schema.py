"""The JSON Schema of a scenario's file: editors complete and check a file with it while one types.

It has keys, types and limits. What fields must satisfy together, only ``load_scenario`` checks.
"""

from pathlib import Path
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from marl_lanes.scenario.schema import Scenario

FILE = Path(__file__).with_name("scenario.schema.json")
"""As it ships."""


def make_json_schema() -> dict[str, Any]:
    """The schema of what ``load_scenario`` accepts as a file or a mapping."""
    schema = Scenario.model_json_schema()
    # What a file leaves out has the default: of its name that is the file's, of a reward the
    # objective's.
    for section in (schema, schema["$defs"]["FollowerReward"]):
        del section["required"]
    return {"$schema": GenerateJsonSchema.schema_dialect, **schema}
