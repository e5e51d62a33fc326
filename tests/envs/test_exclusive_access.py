"""Who may step an environment: nobody once it is closed, and one thread at a time."""

from __future__ import annotations

import copy
import pickle
import threading
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from activestructure_gym.envs import ENV_IDS, ReconstructionEnv
from activestructure_gym.envs.exclusive_access import ExclusiveAccess


def test_a_closed_environment_refuses_and_keeps_what_it_has_reconstructed(box_options: dict[str, Any]) -> None:
    env = gym.make(
        f"activestructure_gym:{ENV_IDS[0]}", disable_env_checker=True, render_mode="rgb_array", **box_options
    )
    env.reset(seed=0)
    for _ in range(2):  # a second close does no harm
        env.close()
    for call in (lambda: env.step(0), lambda: env.reset(seed=0), env.render):
        with pytest.raises(gym.error.ClosedEnvironmentError, match=r"was called on a closed environment: make a new"):
            call()
    assert env.unwrapped.reconstruction.frames == 1 and env.unwrapped.action_masks().any()
    never_begun = ReconstructionEnv(**box_options)
    never_begun.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        never_begun.reset()


def test_true_is_no_row(box_options: dict[str, Any]) -> None:
    env = ReconstructionEnv(**box_options)
    env.reset(seed=0)
    for action in (True, False, np.bool_(True), 1.0, "1", None, -1, np.array([1])):
        assert not env.is_row(action)
        with pytest.raises(gym.error.InvalidAction, match="expected an integer in"):
            env.step(action)
    assert env.reconstruction.frames == 1 and all(map(env.is_row, (0, np.int32(1), np.array(2))))


def test_a_second_thread_is_refused_and_the_first_goes_on(box_options: dict[str, Any], monkeypatch) -> None:
    env = ReconstructionEnv(**box_options)
    env.reset(seed=0)
    inside, leave, steps = threading.Event(), threading.Event(), []
    move_to = env.reconstruction.move_to

    def slow(row: int) -> Any:
        inside.set()
        assert leave.wait(10)
        return move_to(row)

    monkeypatch.setattr(env.reconstruction, "move_to", slow)
    thread = threading.Thread(target=lambda: steps.append(env.step(0)))
    thread.start()
    assert inside.wait(10)
    for call in (lambda: env.step(0), env.reset):
        with pytest.raises(gym.error.AlreadyPendingCallError, match="give every thread an environment of its own"):
            call()
    leave.set()
    thread.join(30)
    assert len(steps) == 1
    env.step(0)  # access is free again


def test_access_is_released_after_an_error_and_in_copies() -> None:
    access = ExclusiveAccess()
    with pytest.raises(ZeroDivisionError), access.claim("step"):
        raise ZeroDivisionError
    for other in (access, copy.deepcopy(access), pickle.loads(pickle.dumps(access))):
        with other.claim("step"), pytest.raises(gym.error.AlreadyPendingCallError) as error, other.claim("reset"):
            pass
        assert error.value.name == "reset"
