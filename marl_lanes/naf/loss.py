"""The temporal-difference loss of normalized advantage functions."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Self

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from tensordict.nn import dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.objectives.common import LossModule
from torchrl.objectives.utils import (
    ValueEstimators,
    dispatch_value_estimator,
    distance_loss,
)
from torchrl.objectives.value import TD0Estimator

from marl_lanes.naf.network import NAFNetwork
from marl_lanes.naf.torch_internals import TensorsOf


class NAFLoss(LossModule):
    """L = mean (r + gamma (1 - terminated) max_a' Q(s', a'; target) - Q(s, a))^2.

    The maximum is the target network's state value, in closed form. A truncated step is not a
    terminated one: it keeps its bootstrap. (Data with `done` but without `terminated` are read, as
    in all TorchRL losses, as if every done step were terminated.)

    The squared error of each row is written to the input under the priority key. Rows excluded by
    `loss_mask_key`, for instance absent agents with `loss.loss_mask_key = ("agents", "mask")`, do
    not enter the reduction. To train M and V only (the paper's first stage) set
    `network.mu_frozen = True`.

    Args:
        value_network: the quadratic Q-function.

    Keyword Args:
        loss_function: "l2" (the default), "l1" or "smooth_l1".
        delay_value: whether the target has parameters of its own, which a
            :class:`~torchrl.objectives.SoftUpdate` or `HardUpdate` then updates. True by default.
        gamma: not accepted here; use `loss.make_value_estimator(gamma=...)`.
        reduction: "mean" (the default), "sum" or "none".
        use_prioritized_weights: whether to weight rows by the `priority_weight` entry; "auto" (the
            default) does so where it is present.

    Raises:
        TypeError: gamma is given, or value_network is not a NAFNetwork.

    Source: Eq. 8. The value estimators TD1 and TDLambda replace its one-step target.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.objectives import SoftUpdate
        >>> from marl_lanes.naf import NAFLoss, NAFNetwork
        >>> network = NAFNetwork(["x", "y", "z"], [-1.0, -1.0], [1.0, 1.0], mu="mlp")
        >>> loss = NAFLoss(network)
        >>> _ = loss.make_value_estimator(gamma=0.95)
        >>> updater = SoftUpdate(loss, tau=0.01)
        >>> data = TensorDict({
        ...     "observation": torch.randn(10, 3),
        ...     "action": torch.rand(10, 2) * 2 - 1,
        ...     "next": {
        ...         "observation": torch.randn(10, 3),
        ...         "reward": torch.randn(10, 1),
        ...         "done": torch.zeros(10, 1, dtype=torch.bool),
        ...         "terminated": torch.zeros(10, 1, dtype=torch.bool),
        ...     },
        ... }, [10])
        >>> output = loss(data)
        >>> output["loss"].shape, data["td_error"].shape
        (torch.Size([]), torch.Size([10]))
        >>> output["loss"].backward()
        >>> updater.step()

    Without tensordicts the arguments are the entries of `in_keys` joined by underscores, and a
    tensor is returned:

        >>> value = loss(
        ...     observation=torch.randn(10, 3),
        ...     action=torch.rand(10, 2) * 2 - 1,
        ...     next_observation=torch.randn(10, 3),
        ...     next_reward=torch.randn(10, 1),
        ...     next_done=torch.zeros(10, 1, dtype=torch.bool),
        ...     next_terminated=torch.zeros(10, 1, dtype=torch.bool),
        ... )
        >>> value.shape
        torch.Size([])
    """

    @dataclass
    class _AcceptedKeys:
        """The keys that `set_keys` accepts, and their defaults.

        The observation and the action are read where the network reads them.

        Attributes:
            advantage: where the value estimator, called by itself, writes the advantage.
            value_target: where the value estimator, called by itself, writes the target.
            value: where the network writes the state value.
            state_action_value: where the network writes Q(s, a).
            priority: where the squared temporal-difference error is written.
            reward: the reward, in "next".
            done: whether the trajectory ended, in "next".
            terminated: whether it ended without a value to bootstrap from, in "next".
            priority_weight: weights of a prioritized replay buffer.
        """

        advantage: NestedKey = "advantage"
        value_target: NestedKey = "value_target"
        value: NestedKey = "state_value"
        state_action_value: NestedKey = "state_action_value"
        priority: NestedKey = "td_error"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        terminated: NestedKey = "terminated"
        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    default_value_estimator = ValueEstimators.TD0
    SUPPORTED_VALUE_ESTIMATORS = (
        ValueEstimators.TD0,
        ValueEstimators.TD1,
        ValueEstimators.TDLambda,
    )
    out_keys = ["loss"]  # noqa: RUF012 -- the base class' way

    value_network: NAFNetwork
    value_network_params: TensorDictParams
    target_value_network_params: TensorDictParams

    def __init__(
        self,
        value_network: NAFNetwork,
        *,
        loss_function: str = "l2",
        delay_value: bool = True,
        gamma: float | None = None,
        reduction: str | None = None,
        use_prioritized_weights: str | bool = "auto",
    ) -> None:
        if gamma is not None:
            raise TypeError(f"gamma = {gamma}: must be given to make_value_estimator(gamma=...)")
        if not isinstance(value_network, NAFNetwork):
            raise TypeError(f"value_network must be a NAFNetwork, got {type(value_network)}")
        super().__init__()
        self._in_keys: list[NestedKey] | None = None
        self._network_tensors: TensorsOf | None = None
        self.use_prioritized_weights = use_prioritized_weights
        self.delay_value = delay_value
        self.loss_function = loss_function
        self.reduction = "mean" if reduction is None else reduction
        self.convert_to_functional(value_network, "value_network", create_target_params=delay_value)

    @property
    def in_keys(self) -> list[NestedKey]:
        """The entries that the loss reads."""
        if self._in_keys is None:
            self._in_keys = self._find_in_keys()
        return self._in_keys

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self._in_keys = values

    def make_value_estimator(
        self, value_type: ValueEstimators | None = None, **hyperparams: Any
    ) -> Self:
        """Builds the estimator of the target: TD0 (the default), TD1 or TDLambda.

        Args:
            value_type: the estimator; TorchRL's own classes and instances are accepted, too.
            **hyperparams: its parameters, such as gamma (0.99 by default) or lmbda.

        Returns:
            this loss.

        Raises:
            NotImplementedError: another member of `ValueEstimators`.
        """
        value_type, parameters = self._prepare_value_estimator_kwargs(value_type, **hyperparams)
        if value_type is None:  # a class or an instance, already in place
            return self
        # Its numbers are tensors: on the CPU they would be sent to a GPU at every update.
        parameters.setdefault("device", next(self.parameters()).device)
        dispatch_value_estimator(
            self, value_type, supported=self.SUPPORTED_VALUE_ESTIMATORS, **parameters
        )
        # They have torch's default dtype, which may be another than the network's.
        self.value_estimator.to(next(self.parameters()).dtype)
        self._forward_value_estimator_keys()
        return self

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Computes the loss and writes each row's squared error under the priority key.

        Args:
            tensordict: transitions with the entries of `in_keys`, any batch size; for TD1 and
                TDLambda its dimension named "time", or else the last one, is time.

        Returns:
            a tensordict with the entry "loss": a scalar, or with reduction "none" one a row.
        """
        network = self.value_network
        observation = tensordict.get(network.observation_key).detach()
        action = tensordict.get(network.action_key).detach()
        following = tensordict.get(("next", network.observation_key)).detach()
        with self._parameters_in_place():
            prediction, next_value = self._evaluate(observation, action, following)
            target = self._target(tensordict, next_value)

        loss = distance_loss(prediction, target, self.loss_function).squeeze(-1)
        if self.loss_function == "l2" and self.reduction != "none":
            priority = loss.detach()
        else:
            priority = (prediction.detach() - target).square().squeeze(-1)
        if tensordict.device is not None:
            priority = priority.to(tensordict.device)
        tensordict.set(self.tensor_keys.priority, priority, inplace=True)

        weights = self._maybe_get_priority_weight(tensordict)
        if weights is not None:
            # A replay buffer weighs rows; the agents of a row share its weight.
            weights = self._expand_loss_mask(weights, loss)
        loss = self._reduce_loss(loss, tensordict=tensordict, weights=weights)
        output = TensorDict({"loss": loss}, [])
        self._clear_weakrefs(
            tensordict, output, "value_network_params", "target_value_network_params"
        )
        return output

    def _parameters_in_place(self) -> AbstractContextManager[Any]:
        """Put the loss's parameters into the network, where it does not have them already.

        It mostly has: they are its own until the loss is cast, moved or given others. To compare
        them takes far less time than to exchange them.
        """
        params = self.value_network_params
        if not torch.compiler.is_compiling():
            if self._network_tensors is None:
                self._network_tensors = TensorsOf(self.value_network)
            if _are_same(TensorsOf(params), self._network_tensors):
                return nullcontext()
        context: AbstractContextManager[Any] = params.to_module(
            self.value_network, preserve_module_state=False
        )
        return context

    def _evaluate(
        self, observation: Tensor, action: Tensor, following: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Q(s, a), and the target's maximum of Q in the following state, (..., 1) each."""
        network = self.value_network
        prediction = network.action_value(observation, action)
        # The network's own maximum, not the estimator's call of the whole network: it skips mu
        # and M where V is all it takes.
        with torch.no_grad():
            next_value = network.max_value(following, self.target_value_network_params)
        return prediction, next_value

    @torch.no_grad()
    def _target(self, tensordict: TensorDictBase, next_value: Tensor) -> Tensor:
        following = tensordict.get("next")
        estimator = self.value_estimator
        target: Tensor
        if type(estimator) is TD0Estimator and not estimator.average_rewards:
            keys = estimator.tensor_keys
            if tensordict.get(keys.steps_to_next_obs, None) is None:
                # What it would do, with fewer look-ups.
                reward = following.get(keys.reward)
                terminated = following.get(keys.terminated, None)
                if terminated is None:
                    terminated = following.get(keys.done)
                if next_value.shape == reward.shape == terminated.shape:
                    gamma = estimator.gamma
                    if gamma.device != reward.device:
                        gamma = gamma.to(reward.device)
                    target = reward + gamma * ~terminated * next_value
                    return target
        target = estimator.value_estimate(tensordict, next_value=next_value)
        return target

    def _set_in_keys(self) -> None:
        self._in_keys = self._find_in_keys()

    def _find_in_keys(self) -> list[NestedKey]:
        keys = {
            unravel_key(self.value_network.observation_key),
            unravel_key(self.value_network.action_key),
            unravel_key(("next", self.value_network.observation_key)),
            unravel_key(("next", self.tensor_keys.reward)),
            unravel_key(("next", self.tensor_keys.done)),
            unravel_key(("next", self.tensor_keys.terminated)),
        }
        if self.use_prioritized_weights:
            keys.add(unravel_key(self.tensor_keys.priority_weight))
        return sorted(keys, key=str)


def _are_same(one: TensorsOf, other: TensorsOf) -> bool:
    """Whether both have the same parameters, and buffers in the same memory."""
    if [*map(id, one.parameters)] != [*map(id, other.parameters)]:
        return False
    # A TensorDictParams has aliases of the buffers, and one for each name.
    return [*dict.fromkeys(map(_memory, one.buffers))] == [
        *dict.fromkeys(map(_memory, other.buffers))
    ]


def _memory(tensor: Tensor) -> tuple[int, torch.dtype]:
    return tensor.data_ptr(), tensor.dtype
