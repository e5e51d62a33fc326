"""What code and pages cite can be found: in docs/references.md, or as a page of the repository."""

from __future__ import annotations

import ast
import io
import os
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.parsed import tree

ROOT = Path(__file__).resolve().parents[1]
CODE = ("activestructure_gym", "envs", "policies", "evaluation", "benchmarks", "examples", "tests", "docs")
# Documents that are not part of the repository, in pieces so that this file does not name them.
ELSEWHERE = re.compile(
    "|".join(("shared/" + "research", "[Dd]os" + "sier", "ablation [A-Z][0-9]", "kill" + "tests", r"\baud" + "it_"))
)
# This file, and one whose tests look for such words in what is printed.
SPARED = {Path(__file__).resolve(), ROOT / "tests" / "evaluation" / "cli" / "test_listing.py"}
KEY = re.compile(r"(?<![\w`\])])\[([a-z][a-z0-9_]{2,})((?:, [^\[\]]*)?)\](?!\()")
PAGE = re.compile(r"(?<![\w*{}-])((?:\.\./|[\w.-]+/)*[\w-]+\.md)\b")
# Written by a run or by a dataset.
NOT_OURS = {"summary.md", "eval.md", "quality.md", "data_organization.md"}
# Stands in recorded results, which must not change.
RECORDED = {("evaluation/metrics/lpips.py", "docs/protocols.md")}


@cache
def files() -> tuple[Path, ...]:
    found = [path for suffix in ("*.py", "*.md") for folder in CODE for path in (ROOT / folder).rglob(suffix)]
    found = [path for path in found if "_made" not in path.parts]  # what docs/build writes
    return (*sorted(found), ROOT / "README.md", ROOT / "CONTRIBUTING.md")


def pages() -> list[Path]:
    return [path for path in files() if path.suffix == ".md"]


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def words(path: Path) -> str:
    """What people read in a file: a page without its code, a module's docstrings and the comments that may cite."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.sub(r"`[^`\n]*`", "", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    read = [ast.get_docstring(node) or "" for node in with_docstrings(tree(path))]
    if any("#" in line and any(sought.search(line) for sought in (KEY, PAGE, ELSEWHERE)) for line in text.splitlines()):
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        read += [token.string for token in tokens if token.type == tokenize.COMMENT]
    return "\n".join(read)


Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def with_docstrings(node: ast.AST) -> Iterator[Documented]:
    """A module and what stands in it, however deep; statements only, since an expression holds no docstring."""
    if isinstance(node, Documented):
        yield node
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        inner = getattr(node, part, ())
        for child in inner if isinstance(inner, list) else ():
            yield from with_docstrings(child)


def keys() -> list[str]:
    return re.findall(
        r"^- \*\*\[(\w+)\]\*\*", (ROOT / "docs" / "references.md").read_text(encoding="utf-8"), re.MULTILINE
    )


def cited() -> Iterator[tuple[str, str]]:
    """Every key with the file that cites it.

    Brackets also hold shapes, ``[count]``: a citation is known by its key, by a year, by what it says besides
    (``[naruto, code]``), or by standing in a sentence about sources.
    """
    known = set(keys())
    for path in files():
        for line in words(path).splitlines():
            for found in KEY.finditer(line):
                about = re.match(r", (code|eqs?\. |sec|table|section)", found[2])
                source = re.search(r"\bSources?:", line[: found.start()])
                if found[1] in known or about or source or re.search(r"(19|20)\d\d$", found[1]):
                    yield name(path), found[1]


def test_no_text_cites_a_document_that_nobody_has() -> None:
    found = {}
    for path in (*files(), ROOT / "CHANGELOG.md", ROOT / "setup.cfg", ROOT / "pyproject.toml"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if path not in SPARED and ELSEWHERE.search(line):
                found[f"{name(path)}:{number}"] = line.strip()
    assert not found


def test_every_key_stands_in_the_bibliography_once_and_is_cited() -> None:
    listed = keys()
    assert len(listed) == len(set(listed)) > 30
    unknown = {(file, key) for file, key in cited() if key not in listed}
    assert not unknown, "docs/references.md lacks them"
    idle = set(listed) - {key for file, key in cited() if file != "docs/references.md"}
    assert not idle, "docs/references.md holds what nobody cites"


def test_every_page_that_is_named_exists() -> None:
    known = {path.name for path in (*pages(), ROOT / "CHANGELOG.md")}
    lost = set()
    for path in files():
        if path.name in (Path(__file__).name, "test_site.py"):
            continue
        # What writes the site's pages names them, and links as they do.
        made = ROOT / "docs" / "_made" / "a_page" if path.parent.name == "_site" else None
        for found in PAGE.findall(path.read_text(encoding="utf-8")):
            if made and (Path(os.path.normpath(made / found)).exists() or found.endswith("/index.md")):
                continue
            there = (ROOT / found).exists() or (path.parent / found).exists() if "/" in found else found in known
            if not (there or found in NOT_OURS or Path(found).name in NOT_OURS or (name(path), found) in RECORDED):
                lost.add((name(path), found))
    assert not lost


def anchors(page: Path) -> set[str]:
    """The headings of a page as GitHub links to them."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", pages(), ids=name)
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    dead = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        place, _, anchor = target.partition("#")
        if "://" in place:
            continue
        there = page.parent / place if place else page
        if not there.exists() or (anchor and there.suffix == ".md" and anchor not in anchors(there)):
            dead.append(target)
    assert not dead
