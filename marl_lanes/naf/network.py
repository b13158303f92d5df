"""The quadratic Q-function of normalized advantage functions."""

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn

from marl_lanes.naf.encoder import make_encoder
from marl_lanes.naf.layers import ActionBox, Heads
from marl_lanes.naf.mu import make_mu

# Bounds of L in M = -L L^T: the logarithm of its diagonal, and an off-diagonal entry's ratio to
# the diagonal entry of its row. With these the condition number of M stays below what float32
# resolves (for three actions or fewer), and exp does not overflow.
LOG_DIAGONAL_BOUND = 3.0
OFF_DIAGONAL_BOUND = 1.0
INITIAL_LOG_DIAGONAL = 0.5


class NAFNetwork(TensorDictModuleBase):
    """Q(s, a) = (mu(s) - a)^T M(s) (mu(s) - a) - D(a, mu(s)) + V(s), M = -L L^T negative definite.

    D = sum_i c_i (|a_i| - |mu_i| - g_i (a_i - mu_i)), g a slope of |a| at mu, is the part of the
    reward's cost c_i |a_i| of an action that lies above its tangent at mu. D is 0 at mu and never
    negative, so the maximum of Q is V at a = mu, with D and without it. Without D (c = 0, Eq. 5)
    a parabola approximates the kink of |a|: with noise its maximum is too low where mu is 0.

    L is lower triangular with an exponential diagonal. M acts on actions in units of the box's
    half-range and is therefore unit-free. Three separate (groups of) tanh networks give mu, L's
    entries and V, each from what the encoder makes of the normalized observation.

    `forward` writes

    * the greedy action, mu clipped to the box, (..., action_dim);
    * the state value, the maximum of Q over the box, (..., 1). It is Q at the clipped mu. All
      structures of mu here stay inside the box; then it is V. If another mu leaves the box, Q at
      the clipped mu is still the maximum for one action (for more, a lower bound of it);
    * if the input has an action, the state-action value Q(s, a), (..., 1).

    Args:
        features: names of the observation's columns.
        action_low: lower bounds of the action, (action_dim,), in action units.
        action_high: upper bounds of the action, (action_dim,).
        mu: structure of mu. For one action: "cascade" (Eq. 7 with an inner yaw-rate loop),
            "cascade-smooth" (the same without a soft threshold), "cascade-gated" (it can wait),
            "paper" (exactly Eq. 6 and Eq. 7) or "damped" (three placed poles). For two actions:
            one of these with "+idm" (car following and a correction) or "+mlp" for the second
            action. "mlp" for any number.
        encoder: "none", "gru" for stacked observations (`GRUEncoder`), or "grid" for an occupancy
            grid (`GridEncoder`).
        hidden_sizes: widths of the hidden layers of every network.
        offsets: observation offsets, one per feature, in its unit; zeros by default.
        scales: observation scales, one per feature, positive, in its unit; ones by default.
        action_costs: c, the weights of |a| in the reward, (action_dim,), per unit of the action,
            not negative; zeros by default.
        off_diagonal: whether L has entries below its diagonal; without them M is diagonal, and no
            action's part of Q depends on another action. For one action it makes no difference.
        observation_key: where observations are read, (..., len(features)).
        action_key: where actions are read, (..., action_dim).
        greedy_action_key: where the greedy action is written.
        value_key: where the state value is written.
        action_value_key: where the state-action value is written.

    Attributes:
        mu: the structure of mu; its parameters are exactly those of mu.
        mu_frozen: while true, no gradient reaches mu's parameters (the paper's first stage, which
            trains M and V only). With `mu.requires_grad_(False)` instead, TorchRL's target
            updaters would not see these parameters: they list the parameters once, when built.

    Raises:
        ValueError: the name of mu or of the encoder is unknown, a feature that it needs is missing,
            mu does not fit the number of actions, or lengths, bounds or scales are inconsistent.

    Source: Eq. 5; Gu et al. 2016, "Continuous Deep Q-Learning with Model-based Acceleration".

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> network = NAFNetwork(["speed", "lateral_deviation", "yaw"], [-0.5], [0.5], mu="paper")
        >>> observation = torch.tensor([[22.0, 3.75, 0.0], [22.0, 0.0, 0.05]])
        >>> data = TensorDict({"observation": observation, "action": torch.zeros(2, 1)}, [2])
        >>> data = network(data)
        >>> data["greedy_action"].sign().flatten().tolist()
        [1.0, -1.0]
        >>> bool((data["state_action_value"] <= data["state_value"]).all())
        True
    """

    def __init__(
        self,
        features: Sequence[str],
        action_low: Sequence[float] | Tensor,
        action_high: Sequence[float] | Tensor,
        *,
        mu: str = "cascade",
        encoder: str = "none",
        hidden_sizes: Sequence[int] = (64, 64),
        offsets: Sequence[float] | Tensor | None = None,
        scales: Sequence[float] | Tensor | None = None,
        action_costs: Sequence[float] | None = None,
        off_diagonal: bool = True,
        observation_key: NestedKey = "observation",
        action_key: NestedKey = "action",
        greedy_action_key: NestedKey = "greedy_action",
        value_key: NestedKey = "state_value",
        action_value_key: NestedKey = "state_action_value",
    ) -> None:
        super().__init__()
        # Required keys only: the action is optional, and value estimators have none.
        self.in_keys = [observation_key]
        self.out_keys = [greedy_action_key, value_key, action_value_key]
        self.observation_key = observation_key
        self.action_key = action_key
        self.greedy_action_key = greedy_action_key
        self.value_key = value_key
        self.action_value_key = action_value_key
        self.features = list(features)
        self.mu_name = mu
        self.encoder_name = encoder
        self.mu_frozen = False
        self.hidden_sizes = list(hidden_sizes)

        self.box = ActionBox(action_low, action_high)
        self.action_costs = _checked_costs(action_costs, self.action_dim)
        self.has_action_costs = any(self.action_costs)
        self.normalise = Normaliser(self.features, offsets, scales)
        self.encoder = make_encoder(encoder, self.features)
        inputs = self.encoder.outputs
        self.mu = make_mu(mu, inputs, self.box, self.hidden_sizes)
        self.off_diagonal = off_diagonal
        actions = self.action_dim
        num_ratios = actions * (actions - 1) // 2 if off_diagonal else 0
        logits = [INITIAL_LOG_DIAGONAL] * actions + [0.0] * num_ratios
        self.factor_logits = Heads(len(inputs), self.hidden_sizes, [logits])
        self.value = Heads(len(inputs), self.hidden_sizes, [[0.0]])

    @property
    def action_dim(self) -> int:
        """Number of actions."""
        return self.box.low.numel()

    @property
    def config(self) -> dict[str, Any]:
        """Constructor arguments in plain Python types: NAFNetwork(**config) has the same form."""
        return {
            "features": list(self.features),
            "action_low": self.box.low.tolist(),
            "action_high": self.box.high.tolist(),
            "mu": self.mu_name,
            "encoder": self.encoder_name,
            "hidden_sizes": list(self.hidden_sizes),
            "offsets": self.normalise.offset.tolist(),
            "scales": self.normalise.scale.tolist(),
            "action_costs": list(self.action_costs),
            "off_diagonal": self.off_diagonal,
            "observation_key": self.observation_key,
            "action_key": self.action_key,
            "greedy_action_key": self.greedy_action_key,
            "value_key": self.value_key,
            "action_value_key": self.action_value_key,
        }

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action, the state value and, given an action, Q(s, a).

        Args:
            tensordict: holds observations, (..., len(features)), and optionally actions.

        Returns:
            the same tensordict.
        """
        observation = tensordict.get(self.observation_key)
        action = tensordict.get(self.action_key, default=None)
        normalised = self._encode(observation)
        mu, slope = self._mu(observation, normalised)
        value = self.value(normalised)
        tensordict.set(self.greedy_action_key, self.box(mu))
        factor = None
        if action is not None:
            factor = self._factor(normalised)
            q = value - self._penalty(factor, mu, slope, action)
            tensordict.set(self.action_value_key, q)
        tensordict.set(self.value_key, value - self._clipping(normalised, mu, slope, factor))
        return tensordict

    def action_value(self, observation: Tensor, action: Tensor) -> Tensor:
        """Q(s, a) as `forward` writes it; evaluates only what is needed for it.

        Args:
            observation: (..., len(features)).
            action: (..., action_dim).

        Returns:
            state-action values, (..., 1).
        """
        return self._action_value(observation, self._encode(observation), action)

    def max_value(self, observation: Tensor, params: TensorDictBase | None = None) -> Tensor:
        """max_a Q(s, a) over the box as `forward` writes it; evaluates only what is needed for it.

        Args:
            observation: (..., len(features)).
            params: parameters to use instead of the network's, such as those of a target; the
                buffers are always the network's.

        Returns:
            state values, (..., 1).
        """
        if self._mu_inside_box:
            values = None if params is None else params.get("value")
            value: Tensor = self.value(self._encode(observation, params), values)
            return value
        if params is not None:
            with params.to_module(self, preserve_module_state=False):
                return self.max_value(observation)
        normalised = self._encode(observation)
        mu, slope = self._mu(observation, normalised)
        value = self.value(normalised)
        return value - self._clipping(normalised, mu, slope, None)

    def cholesky(self, observation: Tensor) -> Tensor:
        """L of M = -L L^T, in units of the box's half-range, (..., action_dim, action_dim)."""
        factor = self._factor(self._encode(observation))
        return factor.unsqueeze(-1) if self.action_dim == 1 else factor

    def policy(
        self, observation_key: NestedKey | None = None, action_key: NestedKey | None = None
    ) -> TensorDictModule:
        """The greedy policy: mu clipped to the box. The networks of M and V are not evaluated.

        Args:
            observation_key: where observations are read; by default this network's key.
            action_key: where the action is written; by default this network's key.

        Returns:
            a module which shares mu's parameters with this network.
        """
        return TensorDictModule(
            _Greedy(self.normalise, self.encoder, self.mu, self.box),
            in_keys=[self.observation_key if observation_key is None else observation_key],
            out_keys=[self.action_key if action_key is None else action_key],
        )

    @property
    def _mu_inside_box(self) -> bool:
        return getattr(self.mu, "inside_box", False)

    def _encode(self, observation: Tensor, params: TensorDictBase | None = None) -> Tensor:
        """What V, M and mu see of an observation; `params` as for `max_value`."""
        normalised = self.normalise(observation)
        values = None if params is None else params.get("encoder", None)
        context = nullcontext() if values is None else values.to_module(self.encoder)
        with context:
            encoded: Tensor = self.encoder(normalised)
        return encoded

    def _action_value(self, observation: Tensor, normalised: Tensor, action: Tensor) -> Tensor:
        mu, slope = self._mu(observation, normalised)
        penalty = self._penalty(self._factor(normalised), mu, slope, action)
        value: Tensor = self.value(normalised)
        return value - penalty

    def _mu(self, observation: Tensor, normalised: Tensor) -> tuple[Tensor, Tensor]:
        """Mu and the slope of the actions' cost at mu, without a gradient if mu is frozen."""
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.mu_frozen):
            if self.has_action_costs:
                mu, slope = self.mu.act(observation, normalised)
            else:
                mu = slope = self.mu(observation, normalised)
        return mu, slope

    def _factor(self, normalised: Tensor) -> Tensor:
        """L, (..., action_dim, action_dim); for one action its only entry, (..., 1)."""
        actions = self.action_dim
        logits = self.factor_logits(normalised)
        bound = LOG_DIAGONAL_BOUND
        if actions == 1:  # the general case needs several more kernels
            return torch.exp(bound * torch.tanh(logits / bound))
        diagonal = torch.exp(bound * torch.tanh(logits[..., :actions] / bound))
        factor = torch.diag_embed(diagonal)
        if not self.off_diagonal:
            return factor
        rows, columns = torch.tril_indices(actions, actions, -1, device=logits.device)
        bound = OFF_DIAGONAL_BOUND
        ratios = bound * torch.tanh(logits[..., actions:] / bound)
        factor[..., rows, columns] = ratios * diagonal[..., rows]
        return factor

    def _penalty(self, factor: Tensor, mu: Tensor, slope: Tensor, action: Tensor) -> Tensor:
        """V - Q = |L^T (mu - a) / half_range|^2 + D(a, mu), (..., 1): never negative.

        Args:
            factor: what `_factor` returns.
            mu: (..., action_dim).
            slope: of |a| at mu, (..., action_dim); not used without costs.
            action: (..., action_dim).
        """
        if action.shape != mu.shape:
            raise ValueError(
                f"expected actions of shape {tuple(mu.shape)}, got {tuple(action.shape)}"
            )
        distance = (mu - action) / self.box.half_range
        if self.action_dim == 1:
            penalty = (factor * distance).square()
        else:
            penalty = (factor.mT @ distance.unsqueeze(-1)).square().sum(-2)
        if not self.has_action_costs:
            return penalty
        # |mu| - g mu is 0 and left out, so that no rounding error of it remains near mu.
        bend = action.abs() - slope * action
        cost = sum(c * bend[..., i : i + 1] for i, c in enumerate(self.action_costs) if c)
        return penalty + cost

    def _clipping(
        self, normalised: Tensor, mu: Tensor, slope: Tensor, factor: Tensor | None
    ) -> Tensor | float:
        """V minus Q at the clipped mu."""
        if self._mu_inside_box:
            return 0.0
        if factor is None:
            factor = self._factor(normalised)
        return self._penalty(factor, mu, slope, self.box(mu))


def _checked_costs(costs: Sequence[float] | None, number: int) -> list[float]:
    """The actions' costs, or a ValueError."""
    found = [0.0] * number if costs is None else [float(cost) for cost in costs]
    if len(found) != number or not all(0.0 <= cost < float("inf") for cost in found):
        raise ValueError(f"action_costs = {costs}: must be {number} finite numbers, not negative")
    return found


class Normaliser(nn.Module):
    """(observation - offset) / scale, for each feature.

    Args:
        features: names of the observation's columns.
        offsets: one per feature, in its unit; zeros by default.
        scales: one per feature, positive, in its unit; ones by default.

    Raises:
        ValueError: no feature, a duplicate name, a wrong length, or a scale that is not positive.
    """

    offset: Tensor
    scale: Tensor

    def __init__(
        self,
        features: Sequence[str],
        offsets: Sequence[float] | Tensor | None,
        scales: Sequence[float] | Tensor | None,
    ) -> None:
        super().__init__()
        if not features or len(set(features)) != len(features):
            raise ValueError(f"need one or more features of different names, got {features}")
        size = len(features)
        offset, scale = (
            torch.as_tensor([value] * size if given is None else given, dtype=torch.float32)
            for given, value in ((offsets, 0.0), (scales, 1.0))
        )
        if offset.shape != (size,) or scale.shape != (size,):
            raise ValueError(
                f"need {size} offsets and scales, one a feature, "
                f"got shapes {tuple(offset.shape)} and {tuple(scale.shape)}"
            )
        if not (torch.isfinite(offset) & torch.isfinite(scale) & (scale > 0)).all():
            raise ValueError(f"need finite offsets and positive scales, got {offsets} and {scales}")
        self.register_buffer("offset", offset.clone())
        self.register_buffer("scale", scale.clone())

    def forward(self, observation: Tensor) -> Tensor:
        """The normalized observation, (..., features)."""
        offset = self.offset
        if observation.shape[-1] != offset.shape[0]:
            raise ValueError(f"expected {offset.shape[0]} features, got {observation.shape[-1]}")
        return (observation - offset) / self.scale


class _Greedy(nn.Module):
    def __init__(
        self, normalise: Normaliser, encoder: nn.Module, mu: nn.Module, box: ActionBox
    ) -> None:
        super().__init__()
        self.normalise = normalise
        self.encoder = encoder
        self.mu = mu
        self.box = box

    def forward(self, observation: Tensor) -> Tensor:
        encoded = self.encoder(self.normalise(observation))
        action: Tensor = self.box(self.mu(observation, encoded))
        return action
