"""Create an env together with a policy that is bound to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from activestructure_gym.errors import InputError, short_repr
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
    **options: Any,
) -> tuple[gym.Env[Any, Any], Policy]:
    """Create an env with the features that a policy requires, and bind the policy to it.

    Parameters
    ----------
    policy
        A spec such as ``"hole_area"``, ``"active_gs?travel=shared"``, ``"learned:CHECKPOINT"`` or
        ``"my_policy:Mine"``; a subclass of `Policy`; or a policy.
    scene
        A value of ``asg compare --scenes`` (a name with options, a file or a folder), a `Scene`, or a sequence of
        them. Default: the scene of ``env_id``, a furnished room.
    env_id
        ID of the environment. The default one accepts any scene.
    features
        Additional features of the observation, after those of the policy.
    setup
        ``"native"`` uses the policy's own candidate sources and schedule (`NativeSettings`), and the preset ``full``
        unless ``preset`` is given. Fields of ``config`` override both.
    **options
        Other arguments of ``gymnasium.make``: ``preset``, ``frame_budget``, ``config``, ...

    Returns
    -------
    tuple of gymnasium.Env and Policy
        The env, and the policy bound to it.

    Raises
    ------
    InputError
        An unknown name, or an invalid option.

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
    if isinstance(features, str) or not isinstance(features, Sequence):
        raise InputError(f"features must be a list of names, got {short_repr(features)}")
    if scene is not None:
        options["scene"] = scene
    settings = native_settings_of(policy, setup)
    if setup == "native":
        options = {"preset": NATIVE_PRESET, **options, "config": _with(settings, options.get("config"))}
    required = features_of(policy)
    env = gym.make(env_id, features=(*required, *(name for name in features if name not in required)), **options)
    try:
        policy.bind(env)
    except BaseException:
        made = options.get("world", scene)
        if made is None or isinstance(made, str):  # a world is the caller's
            env.close()
        raise
    return env, policy


def _with(settings: NativeSettings, config: Any) -> dict[str, Any]:
    """Return the overrides of a policy's native settings, updated by the user's fields ``config``."""
    if config is not None and not isinstance(config, Mapping):
        raise InputError(
            'with setup="native" the policy changes the configuration: give config as a dictionary of field values, '
            f"got {type(config).__name__}"
        )
    return {**settings.overrides(), **(config or {})}
