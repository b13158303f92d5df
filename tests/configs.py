"""The configuration of a training of NAF from a command line."""

from functools import reduce

from marl_lanes.recipes import FOLDER
from marl_lanes.training.algorithms.naf import TrainingConfig
from marl_lanes.training.command_line import compose_fields
from marl_lanes.training.config import read_config


def resolve(*overrides):
    """What hydra makes of a command line."""
    return compose_fields(TrainingConfig, FOLDER, overrides)


def typed(*overrides):
    """The checked configuration of a command line."""
    return read_config(TrainingConfig, resolve(*overrides))


def select(given, name):
    """The value of a dotted name."""
    return reduce(lambda section, key: section[key], name.split("."), given)
