"""Make a page per environment: its docstring, code that makes it, and an animation of an episode."""

from __future__ import annotations

import hashlib
import inspect
import re
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from activestructure_gym.envs import tasks
from activestructure_gym.envs.registration import NAMESPACE, TASKS

ROOT = Path(__file__).parents[2]
# Scene of the animation by environment. Images of datasets may not be published, so their pages show that of Mesh-v0.
SHOWN_IN = {"Room-v0": "room", "Apartment-v0": "apartment?rooms=2", "Mesh-v0": "flat.glb?up=y",
            "World-v0": "simulated?scene=room"}  # fmt: skip
FLAT = "apartment?rooms=1&seed=5"  # the scene in flat.glb
POLICY, FRAMES, SEED = "activestructure", 150, 0  # of the episode in an animation
_WIDTH = 720  # width of an animation in pixels
_MILLISECONDS = 700  # duration of a decision in an animation


def pages(made: Path) -> dict[str, str]:
    """Return the pages by file name, and write their animations below the folder ``made``."""
    films = {task: animation(task, made / "environments") for task in SHOWN_IN}
    texts = {"environments/index.md": _index(films)}
    for task, class_name in TASKS.items():
        texts[f"environments/{task.lower()}.md"] = _page(task, getattr(tasks, class_name), films)
    return texts


def _index(films: Mapping[str, str]) -> str:
    cards = []
    for task, class_name in TASKS.items():
        (summary,) = re.findall(
            r"^\*\*.*?\*\*: (.*)$", inspect.cleandoc(getattr(tasks, class_name).__doc__), re.MULTILINE
        )
        picture = f"![{POLICY} in {task}, decision by decision]({films.get(task, films['Mesh-v0'])})"
        cards.append(f"- [{picture}]({task.lower()}.md)\n  [**{task}**]({task.lower()}.md): {summary}")
    names = "\n".join(task.lower() for task in TASKS)
    return (
        "# Environments\n\nOne environment in six tasks, which differ in what they explore. Scenes of Replica and "
        "Matterport3D may not be published here; their pictures are those of Mesh-v0.\n\n"
        + "\n".join(cards)
        + f"\n\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )


def _page(task: str, kind: type, films: Mapping[str, str]) -> str:
    lines = inspect.cleandoc(kind.__doc__ or "").replace(
        "listed in `activestructure_gym.envs.observation`", "listed in [observation.md](../../reference/observation.md)"
    )
    film = task if task in SHOWN_IN else "Mesh-v0"
    notes = {
        "Mesh-v0": f" `flat.glb` is `{FLAT}`, written to a glTF file and read from there.",
        "Replica-v0": " Scenes of Replica may not be published here, so the animation is that of Mesh-v0.",
        "Matterport3D-v0": " Buildings of Matterport3D may not be published here, so the animation is that of Mesh-v0.",
    }
    shown = (
        f"```{{figure}} {films[film]}\n"
        f":alt: {POLICY} in {SHOWN_IN[film]}: camera, map and plan, decision by decision\n\n"
        f"`{POLICY}` in `{SHOWN_IN[film]}`, {FRAMES} frames, preset `fast`: what the camera sees, the map from the "
        f'same pose, and the plan with the path, as `render_mode="rgb_array"` shows them.{notes.get(task, "")}\n```\n\n'
    )
    make = f'import gymnasium as gym\n\nenv = gym.make("activestructure_gym:{NAMESPACE}/{task}"'
    scene = inspect.signature(kind).parameters.get("scene")
    make += f', world="{SHOWN_IN[task]}")' if scene is None else ', scene="...")' if scene.default is None else ")"
    # The docstring of an environment begins with a heading of level 2.
    return f"# {task}\n\n{shown}```python\n{make}\n```\n\n{lines}\n"


def animation(task: str, folder: Path) -> str:
    """Return the name of the file in ``folder`` with the animation of the environment ``task``, such as "Room-v0".

    The animation is made if the file does not exist, or if the code has changed since.
    """
    key = hashlib.sha256(f"{_code()} {SHOWN_IN[task]}".encode()).hexdigest()[:8]
    path = folder / f"{task.lower()}-{key}.webp"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{task.lower()}-*.webp"):
            old.unlink()
        _film(task, path)
    return path.name


@cache
def _code() -> str:
    """Return a checksum of this file and of all code that affects an episode."""
    files = [path for room in ("activestructure_gym", "envs", "policies") for path in (ROOT / room).rglob("*.py")]
    total = hashlib.sha256()
    for path in (*sorted(files), Path(__file__)):
        total.update(path.read_bytes())
    return total.hexdigest()


def _film(task: str, path: Path) -> None:
    from PIL import Image

    from _site.mesh_file import write_glb
    from activestructure_gym.policies import make_env_and_policy
    from activestructure_gym.scenes import Scene, load_scene

    scene: str | Scene = SHOWN_IN[task]
    if task == "Mesh-v0":
        with tempfile.TemporaryDirectory() as folder:
            name, _, options = SHOWN_IN[task].partition("?")
            write_glb(load_scene(FLAT).mesh, Path(folder) / name)
            scene = load_scene(f"mesh:{folder}/{name}?{options}")
    given = {"world" if task == "World-v0" else "scene": scene}
    env, policy = make_env_and_policy(
        POLICY,
        env_id=f"activestructure_gym:{NAMESPACE}/{task}",
        preset="fast",
        frame_budget=FRAMES,
        render_mode="rgb_array",
        **given,
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
