"""Every field of a scenario broken in every way, derived from the schema."""

import json
import math
import re

from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.messages import shown

SCHEMA = Scenario.model_json_schema()

WHOLE = load_scenario(
    {
        "road": {"arcs": [{"start": 100.0, "end": 500.0, "radius": 500.0}]},
        "command": {"lanes": [1]},
        "action": {"longitudinal": {}},
    }
).model_dump(mode="json")
"""A scenario in which no list and no section is left out."""

NO_NUMBERS = ["many", "5", "", [], [1.0], {}, {"a": 1}, None, math.nan, math.inf, -math.inf, True]
HUGE = ["x" * 10_000, 10**400, list(range(500)), {f"k{k}": k for k in range(500)}]
WRONG = {
    "number": [*NO_NUMBERS, *HUGE],
    "integer": [*NO_NUMBERS, 2.5, 1e300, *HUGE],
    "boolean": ["soon", "", [], {}, None, 7, 0.5, *HUGE],
    "string": [5, 0.5, True, [], ["x"], {}, None, *HUGE],
    "array": ["x", "", 5, True, None, {}, {"a": 1}, [None], *HUGE],
    "object": ["x", "", 5, 0.5, True, None, [], [1], *HUGE],
}
"""By JSON type: values of other types, and absurd ones."""


def breakages():
    """Pairs of a field's path and a value that it must not have."""
    return [(path, value) for path, value in _broken(SCHEMA, WHOLE, ())]


def _broken(schema, whole, path):
    options = schema.get("anyOf", [schema])
    schema = options[0]
    if "$ref" in schema:
        schema = SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]]
    if path:
        for value in _wrong_values(schema):
            if value is not None or {"type": "null"} not in options:
                yield path, value
    if isinstance(whole, dict):
        named = schema.get("properties", {})
        others = [*schema.get("patternProperties", {}).values(), schema.get("additionalProperties")]
        for name, inner in whole.items():
            yield from _broken(named.get(name, others[0]), inner, (*path, name))
    elif isinstance(whole, list):
        for place, inner in enumerate(whole):
            items = schema["prefixItems"][place] if "prefixItems" in schema else schema["items"]
            yield from _broken(items, inner, (*path, str(place)))


def _wrong_values(schema):
    yield from WRONG[schema["type"]]
    if "minimum" in schema:
        yield schema["minimum"] - 1
    if "exclusiveMinimum" in schema:
        yield schema["exclusiveMinimum"]
    if "maximum" in schema:
        yield from (schema["maximum"] + 1, schema["maximum"] * 10**6)
    if "maxLength" in schema:
        yield "x" * (schema["maxLength"] + 1)
    if "enum" in schema:
        yield "nonsense"
    if "prefixItems" in schema:
        yield from ([1.0], [1.0, 2.0, 3.0], [2.0, 1.0])
    if "properties" in schema:
        yield {"nonsense": 1}


def fields_with(path, value):
    """Fields of a scenario with the value at the path, and no others that need not be there."""
    return _replaced(WHOLE, path, value)


def _replaced(whole, path, value):
    if not path:
        return value
    if isinstance(whole, list):
        place = int(path[0])
        inner = _replaced(whole[place], path[1:], value)
        # An entry of a list is replaced as a whole.
        full = whole[place] | inner if path[1:] else inner
        return [*whole[:place], full, *whole[place + 1 :]]
    return {path[0]: _replaced(whole[path[0]], path[1:], value)}


def as_yaml(fields):
    """The fields as YAML: JSON with other names for some numbers."""
    return json.dumps(fields).replace("NaN", ".nan").replace("Infinity", ".inf")


def faults_of(message, path, value):
    """What a message lacks: one short line that names field, value and what is allowed."""
    faults = []
    if "\n" in message or len(message) > 5000:
        faults.append("one short line")
    # Of a list the message may name the entry, or of a wrong entry the list.
    if ".".join(path[:-1] if path[-1].isdecimal() else path) not in message:
        faults.append("the field")
    if isinstance(value, list | dict) and value:
        value = next(iter(value))
    if shown(value).strip("'")[:10] not in message:
        faults.append("the value")
    if not re.search("must|allowed", message):
        faults.append("what is allowed")
    return faults
