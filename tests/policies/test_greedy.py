"""A planner's own travel term and the one for all, by hand; and how a policy with options is named."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.errors import InputError
from activestructure_gym.policies import POLICIES, Greedy, canonical_policy, make_policy
from activestructure_gym.policies.pixel_only import PixelOnly
from tests.policies.binding import bound

FRAMES = CANDIDATE_COLUMNS.index("frames")


class Plain(Greedy):
    """No travel term of its own."""

    required_features = ("pixel",)


class Halving(Plain):
    """A factor of its own: half for every 10 frames."""

    def __init__(self, travel: str = "native", frames: float = 10.0) -> None:
        super().__init__(travel)
        if frames <= 0:
            raise ValueError(f"frames must be above 0, got {frames:g}")
        self.frames = frames

    def native_travel(self, observation):
        return 0.5 ** (observation["candidates"][:, FRAMES] / self.frames)


class Adding(Plain):
    """No factor: a term of a sum."""

    def native_scores(self, gain, observation):
        frames = observation["candidates"][:, FRAMES]
        return gain / gain.sum() - frames / frames.sum()


@pytest.fixture(autouse=True)
def registered():
    kinds = {"plain_here": Plain, "halving_here": Halving}
    POLICIES._entries.update(kinds)
    yield
    for name in kinds:
        del POLICIES._entries[name]


def observation(features, frames, valid=None):
    candidates = np.zeros((len(features), len(CANDIDATE_COLUMNS)), np.float32)
    candidates[:, FRAMES] = frames
    mask = np.ones(len(features), np.int8) if valid is None else np.array(valid, np.int8)
    return {
        "candidates": candidates, "candidate_features": np.array(features, np.float32)[:, None], "action_mask": mask
    }  # fmt: skip


def test_the_same_gains_with_every_travel_term() -> None:
    # shared: 4/2, 6/3, 9/10 -> a tie of the first two would hide an error, so 6.3/3
    seen = observation([4.0, 6.3, 9.0], [5.0, 10.0, 45.0])
    assert bound(Plain()).act(seen) == 2
    assert (
        bound(Plain("shared")).act(seen) == bound(Halving("shared")).act(seen) == bound(Adding("shared")).act(seen) == 1
    )
    assert bound(Halving()).act(seen) == 1  # 2.83, 3.15, 0.40
    assert bound(Halving()).trace() == {}
    halving = bound(Halving(frames=5.0))
    assert halving.act(seen) == 0  # 2, 1.575, ...
    assert halving.trace() == {"pixel": pytest.approx(4.0), "travel": pytest.approx(0.5)}
    assert bound(Adding()).act(seen) == 1  # 0.207 - 0.083, 0.326 - 0.167, 0.466 - 0.75


@pytest.mark.parametrize(
    "planner", [bound(Plain("shared")), bound(Halving()), bound(Halving("shared")), bound(Adding())]
)
def test_where_nothing_is_left_to_gain_the_nearest_valid_view_is_chosen(planner: Greedy) -> None:
    assert planner.act(observation([0.0, 0.0, 0.0, 7.0], [45.0, 5.0, 10.0, 1.0], valid=[1, 1, 1, 0])) == 1


def test_the_scale_of_a_gain_does_not_matter() -> None:
    features, frames = np.array([4.0, 6.3, 9.0]), [5.0, 10.0, 45.0]
    for scale in (1e-12, 1e12):
        assert bound(Plain()).act(observation(scale * features, frames)) == 2
        assert bound(Plain("shared")).act(observation(scale * features, frames)) == 1


def test_a_spec_makes_the_policy_it_says() -> None:
    policy = make_policy("halving_here?travel=shared&frames=3")
    assert isinstance(policy, Halving)
    assert (policy.travel, policy.frames) == ("shared", 3.0)
    assert make_policy("plain_here").travel == "native"
    assert isinstance(make_policy("pixel_only"), PixelOnly)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("plain_here?travel=far", "policy 'plain_here?travel=far': option travel must be native or shared, got 'far'"),
        ("plain_here?travl=shared", "unknown option 'travl' of policy 'plain_here'; did you mean 'travel'?"),
        ("halving_here?frames=few", "option frames of policy 'halving_here' must be a number, got 'few'"),
        ("halving_here?frames=0", "policy 'halving_here?frames=0': frames must be above 0, got 0"),
        ("plain_here?travel", "'travel' in policy 'plain_here?travel' is not of the form key=value"),
        ("random?travel=shared", "unknown option 'travel' of policy 'random'. Known: views_of"),
        ("pixel_only?travel=shared", "policy 'pixel_only' takes no options"),
        ("activestructure?travel=native", "unknown option 'travel' of policy 'activestructure'. Known: discovery"),
        ("plian_here?travel=shared", "unknown policy 'plian_here'; did you mean 'plain_here'?"),
        (3, "a name is given as a text, got 3"),
        ("os:sep", "policy 'os:sep' must be a class derived from activestructure_gym.policies.Policy that defines"),
        ("builtins:dict", "policy 'builtins:dict' must be a class derived from"),
        ("activestructure_gym.policies:Policy", "policy 'activestructure_gym.policies:Policy' must be a class derived"),
    ],
)
def test_a_wrong_option_is_one_sentence(spec: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        make_policy(spec)
    assert str(error.value).startswith(message)


def test_one_policy_has_one_name() -> None:
    assert canonical_policy("halving_here?travel=shared&frames=3") == "halving_here?frames=3&travel=shared"
    assert canonical_policy("halving_here?frames=10&travel=native") == "halving_here"
    assert canonical_policy("random") == "random"
    # An escaped option has the same value however often its name is written.
    odd = canonical_policy("random?views_of=a%26b%2526")
    assert canonical_policy(odd) == odd and odd.options("it") == {"views_of": "a&b%26"}
    with pytest.raises(InputError, match="Bare needs required_features"):
        type("Bare", (Greedy,), {})().act({"action_mask": np.ones(2, np.int8), "candidates": np.zeros((2, 8))})
