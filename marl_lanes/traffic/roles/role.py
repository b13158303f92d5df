"""What a role is: what its agents see, do and are paid, in one definition.

Spaces, specs, infos, networks, the checks of checkpoints, tables and traces follow from it, and the
kernels that observe and pay are made of its rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.scenario.fields import Section
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import Records, Table, structure

Formula = Callable[..., float]
"""A kernel's source: it is compiled, so it uses numbers, records and other kernels alone."""

Bounds = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Lowest and highest values, two (n,) float32."""


class Feature(NamedTuple):
    """A column of the observation."""

    name: str
    unit: str
    offset: float
    """Typical centre, for networks."""
    scale: float
    """Typical spread, for networks."""
    low: float
    high: float
    meaning: str
    formula: Formula
    """Its value; the role says of what."""


class Term(NamedTuple):
    """A term of the reward."""

    name: str
    weight: str
    """The field of the scenario's reward section that it is multiplied by."""
    unit: str
    """Of the weight: the term itself has none."""
    meaning: str
    formula: Formula
    """Its value, weighted; the role says of what, after the weight."""
    is_steering_cost: bool = False
    """Whether it charges a changer's steering, as Eq. 13 sums it and the optimum minimises it."""


class Dimension(NamedTuple):
    """A dimension of the action."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Role:
    """What learns on the roads.

    Args:
        name: agents are called name_0, name_1, ... in PettingZoo.
        group: of the agents in TorchRL.
        table: of the state, which holds what they are paid.
        record: its fields.
        observations: the state's array of what they see.
        features: everything that they could see.
        terms: everything that they are paid, in the order in which it is summed.
        see: names of the features that they see on a scenario, in order.
        act: the dimensions of their action on a scenario.
        reward: the scenario's section with the weights of the terms.
    """

    name: str
    group: str
    table: str
    record: Table
    observations: str
    features: tuple[Feature, ...]
    terms: tuple[Term, ...]
    see: Callable[[Scenario], Sequence[str]]
    act: Callable[[Scenario], tuple[Dimension, ...]]
    reward: Callable[[Scenario], Section]

    def __reduce__(self) -> tuple[Callable[[str], "Role"], tuple[str]]:
        """A copy is the role itself: formulas cannot be pickled."""
        return role_named, (self.name,)

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Of a record of the table."""
        return structure(self.record, num_terms=len(self.terms))

    @property
    def reward_names(self) -> tuple[str, ...]:
        """What the terms are called outside the simulation, in their order."""
        return tuple(f"reward_{term.name}" for term in self.terms)

    def codes(self, scenario: Scenario) -> NDArray[np.int32]:
        """Rows of the features that are seen, (F,) int32."""
        rows = {feature.name: row for row, feature in enumerate(self.features)}
        return np.asarray([rows[name] for name in self.see(scenario)], np.int32)

    def seen(self, scenario: Scenario) -> list[Feature]:
        """The features that are seen, in order."""
        return [self.features[code] for code in self.codes(scenario)]

    def observation_bounds(self, scenario: Scenario) -> Bounds:
        """Lowest and highest observations, (F,)."""
        return _bounds(self.seen(scenario))

    def action_bounds(self, scenario: Scenario) -> Bounds:
        """Lowest and highest actions, (D,)."""
        return _bounds(self.act(scenario))

    def weights(self, scenario: Scenario) -> list[float]:
        """Of the terms, in their order."""
        section = self.reward(scenario)
        return [getattr(section, term.weight) for term in self.terms]

    def terms_of(self, records: Records) -> dict[str, NDArray[np.float64]]:
        """The terms of the last step by ``reward_names``, each of the shape of ``records``."""
        columns = np.moveaxis(records["terms"], -1, 0)
        return dict(zip(self.reward_names, columns, strict=True))


def role_named(name: str) -> Role:
    """The role that the module of its name defines."""
    role: Role = getattr(import_module(f"{__package__}.{name}"), name.upper())
    return role


def _bounds(rows: Sequence[Feature] | Sequence[Dimension]) -> Bounds:
    low = np.asarray([row.low for row in rows], np.float32)
    return low, np.asarray([row.high for row in rows], np.float32)


def make_observer(features: Sequence[Feature]) -> Callable[..., None]:
    """The kernel ``observe(codes, seen, *what)``: ``seen[i]`` is the feature ``codes[i]``."""
    value_of = _chosen([internal(feature.formula) for feature in features])

    @internal
    def observe(codes: Any, seen: Any, *what: Any) -> None:
        for column in range(codes.shape[0]):
            seen[column] = value_of(codes[column], *what)

    return observe


def _chosen(formulas: Sequence[Formula], first: int = 0) -> Formula:
    """The kernel ``value_of(code, *what)``; a chain, for kernels cannot look functions up."""
    formula = formulas[0]
    if len(formulas) == 1:

        @internal
        def last(_: int, *what: Any) -> float:
            return float(formula(*what))

        return last
    others = _chosen(formulas[1:], first + 1)

    @internal
    def value_of(code: int, *what: Any) -> float:
        if code == first:
            return float(formula(*what))
        return float(others(code, *what))

    return value_of


def make_payment(terms: Sequence[Term]) -> Callable[..., None]:
    """The kernel ``pay(record, weights, *what)``: every term, their sum, and its sum over time."""
    number = len(terms)
    write = _written([internal(term.formula) for term in terms])

    @internal
    def pay(record: Any, weights: Any, *what: Any) -> None:
        write(record.terms, weights, *what)
        total = record.terms[0]
        for index in range(1, number):
            total += record.terms[index]
        record.reward = total
        record.episode_reward += total

    return pay


def _written(formulas: Sequence[Formula], index: int = 0) -> Callable[..., None]:
    """The kernel ``write(values, weights, *what)``, a chain as that of the features."""
    formula = formulas[0]
    if len(formulas) == 1:

        @internal
        def write_last(values: Any, weights: Any, *what: Any) -> None:
            values[index] = formula(weights[index], *what)

        return write_last
    others = _written(formulas[1:], index + 1)

    @internal
    def write(values: Any, weights: Any, *what: Any) -> None:
        values[index] = formula(weights[index], *what)
        others(values, weights, *what)

    return write
