"""The reference: a page per room with everything that may be imported from it, from the docstrings."""

from __future__ import annotations

import importlib
import inspect

# Those of docs/guide/api.md, and what its sections send to.
ROOMS = {
    "activestructure_gym": "What most programs need",
    "activestructure_gym.envs": "Environments",
    "activestructure_gym.policies": "Policies",
    "activestructure_gym.policies.learned": "Learned policies",
    "activestructure_gym.features": "Features of candidates",
    "activestructure_gym.sources": "Candidate sources",
    "activestructure_gym.scenes": "Scenes",
    "activestructure_gym.mapping": "The Gaussian map",
    "activestructure_gym.planes": "The Plane Scene Graph",
    "activestructure_gym.evaluation": "Evaluation",
    "activestructure_gym.viewer": "The viewer",
}


def pages() -> dict[str, str]:
    """A page per room, and their list."""
    texts = {f"reference/{room}.md": _page(room, title) for room, title in ROOMS.items()}
    names = "\n".join(ROOMS)
    texts["reference/index.md"] = (
        "# Reference\n\nWhat may be imported, room by room, with shapes, units and frames. The names of "
        "[the list](../../guide/api.md) stay; what stands here and not there may move.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n"
    )
    return texts


def _page(room: str, title: str) -> str:
    module = importlib.import_module(room)
    lines = [
        f"# {title}",
        "",
        f"`{room}`",
        "",
        "```{eval-rst}",
        f".. automodule:: {room}",
        "   :no-members:",
        "```",
        "",
    ]
    for name in module.__all__:
        thing = getattr(module, name)
        lines += ["```{eval-rst}", *_entry(room, name, thing), "```", ""]
    return "\n".join(lines)


def _entry(room: str, name: str, thing: object) -> list[str]:
    # Registered policies have pages of their own; the environment's manual is Markdown, and has one too.
    if inspect.isclass(thing):
        if "## Description" in (thing.__doc__ or ""):
            return [f".. py:class:: {room}.{name}", "   :no-index:", "", "   See :doc:`/_made/environments/index`."]
        return [f".. autoclass:: {room}.{name}", "   :members:", "   :no-index:"]
    if inspect.isfunction(thing):
        return [f".. autofunction:: {room}.{name}", "   :no-index:"]
    return [f".. py:data:: {room}.{name}", "   :no-index:", f"   :type: {type(thing).__name__}"]
