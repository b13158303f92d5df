"""Scenarios drawn from the schema: each number at a limit of its field, or between the limits."""

import math

from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.scenario.agent import FeatureName

SCHEMA = Scenario.model_json_schema()
LEFT_OUT = {"name", "description", "checkpoint", "lanes", "arcs", "features", "profiles", "mix"}
"""Not numbers, or entries of lists and maps, which are drawn below."""


def resolve(node):
    while "$ref" in node:
        node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def numbers(node=SCHEMA, path=""):
    """Path, lower and upper limit of every number of the schema; None for a missing limit."""
    node = resolve(node)
    if node.get("type") in ("number", "integer"):
        yield path, node.get("minimum", node.get("exclusiveMinimum")), node.get("maximum")
    for other in node.get("anyOf", []):
        yield from numbers(other, path)
    for name, field in node.get("properties", {}).items():
        yield from numbers(field, f"{path}.{name}".strip("."))
    if isinstance(node.get("additionalProperties"), dict):
        yield from numbers(node["additionalProperties"], f"{path}.*")
    entries = node.get("prefixItems", [node["items"]] if "items" in node else [])
    for entry in entries:
        yield from numbers(entry, f"{path}[]")


def draw(node, generator, corner, default=None):
    """A value of a schema's node.

    Args:
        node: of the schema.
        generator: a numpy Generator.
        corner: 0 for the least number, 1 for the greatest; None for the default of most fields, and
            for the others the least, the greatest, or any between.
        default: value of the node; None if it has none.
    """
    node = resolve(node)
    if "properties" in node:
        known = default if isinstance(default, dict) else {}
        return {
            name: draw(field, generator, corner, known.get(name))
            for name, field in node["properties"].items()
            if name not in LEFT_OUT
        }
    if corner is None and default is not None and generator.random() < 0.7:
        return default
    if "anyOf" in node:
        # A speed may be text, too: the same number with its unit.
        kinds = [kind for kind in node["anyOf"] if "pattern" not in kind]
        chosen = kinds[0 if corner is not None else generator.integers(len(kinds))]
        return draw(chosen, generator, corner, default)
    if "enum" in node:
        return node["enum"][generator.integers(len(node["enum"]))]
    if "prefixItems" in node:
        return sorted(draw(entry, generator, corner) for entry in node["prefixItems"])
    if node["type"] == "null":
        return None
    if node["type"] == "boolean":
        return bool(generator.integers(2))
    low, high = node.get("minimum", node.get("exclusiveMinimum")), node["maximum"]
    place = generator.choice([0.0, 1.0, generator.random()]) if corner is None else corner
    value = low + place * (high - low)
    if low > 0.0 and 0.0 < place < 1.0:
        value = low * (high / low) ** place
    return math.floor(value) if node["type"] == "integer" else float(min(max(value, low), high))


def draw_fields(generator, corner=None):
    """All fields of a scenario, fitted to each other by the rules between fields."""
    default = load_scenario("dense").model_dump(mode="json")
    fields = draw(SCHEMA, generator, corner, default)
    usual = default["drivers"]["profiles"]["normal"]
    profile = SCHEMA["$defs"]["DriverProfile"]
    names = "abc"[: 1 + generator.integers(3)]
    fields["drivers"]["profiles"] = {n: draw(profile, generator, corner, usual) for n in names}
    fields["drivers"]["mix"] = dict.fromkeys(names, 1.0)
    kinds = ("cooperative", "neutral", "adversarial", "learned")
    fields["followers"]["mix"] = {kind: float(generator.integers(1, 4)) for kind in kinds}
    fields["observation"]["features"] = list(FeatureName.__args__)
    if fields["observation"]["grid"] is not None:
        fields["observation"]["grid"]["num_lanes"] |= 1  # odd
    road, vehicle = fields["road"], fields["vehicle"]
    for body in (vehicle, *fields["drivers"]["profiles"].values()):
        if body["width"] is not None:
            body["width"] = min(body["width"], 0.9 * road["lane_width"])
    rule = fields["completion"]
    rule["max_deviation"] = min(rule["max_deviation"], 0.45 * road["lane_width"])
    position = fields["command"]["position"]
    fields["command"]["position"] = [min(x, 0.9 * road["length"]) for x in position]
    gap, keeping = fields["gap"], fields["lane_keeping"]
    gap["braking_margin"] = min(gap["braking_margin"], 0.9 * gap["safe_braking"])
    keeping["pole"] = min(keeping["pole"], 0.5 / fields["time_step"])
    keeping["max_yaw_acceleration"] = max(keeping["max_yaw_acceleration"], 0.14 * keeping["pole"])
    for section, name in ((fields, "horizon"), (fields["command"], "time_limit")):
        if section[name] is not None:
            section[name] = max(section[name], fields["time_step"])
    if generator.integers(2):
        # Sharper than a tenth of them can be: refused where lane keeping would leave its lane.
        radius = max(50.0, 2.0 * road["num_lanes"] * road["lane_width"])
        bend = {"radius": radius * generator.choice([1.0, -1.0, 3.0]), "transition": 10.0}
        road["arcs"] = [{"start": 10.0, "end": 90.0, **bend}]
    return fields


def draw_scenario(generator, corner=None, **overrides):
    """A scenario that is not refused."""
    while True:
        fields = {"name": "drawn", **draw_fields(generator, corner), **overrides}
        try:
            return load_scenario(fields)
        except ScenarioError as error:
            assert "lane keeping must stay" in str(error)  # noqa: PT017
