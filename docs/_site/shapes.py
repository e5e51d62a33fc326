"""Add the shapes and units of arguments and results to the reference, from comments in signatures."""

from __future__ import annotations

import ast
import inspect
import io
import re
import textwrap
import tokenize
from typing import Any


def add_shapes(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Append shapes and units to the lines of a docstring; Sphinx calls this for every documented object."""
    if what not in ("function", "method", "property"):
        return
    comments = [f"``{name}`` {_plain(words)}" if name else _plain(words) for name, words in shapes(thing)]
    if comments:
        lines += ["", f"Shapes and units: {'; '.join(comments)}.", ""]


def shapes(thing: Any) -> list[tuple[str, str]]:
    """Return (argument, comment) for every comment in a function's signature; the argument is "" for the result."""
    function: Any = thing.fget if isinstance(thing, property) else inspect.unwrap(thing)
    try:
        source = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):  # compiled, or not a function
        return []
    node = ast.parse(source).body[0]
    if not isinstance(node, ast.FunctionDef):
        return []
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT and not token.line.lstrip().startswith("#")
    }
    asked = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    last = (node.returns.end_lineno if node.returns else None) or node.lineno
    rows = [
        (one.arg, comments[one.end_lineno])
        for one in asked
        if one.end_lineno in comments and one.end_lineno != last  # a comment on the last line is on the result
    ]
    if last in comments:
        rows.append(("", comments[last] if "->" in comments[last] else f"returns {comments[last]}"))
    return rows


def _plain(words: str) -> str:
    """Escape reStructuredText characters in a text, except in code between backticks."""
    parts = words.split("`")
    parts[::2] = [re.sub(r"([*|_\\])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)
