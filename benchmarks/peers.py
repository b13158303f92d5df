"""Other simulators with the paper's traffic: 1000 m, three lanes, 0.1 s, no rendering.

Their packages come with the extra ``benchmark``.
"""

import importlib.util
import random
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from turns import Contestant, Rate

STEPS = 20
"""Steps of a turn between two readings of the clock."""


def is_installed(package: str) -> bool:
    """Whether ``package`` can be imported."""
    return importlib.util.find_spec(package) is not None


def open_highway_env(
    num_vehicles: int, render_mode: str | None = None, config: dict[str, Any] | None = None
) -> Any:
    """highway-v0 with ``num_vehicles`` (one of them acts), a continuous action, 10 Hz."""
    import gymnasium
    import highway_env  # noqa: F401 - registers its environments

    traffic = {
        "action": {"type": "ContinuousAction"},
        "lanes_count": 3,
        "vehicles_count": num_vehicles - 1,
        "simulation_frequency": 10,
        "policy_frequency": 10,
        "duration": 40,
    }
    return gymnasium.make(
        "highway-v0",
        config={**traffic, **(config or {})},
        render_mode=render_mode,
        disable_env_checker=True,
    )


def make_highway_env(num_vehicles: int) -> Contestant:
    """highway-v0 with actions of zero."""
    env = open_highway_env(num_vehicles)
    env.reset(seed=0)
    zero = np.zeros(2, np.float32)

    def advance() -> Rate:
        for _ in range(STEPS):
            _, _, terminated, truncated, _ = env.step(zero)
            if terminated or truncated:
                env.reset()
        return Rate(STEPS, STEPS * num_vehicles)

    return advance


_NET = """<net version="1.20">
  <location netOffset="0,0" convBoundary="0,0,1000,0" origBoundary="0,0,1000,0" projParameter="!"/>
  <edge id="road" from="a" to="b" priority="1">{lanes}</edge>
  <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-11.25"/>
  <junction id="b" type="dead_end" x="1000" y="0" incLanes="road_0 road_1 road_2" intLanes=""
            shape="1000,-11.25 1000,0"/>
</net>
"""
_LANE = """<lane id="road_{lane}" index="{lane}" speed="60" length="1000" width="3.75"
 shape="0,{y} 1000,{y}"/>"""
_LAST_DEPARTURE = 36_000.0
"""[s] Length of the written traffic; the simulation restarts before it ends."""


def _write_sumo(folder: Path) -> None:
    lanes = "".join(_LANE.format(lane=lane, y=-9.375 + 3.75 * lane) for lane in range(3))
    (folder / "road.net.xml").write_text(_NET.format(lanes=lanes), encoding="utf-8")
    draw = random.Random(0)  # noqa: S311 - traffic, not a secret
    departures = []
    for lane in range(3):
        time = draw.uniform(0.0, 10.0)
        while time < _LAST_DEPARTURE:
            departures.append((time, lane))
            time += draw.uniform(5.0, 10.0)
    rows = ["<routes>", '<route id="way" edges="road"/>']
    for number in range(64):
        speed = draw.uniform(80.0, 120.0) / 3.6
        rows.append(
            f'<vType id="driver{number}" carFollowModel="IDM" length="4.8" width="1.8" accel="2.0" '
            f'decel="1.5" tau="1.0" minGap="5.0" maxSpeed="{speed:.3f}" speedDev="0" '
            # Every vehicle keeps its lane, which is also the least work for SUMO.
            'lcSpeedGain="0" lcKeepRight="0" lcCooperative="0"/>'
        )
    for number, (time, lane) in enumerate(sorted(departures)):
        speed = draw.uniform(30.0, 50.0) / 3.6
        rows.append(
            f'<vehicle id="{number}" type="driver{draw.randrange(64)}" route="way" '
            f'depart="{time:.2f}" departLane="{lane}" departSpeed="{speed:.3f}"/>'
        )
    (folder / "traffic.rou.xml").write_text("\n".join([*rows, "</routes>"]), encoding="utf-8")


def make_sumo() -> tuple[Contestant, Contestant]:
    """Libsumo, bare and with four reads of every vehicle after each step.

    IDM, the paper's departures on every lane. Both share one simulation, because libsumo allows
    only one per process.
    """
    import libsumo

    folder = Path(tempfile.mkdtemp(prefix="marl_lanes_sumo_"))
    _write_sumo(folder)
    command = ["sumo", "-n", str(folder / "road.net.xml"), "-r", str(folder / "traffic.rou.xml")]
    command += ["--step-length", "0.1", "--no-step-log", "--no-warnings", "--seed", "0"]
    libsumo.start(command)
    vehicle = libsumo.vehicle

    def restart_late() -> None:
        if libsumo.simulation.getTime() > 0.9 * _LAST_DEPARTURE:
            libsumo.load(command[1:])
        while libsumo.simulation.getTime() < 90.0:
            libsumo.simulationStep()

    restart_late()

    def bare() -> Rate:
        restart_late()
        for _ in range(STEPS):
            libsumo.simulationStep()
        return Rate(STEPS, STEPS * vehicle.getIDCount())

    def reading() -> Rate:
        restart_late()
        count = 0
        for _ in range(STEPS):
            libsumo.simulationStep()
            for name in vehicle.getIDList():
                vehicle.getPosition(name)
                vehicle.getSpeed(name)
                vehicle.getAcceleration(name)
                vehicle.getLateralLanePosition(name)
                count += 1
        return Rate(STEPS, count)

    return bare, reading


def make_vmas(num_agents: int) -> Contestant:
    """VMAS road_traffic, one environment, ``num_agents`` agents, actions of zero."""
    import torch
    import vmas

    env = vmas.make_env("road_traffic", num_envs=1, device="cpu", seed=0, n_agents=num_agents)
    env.reset()
    zeros = [torch.zeros(1, env.get_agent_action_size(agent)) for agent in env.agents]

    def advance() -> Rate:
        _, _, done, _ = env.step(zeros)
        if done.any():
            env.reset()
        return Rate(1, num_agents)

    return advance
