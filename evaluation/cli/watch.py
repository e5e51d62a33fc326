"""Define ``asg watch``, which plays an episode and shows it in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import ip_address
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.fields import Changes, Count, Switch, option
from activestructure_gym.evaluation.cli.options import parse_overrides, parse_start, split_scenes
from activestructure_gym.evaluation.cli.output import make_console, working
from activestructure_gym.policies.native_settings import NATIVE_PRESET, Setup
from activestructure_gym.streams import complain

if TYPE_CHECKING:
    import gymnasium as gym

    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.policies import Policy
    from activestructure_gym.viewer import LiveView

YOU = "you"  # value of --policy with which the user chooses every view on the page
_COLOURED_BY = "hole_area"  # policy whose feature colours the candidates if the user chooses


@dataclass(frozen=True)
class Watch:
    """Show a running episode in a browser.

    The page shows the growing map, planes, candidates and the camera. You can pause, step, go back in time, and click a
    candidate to send the agent there. Without --host only this machine can open the page. Ctrl+C ends it.
    """

    scene: Annotated[str, option("SCENE")] = "room"
    """Explore this scene: a name (see `asg list scenes`) or a file."""
    world: Annotated[str | None, option("WORLD", "")] = None
    """Explore this world in place of a scene: a name or package.module:factory; see `asg explore --help`."""
    policy: Annotated[str, option("NAME")] = "activestructure"
    """Explore with this policy (see `asg list policies`); with `you`, choose every view yourself."""
    seed: int = 0
    """Set the random seed: the same start as in `asg compare`."""
    preset: Annotated[str | None, option("rl|fast|default|full|paper", "(default: default)")] = None
    """Use the configuration that `asg list config PRESET` prints."""
    setup: Setup = "shared"
    """Use the common candidates, keyframes and mapper (shared), or the planner's own with preset full (native)."""
    frames: Count = None
    """Stop after this many frames (default: the preset's)."""
    start: Annotated[str | None, option("X,Y,Z,YAW", "")] = None
    """Start at x,y,z,yaw in metres and degrees (write --start=-1,2,1.4,90)."""
    set: Changes = ()
    """Change fields of the configuration (see `asg list config`)."""
    port: Annotated[int, option("N", "(default: a free one)")] = 0
    """Serve the page on this port."""
    host: Annotated[str, option("IP", "(default: 127.0.0.1)")] = "127.0.0.1"
    """Serve the page at this address of the machine; everyone with the link can watch and steer."""
    paused: Switch = False
    """Begin paused."""
    exit: Switch = False
    """Exit when the episode ends, instead of serving the page until Ctrl+C."""

    def run(self) -> int:
        """Serve the page and play the episode; then serve the page until Ctrl+C, except with ``--exit``."""
        from activestructure_gym.viewer import LiveView

        env, policy = self._make()
        try:
            view = LiveView(
                f"{self.policy} · {self.world or self.scene} · seed {self.seed}",
                address=self.host,
                port=self.port,
                chooses=True,
                asks=self.policy == YOU,
                paused=self.paused,
            )
        except BaseException:
            env.close()
            raise
        console = make_console()
        if not ip_address(self.host).is_loopback:
            complain(
                f"note: everyone who reaches {self.host} and has the link can watch and steer, and the connection is "
                "not encrypted"
            )
        console.print(f"Watch at [bold]{view.url}[/] (Ctrl+C ends)", soft_wrap=True)
        try:
            with working(console, "exploring") as say:
                summary = play(env, policy, self.policy, self.seed, view, say)
            console.print(f"The episode has ended: {summary}")
            while not self.exit:
                try:
                    time.sleep(1.0)
                except KeyboardInterrupt:
                    break
        finally:
            view.close()
            env.close()
        return 0

    def _make(self) -> tuple[gym.Env[Any, Any], Policy]:
        from activestructure_gym.policies import make_env_and_policy
        from activestructure_gym.scenes.library import check_scene_name
        from activestructure_gym.worlds.registry import PREFIX, check_world_name

        scenes = split_scenes((self.scene,))
        if not scenes:
            raise InputError(f"--scene names a scene to explore, got '{self.scene}'; `asg list scenes` lists the names")
        if self.world is not None:
            scenes = (PREFIX + self.world.removeprefix(PREFIX),)
            check_world_name(scenes[0])
        else:
            for scene in scenes:
                check_scene_name(scene)
        preset = self.preset or (NATIVE_PRESET if self.setup == "native" else "default")
        return make_env_and_policy(
            _COLOURED_BY if self.policy == YOU else self.policy,
            list(scenes) if len(scenes) > 1 else scenes[0],
            setup=self.setup,
            preset=preset,
            frame_budget=self.frames,
            config=parse_overrides(self.set),
            start_pose=parse_start(self.start),
            coverage_target=None,
            disable_env_checker=True,
        )


def play(
    env: gym.Env[Any, Any], policy: Policy, name: str, seed: int, view: LiveView, say: Callable[[str], None]
) -> str:
    """Play one episode, show it on the page ``view``, and return a summary as text.

    If the policy's ``name`` is `YOU`, the user chooses every view on the page. ``say`` is called with a text after
    every step.
    """
    from activestructure_gym.envs.reward import known_volume
    from activestructure_gym.evaluation.running.actors import chosen_row

    shell: ReconstructionEnv = env.unwrapped  # type: ignore[assignment]
    asks = name == YOU
    observation, info = env.reset(seed=seed)
    policy.reset(seed)
    episode, names = shell.reconstruction, shell.config.features
    view.begin(episode, names[0] if names else "")
    ended = False
    while not ended:
        wanted = None if asks else chosen_row(name, shell, policy.act(observation))
        view.show(None if asks else policy.trace().get("phase"))
        if wanted is not None:
            view.chosen(wanted)
        clicked = view.wait()
        row = wanted if clicked is None else clicked
        if row is None:  # the page was closed
            break
        view.chosen(row)
        observation, _, terminated, truncated, info = env.step(np.int64(row))
        ended = terminated or truncated
        say(f"exploring: {info['frames']} of {episode.frame_budget} frames, {info['gaussians']} Gaussians")
    view.show()
    view.end()
    if "ground_truth" in info:
        observed = f"{known_volume(episode.volume):.1f} m³ known, no ground truth"
    else:
        observed = f"{shell.coverage.share:.1%} of the surface observed"
    return (
        f"{info['frames']} frames, {info['metres']:.1f} m, {info['gaussians']} Gaussians, {info['planes']} planes, "
        f"{observed}"
    )
