"""What holds on every road after every step, whatever the scenario and the actions."""

import numpy as np
from staging import assert_conserved, present

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

ROUNDING = 1e-9
ALLOWED_PHASES = {
    (Phase.WAITING, Phase.WAITING),
    (Phase.WAITING, Phase.ENGAGED),
    (Phase.ENGAGED, Phase.ENGAGED),
    (Phase.ENGAGED, Phase.ABORTING),
    (Phase.ABORTING, Phase.ABORTING),
    (Phase.ABORTING, Phase.WAITING),
}
MAX_TURN = 0.5
"""[rad] Bodies turned further are not compared for having passed through each other."""


class Watch:
    """The invariants of a simulator's roads: call ``check`` after every step.

    Args:
        simulator: reset.
    """

    def __init__(self, simulator):
        self.simulator = simulator
        self.before = simulator.vehicles.copy()
        self.commands = [{} for _ in range(simulator.num_envs)]
        """Of each road: phase, sum of rewards and outcome of each command so far."""

    def check(self):
        """Assert every invariant, and keep the state for the next step."""
        assert_conserved(self.simulator)
        self._check_motion()
        self._check_passing()
        self._check_observations()
        self._check_rewards()
        self._check_commands()
        self.before = self.simulator.vehicles.copy()

    def _check_motion(self):
        simulator = self.simulator
        cars, limits = simulator.vehicles[present(simulator)], simulator.scenario.vehicle
        for name, (kind, *_) in cars.dtype.fields.items():
            if kind == "f8" and name != "command_position":
                assert np.isfinite(cars[name]).all(), name
        assert (cars["speed"] >= 0.0).all()
        assert (cars["acceleration"] >= -limits.max_braking - ROUNDING).all()
        fastest = cars["speed"] / limits.min_turning_radius
        # A vehicle that has just entered turns with the road.
        is_new = cars["position"] == 0.0
        assert (is_new | (abs(cars["yaw_rate"]) <= fastest + ROUNDING)).all()

    def _check_passing(self):
        """Nobody is in another one's place, or has driven through it."""
        simulator = self.simulator
        scenario = simulator.scenario
        sizes = np.array([scenario.body_of(name) for name in scenario.drivers.profiles])
        for env in range(simulator.num_envs):
            cars, before = simulator.vehicles[env], self.before[env]
            stays = (cars["id"] >= 0) & (cars["id"] == before["id"]) & (abs(cars["yaw"]) < MAX_TURN)
            x0, y0 = _apart(before[stays])
            x1, y1 = _apart(cars[stays])
            own = sizes[cars["profile"][stays]]
            length, width = np.moveaxis(0.5 * (own[:, None] + own), -1, 0)
            is_there = (abs(x1) < 0.99 * length) & (abs(y1) < 0.99 * width)
            is_straight = cars["yaw"][stays] == 0.0
            is_there &= is_straight[:, None] & is_straight
            np.fill_diagonal(is_there, val=False)
            assert not is_there.any(), f"two bodies in one place on road {env}"
            is_swapped = x0 * x1 < 0.0
            share = np.divide(x0, x0 - x1, out=np.zeros_like(x0), where=is_swapped)
            beside = abs(y0 + share * (y1 - y0))
            is_through = is_swapped & (beside < 0.9 * np.minimum(length, width))
            assert not is_through.any(), f"two vehicles have changed places on road {env}"

    def _check_observations(self):
        simulator, state = self.simulator, self.simulator.state
        is_seen = simulator.is_live | simulator.has_ended
        for role in (CHANGER, FOLLOWER):
            low, high = role.observation_bounds(simulator.scenario)
            seen = getattr(state, role.observations)[is_seen]
            names = [feature.name for feature in role.seen(simulator.scenario)]
            bad = ~((low <= seen) & (seen <= high))
            assert not bad.any(), [
                (names[column], float(seen[row, column])) for row, column in np.argwhere(bad)[:3]
            ]
            assert not getattr(state, role.observations)[~is_seen].any()

    def _check_rewards(self):
        for table in (self.simulator.agents, self.simulator.state.followers):
            total = np.zeros(table.shape)
            for term in np.moveaxis(table["terms"], -1, 0):
                total += term
            assert (table["reward"] == total).all()

    def _check_commands(self):
        """Every command has one outcome, once, and its phases follow each other as they may."""
        simulator = self.simulator
        agents, has_ended = simulator.agents, simulator.has_ended
        for env, known in enumerate(self.commands):
            for slot in (simulator.is_live | has_ended)[env].nonzero()[0].tolist():
                row = agents[env, slot]
                phase, total, outcome = known.pop(
                    int(row["command"]), (Phase.WAITING, 0.0, Outcome.UNFINISHED)
                )
                assert outcome == Outcome.UNFINISHED, "a command ended twice"
                if not has_ended[env, slot]:
                    assert (phase, row["phase"]) in ALLOWED_PHASES
                    phase = Phase(int(row["phase"]))
                # The command itself is given after the rewards of a step.
                total += float(row["reward"])
                assert row["episode_reward"] == total
                known[int(row["command"])] = phase, total, Outcome(int(row["outcome"]))
            road = simulator.roads[env]
            outcomes = [outcome for _, _, outcome in known.values()]
            assert sorted(known) == list(range(int(road["num_commands"])))
            assert outcomes.count(Outcome.UNFINISHED) == road["num_live"]
            live = agents["phase"][env] != Phase.ABSENT
            assert np.count_nonzero(live) == road["num_live"]
            assert not (live & has_ended[env]).any()


def _apart(cars):
    """Distances along and across the road of each pair, (N, N) each."""
    x, y = cars["position"], cars["lateral_position"]
    return x[:, None] - x, y[:, None] - y
