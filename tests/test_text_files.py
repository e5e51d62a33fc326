"""Text is read and written in UTF-8, whatever the locale says; and only the doors write to a terminal."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tests.parsed import dotted, nodes

ROOT = Path(__file__).resolve().parents[1]
TOP = ("activestructure_gym", "envs", "policies", "evaluation", "benchmarks", "examples", "docs")
# Who writes for another process, or into a log: not to a terminal.
WORKERS = {"evaluation/running/worker.py"}
DOORS = {"activestructure_gym/streams.py", "evaluation/cli/output.py"}


def calls(module: Iterable[ast.AST]) -> Iterator[tuple[int, str, ast.Call]]:
    """Yield every call of a module: its line and the name that is called, with what stands in front of it."""
    return ((node.lineno, dotted(node.func), node) for node in module if isinstance(node, ast.Call))


def without_encoding(module: Iterable[ast.AST]) -> Iterator[tuple[int, str]]:
    """Calls that read or write text in the encoding of the locale."""
    for line, called, node in calls(module):
        front, _, name = called.rpartition(".")
        named = {word.arg for word in node.keywords}
        if "encoding" in named or (name in ("open", "fdopen") and _is_binary(front, name, node)):
            continue
        if name in ("read_text", "write_text", "open", "fdopen", "TextIOWrapper", "FileHandler"):
            yield line, called
        if front == "subprocess" and named & {"text", "universal_newlines"}:
            yield line, called


def _is_binary(front: str, name: str, node: ast.Call) -> bool:
    """Whether it is no file of text: a descriptor, an entry of an archive, a picture, or a mode with a b."""
    if name == "open" and front in ("os", "archive", "images", "Image"):
        return True
    of_a_path = name == "open" and front not in ("", "io", "gzip", "bz2", "lzma")  # path.open(mode)
    modes = [*(node.args[:1] if of_a_path else node.args[1:2]), *(w.value for w in node.keywords if w.arg == "mode")]
    constants = [part.value for mode in modes for part in ast.walk(mode) if isinstance(part, ast.Constant)]
    return any(isinstance(value, str) and "b" in value for value in constants)


def written_past_the_doors(module: Sequence[ast.AST]) -> Iterator[tuple[int, str]]:
    """Calls that write to a standard stream by themselves, or open a console of their own."""
    for line, called, _ in calls(module):
        if called in ("print", "sys.stdout.write", "sys.stderr.write", "Console", "rich.print", "traceback.print_exc"):
            yield line, called
        elif called.endswith(".markup.escape"):
            yield line, called
    for node in module:
        if isinstance(node, ast.ImportFrom) and node.module == "rich.markup":
            yield node.lineno, "rich.markup"


def modules(*top: str) -> Iterator[tuple[str, Sequence[ast.AST]]]:
    for folder in top:
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), nodes(path)


def test_no_text_file_is_opened_in_the_encoding_of_the_locale() -> None:
    wrong = [f"{path}:{line} {called}" for path, module in modules(*TOP) for line, called in without_encoding(module)]
    assert not wrong, f"say encoding='utf-8': {wrong}"


def test_only_the_doors_write_to_a_terminal() -> None:
    wrong = [
        f"{path}:{line} {called}"
        for path, module in modules("activestructure_gym", "envs", "policies", "evaluation")
        if path not in DOORS | WORKERS
        for line, called in written_past_the_doors(module)
    ]
    assert not wrong, f"use say, complain, escape of streams, or make_console: {wrong}"


def walked(text: str) -> list[ast.AST]:
    return list(ast.walk(ast.parse(text)))


def test_what_would_be_found() -> None:
    found = (
        "open('b'); open(a, 'w'); p.read_text(); os.fdopen(1, 'w'); subprocess.run(a, text=True); gzip.open(a, 'rt')"
    )
    assert len(list(without_encoding(walked(found)))) == 6
    passed = "open(a, 'rb'); open(a, 'wb' if b else 'ab'); p.open(mode='rb'); open(a, encoding='utf-8'); os.open(a, 0)"
    assert not list(without_encoding(walked(passed)))
    assert len(list(written_past_the_doors(walked("print(1); Console(); from rich.markup import escape")))) == 3
