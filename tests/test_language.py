"""Check the language of everything that a person reads: pages, docstrings, comments, messages and templates.

No banned word, no sentence of more than 35 words, none with six numbers or more, and no decimal such as ".7".
"""

from __future__ import annotations

import ast
import io
import math
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.parsed import nodes

ROOT = Path(__file__).resolve().parents[1]
# Everything that a person reads: pages, docstrings, comments, messages, help texts and templates.
CHECKED = (
    "*.md",
    ".github/**/*.md",
    *(f"{top}/**/*{ending}" for top in ("docs", "policies") for ending in (".md", ".py")),
    *(f"{top}/**/*.py" for top in ("activestructure_gym", "benchmarks", "envs", "evaluation", "examples")),
    "activestructure_gym/**/*.j2",
    "evaluation/**/*.j2",
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
MOST_NUMBERS = 5  # numbers of a sentence; more belong in a table
_BANNED = re.compile("|".join(rf"\b(?:{words})\b" for words in BANNED), re.IGNORECASE)
_WHAT = re.compile(r"(?:^|[.:;] )What\b(?![^.]*\?)")  # a sentence whose subject is a clause with "what"
_CODE = re.compile(r"``.*?``|`.*?`|\"[^\"]*\"|'[^' ]*'")
_NUMBER = re.compile(r"(?<![\w.^])\d[\d,.]*(?:e-?\d+| [x×] \d[\d,.]*)*")  # a size such as 256 x 256 counts once
_DECIMAL = re.compile(r"(?<![\w.)\]}])\.\d")
_ADDRESS = re.compile(r"\]\([^)]*\)")  # of a link in Markdown
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


def messages_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield strings of at least three words in one line: errors, help texts, captions. Each "{...}" becomes "x"."""
    parts = {id(part) for node in nodes(path) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    elsewhere = parts | {id(node.value) for node in nodes(path) if isinstance(node, ast.Expr)}  # docstrings
    for node in nodes(path):
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in elsewhere:
            text = node.value
        else:
            continue
        words = [re.fullmatch(r"[(]?[A-Za-z]+[-A-Za-z]*[,.:;)]?", word) is not None for word in text.split()]
        if "\n" not in text.strip() and sum(words) > max(2, len(words) / 2):  # else it is code, such as a path of SVG
            yield node.lineno, text


def template_texts_of(source: str) -> Iterator[tuple[int, str]]:
    """Yield the texts between the tags of an HTML template; each "{{...}}" becomes "x"."""
    plain = re.sub(r"\{\{.*?\}\}", "x", re.sub(r"\{[%#].*?[%#]\}", "<>", source, flags=re.DOTALL), flags=re.DOTALL)
    for found in re.finditer(r"(?:^|(?<=>))[^<>]+", plain):
        yield plain.count("\n", 0, found.start()) + 1, " ".join(found[0].split())


def texts_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the texts of a page, of a template, or of a module (docstrings and comments), with their lines."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield from ((1 + offset, text) for offset, text in paragraphs(source))
    elif path.suffix == ".j2":
        yield from template_texts_of(source)
    else:
        for node in nodes(path):
            if (
                isinstance(node, ast.Expr)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)
            ):
                for offset, text in paragraphs(node.value.value):
                    yield node.lineno + offset, text
        yield from comments_of(source)


def faults_of(text: str, most_numbers: float = MOST_NUMBERS) -> Iterator[str]:
    """Yield the faults of a paragraph, whose sentences have at most ``most_numbers`` numbers."""
    plain = _ADDRESS.sub("]", _CODE.sub("x", text))
    for found in _BANNED.finditer(plain):
        yield f"'{found[0]}'"
    if _WHAT.search(plain):
        yield "a sentence that begins with 'What'"
    if _DECIMAL.search(plain):
        yield "a decimal without a leading zero"
    for sentence in re.split(r"(?<=[.!?:;])\s+(?=[A-Z`\[(])|(?<=[.!?])\s+", plain):
        words, numbers = len(sentence.split()), len(_NUMBER.findall(sentence))
        if words > LONGEST:
            yield f"{words} words in '{sentence[:50]}...'"
        if numbers > most_numbers:
            yield f"{numbers} numbers in '{sentence[:50]}...'"


def faults_in(path: Path) -> list[str]:
    """Return the faults of a file, each with its line. Formulas in docstrings and comments may have many numbers."""
    is_code = path.suffix == ".py"
    most = math.inf if is_code and "cli" not in path.parts else MOST_NUMBERS
    found = [f"{line}: {one}" for line, text in texts_of(path) for one in faults_of(text, most)]
    messages = messages_of(path) if is_code else ()
    return found + [f"{line}: {one}" for line, text in messages for one in faults_of(text)]


@cache
def faults() -> dict[str, list[str]]:
    """Return the faults of all files by path."""
    found = {path for name in CHECKED for path in ROOT.glob(name)}
    paths = sorted(path for path in found if "_made" not in path.parts)  # what docs/build writes
    assert len(paths) > 300
    return {path.relative_to(ROOT).as_posix(): faults_in(path) for path in paths}


def test_every_text_keeps_the_style() -> None:
    found = [f"{name}:{one}" for name, all_of in faults().items() for one in all_of]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("Nobody knows.", "'Nobody'"),
        ("What a view shows is kept.", "a sentence that begins with 'What'"),
        ("It gains .7 dB.", "a decimal without a leading zero"),
        ("Return " + "a word " * 18, "37 words in 'Return a word a word a word a word a word a word a...'"),
        ("It has 1, 2, 3.5, 4,000, 5 and 6 m.", "6 numbers in 'It has 1, 2, 3.5, 4,000, 5 and 6 m....'"),
    ],
)
def test_faults_are_found(text: str, fault: str) -> None:
    assert list(faults_of(text)) == [fault]


def test_code_quotes_sizes_and_separate_items_are_not_faults() -> None:
    text = "Return ``nobody`` and 'dead' of 256 x 256 and 1, 2, 3 and 4:\n\n- " + "one word " * 10 + "\n- "
    text += "one word " * 10 + "\n\n>>> stands()\n\n| 1 | 2 | 3 | 4 | 5 | 6 |"
    assert not [fault for _, one in paragraphs(text) for fault in faults_of(one)]


def test_messages_and_templates_are_read(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        '"""Hold a text."""\nraise ValueError(f"a run of {name} died: {1}")\nCODE = "dead"\n', encoding="utf-8"
    )
    assert list(texts_of(module)) == [(1, "Hold a text.")] and faults_in(module) == ["2: 'died'"]
    template = "{# dead #}\n<p>Best {{ dead }}\n of all</p>{% if dead %}"
    assert [(line, text) for line, text in template_texts_of(template) if text] == [(2, "Best x of all")]
