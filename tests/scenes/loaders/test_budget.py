from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from activestructure_gym.scenes.loaders.budget import LIMITS, LimitError, SceneBudget


@pytest.mark.parametrize("what", LIMITS)
def test_a_limit_grows_with_the_bytes_that_were_read_up_to_its_ceiling(what):
    limit = LIMITS[what]
    budget = SceneBudget()
    budget.take(what, limit.allowance)
    with pytest.raises(LimitError, match=f"more than {limit.allowance:,} {what}.*0 bytes; {limit.remedy}"):
        budget.take(what, 1)
    budget.bytes_read = 1000
    budget.take(what, int(1000 * limit.per_byte))
    budget.bytes_read = 1 << 60
    with pytest.raises(LimitError, match=f"{limit.ceiling:,}"):
        budget.take(what, limit.ceiling)


def test_a_file_counts_once_however_often_it_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    os.link(tmp_path / "a", tmp_path / "b")
    budget = SceneBudget()
    assert [budget.read(tmp_path / name) for name in "aab"] == [b"12345"] * 3
    assert budget.bytes_read == 5


def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    for name in ("pipe", "zero"):
        with pytest.raises(LimitError, match="device or a pipe"):
            SceneBudget().read(tmp_path / name)
    # Its size is said to be 0, and reading it to the end would wait for messages of the kernel.
    assert SceneBudget().read("/proc/self/status") == b""


def test_the_files_of_a_scene_have_a_total(tmp_path):
    with open(tmp_path / "sparse", "wb") as stream:
        stream.truncate(5 << 30)
    with pytest.raises(LimitError, match="more than 4 GB"):
        SceneBudget().read(tmp_path / "sparse")


@pytest.mark.parametrize("what", LIMITS)
def test_the_docs_say_the_limits(what):
    text = (Path(__file__).parents[3] / "docs" / "reference" / "conventions.md").read_text()
    limit = LIMITS[what]
    (row,) = (
        line for line in text.splitlines() if re.match(rf"\| {what}( that| to|) ?[^|]*\| {limit.allowance:,} ", line)
    )
    assert row.endswith(f"| {limit.per_byte:g} | {limit.ceiling:,} |")
