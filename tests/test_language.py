"""Check the language of docstrings, comments and pages: banned words, and sentences of more than 35 words."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.parsed import nodes

ROOT = Path(__file__).resolve().parents[1]
# Rooms and pages that were read against the style page. The others follow; this list only grows.
READ = (
    "activestructure_gym/*.py",
    "activestructure_gym/compiling",
    "activestructure_gym/features",
    "activestructure_gym/geometry",
    "activestructure_gym/ground_truth",
    "activestructure_gym/mapping",
    "activestructure_gym/motion",
    "activestructure_gym/planes",
    "activestructure_gym/reconstruction",
    "activestructure_gym/scenes",
    "activestructure_gym/sensors",
    "activestructure_gym/sources",
    "activestructure_gym/splatting",
    "activestructure_gym/viewer",
    "activestructure_gym/views",
    "activestructure_gym/volume",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "README.md",
    "benchmarks",
    "docs/_site",
    "docs/about/*.md",
    "docs/architecture.md",
    "docs/conf.py",
    "docs/explanation/*.md",
    "docs/howto/*.md",
    "docs/images/*.py",
    "docs/index.md",
    "docs/notebook/*.py",
    "docs/notebook/benchmark.md",
    "docs/notebook/exploration.md",
    "docs/notebook/grid.md",
    "docs/notebook/groundwork.md",
    "docs/notebook/learning.md",
    "docs/notebook/map.md",
    "docs/notebook/method.md",
    "docs/notebook/passive.md",
    "docs/notebook/performance.md",
    "docs/notebook/planners.md",
    "docs/notebook/rasteriser.md",
    "docs/notebook/refinement.md",
    "docs/notebook/results.md",
    "docs/package_index.md",
    "docs/reference/*.md",
    "docs/references.md",
    "docs/results/*.md",
    "docs/start/*.md",
    "envs",
    "evaluation/*.py",
    "evaluation/archive",
    "evaluation/benchmarks",
    "evaluation/cli",
    "evaluation/export",
    "evaluation/machine",
    "evaluation/metrics",
    "evaluation/protocols",
    "evaluation/references",
    "evaluation/replay",
    "evaluation/report",
    "evaluation/reproduction",
    "evaluation/running",
    "evaluation/statistics",
    "evaluation/training",
    "evaluation/trajectories",
    "examples",
    "policies",
    "policies/*/README.md",
)
# What to write instead is in brackets; a dash means: rewrite the sentence.
BANNED = {
    "told from": "significantly different from",
    "tell|tells": "show, state",
    "died|dead": "removed",
    "is worth": "utility, score",
    "stands?": "is",
    "lies": "is",
    "beside": "next to, in parallel",
    "by what|of then|not ours": "-",
    "today's": "current",
    "nobody|somebody|everybody|anybody|whoever": "-",
    "at hand": "available",
}
LONGEST = 35  # words of a sentence
_BANNED = re.compile("|".join(rf"\b(?:{words})\b" for words in BANNED), re.IGNORECASE)
_WHAT = re.compile(r"(?:^|[.:;] )What\b(?![^.]*\?)")  # a sentence whose subject is a clause with "what"
_CODE = re.compile(r"``.*?``|`.*?`|\"[^\"]*\"|'[^' ]*'")
_APART = re.compile(r"(?:>>>|\.\.\. |[-=]{3,}$|\||[-*] |\d+\. |#|!|```)")  # lines that are no part of a paragraph


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield the paragraphs and list items of a text, each with the offset of its first line; code is left out."""
    first, words, fenced, depth = 0, list[str](), False, 0
    for number, line in enumerate([*text.splitlines(), ""]):
        content, indent = line.strip(), len(line) - len(line.lstrip())
        fenced ^= content.startswith("```")
        apart = fenced or not content or _APART.match(content) is not None or (bool(words) and indent != depth)
        if apart and words:
            yield first, " ".join(words)
            words = []
        skipped = fenced or not content or re.match(r">>>|\.\.\. |[-=]{3,}$|\||```|!", content)
        if not skipped:
            item = re.match(r"[-*] |\d+\. ", content)
            if not words:
                first, depth = number, indent + (len(item[0]) if item else 0)
            words.append(content[len(item[0]) :] if item else content)


def comments_of(source: str) -> Iterator[tuple[int, str]]:
    """Yield comments with their lines; consecutive lines of comments are one text."""
    block, last = list[str](), 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        own = token.line.lstrip().startswith("#")
        if block and not (own and token.start[0] == last + 1):
            yield last - len(block) + 1, " ".join(block)
            block = []
        block.append(token.string.lstrip("#").strip())
        last = token.start[0] if own else -1
        if not own:
            yield token.start[0], block.pop()
    if block:
        yield last - len(block) + 1, " ".join(block)


def texts_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield every paragraph of a module's docstrings and comments, or of a page, with its line."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield from ((1 + offset, text) for offset, text in paragraphs(source))
        return
    for node in nodes(path):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for offset, text in paragraphs(node.value.value):
                yield node.lineno + offset, text
    yield from comments_of(source)


def faults_of(text: str) -> Iterator[str]:
    """Yield the faults of a paragraph."""
    plain = _CODE.sub("x", text)
    for found in _BANNED.finditer(plain):
        yield f"'{found[0]}'"
    if _WHAT.search(plain):
        yield "a sentence that begins with 'What'"
    for sentence in re.split(r"(?<=[.!?:;])\s+(?=[A-Z`\[(])|(?<=[.!?])\s+", plain):
        count = len(sentence.split())
        if count > LONGEST:
            yield f"{count} words in '{sentence[:50]}...'"


def read_files() -> list[Path]:
    found = []
    for name in READ:
        found += sorted(ROOT.glob(name)) if "*" in name or "." in name else sorted((ROOT / name).rglob("*.py"))
    return found


def test_pages_and_rooms_that_were_read_keep_the_style() -> None:
    faults = [
        f"{path.relative_to(ROOT).as_posix()}:{line}: {fault}"
        for path in read_files()
        for line, text in texts_of(path)
        for fault in faults_of(text)
    ]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("Nobody knows.", "'Nobody'"),
        ("What a view shows is kept.", "a sentence that begins with 'What'"),
        ("Return " + "a word " * 18, "37 words in 'Return a word a word a word a word a word a word a...'"),
    ],
)
def test_faults_are_found(text: str, fault: str) -> None:
    assert list(faults_of(text)) == [fault]


def test_code_quotes_and_separate_items_are_not_faults() -> None:
    text = "Return ``nobody`` and 'dead':\n\n- " + "one word " * 10 + "\n- " + "one word " * 10 + "\n\n>>> stands()"
    assert not [fault for _, one in paragraphs(text) for fault in faults_of(one)]
