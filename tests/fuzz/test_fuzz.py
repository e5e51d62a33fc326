from __future__ import annotations

import pytest

from tests.fuzz.harness import _CONTROL, _tried, generator, kind_module, kinds, run

HEAVY = ("verdicts", "runs", "checkpoints", "layouts")  # each case plays or reads a whole run
SHARES = [(kind, rest) for kind in kinds() for rest in (0, 1)]


@pytest.mark.parametrize(
    ("kind", "rest"),
    [pytest.param(kind, rest, marks=[pytest.mark.slow] if rest or kind in HEAVY else []) for kind, rest in SHARES],
)
def test_every_input_is_used_or_refused_in_one_sentence(kind, rest):
    cases = kind_module(kind).CI_CASES
    tally = run(kind, range(cases // 10, cases) if rest else range(cases // 10))
    shown = [f"python -m tests.fuzz --only {kind}:{o.number}: {o.message}" for o in tally.failures]
    assert not shown, "\n".join(shown)


@pytest.mark.parametrize("kind", kinds())
def test_a_case_can_be_repeated(kind, tmp_path):
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        kind_module(kind).case(generator(kind, 0, 1), folder)
    left = _content(tmp_path / "a")
    assert left == _content(tmp_path / "b") and left


def _content(folder):
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def test_what_is_a_failure():
    from activestructure_gym.errors import InputError

    def raises(error):
        def read():
            raise error

        return _tried(read)[0]

    assert _tried(lambda: None)[0] == "used"
    assert raises(InputError("give a mesh")) == "refused"
    assert raises(InputError("")) == "failed"
    assert raises(InputError("two\nlines")) == raises(InputError("long " * 1000)) == "refused"  # it shortens itself
    assert _CONTROL.search("a\x1b[1A") and _CONTROL.search("\u202e") and not _CONTROL.search("a line\tand another\n")
    assert raises(SystemExit(2)) == "refused" and raises(SystemExit(3)) == "failed"
    assert raises(KeyError("x")) == raises(MemoryError()) == raises(RecursionError()) == "failed"


def test_hangs_and_floods_and_deaths_are_failures():
    tally = run("_selfcheck", range(5), seconds=2.0, megabytes=200.0)
    assert [o.verdict for o in tally.outcomes] == ["failed", "failed", "failed", "failed", "used"]
    assert [o.message.split(":")[0] for o in tally.outcomes[:4]] == [
        "hangs", "takes over 200 MB", "the process died with exit code -9", "printed a traceback",
    ]  # fmt: skip
