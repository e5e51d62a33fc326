"""Define the interface of policies, their registry, and functions shared by several policies."""

from __future__ import annotations

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, TypeGuard

import numpy as np

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, feature_columns, feature_names, row_names
from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.policies.candidates import Candidates, Observation, listed
from activestructure_gym.policies.native_settings import NativeSettings
from activestructure_gym.policies.scored import record_scores
from activestructure_gym.registry import Registry
from activestructure_gym.specs import Spec, escaped_option, typed_options


class Policy(ABC):
    """Choose one row of the candidate table per step.

    A policy reads only the observation, never the map, the scene or the env. It therefore runs unchanged in any vector
    env, and can be pickled. The columns of ``observation["candidate_features"]`` are the features of the candidates,
    in an order that the env defines. `bind` stores their names, and `candidates` reads them by name; without `bind`,
    reading a feature raises `InputError`. `make_env_and_policy` creates an env and a policy and binds the policy.

    The parameters of a subclass's constructor are its options, ``name?key=value`` in a command. The constructor checks
    them and raises `InputError`.
    """

    criterion: ClassVar[str] = ""  # one line for lists: how views are scored; default: first line of the docstring
    travel_term: ClassVar[str] = "none"  # one line for lists: how the original paper includes the path to a view
    source: ClassVar[str] = ""  # one line for lists: the paper
    native_settings: NativeSettings = NativeSettings()  # configuration in the native setup
    # Features that the env evaluates for every candidate. An instance may have its own tuple if its options change it.
    required_features: tuple[str, ...] = ()
    _columns: tuple[str, ...] | None = None  # names of the columns of ``candidate_features``; None before `bind`
    _rows: tuple[str, ...] = CANDIDATE_COLUMNS  # names of the columns of ``candidates``

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)

    def bind(self, source: Any) -> None:
        """Store the names of the observation's columns, so that the policy can read features by name.

        ``source`` is an env, a vector env, an observation space, or the names of the feature columns. A policy without
        required features needs no binding. Raises `InputError` if a required feature is missing.
        """
        names, needed = feature_names(source), features_of(self)
        if missing := [name for name in needed if not _offered(name, names)]:
            raise InputError(
                f"{type(self).__name__} needs the features {listed(missing)}, and the env offers {listed(names)}: make "
                "the env with them in features=..., or both at once with env, policy = make_env_and_policy(...)"
            )
        self._columns, self._rows = names, row_names(source)

    def reset(self, seed: int) -> None:
        """Begin an episode; ``seed`` determines all random choices of the policy."""
        self.rng = np.random.default_rng(seed)

    @abstractmethod
    def act(self, observation: Observation) -> int:
        """Return the chosen row of the candidate table; ``observation["action_mask"]`` must be 1 there."""

    def trace(self) -> dict[str, Any]:
        """Return numbers that explain the last choice, for the run's log; they must be JSON serialisable."""
        return {}

    def candidates(self, observation: Observation) -> Candidates:
        """Return the candidates of an observation, with their features by name if the policy is bound."""
        return Candidates(observation, self._columns, type(self).__name__, self._rows)

    def only_views(self, observation: Observation) -> Observation:
        """Return a copy of the observation in which only views are valid, unless no view is; see `Candidates.views`.

        Rows that end the episode or switch stages have the agent's position, no path, and index 0 of a node, region or
        frontier, which views can have too. So planners take such a row only if nothing else is left.
        """
        candidates = self.candidates(observation)
        views = candidates.views
        if not views.any() or np.array_equal(views, candidates.valid):
            return observation
        return {**observation, "action_mask": views.astype(np.int8)}


def features_of(policy: Policy | type[Policy]) -> tuple[str, ...]:
    """Return the required features of a policy or its class; raise `InputError` unless they are a tuple of names."""
    features = policy.required_features
    if not isinstance(features, tuple | list) or not all(isinstance(name, str) for name in features):
        name = (policy if isinstance(policy, type) else type(policy)).__name__
        raise InputError(f"required_features of {name} must be a tuple of names, got {short_repr(features)}")
    return tuple(features)


def _offered(name: str, columns: tuple[str, ...]) -> bool:
    """Return whether ``columns`` contains ``name``, a column's full name, or all columns of the feature ``name``."""
    if name in columns:
        return True
    try:
        return set(feature_columns(name)) <= set(columns)
    except InputError:  # an unknown feature
        return False


def is_policy(kind: Any) -> TypeGuard[type[Policy]]:
    """Return whether ``kind`` is a concrete subclass of `Policy`."""
    return isinstance(kind, type) and issubclass(kind, Policy) and not inspect.isabstract(kind)


POLICIES: Registry[type[Policy]] = Registry(
    "policy",
    "policies",
    fits=is_policy,
    wanted="a class derived from activestructure_gym.policies.Policy that defines act()",
    files=("policies/*/policy.py",),
)


def make_policy(spec: str) -> Policy:
    """Create the policy that ``spec`` names.

    Parameters
    ----------
    spec
        A registered name, ``learned:CHECKPOINT`` or ``package.module:Class``, with options after a question mark:
        ``pixel_only``, ``active_gs?travel=shared``, ``my_policy:Mine?depth=3``.

    Returns
    -------
    Policy
        A policy that is not bound to an env yet; see `Policy.bind`.

    Raises
    ------
    InputError
        An unknown name or option, or an invalid value of an option.

    Examples
    --------
    >>> make_policy("active_gs?travel=shared").travel
    'shared'
    """
    _, kind, options = _parsed(spec)
    try:
        policy = kind(**options)
        features_of(policy)
    except ValueError as error:
        raise InputError(f"policy '{spec}': {error}") from error
    return policy


def canonical_policy(spec: str) -> Spec:
    """Return the canonical spec of a policy: options sorted by name, default values left out.

    The canonical spec of a checkpoint contains its absolute path and a hash of its content.

    Parameters
    ----------
    spec
        As for `make_policy`.

    Returns
    -------
    Spec
        The canonical spec, a text; equal policies have equal canonical specs.

    Raises
    ------
    InputError
        An unknown name or option.

    Examples
    --------
    >>> canonical_policy("active_gs?travel=native"), canonical_policy("active_gs?travel=shared")
    ('active_gs', 'active_gs?travel=shared')
    """
    parsed, kind, options = _parsed(spec)
    defaults = {name: parameter.default for name, parameter in inspect.signature(kind).parameters.items()}
    name = vars(kind).get("spec", parsed.name)  # only the class's own attribute, not an inherited one
    texts = parsed.options(f"policy '{spec}'")
    kept = [
        f"{key}={escaped_option(texts[key])}"
        for key in sorted(texts)
        if options[key] != defaults.get(key, inspect.Parameter.empty)
    ]
    return Spec.joined(name, "&".join(kept))


def _parsed(spec: str) -> tuple[Spec, type[Policy], dict[str, Any]]:
    parsed = Spec(spec)
    kind = POLICIES.get(parsed.name)
    return parsed, kind, typed_options(f"policy '{parsed.name}'", kind, parsed.options(f"policy '{spec}'"))


def travel_discount(observation: Observation, scale_frames: float = 5.0) -> np.ndarray:  # [K] in (0, 1]
    """Return the shared travel term g(T_c, T_cur) of Eq. 15 as 1 / (1 + frames / 5).

    The paper does not define g. The number of frames includes turns, so turning on the spot is not free; 5 frames is
    the keyframe interval.

    Parameters
    ----------
    observation
        Its column ``frames`` of the candidates [K, 9 or more] is read.
    scale_frames
        Number of frames at which the factor is 0.5.

    Returns
    -------
    [K] in (0, 1]
        Factor on the gain of every candidate, without unit.
    """
    return 1.0 / (1.0 + Candidates(observation).frames / scale_frames)


def best_valid(scores: np.ndarray, observation: Observation, terms: Mapping[str, np.ndarray] | None = None) -> int:
    """Return the valid row with the highest score; the first of equal ones.

    A run stores the scores of a decision's last call if this call returned the chosen row. ``asg why`` and the replay
    show these scores.

    Parameters
    ----------
    scores
        [K] score of every row; -inf excludes a row from the comparison.
    observation
        The observation; its ``action_mask`` names the valid rows.
    terms
        Terms of the scores by name, [K] each, to explain the choice. A score is the sum of the terms, times those
        whose name begins with "× ". Default: the features explain the choice.

    Returns
    -------
    int
        The row.

    Raises
    ------
    InputError
        If no row is valid, if the score of a valid row is NaN, or if ``scores`` or a term does not have one number per
        row.
    """
    valid = Candidates(observation).valid
    if np.shape(scores) != valid.shape:
        raise InputError(f"scores must have one number per row, {valid.shape}, got {np.shape(scores)}")
    if not valid.any():
        raise InputError("no candidate is valid: the episode has ended, call reset()")
    masked = np.where(valid, scores, -np.inf)
    if np.isnan(masked).any():  # np.argmax treats NaN as the maximum
        raise InputError(f"the score of every valid row must be a number, got nan in row {np.isnan(masked).argmax()}")
    row = int(np.argmax(masked))
    row = row if valid[row] else int(np.argmax(valid))  # all valid rows have the score -inf
    record_scores(row, masked, terms)
    return row


def nearest_of_best(
    scores: np.ndarray,
    observation: Observation,
    tolerance: float = 0.0,
    terms: Mapping[str, np.ndarray] | None = None,
) -> int:
    """Return the valid row with the highest of ``scores`` [K]; of equal ones, the row with the fewest frames.

    Scores are equal if they differ by at most the relative ``tolerance``. ``terms`` are those of `best_valid`.
    """
    best = scores[best_valid(scores, observation)]
    near = np.where(scores >= best - tolerance * abs(best), travel_discount(observation), -1.0)
    row = best_valid(near, observation)
    record_scores(row, np.where(Candidates(observation).valid, scores, -np.inf), terms)
    return row


def without_revisits(observation: Observation) -> Observation:
    """Return a copy of the observation in which revisits of keyframes are invalid, unless only revisits are valid.

    Planners whose papers have no revisits use it. Revisits are the poses of up to four keyframes, those with the lowest
    PSNR. They are often at the agent's position, where their path length of 0 would favour them.
    """
    candidates = Candidates(observation)
    new = candidates.valid & ~candidates.revisit
    return {**observation, "action_mask": new.astype(np.int8)} if new.any() else observation


def patience(rows: int) -> int:
    """Return how many successive tables of ``rows`` rows end a phase or stage if none has a view that suffices.

    A table is a random part of all views. So there must be at least 3 tables, with at least 768 rows together: 3 tables
    of the default size, 12 of preset `fast`.
    """
    return max(3, math.ceil(768 / rows))


def nearest_new(observation: Observation) -> int:
    """Return the valid row with the fewest frames; revisits and the current pose come after all other views.

    Planners use it if no view has a gain. A revisit of the current pose costs a single frame and would otherwise always
    be the nearest view.
    """
    candidates = Candidates(observation)
    return best_valid(travel_discount(observation) - (candidates.revisit | at_current_pose(candidates)), observation)


def at_current_pose(candidates: Candidates) -> np.ndarray:  # [K] bool
    """Return which candidates are the agent's current view: a path of length 0 that costs a single frame."""
    return (candidates.path_length < 1e-3) & (candidates.frames == 1)
