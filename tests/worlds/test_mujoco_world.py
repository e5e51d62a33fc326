"""MuJoCo's pictures against our ray caster's of the same room, and what the world refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import look_along
from activestructure_gym.policies import make_env_and_policy
from activestructure_gym.sensors.raycast import RaycastRenderer
from activestructure_gym.worlds import load_world
from tests.examples.test_examples import load
from tests.worlds.rooms import room

DOZEN = [
    look_along(
        np.random.default_rng(n).uniform((1.0, 1.2, 1.0), (4.0, 3.0, 2.2)), np.random.default_rng(n).normal(size=3)
    )
    for n in range(12)
]


@pytest.mark.parametrize(("width", "height", "fovy"), [(160, 90, 60.0), (64, 80, 95.0)])
def test_depth_agrees_with_our_ray_caster(mujoco_room: Path, width: int, height: int, fovy: float) -> None:
    world = load_world(f"mujoco?model={mujoco_room}&width={width}&height={height}&fovy={fovy}")
    rays = RaycastRenderer(room())
    rolled = DOZEN[0].copy()
    rolled[:3, :3] = rolled[:3, :3] @ [[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]
    errors = []
    for pose in [*DOZEN, rolled]:
        frame = world.capture(pose)
        errors.append(np.abs(frame.depth - rays.render(world.camera, pose, supersample=1)[1]))
    world.close()
    assert (np.stack(errors) < 1e-4).mean() > 0.99


def test_colours_are_in_their_places(mujoco_room: Path) -> None:
    world = load_world(f"mujoco?model={mujoco_room}")
    rays = RaycastRenderer(room())
    place = np.array([2.5, 1.5, 1.4])
    for ahead, channel in (((-1.0, 0.0, 0.0), 0), ((1.0, 0.0, 0.0), 1)):  # the red and the green wall
        rgb = world.capture(look_along(place, np.array(ahead))).rgb
        middle = rgb[35:50, 70:90].reshape(-1, 3).mean(axis=0)
        assert middle[channel] > 1.5 * np.delete(middle, channel).max()
        floor, ceiling = rgb[-1, 80].astype(int), rgb[0, 80].astype(int)
        assert floor[2] > floor[0] + 40 and np.ptp(ceiling) < 20  # blue below, grey above
    # Lit from the camera in MuJoCo, unlit in our ray caster.
    seen, expected = (
        np.stack(pictures).ravel()
        for pictures in zip(*[(world.capture(pose).rgb, rays.render(world.camera, pose)[0]) for pose in DOZEN])
    )
    assert np.corrcoef(seen, expected)[0, 1] > 0.95
    world.close()


def test_bounds_and_starts_are_those_of_the_model(mujoco_room: Path) -> None:
    world: Any = load_world(f"mujoco?model={mujoco_room}")
    np.testing.assert_allclose(world.bounds, room().bounds, atol=1e-6)
    caster, rays, places = room().raycaster, np.random.default_rng(0).normal(size=(2000, 3)), set()
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for seed in range(12):
        world.reset(seed)
        start = world.start
        places.add(tuple(start.pose[:3, 3]))
        assert 0.6 <= start.free_radius < caster.cast(start.pose[:3, 3], rays).distance.min()
        assert ((start.pose[:3, 3] > 0) & (start.pose[:3, 3] < (5, 4, 2.6))).all()
    assert len(places) > 3
    world.close()
    given: Any = load_world(f"mujoco?model={mujoco_room}&start=1,2,1.2,90&bounds=0,0,0,5,4,2.5")
    np.testing.assert_allclose(given.start.pose, look_along(np.array([1, 2, 1.2]), np.array([0, 1, 0])), atol=1e-12)
    assert given.bounds.tolist() == [[0, 0, 0], [5, 4, 2.5]] and 0.8 < given.start.free_radius < 1.0
    given.close()


def test_a_model_in_a_state_of_its_own(mujoco_room: Path) -> None:
    import mujoco

    from activestructure_gym.worlds.mujoco_world import MujocoWorld

    text = mujoco_room.read_text().replace(
        "</worldbody>",
        '<body name="ball" pos="2.5 2 1"><freejoint/><geom size="0.2" rgba="1 0 0 1"/></body></worldbody>',
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    sizes = model.vis.global_.offwidth, model.vis.quality.offsamples
    world = MujocoWorld(model, data=data, start=(1.0, 2.0, 1.0, 0.0))
    assert (model.vis.global_.offwidth, model.vis.quality.offsamples) == sizes  # the user's model is as it was
    assert world.capture(world.start.pose).depth[45, 80] == pytest.approx(1.3, abs=0.005)
    data.qpos[0] = 3.0
    mujoco.mj_forward(model, data)
    assert world.capture(world.start.pose).depth[45, 80] == pytest.approx(1.8, abs=0.005)
    world.close()
    with pytest.raises(ValueError, match="closed"):
        world.capture(world.start.pose)


def test_what_is_above_the_walls_has_no_depth(tmp_path: Path, mujoco_room: Path) -> None:
    path = tmp_path / "open.xml"
    path.write_text(
        '<mujoco><asset><texture type="skybox" builtin="gradient" width="64" height="64" rgb1="1 1 1" rgb2="0 1 0"/>'
        '</asset><worldbody><geom type="plane" size="0 0 1" pos="0 0 -0.5"/><geom type="box" size="1 1 0.2"/>'
        '<geom size="9" rgba="1 1 1 0"/><geom size="9" group="3"/></worldbody></mujoco>'
    )
    world = load_world(f"mujoco?model={path}&start=0,0,2,0")
    frame = world.capture(world.start.pose)
    # The floor below the box; what is not drawn does not count.
    np.testing.assert_allclose(world.bounds, [[-1, -1, -0.5], [1, 1, 0.2]], atol=1e-6)
    assert np.isposinf(frame.depth[:40]).all() and (frame.rgb[:40] == 0).all() and (frame.depth[-5:] > 0).all()
    assert frame.depth[40:].max() > 10.0  # the plane has no end
    world.close()
    env = ReconstructionEnv(f"world:mujoco?model={path}&start=0,0,2,0&bounds=-2,-2,-1,2,2,3", preset="fast")
    seen = env.reset(seed=0)[0]["depth"]
    assert 5.0 < seen.max() <= env.config.sensor.max_range == 10.0
    env.close()


def explored(name: str, policy: str, frames: int) -> dict[str, Any]:
    env, player = make_env_and_policy(policy, name, preset="fast", frame_budget=frames)
    player.reset(0)
    observation, info = env.reset(seed=0)
    ended = False
    while not ended:
        observation, _, terminated, truncated, info = env.step(player.act(observation))
        ended = terminated or truncated
    assert np.median(env.unwrapped.reconstruction.mapper.keyframe_psnr()) > 18.0
    env.close()
    return info


@pytest.mark.parametrize("policy", ["activestructure", "unknown_volume"])
def test_policies_explore_the_room(mujoco_room: Path, policy: str) -> None:
    info = explored(f"world:mujoco?model={mujoco_room}&width=64&height=36", policy, 90)
    assert info["metres"] > 1.0 and info["ground_truth"] is False


@pytest.fixture(scope="module")
def kitchen(mujoco_room: Path) -> str:
    """The name of the Franka kitchen; skips without it, EGL or GL."""
    pytest.importorskip("gymnasium_robotics", exc_type=ImportError)
    return str(load("worlds/mujoco_kitchen").kitchen())


def test_the_kitchen_is_drawn(kitchen: str) -> None:
    world: Any = load_world(f"{kitchen}&width=64&height=36")
    frame = world.capture(world.start.pose)
    assert world.start.free_radius > 0.6
    near = np.isfinite(frame.depth)
    assert 0.3 < near.mean() < 0.9  # no ceiling
    assert 1.0 < np.median(frame.depth[near]) < 4.0 and frame.rgb.std() > 30
    # MuJoCo's rays meet the surfaces that are drawn.
    rays, hit = world.camera.rays() @ frame.world_from_camera[:3, :3].T, np.zeros(1, np.int32)
    mujoco, place = world._mujoco, frame.world_from_camera[:3, 3].copy()
    shown = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    cast = [
        mujoco.mj_ray(world.model, world.data, place, rays[y, x].astype(float), shown, 1, -1, hit)
        for y in range(0, 36, 3)
        for x in range(0, 64, 3)
    ]
    seen, hits = frame.depth[::3, ::3].ravel(), np.array(cast)  # mj_ray returns -1 where it meets nothing
    same = np.where(np.isfinite(seen), np.abs(seen - hits) < 0.01, hits < 0)
    assert same.mean() > 0.97  # no silhouette is anti-aliased, but rays and pixels may differ
    world.close()


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["activestructure", "unknown_volume"])
def test_policies_explore_the_kitchen(kitchen: str, policy: str) -> None:
    # At 64 x 36 pixels most of the 90 frames pass with turns at the start, until enough space is known to be free.
    info = explored(f"{kitchen}&width=160&height=90", policy, 90)
    assert info["metres"] > 3.0 and info["gaussians"] > 1000


@pytest.mark.slow
def test_the_example_of_the_kitchen(kitchen: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = load("worlds/mujoco_kitchen")
    example.main(example.Args(preset="fast", frames=15, picture=tmp_path / "last.png"))
    assert "Gaussians" in capsys.readouterr().out and (tmp_path / "last.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("model=nowhere.xml", "there is no MuJoCo model 'nowhere.xml'"),
        ("model={room}&start=3.3,2.6,0.4,0", "inside a geom"),
        ("model={room}&bounds=0,0,0,1", "bounds of world 'mujoco'"),
        ("model={room}&bounds=0,0,0,1,1,0", "lowest and the highest corner"),
        ("model={room}&fovy=180", "between 0 and 180 degrees"),
        ("model={room}&width=0", "at least 1 pixel"),
        ("model={room}&start=1,2,3", "start of world 'mujoco'"),
    ],
)
def test_options_are_checked(mujoco_room: Path, options: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_world("mujoco?" + options.format(room=mujoco_room))


def test_models_are_checked(mujoco_room: Path, tmp_path: Path) -> None:
    from activestructure_gym.worlds.mujoco_world import MujocoWorld

    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    with pytest.raises(InputError, match=r"MuJoCo cannot read .*broken\.xml'"):
        MujocoWorld(str(broken))
    empty = tmp_path / "empty.xml"
    empty.write_text("<mujoco/>")
    with pytest.raises(InputError, match="no geoms.*give bounds"):
        MujocoWorld(str(empty))
    with pytest.raises(InputError, match="an MJCF file or a mujoco.MjModel, got 3"):
        MujocoWorld(3)
    with pytest.raises(InputError, match="lowest and the highest corner"):
        MujocoWorld(str(mujoco_room), bounds=(0.0, 0.0, 0.0, 1.0))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no place with 0.3 m of clearance"):
        MujocoWorld(str(mujoco_room), bounds=(3.2, 2.5, 0.6, 3.4, 2.7, 0.8))


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'activestructure-gym\[mujoco\]'"):
        load_world("mujoco?model=x.xml")


def test_without_opengl_the_message_names_the_remedy(mujoco_room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import ctypes

    def missing(name: str) -> None:
        raise OSError(name)

    name = f"mujoco?model={mujoco_room}&start=1,2,1.2,0"
    monkeypatch.setenv("EGL_DEVICE_ID", "63")
    with pytest.raises(InputError, match="could not create an OpenGL context.*libegl1"):
        load_world(name)
    monkeypatch.setattr(ctypes, "CDLL", missing)
    with pytest.raises(InputError, match="EGL, which is missing.*libegl1.*libosmesa6"):
        load_world(name)
    import mujoco

    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(mujoco, "GLContext", missing)
    with pytest.raises(InputError, match="MUJOCO_GL=osmesa.*libosmesa6"):
        load_world(name)


@pytest.mark.parametrize("platform", ["osmesa", "egl"])
def test_platforms_that_the_environment_names(mujoco_room: Path, platform: str) -> None:
    from ctypes.util import find_library

    if platform == "osmesa" and find_library("OSMesa") is None:
        pytest.skip("libosmesa6 is not installed")
    code = (
        "import sys; from activestructure_gym.worlds import load_world; world = load_world(sys.argv[1]);"
        "print(world.capture(world.start.pose).depth[20, 30])"
    )
    name = f"mujoco?model={mujoco_room}&start=1,2,1.2,0&width=60&height=40"
    environment = {**os.environ, "MUJOCO_GL": platform, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment.pop("PYOPENGL_PLATFORM", None)
    ran = subprocess.run([sys.executable, "-c", code, name], capture_output=True, text=True, env=environment)
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout) == pytest.approx(4.0, abs=0.01)  # to the wall


def test_opengl_that_cannot_draw_is_reported(mujoco_room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import mujoco

    def broken(*_: Any) -> None:
        raise mujoco.FatalError("no platform library")

    monkeypatch.setattr(mujoco, "MjrContext", broken)
    with pytest.raises(InputError, match="cannot draw with the OpenGL of this machine: no platform.*libgl1"):
        load_world(f"mujoco?model={mujoco_room}&start=1,2,1.2,0")


def test_a_fork_does_not_draw(mujoco_room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = load_world(f"mujoco?model={mujoco_room}&start=1,2,1.2,0")
    monkeypatch.setattr(os, "getpid", lambda: -1)
    with pytest.raises(InputError, match="'spawn' or 'forkserver'"):
        world.capture(world.start.pose)
    monkeypatch.undo()
    world.close()


def test_worlds_draw_in_turn_and_in_threads(mujoco_room: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    name = f"mujoco?model={mujoco_room}&start=1,2,1.2,0"
    one, other = load_world(name), load_world(name + "&width=40&height=30")
    first = one.capture(one.start.pose)
    other.capture(other.start.pose)
    other.close()
    with ThreadPoolExecutor(1) as pool:
        again = pool.submit(one.capture, one.start.pose).result()
    np.testing.assert_array_equal(first.rgb, again.rgb)
    one.close()


def test_an_environment_of_a_model_is_made_by_name(mujoco_room: Path) -> None:
    env = ReconstructionEnv(f"world:mujoco?model={mujoco_room}&width=48&height=32", preset="fast", frame_budget=20)
    first = env.reset(seed=1)[0]["pose"]
    assert not np.array_equal(first, env.reset(seed=2)[0]["pose"])  # the seed draws the start
    np.testing.assert_array_equal(first, env.reset(seed=1)[0]["pose"])
    env.close()
