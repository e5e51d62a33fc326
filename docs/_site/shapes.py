"""Shapes and units of arguments and results, which signatures say in comments beside them."""

from __future__ import annotations

import ast
import inspect
import io
import re
import textwrap
import tokenize
from typing import Any


def tell_shapes(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Add them to what autodoc shows of a function, method or property."""
    if what not in ("function", "method", "property"):
        return
    said = [f"``{name}`` {_plain(words)}" if name else _plain(words) for name, words in shapes(thing)]
    if said:
        lines += ["", f"Shapes and units: {'; '.join(said)}.", ""]


def shapes(thing: Any) -> list[tuple[str, str]]:
    """What the comments in a function's signature say: of its arguments by name, and of its result."""
    function: Any = thing.fget if isinstance(thing, property) else inspect.unwrap(thing)
    try:
        source = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):  # it is compiled, or no function
        return []
    node = ast.parse(source).body[0]
    if not isinstance(node, ast.FunctionDef):
        return []
    said = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT and not token.line.lstrip().startswith("#")
    }
    asked = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    last = (node.returns.end_lineno if node.returns else None) or node.lineno
    rows = [
        (one.arg, said[one.end_lineno])
        for one in asked
        if one.end_lineno in said and one.end_lineno != last  # whose comment is the result's
    ]
    if last in said:
        rows.append(("", said[last] if "->" in said[last] else f"returns {said[last]}"))
    return rows


def _plain(words: str) -> str:
    """Words in which nothing but code is marked up."""
    parts = words.split("`")
    parts[::2] = [re.sub(r"([*|_\\])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)
