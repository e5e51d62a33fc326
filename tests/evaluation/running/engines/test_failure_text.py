"""What is said of a run that failed: one short line, whatever its policy said."""

from __future__ import annotations

from pathlib import Path

from activestructure_gym.errors import MAX_CHARACTERS
from activestructure_gym.evaluation.running.engines.failure_text import error_text, failure_text


def test_a_policys_words_are_one_short_printable_line(tmp_path: Path) -> None:
    log = tmp_path / "job.log"
    log.write_text("Traceback\nRuntimeError: \x1b[2J\u202e" + "x" * 100_000, encoding="utf-8")
    for said in (
        failure_text(log, 0, 1),
        failure_text(log, 0, -9),
        error_text(RuntimeError("\x1b[2J\n✓" + "x" * 100_000)),
    ):
        assert said.isprintable() and len(said) < MAX_CHARACTERS + 200 and said.startswith("RuntimeError: \\x1b[2J"), (
            said[:50]
        )
