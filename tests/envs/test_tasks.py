"""Keywords that only some tasks have, and what loads before workers are forked."""

from __future__ import annotations

from typing import Any

import pytest

from activestructure_gym.compiling.ahead import listed_kernels
from activestructure_gym.envs import ApartmentEnv, RoomEnv
from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth import Layout


def test_layouts_are_drawn_in_every_reset_by_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(set(RoomEnv(layouts=20)._scenes)) == 20
    assert ApartmentEnv(layouts=4, rooms=range(1, 3))._scenes == ApartmentEnv(layouts=4, rooms=[1, 2])._scenes
    truth = Layout("box").truth()
    drawn: list[str] = []
    monkeypatch.setattr(Layout, "truth", lambda self: (drawn.append(self.spec), truth)[1])
    options: dict[str, Any] = {"preset": "rl", "features": (), "frame_budget": 5}
    for seed in (3, 3, 4):
        env = ApartmentEnv(layouts=200, rooms=(1, 2), **options)
        for n in range(4):
            env.reset(seed=seed if n == 0 else None)
        assert len(env._loaded) == 1  # one layout in memory
        env.close()
    first, again, other = drawn[:4], drawn[4:8], drawn[8:]
    assert first == again != other and len(set(first)) == 4
    assert all(spec.startswith("apartment?rooms=") and spec.endswith("&lit=false") for spec in drawn)
    assert {spec[16] for spec in drawn} == {"1", "2"}


@pytest.mark.parametrize(
    ("kind", "options", "said"),
    [
        (RoomEnv, {"layouts": 0}, "layouts must be a whole number from 1 to 100000, got 0"),
        (RoomEnv, {"layouts": True}, "layouts must be a whole number"),
        (RoomEnv, {"layouts": 2.5}, "layouts must be a whole number"),
        (RoomEnv, {"layouts": 3, "scene_seed": 1}, "layouts takes the place of scene_seed"),
        (ApartmentEnv, {"layouts": 3, "scene": "box"}, "layouts takes the place of scene;"),
        (ApartmentEnv, {"layouts": 3, "rooms": (1, 8)}, "rooms must be a whole number from 1 to 7, or several"),
        (ApartmentEnv, {"layouts": 3, "rooms": ()}, "rooms must be a whole number from 1 to 7, or several"),
        (ApartmentEnv, {"rooms": (1, 2)}, "rooms must be a whole number"),
    ],
)
def test_wrong_layouts_are_refused_in_one_sentence(kind: type, options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        kind(**options)


def test_a_forkserver_loads_kernels_and_runs_none() -> None:
    import activestructure_gym.envs.preload  # noqa: F401
    from activestructure_gym.features.unknown_volume import _open

    kept = all(kernel.is_kept() for kernel in listed_kernels(("activestructure_gym.features.unknown_volume",)))
    assert _open.signatures or not kept
