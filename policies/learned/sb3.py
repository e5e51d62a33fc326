"""Adapt the candidate-set network to stable-baselines3: ``PPO(CandidatePolicy, env)``.

It trains on any environment of this package. ``with_used_keys(env)`` makes training about twice as fast, since
stable-baselines3 copies and converts every entry of an observation, including images. The policy applies the action
mask of the observation, so PPO never samples a masked row. `MaskableCandidatePolicy` (``maskable.py``) is the policy
for sb3-contrib's MaskablePPO.
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
    """Return the env with a wrapper that removes the entries of the observation that the network does not read."""
    _refuse_others(env.observation_space)
    return gym.wrappers.FilterObservation(env, list(USED_KEYS))


def _refuse_others(space: gym.Space[Any]) -> None:
    """Raise `InputError` for an observation space without the entries that the network reads."""
    if not isinstance(space, spaces.Dict):
        raise InputError(
            f"a learned policy reads the entries {', '.join(USED_KEYS)} of an observation, and this one is a "
            f"{type(space).__name__} without entries: use an env of this package that no wrapper has flattened"
        )
    if missing := [key for key in USED_KEYS if key not in space.spaces]:
        raise InputError(f"the observation lacks {', '.join(missing)}: a learned policy reads {', '.join(USED_KEYS)}")


class CandidateExtractor(BaseFeaturesExtractor):
    """Wrap the whole network as a feature extractor of stable-baselines3; its output [B, K + 1] is scores and value."""

    def __init__(self, observation_space: spaces.Dict, network: Mapping[str, Any] | None = None) -> None:
        """Create the network; ``network`` is a `NetworkConfig` as a dictionary.

        Without it, the network has default sizes and the features of the observation space. Raises `InputError` if the
        space does not match.
        """
        _refuse_others(observation_space)
        table = observation_space["candidate_features"]
        names: tuple[str, ...] | None = getattr(table, "names", None)
        rows, features = table.shape  # type: ignore[misc]
        super().__init__(observation_space, rows + 1)
        if network is not None:
            config = NetworkConfig.from_dict(network)
        elif names is not None:
            (planes,) = observation_space["plane_mask"].shape  # type: ignore[misc]
            config = NetworkConfig(features=names, max_planes=planes)
        else:
            raise InputError(
                "this observation space has no names for the columns of candidate_features: give them "
                'with policy_kwargs={"network": NetworkConfig(features=...).as_dict()}'
            )
        if len(config.features) != features or names not in (None, config.features):
            offered = f"{features} features" if names is None else ", ".join(names) or "none"
            raise InputError(
                f"the network needs the features ({', '.join(config.features)}), but the env offers ({offered}): "
                f"make the env with features={config.features}"
            )
        self.network = CandidateNetwork(config)

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Return the scores of the K rows, then the value of the state: [B, K + 1].

        Raises `InputError` if the action mask has other numbers than 0 and 1.
        """
        mask = observations["action_mask"]
        if not ((mask == 0) | (mask == 1)).all():
            raise InputError(
                "action_mask holds other numbers than 0 and 1: a wrapper such as VecNormalize has changed the "
                "observation, which this policy scales by itself; leave them as they are (norm_obs=False)"
            )
        scores, value = self.network(observations)
        return torch.cat([scores, value[:, None]], dim=-1)


class _Split(nn.Module):
    """Split the extractor's output [B, K + 1] into scores and value, instead of stable-baselines3's hidden networks."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = rows, 1

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return the scores [B, K] and the value [B, 1]."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        """Return the scores [B, K]."""
        return features[:, :-1]

    def forward_critic(self, features: Tensor) -> Tensor:
        """Return the value [B, 1]."""
        return features[:, -1:]


class CandidateHeads(BasePolicy):
    """Replace the networks of an actor-critic policy of stable-baselines3 by the candidate-set network; a mixin.

    ``policy_kwargs={"network": NetworkConfig(...).as_dict()}`` sets the sizes and the features of the network.
    `begin_from` copies the weights of a checkpoint, and `save_learned` writes a checkpoint.
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
        """Create the policy; ``network`` is a `NetworkConfig` as a dictionary, ``options`` are the base class's."""
        options.setdefault("features_extractor_class", CandidateExtractor)
        options.setdefault("features_extractor_kwargs", {"network": network})
        options["ortho_init"] = False
        super().__init__(observation_space, action_space, lr_schedule, **options)

    def _build(self, lr_schedule: Any) -> None:
        """Create the optimiser, and identity layers in place of stable-baselines3's heads for actions and value."""
        self.mlp_extractor = _Split(self.features_dim - 1)
        self.action_net, self.value_net = nn.Identity(), nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]

    @property
    def network(self) -> CandidateNetwork:
        """Return the candidate-set network inside the feature extractor."""
        return self.features_extractor.network  # type: ignore[return-value,union-attr]

    def begin_from(self, place: str | os.PathLike[str]) -> None:
        """Copy the weights of a checkpoint; raise `InputError` if its network has another configuration."""
        start = load_network(find_checkpoint(place))
        if start.config != self.network.config:
            raise InputError(f"'{place}' holds another network: {start.config}, expected {self.network.config}")
        self.network.load_state_dict(start.state_dict())

    def save_learned(self, place: str | os.PathLike[str]) -> Path:
        """Write the network as a checkpoint for the policy ``learned:PLACE``.

        The files are ``PLACE.safetensors`` and ``PLACE.json``. In an existing folder PLACE, they are
        ``best.safetensors`` and ``best.json``.

        Parameters
        ----------
        place
            Path of the checkpoint; existing files are replaced.

        Returns
        -------
        Path
            The file of the weights.

        Raises
        ------
        InputError
            The path contains a '?'.
        """
        weights = weights_at(place)
        save_checkpoint(weights, self.network, {"method": "stable-baselines3"})
        return weights


class CandidatePolicy(CandidateHeads, MultiInputActorCriticPolicy):
    """Provide actor and critic of the candidate-set network to stable-baselines3's ``PPO`` and ``A2C``."""
