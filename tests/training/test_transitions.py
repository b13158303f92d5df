"""From batches of slots to the rows of acting agents."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector

from marl_lanes import LaneChangeEnv
from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.training.transitions import LivePolicy, finished_maneuvers, live_transitions

torch.set_num_threads(1)

FEATURES = ["speed", "acceleration", "lateral_deviation", "yaw", "yaw_rate", "curvature", "phase"]
ROAD = 400.0
PHASE = FEATURES.index("phase")
BUSY = {
    "num_agents": None,
    "horizon": None,
    "departures": {"interval": [1.5, 3.0]},
    "command": {"probability": 1.0},
    "num_slots": 4,
    "observation": {"features": FEATURES},
    "gap": {"rule": "kinematic", "minimum_gap": 0.5, "time_gap": 0.1},
    "road": {"length": ROAD},
}
FAILURES = {Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD}

collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)


def steer(observation):
    """Slow feedback toward the reference lane: the guard has the time to turn agents back."""
    speed, _, deviation, yaw, yaw_rate, curvature, _ = observation.unbind(-1)
    wanted = (0.3 * deviation).clamp(-0.8, 0.8) / speed.clamp(min=1.0)
    action = 2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed)
    return action.clamp(-0.5, 0.5).unsqueeze(-1)


def steer_roughly(observation):
    """The same at most speeds, full to one side at the others."""
    return torch.where(observation[..., :1] % 5.0 < 0.7, 0.5, steer(observation))


@pytest.fixture(scope="module")
def batch():
    """Two busy roads: waiting, engaged, aborting and absent slots, and every kind of end."""
    env = LaneChangeEnv("adversarial", 2, overrides=BUSY, seed=3)
    keys = [("changers", "observation")], [("changers", "action")]
    return env.rollout(1200, TensorDictModule(steer_roughly, *keys), break_when_any_done=False)


def loop(batch):
    """Plain reference: (env, time, slot) of every row to keep, in order."""
    phases = batch["changers", "observation"][..., PHASE]
    # The slot of an agent that just ended still has its last observation.
    shape, phases = phases.shape, (phases * batch["changers", "mask"]).tolist()
    return [
        (e, t, a)
        for e in range(shape[0])
        for t in range(shape[1])
        for a in range(shape[2])
        if phases[e][t][a] in {Phase.ENGAGED, Phase.ABORTING}
    ]


def test_the_rows_of_steering_agents_are_kept_and_no_others(batch):
    rows = live_transitions(batch)
    kept = loop(batch)
    index = tuple(torch.tensor(kept).T)
    assert rows.batch_size == (len(kept),)
    assert set(rows.keys(True, True)) == {
        "observation",
        "action",
        "is_aborting",
        *(("next", key) for key in ("observation", "reward", "done", "terminated", "truncated")),
    }
    now, after = batch["changers"], batch["next", "changers"]
    assert torch.equal(rows["observation"], now["observation"][index])
    assert torch.equal(rows["action"], now["action"][index])
    for key in ("observation", "reward", "truncated"):
        assert torch.equal(rows["next", key], after[key][index]), key
    phases = now["observation"][..., PHASE]
    assert torch.equal(rows["is_aborting"], phases[index] == Phase.ABORTING)
    # Something was dropped: waiting agents, and empty slots.
    phases = now["observation"][..., PHASE]
    for phase in Phase:
        assert (phases == phase).any(), phase
    assert len(kept) < int(now["mask"].sum()) < now["mask"].numel()


@pytest.mark.parametrize("num_steps", [2, 5, 1000])
def test_a_row_looks_ahead_to_the_end_of_its_attempt_or_of_the_batch(batch, num_steps):
    gamma = 0.9
    rows = live_transitions(batch, num_steps=num_steps, gamma=gamma)
    ones = live_transitions(batch)
    where = {place: row for row, place in enumerate(loop(batch))}
    lengths = set()
    for row, (env, time, slot) in enumerate(loop(batch)):
        reward, last = 0.0, row
        for step in range(num_steps):
            last = where[env, time + step, slot]
            reward += gamma**step * ones["next", "reward"][last].item()
            is_last = time + step == batch.shape[1] - 1
            if is_last or ones["next", "done"][last]:
                break
        lengths.add(step + 1)
        assert rows["steps_to_next_obs"][row].item() == step + 1
        assert rows["next", "reward"][row].item() == pytest.approx(reward, rel=1e-5)
        for key in ("observation", "done", "terminated", "truncated"):
            assert torch.equal(rows["next", key][row], ones["next", key][last]), key
        assert torch.equal(rows["observation"][row], ones["observation"][row])
    assert lengths >= set(range(1, min(num_steps, 20) + 1))


def returned_to_waiting(rows):
    before, after = rows["observation"][:, PHASE], rows["next", "observation"][:, PHASE]
    return (before == Phase.ABORTING) & (after == Phase.WAITING)


def test_ends_are_the_agents_own_and_those_of_its_attempts(batch):
    rows = live_transitions(batch)
    returned, rows = returned_to_waiting(rows), rows["next"]
    kept = loop(batch)
    outcome = batch["next", "changers", "outcome"][tuple(torch.tensor(kept).T)]
    for end in (Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD, Outcome.MISSED):
        assert (outcome == end).any(), end
    assert returned.sum() >= 3
    terminated = torch.tensor([value.item() in FAILURES for value in outcome]) | returned
    assert torch.equal(rows["terminated"].squeeze(-1), terminated)
    assert torch.equal(rows["truncated"].squeeze(-1), outcome == Outcome.MISSED)
    done = (outcome != Outcome.UNFINISHED) | returned
    assert torch.equal(rows["done"].squeeze(-1), done)


def test_being_turned_back_bootstraps(batch):
    rows = live_transitions(batch)
    before, after = rows["observation"][:, PHASE], rows["next", "observation"][:, PHASE]
    turned = (before == Phase.ENGAGED) & (after == Phase.ABORTING)
    assert turned.sum() >= 3
    for key in ("done", "terminated", "truncated"):
        assert not rows["next", key][turned].any()


@pytest.mark.slow
@pytest.mark.parametrize("group", ["changers", "followers"])
def test_what_a_value_looks_into_is_a_state_in_which_the_agent_acts(group):
    """Equal observations have one world ahead of them: the attempt at hand, and no other."""
    env = LaneChangeEnv("adversarial", 2, overrides=BUSY, seed=3, learned_followers=True)
    keys = [("changers", "observation")], [("changers", "action")]
    follow = [("followers", "observation")], [("followers", "action")]
    drive = TensorDictModule(lambda seen: seen[..., :1] * 0.0 + 1.0, *follow)
    policy = TensorDictSequential(TensorDictModule(steer_roughly, *keys), drive)
    batch = env.rollout(1200, policy, break_when_any_done=False)
    now, after = batch[group], batch["next", group]
    acting = now["acting"]
    index = acting.nonzero()
    rows = live_transitions(batch, group)
    looks = ~(rows["next", "terminated"] | rows["next", "truncated"]).squeeze(-1)
    # The same agent acts in the step after, and there it sees what the value looks into.
    env_index, time, slot = index[looks].T
    inner = time < batch.shape[1] - 1
    later = env_index[inner], time[inner] + 1, slot[inner]
    assert acting[later].all()
    assert torch.equal(now["observation"][later], rows["next", "observation"][looks][inner])
    assert inner.sum() > 1000
    # And none that goes on is cut off.
    goes_on = after["acting"][acting] & ~after["done"].squeeze(-1)[acting]
    assert torch.equal(goes_on, looks)


def test_where_waiting_agents_act_their_rows_are_kept():
    """With a longitudinal action the rows are all those of live agents."""
    overrides = BUSY | {"action": {"longitudinal": {}}}
    env = LaneChangeEnv("adversarial", 2, overrides=overrides, seed=3)
    steps = env.rollout(300, break_when_any_done=False)
    rows = live_transitions(steps)
    mask = steps["changers", "mask"]
    assert torch.equal(rows["observation"], steps["changers", "observation"][mask])
    assert torch.equal(rows["next", "reward"], steps["next", "changers", "reward"][mask])
    assert rows["action"].shape == (int(mask.sum()), 2)
    assert (rows["observation"][:, PHASE] == Phase.WAITING).any()


def two_groups(acting, after, done):
    """A batch of one road and slot: time steps in which its follower does or does not act."""
    size = [1, len(acting), 1]
    flags = {key: torch.tensor(done).reshape(*size, 1) for key in ("done", "terminated")}

    def group(mask, **leaves):
        observation = torch.arange(float(len(acting))).reshape(*size, 1)
        mask = torch.tensor(mask).reshape(size)
        return TensorDict({"observation": observation, "acting": mask, **leaves}, size)

    following = group(
        after,
        reward=torch.ones(*size, 1),
        command_reward=torch.full((*size, 1), 7.0),
        truncated=torch.zeros(*size, 1, dtype=torch.bool),
        **flags,
    )
    outcome = torch.full(size, int(Outcome.MISSED))
    changers = TensorDict({"outcome": outcome}, size)
    now = {"followers": group(acting, action=torch.zeros(*size, 1))}
    next_ = TensorDict({"followers": following, "changers": changers}, size[:2])
    return TensorDict({**now, "next": next_}, size[:2])


def test_a_followers_rows_end_with_its_pairing():
    acting = [False, True, True, False, True, True]
    after = [True, True, False, True, True, False]
    batch = two_groups(acting, after, done=[False] * 5 + [True])
    rows = live_transitions(batch, "followers")
    assert rows["observation"].flatten().tolist() == [1.0, 2.0, 4.0, 5.0]
    for key in ("done", "terminated"):
        assert rows["next", key].flatten().tolist() == [False, True, False, True], key
        assert rows["next", key].shape == (4, 1)
    assert not rows["next", "truncated"].any()
    returns, outcomes = finished_maneuvers(batch, "followers")
    assert (returns.tolist(), outcomes.tolist()) == ([7.0], [Outcome.MISSED])
    assert not batch["next", "followers", "terminated"][0, 2].any(), "the batch is as it was"


def test_any_leading_shape_will_do(batch):
    whole = live_transitions(batch)
    flat = live_transitions(batch.reshape(-1))
    assert (whole == flat).all()
    parts = torch.cat([live_transitions(part) for part in (batch[:1], batch[1:])])
    assert (whole == parts).all()
    assert len(live_transitions(batch[:, :0])) == 0


def test_finished_maneuvers_are_every_end_with_its_return(batch):
    returns, outcomes = finished_maneuvers(batch)
    expected = []
    after = batch["next", "changers"]
    running = {}
    for e, t in torch.cartesian_prod(*(torch.arange(n) for n in batch.shape)).tolist():
        for a in range(after.shape[-1]):
            key = (e, a)
            running[key] = running.get(key, 0.0) + after["reward"][e, t, a].item()
            if after["outcome"][e, t, a] != Outcome.UNFINISHED:
                expected.append((running.pop(key), after["outcome"][e, t, a].item()))
    assert len(expected) > 20
    assert outcomes.tolist() == [outcome for _, outcome in expected]
    assert returns.tolist() == pytest.approx([value for value, _ in expected], abs=1e-3)


class Spy(nn.Module):
    """Counts the rows that it is given."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def forward(self, observation):
        assert observation.ndim == 2
        self.calls.append(len(observation))
        return observation[:, :1] * 0.01 + 0.1


def test_the_policy_is_evaluated_for_acting_agents_alone(batch):
    spy = Spy()
    steps = batch.exclude(("changers", "action"), "next")
    out = LivePolicy(spy, 1)(steps.clone())
    acting = batch["changers", "acting"]
    action = out["changers", "action"]
    assert spy.calls == [int(acting.sum())]
    assert action.shape == (*acting.shape, 1)
    assert (action[~acting] == 0.0).all()
    speed = batch["changers", "observation"][..., :1]
    assert torch.equal(action[acting], (speed * 0.01 + 0.1)[acting])
    assert not action.requires_grad


def test_where_all_slots_are_evaluated_the_others_get_zeros(batch):
    """As on a GPU."""
    policy = LivePolicy(Spy(), 1)
    observation, acting = (batch["changers", key] for key in ("observation", "acting"))
    found = policy._act_at_all(observation, acting)
    assert torch.equal(found, policy._act_at_live(observation, acting))
    assert policy.policy.calls == [acting.numel(), int(acting.sum())]


def test_the_policy_with_no_one_to_act():
    spy = Spy()
    group = TensorDict(
        {"observation": torch.ones(3, 2, 4), "acting": torch.zeros(3, 2, dtype=torch.bool)}, [3, 2]
    )
    out = LivePolicy(spy, 1)(TensorDict({"changers": group}, [3]))
    assert spy.calls == [0]
    assert torch.equal(out["changers", "action"], torch.zeros(3, 2, 1))


def test_no_gradient_flows_into_the_policy(batch):
    layer = nn.Linear(len(FEATURES), 1)
    out = LivePolicy(layer, 1)(batch[:, :200].clone())
    assert not out["changers", "action"].requires_grad
    assert out["changers", "action"].any()


@collector_warnings
def test_the_policy_drives_a_collector():
    spy = Spy()
    env = LaneChangeEnv("paper", 3, overrides=BUSY, seed=1)
    collector = Collector(
        env,
        LivePolicy(spy, 1),
        frames_per_batch=3 * 40,
        total_frames=3 * 120,
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )
    batches = [data.clone() for data in collector]
    collector.shutdown()
    assert [data.shape for data in batches] == [(3, 40)] * 3
    total = sum(int(data["changers", "acting"].sum()) for data in batches)
    assert sum(spy.calls) == total > 0
    whole = torch.cat(batches, 1)
    acting = whole["changers", "acting"]
    assert (whole["changers", "action"][~acting] == 0.0).all()
    assert (whole["changers", "action"][acting] != 0.0).all()
