"""Make a page per environment: its docstring, code that makes it, and a film of two planners."""

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
# Scene of the film by environment. Images of datasets may not be published, so their pages show that of Mesh-v0.
SHOWN_IN = {"Room-v0": "room", "Apartment-v0": "apartment", "Mesh-v0": "flat.glb?up=y",
            "World-v0": "simulated?scene=room"}  # fmt: skip
FLAT = "apartment?rooms=1&seed=5"  # the scene in flat.glb
POLICIES, FRAMES = ["random", "activestructure"], 150  # of the two episodes in a film, from left to right


def pages(made: Path) -> dict[str, str]:
    """Return the pages by file name, and write their films below the folder ``made``."""
    films = {task: film(task, made / "environments") for task in SHOWN_IN}
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
        picture = f"![{' and '.join(POLICIES)} in {task}]({films.get(task, films['Mesh-v0'])})"
        cards.append(f"- [{picture}]({task.lower()}.md)\n  [**{task}**]({task.lower()}.md): {summary}")
    names = "\n".join(task.lower() for task in TASKS)
    return (
        "# Environments\n\nOne environment in six tasks, which differ in what they explore. Scenes of Replica and "
        "Matterport3D may not be published here; their film is that of Mesh-v0.\n\n"
        + "\n".join(cards)
        + f"\n\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )


def _page(task: str, kind: type, films: Mapping[str, str]) -> str:
    lines = inspect.cleandoc(kind.__doc__ or "").replace(
        "listed in `activestructure_gym.envs.observation`", "listed in [observation.md](../../reference/observation.md)"
    )
    shown = task if task in SHOWN_IN else "Mesh-v0"
    curve = "known space" if task == "World-v0" else "observed surface"  # a world has no ground truth
    notes = {"Mesh-v0": f" `flat.glb` is `{FLAT}`, written to a glTF file and read from there."} | {
        f"{name}-v0": f" Scenes of {name} may not be published here, so the film is that of Mesh-v0."
        for name in ("Replica", "Matterport3D")
    }
    planners = " and ".join(f"`{name}`" for name in POLICIES)
    figure = (
        f"```{{figure}} {films[shown]}\n"
        f":alt: {planners.replace('`', '')}: their maps grow along the camera's path, with the {curve} below\n\n"
        f"{planners} explore `{SHOWN_IN[shown]}` for {FRAMES} frames with preset `fast`: their maps grow along the "
        f"camera's path, with the {curve} below.{notes.get(task, '')}\n```\n\n"
    )
    make = f'import gymnasium as gym\n\nenv = gym.make("activestructure_gym:{NAMESPACE}/{task}"'
    scene = inspect.signature(kind).parameters.get("scene")
    make += f', world="{SHOWN_IN[task]}")' if scene is None else ', scene="...")' if scene.default is None else ")"
    # The docstring of an environment begins with a heading of level 2.
    return f"# {task}\n\n{figure}```python\n{make}\n```\n\n{lines}\n"


def film(task: str, folder: Path) -> str:
    """Return the name of the file in ``folder`` with the film of the environment ``task``, such as "Room-v0".

    The film is made if the file does not exist, or if the code has changed since.
    """
    path = folder / f"{task.lower()}-{_code()}.webp"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{task.lower()}-*.webp"):
            old.unlink()
        _play(task, path)
    return path.name


@cache
def _code() -> str:
    """Return a checksum of this file and of all code that affects an episode or a film."""
    rooms = ("activestructure_gym", "envs", "evaluation", "policies")
    files = [path for room in rooms for path in (ROOT / room).rglob("*.py")]
    total = hashlib.sha256()
    for path in (*sorted(files), Path(__file__)):
        total.update(path.read_bytes())
    return total.hexdigest()[:8]


def _play(task: str, path: Path) -> None:
    """Play the episodes of the environment ``task``, and write their film to ``path``."""
    from _site.mesh_file import write_glb
    from activestructure_gym.evaluation import Conditions, StandardProtocol, compare
    from activestructure_gym.evaluation.replay import play_again, write_video
    from activestructure_gym.scenes import load_scene

    # Of the metrics, the film shows only the observed surface.
    protocol = StandardProtocol(surface_samples=20_000, views=1, points_source="means")
    conditions = Conditions(preset="fast", frame_budget=FRAMES, protocol=protocol)
    with tempfile.TemporaryDirectory() as folder:
        scene = SHOWN_IN[task]
        if task == "World-v0":
            scene = f"world:{scene}"
        elif task == "Mesh-v0":
            write_glb(load_scene(FLAT).mesh, Path(folder, scene.partition("?")[0]))
            scene = f"{folder}/{scene}"
        runs = compare([scene], POLICIES, f"{folder}/runs", conditions=conditions, engine="inline").runs
        write_video([play_again(run) for run in sorted(runs, key=lambda run: POLICIES.index(run.policy))], path)
