"""An env and a policy that fit each other, made in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, renamed, short_repr
from activestructure_gym.policies.base import Policy, features_of, is_policy, make_policy
from activestructure_gym.policies.native_settings import NATIVE_PRESET, NativeSettings, Setup, native_settings_of

if TYPE_CHECKING:
    import gymnasium as gym

ROOM = "activestructure_gym:ActiveStructure/Room-v0"


def make_env_and_policy(
    policy: str | type[Policy] | Policy,
    scene: Any = None,
    *,
    env_id: str = ROOM,
    features: Sequence[str] = (),
    setup: Setup = "shared",
    gains: Sequence[str] | None = None,
    **options: Any,
) -> tuple[gym.Env[Any, Any], Policy]:
    """``gymnasium.make`` with the features that the policy asks for, and the policy bound to that env.

    Parameters
    ----------
    policy
        Its name with options (``"hole_area"``, ``"active_gs?travel=shared"``, ``"learned:CHECKPOINT"``,
        ``"my_policy:Mine"``), or a class, or a policy.
    scene
        What ``asg compare --scenes`` takes: a name with options, a file, a folder; or a `Scene`, or several of them.
        Without one that of ``env_id``, a furnished room.
    env_id
        The environment; that of a room takes any scene.
    features
        More features to put into the observation, behind those of the policy.
    setup
        ``"native"``: the policy brings its own candidate sources and schedule (`NativeSettings`). The preset is then
        ``full`` unless one is given. Fields of ``config`` override both.
    gains
        The old name of ``features``; it warns.
    **options
        Everything else that ``gymnasium.make`` takes: ``preset``, ``frame_budget``, ``config``, ...

    Returns
    -------
    tuple of gymnasium.Env and Policy
        The policy knows the columns of this env's observation.

    Raises
    ------
    InputError
        A name or an option that cannot be used.

    Examples
    --------
    >>> env, policy = make_env_and_policy("pixel_only", "box", preset="fast", frame_budget=10)
    >>> observation, info = env.reset(seed=1)
    >>> bool(observation["action_mask"][policy.act(observation)])
    True
    >>> env.close()
    """
    import gymnasium as gym

    if isinstance(policy, str):
        policy = make_policy(policy)
    elif is_policy(policy):
        policy = policy()
    if not isinstance(policy, Policy):
        raise InputError(
            "a policy is given by its name, as a class derived from Policy that defines act(), or ready-made, got "
            f"{short_repr(policy)}"
        )
    features = renamed("gains", gains, "features", features)
    if isinstance(features, str) or not isinstance(features, Sequence):
        raise InputError(f"features must be a list of names, got {short_repr(features)}")
    if scene is not None:
        options["scene"] = scene
    brought = native_settings_of(policy, setup)
    if setup == "native":
        options = {"preset": NATIVE_PRESET, **options, "config": _with(brought, options.get("config"))}
    wanted = features_of(policy)
    env = gym.make(env_id, features=(*wanted, *(name for name in features if name not in wanted)), **options)
    policy.bind(env)
    return env, policy


def _with(brought: NativeSettings, config: Any) -> dict[str, Any]:
    """What the policy brings, and what was asked for, which goes before."""
    if config is not None and not isinstance(config, Mapping):
        raise InputError(
            'with setup="native" the policy changes the configuration: give config as a dictionary of the fields that '
            f"shall differ, got {type(config).__name__}"
        )
    return {**brought.overrides(), **(config or {})}
