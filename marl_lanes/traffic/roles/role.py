"""A role: one definition of the observation, action and reward of its agents.

Spaces, specs, infos, networks, the checks of checkpoints, tables and traces follow from it. The
kernels for observations and rewards are made from its rows.
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
"""A kernel's source: it is compiled, so it may use only numbers, records and other kernels."""

Bounds = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Lowest and highest values, two (n,) float32."""


class Column(NamedTuple):
    """A column of the observation."""

    name: str
    unit: str
    offset: float
    """Typical centre, for networks."""
    scale: float
    """Typical spread, for networks."""
    low: float
    """Bounds of the space; a value beyond them is observed as the bound."""
    high: float
    meaning: str


class Feature(NamedTuple):
    """A column that a scenario may name, with its formula; the first fields are those of Column."""

    name: str
    unit: str
    offset: float
    scale: float
    low: float
    high: float
    meaning: str
    formula: Formula
    """Its value; the module of the role names the arguments."""

    @property
    def column(self) -> Column:
        """What it is without the formula."""
        return Column(*self[:-1])


class Term(NamedTuple):
    """A term of the reward."""

    name: str
    weight: str
    """The field of the scenario's reward section that holds its weight."""
    unit: str
    """Unit of the weight; the term itself has none."""
    meaning: str
    formula: Formula
    """Its weighted value; the module of the role names the arguments after the weight."""
    is_steering_cost: bool = False
    """Whether it is a cost of steering: part of the return, Eq. 13; the optimum must include it."""


class Dimension(NamedTuple):
    """A dimension of the action."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Role:
    """A kind of agent that can learn.

    Args:
        name: agents are called name_0, name_1, ... in PettingZoo.
        group: of the agents in TorchRL.
        table: name of the state's table with their rewards.
        record: fields of that table.
        observations: name of the state's array of their observations.
        features: all features that they can observe.
        terms: all terms of their reward, in the order of summation.
        see: names of the features that they observe in a scenario, in order.
        beside: further columns of an observation, behind the features; a kernel sets them at once.
        stack: how many observations they see there, the newest and those of the steps before.
        act: the dimensions of their action in a scenario.
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
    beside: Callable[[Scenario], Sequence[Column]]
    stack: Callable[[Scenario], int]
    act: Callable[[Scenario], tuple[Dimension, ...]]
    reward: Callable[[Scenario], Section]

    def __reduce__(self) -> tuple[Callable[[str], "Role"], tuple[str]]:
        """A copy is the role itself: formulas cannot be pickled."""
        return role_named, (self.name,)

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The dtype of a record of the table."""
        return structure(self.record, num_terms=len(self.terms))

    @property
    def reward_names(self) -> tuple[str, ...]:
        """Names of the terms outside the simulation, in their order."""
        return tuple(f"reward_{term.name}" for term in self.terms)

    def codes(self, scenario: Scenario) -> NDArray[np.int32]:
        """Row numbers of the features of one observation, int32."""
        rows = {feature.name: row for row, feature in enumerate(self.features)}
        return np.asarray([rows[name] for name in self.see(scenario)], np.int32)

    def seen(self, scenario: Scenario) -> list[Column]:
        """The columns of the observation, in order; ``speed@2`` is the speed two steps ago."""
        now = [self.features[code].column for code in self.codes(scenario)]
        now += self.beside(scenario)
        before = [
            column._replace(name=f"{column.name}@{steps}")
            for steps in range(1, self.stack(scenario))
            for column in now
        ]
        return now + before

    def observation_bounds(self, scenario: Scenario) -> Bounds:
        """Lowest and highest observations, (F,)."""
        return _bounds(self.seen(scenario))

    def action_bounds(self, scenario: Scenario) -> Bounds:
        """Lowest and highest actions, (D,)."""
        return _bounds(self.act(scenario))

    def weights(self, scenario: Scenario) -> list[float]:
        """Weights of the terms, in their order."""
        section = self.reward(scenario)
        return [getattr(section, term.weight) for term in self.terms]

    def terms_of(self, records: Records) -> dict[str, NDArray[np.float64]]:
        """The terms of the last step by ``reward_names``, each with the shape of ``records``."""
        columns = np.moveaxis(records["terms"], -1, 0)
        return dict(zip(self.reward_names, columns, strict=True))


def role_named(name: str) -> Role:
    """The role with this name, from the module of the same name."""
    role: Role = getattr(import_module(f"{__package__}.{name}"), name.upper())
    return role


def _bounds(rows: Sequence[Column] | Sequence[Dimension]) -> Bounds:
    low = np.asarray([row.low for row in rows], np.float32)
    return low, np.asarray([row.high for row in rows], np.float32)


def make_observer(features: Sequence[Feature]) -> Callable[..., None]:
    """The kernel ``observe(codes, seen, *what)``: sets ``seen[i]`` to the feature ``codes[i]``."""
    value_of = _chosen([_bounded(feature) for feature in features])

    @internal
    def observe(codes: Any, seen: Any, *what: Any) -> None:
        for column in range(codes.shape[0]):
            seen[column] = value_of(codes[column], *what)

    return observe


def _bounded(feature: Feature) -> Formula:
    """The kernel of the feature's value, clipped to its bounds."""
    formula, low, high = internal(feature.formula), feature.low, feature.high

    @internal
    def value(*what: Any) -> float:
        return min(max(float(formula(*what)), low), high)

    return value


def _chosen(formulas: Sequence[Formula], first: int = 0) -> Formula:
    """The kernel ``value_of(code, *what)``: a chain, as kernels cannot select a function."""
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
    """The kernel ``pay(record, weights, *what)``: sets all terms, their sum, its sum over time."""
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
    """The kernel ``write(values, weights, *what)``: a chain, like that of the features."""
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
