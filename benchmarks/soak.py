"""Does the simulation hold? All shipped scenarios, random actions, invariants, memory.

python benchmarks/soak.py [--vehicle-steps N] [--roads N] [--threads N] [--seed N] [--json FILE]

Each scenario runs twice side by side: with its own followers, and with followers that take random
actions. Commands and horizon are without limit; now and then a road is reset. Every NUM_STEPS steps
the invariants are checked on all roads. Ctrl-C ends it with the result so far. The exit code is 1
if an invariant was violated, 130 after Ctrl-C.
"""

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from marl_lanes import Simulator, list_scenarios
from marl_lanes.files import write_json
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

NUM_STEPS = 50
"""Between two checks."""

ENDLESS = {"num_agents": None, "horizon": None}
COUNTED = ("num_entered", "num_left", "num_off_road", "num_collided", "num_commands")
STEERED = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")
"""Features of the steering; every shipped scenario observes them."""


class Course:
    """Roads of a scenario that are driven and checked.

    Args:
        scenario: a shipped name.
        num_roads: roads.
        num_threads: as for ``Simulator``.
        seed: of the roads, the actions and the resets.
        learned_followers: whether followers take random actions.
    """

    def __init__(
        self,
        scenario: str,
        num_roads: int,
        num_threads: int | None,
        seed: int,
        *,
        learned_followers: bool,
    ) -> None:
        self.name = f"{scenario}, random followers" if learned_followers else scenario
        self.simulator = Simulator(
            scenario,
            num_roads,
            seed=seed,
            num_threads=num_threads,
            overrides=ENDLESS,
            learned_followers=learned_followers,
        )
        self.simulator.reset()
        self.num_vehicle_steps = 0
        self.violations: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self._generator = np.random.default_rng(seed)
        features = self.simulator.scenario.observation.features
        self._columns = [features.index(name) for name in STEERED]

    def drive(self) -> None:
        """NUM_STEPS steps, the check, and a reset of a few roads."""
        simulator, random = self.simulator, self._generator
        low, high = CHANGER.action_bounds(simulator.scenario)
        behind_low, behind_high = FOLLOWER.action_bounds(simulator.scenario)
        for _ in range(NUM_STEPS):
            actions = random.uniform(low, high, simulator.actions.shape)
            # On every other road the changes are also completed.
            actions[::2, :, 0] = 0.2 * actions[::2, :, 0] + self._steering()[::2]
            behind = None
            if simulator.learned_followers:
                shape = simulator.follower_actions.shape
                behind = random.uniform(behind_low, behind_high, shape)
            simulator.step(actions, behind)
            self.num_vehicle_steps += int(simulator.roads["num_vehicles"].sum())
        self.violations.update(find_violations(simulator))
        mask = random.random(simulator.num_envs) < 0.002
        if mask.any():
            self._count(mask)
            simulator.reset(mask)

    def finish(self) -> dict[str, Any]:
        """What happened on all roads."""
        self._count(np.ones(self.simulator.num_envs, np.bool_))
        return {
            "vehicle_steps": self.num_vehicle_steps,
            **self.counts,
            "violations": dict(self.violations),
        }

    def _count(self, mask: NDArray[np.bool_]) -> None:
        for name in COUNTED:
            self.counts[name] += int(self.simulator.roads[name][mask].sum())

    def _steering(self) -> NDArray[np.float64]:
        """Yaw accelerations toward the reference lane, (E, A) [rad/s^2]."""
        seen = self.simulator.state.observations[..., self._columns].astype(np.float64)
        speed, deviation, yaw, yaw_rate, curvature = np.moveaxis(seen, -1, 0)
        wanted = np.clip(0.5 * deviation, -2.0, 2.0) / np.maximum(speed, 1.0)
        return np.asarray(2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed))


def find_violations(simulator: Simulator) -> Counter[str]:
    """How often each invariant is violated in the present state, over all roads."""
    state, roads, scenario = simulator.state, simulator.roads, simulator.scenario
    present = simulator.vehicles["id"] >= 0
    cars = simulator.vehicles[present]
    count = roads["num_vehicles"]
    found: Counter[str] = Counter()
    for table in (cars, state.agents, state.followers):
        for name, (kind, *_) in (table.dtype.fields or {}).items():
            # The command position is inf once the command is decided.
            if kind.base == np.float64 and name != "command_position":
                found["not finite"] += int((~np.isfinite(table[name])).sum())
    found["negative speed"] = int((cars["speed"] < 0.0).sum())
    gone = roads["num_left"] + roads["num_collided"]
    found["vehicles not conserved"] = int((roads["num_entered"] != count + gone).sum())
    found["vehicles not conserved"] += int((present.sum(axis=1) != count).sum())
    ordered = np.take_along_axis(simulator.vehicles, state.order.astype(np.int64), axis=1)
    is_counted = np.arange(ordered.shape[1]) < count[:, None]
    found["order"] = int((ordered["id"][is_counted] < 0).sum())
    is_pair = is_counted[:, 1:]
    found["order"] += int((np.diff(ordered["position"])[is_pair] > 0.0).sum())
    found["commands"] = int((simulator.is_live.sum(axis=1) != roads["num_live"]).sum())
    for role in (CHANGER, FOLLOWER):
        low, high = role.observation_bounds(scenario)
        seen = getattr(state, role.observations)[simulator.is_live]
        # NaN is outside, too.
        found["observation outside its space"] += int((~((low <= seen) & (seen <= high))).sum())
    return found


@dataclass
class Memory:
    """Resident memory over the vehicle-steps."""

    samples: list[tuple[int, int]] = field(default_factory=list)
    """Vehicle-steps, and bytes."""

    def sample(self, num_vehicle_steps: int) -> float:
        """Note the present memory and return it [MiB]."""
        used = psutil.Process().memory_info().rss
        self.samples.append((num_vehicle_steps, used))
        return float(used / 2**20)

    @property
    def slope(self) -> float:
        """Bytes for each million vehicle-steps in the second half, where all is loaded."""
        late = np.asarray(self.samples[len(self.samples) // 2 :], np.float64)
        if len(late) < 2:
            return 0.0
        return float(np.polyfit(late[:, 0] / 1e6, late[:, 1], 1)[0])


def soak(courses: list[Course], num_vehicle_steps: int, memory: Memory) -> bool:
    """Drive all courses in turn until they have so many vehicle-steps, or Ctrl-C.

    Returns:
        Whether they have them.
    """
    start, done, shown = time.perf_counter(), 0, -np.inf
    try:
        while done < num_vehicle_steps:
            for course in courses:
                course.drive()
            done = sum(course.num_vehicle_steps for course in courses)
            used, now = memory.sample(done), time.perf_counter()
            if now - shown >= 10.0 or done >= num_vehicle_steps:
                shown = now
                bad = sum(course.violations.total() for course in courses)
                print(
                    f"{done / 1e6:,.1f} of {num_vehicle_steps / 1e6:,.1f} million vehicle-steps, "
                    f"{done / 1e6 / (now - start):.2f} million/s, {used:.0f} MiB, "
                    f"{bad} violations",
                    file=sys.stderr,
                )
    except KeyboardInterrupt:
        return False
    return True


def main(arguments: list[str] | None = None) -> int:
    """Soak, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--vehicle-steps", type=float, default=1e9, help="of all scenarios (default: 1e9)"
    )
    parser.add_argument("--roads", type=int, default=64, help="of each scenario (default: 64)")
    parser.add_argument("--threads", type=int, help="(default: as for Simulator)")
    parser.add_argument("--seed", type=int, default=0, help="(default: 0)")
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    options = parser.parse_args(arguments)
    courses = [
        Course(name, options.roads, options.threads, options.seed, learned_followers=is_learned)
        for name in list_scenarios()
        for is_learned in (False, True)
    ]
    memory = Memory()
    is_whole = soak(courses, int(options.vehicle_steps), memory)
    rows = {course.name: course.finish() for course in courses}
    print(
        f"{'scenario':>30} {'vehicle-steps':>14} {'commands':>10} {'collided':>9} {'off road':>9}"
    )
    for name, row in rows.items():
        print(
            f"{name:>30} {row['vehicle_steps']:14,} {row['num_commands']:10,} "
            f"{row['num_collided']:9,} {row['num_off_road']:9,}"
        )
    violations = sum((course.violations for course in courses), Counter())
    total = sum(row["vehicle_steps"] for row in rows.values())
    print(f"{total:,} vehicle-steps; violations: {dict(violations) or 'none'}")
    if memory.samples:
        first, last = (memory.samples[index][1] / 2**20 for index in (0, -1))
        print(
            f"memory: {first:.0f} MiB at first, {last:.0f} MiB at last, {memory.slope:,.0f} bytes "
            "for each million vehicle-steps in the second half"
        )
    if not is_whole:
        print("ended by Ctrl-C")
    if options.json is not None:
        write_json(
            options.json,
            {
                "is_whole": is_whole,
                "vehicle_steps": total,
                "violations": dict(violations),
                "scenarios": rows,
                "memory": memory.samples[:: max(1, len(memory.samples) // 100)],
                "memory_slope": memory.slope,
            },
        )
    if violations:
        return 1
    return 0 if is_whole else 130


if __name__ == "__main__":
    sys.exit(main())
