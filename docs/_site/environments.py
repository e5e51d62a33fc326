"""A page per environment: its docstring, its signature, and a few decisions of an episode, played for the page."""

from __future__ import annotations

import hashlib
import inspect
from pathlib import Path

from activestructure_gym._version import __version__
from activestructure_gym.envs import tasks
from activestructure_gym.envs.registration import NAMESPACE, TASKS

# The scene each is shown in; the datasets' own would have to be fetched.
SHOWN_IN = {"Room-v0": "room", "Apartment-v0": "apartment?rooms=2"}
POLICY, FRAMES, SEED = "activestructure", 150, 0
_WIDTH = 720  # pixels
_MILLISECONDS = 700  # per decision


def pages(made: Path) -> dict[str, str]:
    """The pages by name, beside their animations in ``made``."""
    texts = {"environments/index.md": _index()}
    for task, class_name in TASKS.items():
        texts[f"environments/{task.lower()}.md"] = _page(task, getattr(tasks, class_name), made)
    return texts


def _index() -> str:
    names = "\n".join(task.lower() for task in TASKS)
    return (
        "# Environments\n\nOne environment in five tasks, which differ in the scenes they begin with.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n"
    )


def _page(task: str, kind: type, made: Path) -> str:
    lines = inspect.cleandoc(kind.__doc__ or "").replace(
        "listed in `activestructure_gym.envs.observation`", "listed in [observation.md](../../guide/observation.md)"
    )
    shown = ""
    if task in SHOWN_IN:
        name = animation(task, made / "environments")
        shown = (
            f"```{{figure}} {name}\n:alt: {POLICY} in {SHOWN_IN[task]}: camera, map and plan, decision by decision\n\n"
            f"`{POLICY}` in `{SHOWN_IN[task]}`, {FRAMES} frames, preset `fast`: what the camera sees, the map from the "
            'same pose, and the plan with the path, as `render_mode="rgb_array"` shows them.\n```\n\n'
        )
    make = f'import gymnasium as gym\n\nenv = gym.make("activestructure_gym:{NAMESPACE}/{task}"'
    make += ', scene="...")' if task not in SHOWN_IN else ")"
    # The manual's headings are of the second level already.
    return f"# {task}\n\n{shown}```python\n{make}\n```\n\n{lines}\n"


def animation(task: str, folder: Path) -> str:
    """Name of a moving picture of a short episode; it is made once per version of what it shows."""
    key = hashlib.sha256(f"{__version__} {SHOWN_IN[task]} {POLICY} {FRAMES} {SEED}".encode()).hexdigest()[:8]
    path = folder / f"{task.lower()}-{key}.webp"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{task.lower()}-*.webp"):
            old.unlink()
        _film(task, path)
    return path.name


def _film(task: str, path: Path) -> None:
    from PIL import Image

    from activestructure_gym.policies import make_env_and_policy

    env, policy = make_env_and_policy(
        POLICY, SHOWN_IN[task], preset="fast", frame_budget=FRAMES, render_mode="rgb_array"
    )
    policy.reset(SEED)
    observation, _ = env.reset(seed=SEED)
    pictures, ended = [env.render()], False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        pictures.append(env.render())
        ended = terminated or truncated
    env.close()
    images = [Image.fromarray(picture) for picture in pictures]
    height = round(_WIDTH * images[0].height / images[0].width)
    images = [image.resize((_WIDTH, height), Image.Resampling.LANCZOS) for image in images]
    durations = [_MILLISECONDS] * (len(images) - 1) + [4 * _MILLISECONDS]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0, quality=70, method=4)
