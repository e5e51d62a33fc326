"""Check that rooms import only the rooms above them, in the order of docs/architecture.md.

`ORDER` is the only place where the order of the rooms stands in code; docs/architecture.md shows the same list.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import networkx as nx
import pytest

from tests.parsed import nodes

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "activestructure_gym"
TOP = (PACKAGE, "envs", "policies", "evaluation")

# From the ground up: a room may import those before it. Rooms of one line do not know each other.
ORDER: tuple[tuple[str, ...], ...] = (
    ("errors", "cores", "files", "_version"),
    ("registry", "specs", "ranges", "npz", "owners", "ply_header", "streams"),
    ("compiling",),
    ("geometry",),
    ("scenes",),
    ("ground_truth", "sensors"),
    ("splatting", "volume"),
    ("mapping", "motion"),
    ("planes",),
    ("views",),
    ("features",),
    ("sources",),
    ("config",),
    ("worlds",),
    ("reconstruction",),
    ("viewer",),
    ("envs",),
    ("policies",),
    ("evaluation.machine", "evaluation.statistics"),
    ("evaluation.metrics",),
    ("evaluation.protocols",),
    ("evaluation.archive",),
    ("checks",),
    ("evaluation.report", "evaluation.trajectories"),
    ("evaluation.references",),
    ("evaluation.running",),
    ("explorer",),
    ("evaluation.export", "evaluation.replay", "evaluation.reproduction"),
    ("evaluation.training",),
    ("evaluation.benchmarks",),
    ("evaluation.cli",),
)
LEVEL = {room: level for level, rooms in enumerate(ORDER) for room in rooms}


@dataclass(frozen=True)
class Import:
    """One import statement: which module asks for which, and where."""

    importer: str
    imported: str
    place: str


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts if parts[0] == PACKAGE else (PACKAGE, *parts))


@cache
def modules() -> dict[str, Path]:
    paths = (path for top in TOP for path in sorted((ROOT / top).rglob("*.py")) if "__pycache__" not in path.parts)
    return {module_name(path): path for path in paths}


def room_of(module: str) -> str:
    """``activestructure_gym.evaluation.report.page.document`` stands in ``evaluation.report``."""
    parts = module.split(".")[1:]
    return ".".join(parts[:2]) if parts[0] == "evaluation" and len(parts) > 1 else parts[0]


def imports_of(name: str, path: Path) -> Iterator[Import]:
    """Every import of our own modules, those for types and those inside functions too."""
    known = modules()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            targets = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for target in targets:
            while target and target not in known:
                target = target.rpartition(".")[0]
            if target and target not in (name, PACKAGE):
                yield Import(name, target, f"{path.relative_to(ROOT)}:{node.lineno}")


@cache
def every_import() -> tuple[Import, ...]:
    return tuple(found for name, path in modules().items() if name != PACKAGE for found in imports_of(name, path))


def circles(pairs: Iterator[tuple[str, str]]) -> list[list[str]]:
    graph = nx.DiGraph((a, b) for a, b in pairs if a != b)
    return [sorted(found) for found in nx.strongly_connected_components(graph) if len(found) > 1]


def test_every_room_has_its_place() -> None:
    rooms = {room_of(name) for name in modules() if name != PACKAGE} - {"evaluation"}
    assert rooms == set(LEVEL), f"say where they stand in ORDER: {sorted(rooms ^ set(LEVEL))}"


def test_nothing_imports_upwards() -> None:
    wrong = []
    for found in every_import():
        lower, upper = room_of(found.importer), room_of(found.imported)
        if lower != upper and "evaluation" not in (lower, upper) and LEVEL[upper] >= LEVEL[lower]:
            wrong.append(f"{found.place}: {lower} imports {upper}")
    assert not wrong, "\n".join(wrong)


def test_there_is_no_circle_between_files() -> None:
    found = circles((one.importer, one.imported) for one in every_import())
    assert not found, "\n".join(" <-> ".join(circle) for circle in found)


def test_there_is_no_circle_between_rooms() -> None:
    assert not circles((room_of(one.importer), room_of(one.imported)) for one in every_import())


def test_a_circle_and_a_step_up_would_be_found() -> None:
    assert circles(iter([("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")])) == [["a", "b", "c"]]
    assert LEVEL["planes"] < LEVEL["features"] < LEVEL["policies"] < LEVEL["evaluation.cli"]


def test_the_docs_show_this_order() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    lines = [", ".join(f"`{room}`" for room in rooms) for rooms in ORDER]
    places = [text.find(f"{number}. {line}") for number, line in enumerate(lines, start=1)]
    missing = [lines[number] for number, place in enumerate(places) if place < 0]
    assert not missing, f"docs/architecture.md lacks {missing}"
    assert places == sorted(places)


@pytest.mark.parametrize("room", ["features", "views", "planes", "mapping", "volume"])
def test_no_room_of_the_planners_side_knows_the_truth(room: str) -> None:
    """What features and observations are made of never imports a scene or its truth."""
    for found in every_import():
        if room_of(found.importer) == room:
            assert room_of(found.imported) not in ("scenes", "ground_truth"), found.place


@cache
def blind() -> frozenset[str]:
    """Files of `policies` that never see the map: all but `features.py` and `sources.py` of a planner, and their own.

    Those are `policy.py` of every folder, what stands in none, the folder `learned`, and whatever these import.
    """
    room = [name for name in modules() if name != PACKAGE and room_of(name) == "policies"]
    waiting = [name for name in room if name.endswith(".policy") or name.count(".") < 3 or ".learned." in name]
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += [one.imported for one in every_import() if one.importer == name and one.imported in room]
    return frozenset(found)


def test_policies_know_names_and_nothing_of_the_world() -> None:
    allowed = ("policies", "registry", "errors", "files", "specs", "ranges")
    for found in every_import():
        if found.importer in blind():
            assert room_of(found.imported) in allowed or found.imported.endswith("envs.observation"), found.place


def test_a_planner_s_features_and_sources_stand_where_the_shared_ones_do() -> None:
    """They import what those rooms may, and their own folder; nothing else of `policies` is left."""
    seeing = {name for name in modules() if name != PACKAGE and room_of(name) == "policies"} - blind()
    assert len([name for name in seeing if name.endswith(".features")]) > 15
    for found in every_import():
        if found.importer in seeing and room_of(found.imported) != "policies":
            assert LEVEL[room_of(found.imported)] <= LEVEL["sources"], found.place
            assert room_of(found.imported) not in ("scenes", "ground_truth"), found.place
        elif found.importer in seeing:
            assert found.imported.rpartition(".")[0] == found.importer.rpartition(".")[0], found.place


def test_a_policy_that_looks_at_the_map_would_be_found() -> None:
    planner = f"{PACKAGE}.policies.naruto"
    assert {f"{planner}.policy", f"{PACKAGE}.policies.base"} <= blind()
    assert not {f"{planner}.features", f"{planner}.sources", f"{PACKAGE}.policies.popgs.block_features"} & blind()
