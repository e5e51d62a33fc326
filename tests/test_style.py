"""What is held for the sake of who reads it: no function with more than eight positional parameters."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOP = ("activestructure_gym", "envs", "policies", "evaluation")
MOST = 8

# Functions, nearly all kernels, that are still above it, with what they take; this list may only shrink.
ABOVE = {
    "activestructure_gym/mapping/map_passes.py:larger_in_view": 9,
    "activestructure_gym/planes/detection_kernels.py:explained_shares": 10,
    "activestructure_gym/planes/detection_kernels.py:grow_regions": 11,
    "activestructure_gym/planes/detection_kernels.py:refine_pixels": 13,
    "activestructure_gym/planes/quality_kernels.py:open_sides": 10,
    "activestructure_gym/planes/surface_kernels.py:count_hits": 11,
    "activestructure_gym/planes/surface_kernels.py:image_sums": 9,
    "activestructure_gym/planes/surface_kernels.py:join": 11,
    "activestructure_gym/planes/surface_kernels.py:look_up_cells": 15,
    "evaluation/metrics/fusion.py:_integrate": 9,
    "evaluation/metrics/nearest.py:_search": 9,
}


def positional_parameters() -> dict[str, int]:
    """Of every function and method, itself not counted."""
    found = {}
    for top in TOP:
        for path in sorted((ROOT / top).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args)]
                    count = len(names) - (names[:1] in (["self"], ["cls"], ["ctx"]))
                    place = f"{path.relative_to(ROOT).as_posix()}:{node.name}"
                    found[place] = max(count, found.get(place, 0))
    return found


def test_no_function_takes_more_than_eight_positional_parameters() -> None:
    above = {name: count for name, count in positional_parameters().items() if count > MOST}
    new = {name: count for name, count in above.items() if count > ABOVE.get(name, MOST)}
    assert not new, f"pass what belongs together as a NamedTuple: {new}"
    assert above == ABOVE, f"the list may shrink: {sorted(ABOVE.items() - above.items())}"
