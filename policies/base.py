"""The interface of policies: required features, a seed at the start of an episode, and the choice of a row."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from typing import Any, ClassVar, TypeGuard

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, feature_columns, feature_names, row_names
from activestructure_gym.errors import InputError, renamed, short_repr
from activestructure_gym.policies.candidates import Candidates, Observation, listed
from activestructure_gym.policies.native_settings import NativeSettings
from activestructure_gym.registry import Registry
from activestructure_gym.specs import Spec, typed_options


class Policy(ABC):
    """Chooses one row of the candidate table per step.

    A policy sees the observation and nothing else: no map, no scene, no env. So it runs unchanged in any vector env,
    and pickles. The features of the candidates are the columns of ``observation["candidate_features"]``. Only the env
    knows their order: `bind` tells the policy, and `candidates` reads them by name. Without `bind`, `candidates`
    refuses. `make_env_and_policy` makes both at once and binds them.

    Parameters of a subclass's constructor are its options: ``name?key=value`` in a command. They are checked there,
    with an `InputError`.
    """

    criterion: ClassVar[str] = ""  # a line for lists; the first of the docstring where there is none
    travel_term: ClassVar[str] = "none"  # how the path to a view counts in the original, for lists
    source: ClassVar[str] = ""  # the paper, for lists
    native_settings: ClassVar[NativeSettings] = (
        NativeSettings()
    )  # what it brings where planners are compared on their own terms
    # Features that the env evaluates for every candidate: the class's, or the policy's own where options decide.
    required_features: tuple[str, ...] = ()
    _columns: tuple[str, ...] | None = None  # of the features in the observation, once they are known
    _rows: tuple[str, ...] = CANDIDATE_COLUMNS  # columns of the candidate table

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        old = cls.__dict__.get("required_gains")
        cls.required_features = renamed("required_gains", old, "required_features", cls.required_features)

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)

    def bind(self, source: Any) -> None:
        """Learn what stands in which column: from an env, a vector env, an observation space or the columns' names.

        Raises `InputError` if a required feature is missing. A policy without any needs no binding.
        """
        names, needed = feature_names(source), features_of(self)
        if missing := [name for name in needed if not _offered(name, names)]:
            raise InputError(
                f"{type(self).__name__} needs the features {listed(missing)}, and the env offers {listed(names)}: make "
                "the env with them in features=..., or both at once with env, policy = make_env_and_policy(...)"
            )
        self._columns, self._rows = names, row_names(source)

    def reset(self, seed: int) -> None:
        """Begin an episode; every random choice of the policy comes from this seed."""
        self.rng = np.random.default_rng(seed)

    @abstractmethod
    def act(self, observation: Observation) -> int:
        """The row to go to; must be one where ``observation["action_mask"]`` is 1."""

    def trace(self) -> dict[str, Any]:
        """Numbers behind the last choice, for the run's log; JSON-able."""
        return {}

    def candidates(self, observation: Observation) -> Candidates:
        """The candidates by name, and their features where the policy is bound to the env that made the observation."""
        return Candidates(observation, self._columns, type(self).__name__, self._rows)


def features_of(policy: Policy | type[Policy]) -> tuple[str, ...]:
    """The features that a policy or its class asks an env for; raises `InputError` unless it is a tuple of names."""
    features = policy.required_features
    if not isinstance(features, tuple | list) or not all(isinstance(name, str) for name in features):
        name = (policy if isinstance(policy, type) else type(policy)).__name__
        raise InputError(f"required_features of {name} must be a tuple of names, got {short_repr(features)}")
    return tuple(features)


def _offered(name: str, columns: tuple[str, ...]) -> bool:
    """Whether a feature, or a single column, is among these."""
    if name in columns:
        return True
    try:
        return set(feature_columns(name)) <= set(columns)
    except InputError:  # a name that nobody knows here
        return False


def is_policy(kind: Any) -> TypeGuard[type[Policy]]:
    """Whether it is a class of policies that can be made."""
    return isinstance(kind, type) and issubclass(kind, Policy) and not inspect.isabstract(kind)


POLICIES: Registry[type[Policy]] = Registry(
    "policy",
    "policies",
    fits=is_policy,
    wanted="a class derived from activestructure_gym.policies.Policy that defines act()",
    files=("policies/*/policy.py",),
)


def make_policy(spec: str) -> Policy:
    """The policy that ``spec`` names: ``pixel_only``, ``active_gs?travel=shared``, ``my_policy:Mine?depth=3``.

    Parameters
    ----------
    spec
        A registered name, ``learned:CHECKPOINT`` or ``package.module:Class``, with options behind a question mark.

    Returns
    -------
    Policy
        Not bound to any env yet.

    Raises
    ------
    InputError
        Unknown name or option, a value of the wrong kind, or one that the policy refuses.

    Examples
    --------
    >>> make_policy("active_gs?travel=shared").travel
    'shared'
    """
    kind, options = _class_and_options(spec)
    try:
        return kind(**options)
    except ValueError as error:
        raise InputError(f"policy '{spec}': {error}") from error


def canonical_policy(spec: str) -> str:
    """The one text for a policy: options sorted by name, without those that say what is usual.

    A class that is made from its name says in ``spec`` what it is called from anywhere: a checkpoint by its absolute
    path and its content.

    Parameters
    ----------
    spec
        As for `make_policy`.

    Returns
    -------
    str
        Equal for equal policies.

    Raises
    ------
    InputError
        Unknown name or option.

    Examples
    --------
    >>> canonical_policy("active_gs?travel=native"), canonical_policy("active_gs?travel=shared")
    ('active_gs', 'active_gs?travel=shared')
    """
    kind, options = _class_and_options(spec)
    usual = {name: parameter.default for name, parameter in inspect.signature(kind).parameters.items()}
    parsed = Spec.of(spec)
    name = vars(kind).get("spec", parsed.name)  # its own, and not that of a class it is derived from
    texts = parsed.options(f"policy '{spec}'")
    kept = [f"{key}={texts[key]}" for key in sorted(texts) if options[key] != usual.get(key, inspect.Parameter.empty)]
    return str(Spec(name, "&".join(kept)))


def _class_and_options(spec: str) -> tuple[type[Policy], dict[str, Any]]:
    parsed = Spec.of(spec)
    kind = POLICIES.get(parsed.name)
    return kind, typed_options(f"policy '{parsed.name}'", kind, parsed.options(f"policy '{spec}'"))


def travel_discount(observation: Observation, scale_frames: float = 5.0) -> np.ndarray:  # [K] in (0, 1]
    """g(T_c, T_cur) of Eq. 15 as 1 / (1 + frames / 5), shared by all policies: gain per frame paid.

    The paper leaves g open. Frames count turns as well as steps, so turning on the spot is not free; 5 is the keyframe
    interval. Measured against exp(-metres / 4).

    Parameters
    ----------
    observation
        Of which the column ``frames`` of the candidates [K, 9] is read.
    scale_frames
        Frames after which a gain counts half.

    Returns
    -------
    [K] in (0, 1]
        The factor on every candidate's gain.
    """
    return 1.0 / (1.0 + Candidates(observation).frames / scale_frames)


def best_valid(scores: np.ndarray, observation: Observation) -> int:
    """The row with the highest score among the valid ones; the first of equals. A NaN there raises `ValueError`."""
    valid = Candidates(observation).valid
    if not valid.any():
        raise ValueError("no candidate is valid: the episode has ended, call reset()")
    counted = np.where(valid, scores, -np.inf)
    if np.isnan(counted).any():  # argmax would take it for the best
        raise ValueError(f"the score of every valid row must be a number, got nan in row {np.isnan(counted).argmax()}")
    return int(np.argmax(counted))


def nearest_of_best(scores: np.ndarray, observation: Observation, tolerance: float = 0.0) -> int:
    """`best_valid`, but of equals, to a relative ``tolerance``, the one with the fewest frames."""
    best = scores[best_valid(scores, observation)]
    return best_valid(np.where(scores >= best - tolerance * abs(best), travel_discount(observation), -1.0), observation)


def without_revisits(observation: Observation) -> Observation:
    """The observation with the revisits masked, as long as anything else is valid.

    For planners that know no way back to a keyframe. Up to four rows of every table are the worst rendered ones, often
    where the agent stands, so that a way of length 0 would count for them.
    """
    candidates = Candidates(observation)
    new = candidates.valid & ~candidates.revisit
    return {**observation, "action_mask": new.astype(np.int8)} if new.any() else observation


def nearest_new(observation: Observation) -> int:
    """The fallback of planners without anything to decide by: the valid view with the fewest frames, revisits last.

    A revisit of the present pose costs a single frame, so among the others it would always be the nearest; and so would
    be the present pose itself, where a source offers it.
    """
    candidates = Candidates(observation)
    return best_valid(travel_discount(observation) - (candidates.revisit | at_current_pose(candidates)), observation)


def at_current_pose(candidates: Candidates) -> np.ndarray:  # [K] bool
    """Which views are the one it has: a single frame and no way. A planner that takes one stands still."""
    return (candidates.path_length < 1e-3) & (candidates.frames == 1)
