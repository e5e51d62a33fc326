"""Make the reference: a page per room with its public names, from docstrings and comments. A room is a package."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
from functools import cache
from typing import Any

from activestructure_gym.evaluation.cli.config import field_notes
from activestructure_gym.features.table import feature_table

# Titles of the rooms in docs/reference/api.md. A name that several rooms have is described in the last of these.
ROOMS = {
    "activestructure_gym": "The main functions and classes",
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
    """Return a page per room, the table of features, and the index of the reference, by file name."""
    texts = {f"reference/{room}.md": _page(room, title) for room, title in ROOMS.items()}
    texts["features/index.md"] = f"# Features\n\n{feature_table()}\n"
    names = "\n".join(ROOMS)
    texts["reference/index.md"] = (
        "# Python API\n\nPublic names by room, with shapes, units and frames. The names of "
        "[the list](../../reference/api.md) are stable; other names may move.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n"
    )
    return texts


@cache
def entries() -> dict[str, str]:
    """Return, for the full name of each public function's or class's definition, the name under which it is described.

    For example, "activestructure_gym.scenes.scene.Scene" is described as "activestructure_gym.scenes.Scene".
    """
    found = {}
    for room in ROOMS:
        module = importlib.import_module(room)
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                found[_written(thing)] = f"{room}.{name}"
    return found


def link_to_entry(app: Any, env: Any, node: Any, content: Any) -> Any:
    """Return a link for a name that Sphinx cannot resolve, if `entries` has it, else None.

    Sphinx calls this with the unresolved reference ``node`` and the node ``content`` that the link shows.
    """
    name = entries().get(node.get("reftarget", ""))
    if name is None:
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(env, node["refdoc"], app.builder, node["reftype"], name, node, content)


def field_words(kind: type) -> list[tuple[str, str, str, str]]:
    """Return (name, type, default, description) of each field that a dataclass defines itself and does not inherit."""
    source = inspect.cleandoc("\n" + inspect.getsource(kind))
    (body,) = (node.body for node in ast.parse(source).body if isinstance(node, ast.ClassDef))
    names, notes = {field.name for field in dataclasses.fields(kind)}, field_notes(kind)
    return [
        (node.target.id, ast.unparse(node.annotation), _default(node.value), notes[node.target.id])
        for node in body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id in names
    ]


def escaped(text: str) -> str:
    """Escape Markdown characters in a docstring or comment, except in code between backticks."""
    parts = text.split("`")
    parts[::2] = ["".join(f"\\{letter}" if letter in "*<>|_[]#" else letter for letter in part) for part in parts[::2]]
    parts[1::2] = [part.replace("|", "\\|") for part in parts[1::2]]
    return "`".join(parts)


def _written(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"


def _default(value: ast.expr | None) -> str:
    if value is None:
        return ""
    if isinstance(value, ast.Call) and ast.unparse(value.func) in ("field", "dataclasses.field"):
        made = [word.value for word in value.keywords if word.arg in ("default", "default_factory")]
        return ast.unparse(made[0]) if made else ""
    return ast.unparse(value)


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
        if _has_table(thing) and _has_entry_in(thing, room, name):
            lines += _fields(thing)
    return "\n".join(lines)


def _has_entry_in(thing: Any, room: str, name: str) -> bool:
    return entries()[_written(thing)] == f"{room}.{name}"


def _entry(room: str, name: str, thing: object) -> list[str]:
    # Environments have their own pages.
    if inspect.isclass(thing):
        if not _has_entry_in(thing, room, name):
            return [f"`{name}`: :py:class:`{entries()[_written(thing)]}`"]
        if "## Description" in (thing.__doc__ or ""):
            return [f".. py:class:: {name}", f"   :module: {room}", "", "   See :doc:`/_made/environments/index`."]
        if _has_table(thing):
            return [f".. autoclass:: {room}.{name}(...)", "   :members:"]
        return [f".. autoclass:: {room}.{name}", "   :members:"]
    if inspect.isfunction(thing):
        if not _has_entry_in(thing, room, name):
            return [f"`{name}`: :py:func:`{entries()[_written(thing)]}`"]
        return [f".. autofunction:: {room}.{name}"]
    return [f".. py:data:: {name}", f"   :module: {room}", f"   :type: {type(thing).__name__}"]


def _has_table(thing: object) -> bool:
    """Return whether ``thing`` is a dataclass whose fields are described by comments and not in its docstring."""
    if not (isinstance(thing, type) and dataclasses.is_dataclass(thing)):
        return False
    comments = [bool(words) for *_, words in field_words(thing)]
    return any(comments) and (all(comments) or "Parameters\n" not in (inspect.getdoc(thing) or ""))


def _fields(kind: type) -> list[str]:
    table = ["| field | type | default | meaning |", "|---|---|---|---|"]
    for name, annotation, default, words in field_words(kind):
        cells = (f"`{name}`", *(f"`{text}`".replace("|", "\\|") if text else "" for text in (annotation, default)))
        table.append(f"| {' | '.join(cells)} | {escaped(words)} |")
    return [*table, ""]
