"""What is held for the sake of who reads it: no function with more than eight positional parameters."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.parsed import nodes

ROOT = Path(__file__).resolve().parents[1]
TOP = ("activestructure_gym", "envs", "policies", "evaluation")
MAX_POSITIONAL = 8


def positional_parameters() -> dict[str, int]:
    """Of every function and method, itself not counted."""
    found = {}
    for top in TOP:
        for path in sorted((ROOT / top).rglob("*.py")):
            for node in nodes(path):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args)]
                    count = len(names) - (names[:1] in (["self"], ["cls"], ["ctx"]))
                    place = f"{path.relative_to(ROOT).as_posix()}:{node.name}"
                    found[place] = max(count, found.get(place, 0))
    return found


def test_no_function_takes_more_than_eight_positional_parameters() -> None:
    above = {name: count for name, count in positional_parameters().items() if count > MAX_POSITIONAL}
    assert not above, f"pass what belongs together as a NamedTuple: {above}"
