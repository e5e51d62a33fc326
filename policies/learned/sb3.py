"""The candidate-set network inside stable-baselines3's PPO.

``PPO(CandidatePolicy, env)`` trains on any of our environments; with ``with_used_keys(env)`` it does so about twice as
fast, since stable-baselines3 copies and converts every entry of an observation, images included. The mask is applied
inside the policy, from the observation: plain PPO never samples a masked row, and nothing else is needed. For
sb3-contrib's MaskablePPO, which brings the mask itself and takes policies of its own kind alone, there is
`MaskableCandidatePolicy` (``maskable.py``).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy, MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from activestructure_gym.errors import InputError
from activestructure_gym.policies.learned.checkpoint import find_checkpoint, load_network, save_checkpoint, weights_at
from activestructure_gym.policies.learned.config import USED_KEYS, NetworkConfig
from activestructure_gym.policies.learned.network import CandidateNetwork


def with_used_keys(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """The env without the entries of the observation that the network does not read."""
    _refuse_others(env.observation_space)
    return gym.wrappers.FilterObservation(env, list(USED_KEYS))


def _refuse_others(space: gym.Space[Any]) -> None:
    """Raise `InputError` for an observation space without the entries that the network reads."""
    if not isinstance(space, spaces.Dict):
        raise InputError(
            f"a learned policy reads the entries {', '.join(USED_KEYS)} of an observation, and this one is a "
            f"{type(space).__name__} without entries: give it an env of ours that no wrapper has flattened"
        )
    if missing := [key for key in USED_KEYS if key not in space.spaces]:
        raise InputError(f"the observation lacks {', '.join(missing)}: a learned policy reads {', '.join(USED_KEYS)}")


class CandidateExtractor(BaseFeaturesExtractor):
    """The whole network, as what stable-baselines3 calls a feature extractor: [B, K + 1], scores and value."""

    def __init__(self, observation_space: spaces.Dict, network: Mapping[str, Any] | None = None) -> None:
        _refuse_others(observation_space)
        table = observation_space["candidate_features"]
        names: tuple[str, ...] | None = getattr(table, "names", None)
        rows, features = table.shape  # type: ignore[misc]
        super().__init__(observation_space, rows + 1)
        if network is not None:
            config = NetworkConfig.from_dict(network)
        elif names is not None:
            config = NetworkConfig(features=names)
        else:
            raise InputError(
                "this observation space does not name the columns of candidate_features: name them "
                'with policy_kwargs={"network": NetworkConfig(features=...).as_dict()}'
            )
        if len(config.features) != features or names not in (None, config.features):
            offered = f"{features} features" if names is None else ", ".join(names) or "none"
            raise InputError(
                f"the network was made for the features {', '.join(config.features)}, the env offers {offered}: "
                f"make the env with features={config.features}"
            )
        self.network = CandidateNetwork(config)

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Scores of all rows, then the value."""
        mask = observations["action_mask"]
        if not ((mask == 0) | (mask == 1)).all():
            raise InputError(
                "action_mask holds other numbers than 0 and 1: a wrapper such as VecNormalize has changed the "
                "observation, which this policy scales by itself; leave them as they are (norm_obs=False)"
            )
        scores, value = self.network(observations)
        return torch.cat([scores, value[:, None]], dim=-1)


class _Split(nn.Module):
    """Takes scores and value apart again, where stable-baselines3 has its two hidden networks."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = rows, 1

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        return features[:, :-1]

    def forward_critic(self, features: Tensor) -> Tensor:
        return features[:, -1:]


class CandidateHeads(BasePolicy):
    """Mixin before an actor-critic policy of stable-baselines3 that makes it one of the candidate-set network.

    ``policy_kwargs={"network": NetworkConfig(...).as_dict()}`` sets the network's sizes and the names of its features;
    `begin_from` copies a checkpoint of ours, and `save_learned` writes one.
    """

    features_dim: Any
    mlp_extractor: Any
    action_net: Any
    value_net: Any

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Any,
        *,
        network: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        options.setdefault("features_extractor_class", CandidateExtractor)
        options.setdefault("features_extractor_kwargs", {"network": network})
        options["ortho_init"] = False
        super().__init__(observation_space, action_space, lr_schedule, **options)

    def _build(self, lr_schedule: Any) -> None:
        self.mlp_extractor = _Split(self.features_dim - 1)
        self.action_net, self.value_net = nn.Identity(), nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    @property
    def network(self) -> CandidateNetwork:
        """The network itself, to be saved or copied."""
        return self.features_extractor.network  # type: ignore[return-value,union-attr]

    def begin_from(self, place: str | os.PathLike[str]) -> None:
        """Take over the weights of a checkpoint; raises `InputError` if its network is another one."""
        start = load_network(find_checkpoint(place))
        if start.config != self.network.config:
            raise InputError(f"'{place}' holds another network: {start.config}, expected {self.network.config}")
        self.network.load_state_dict(start.state_dict())

    def save_learned(self, place: str | os.PathLike[str]) -> Path:
        """Write the network as a checkpoint, ``PLACE.safetensors`` and ``PLACE.json``: it plays as ``learned:PLACE``.

        Where PLACE is a folder that exists, the files are ``best.safetensors`` and ``best.json`` in it.

        Parameters
        ----------
        place
            The checkpoint's name, with its folder; what is there already is replaced.

        Returns
        -------
        Path
            The file of the weights.

        Raises
        ------
        InputError
            A name that holds a '?'.
        """
        weights = weights_at(place)
        save_checkpoint(weights, self.network, {"method": "stable-baselines3"})
        return weights


class CandidatePolicy(CandidateHeads, MultiInputActorCriticPolicy):
    """Actor and critic of the candidate-set network, for stable-baselines3's ``PPO`` and ``A2C``."""
