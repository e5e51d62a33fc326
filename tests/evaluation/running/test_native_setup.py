"""A comparison in the native setup, from the call to the page, and what it is not mixed with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import StandardProtocol, compare
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.report.page.method_text import native_setup_text
from activestructure_gym.evaluation.report.results import gather

BRINGER = "tests.policies.test_native_settings:Bringer"
PROTOCOL = replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000)
SHARED = Conditions(preset="fast", frame_budget=25, protocol=PROTOCOL)
NATIVE = replace(SHARED, setup="native")


@pytest.mark.slow
def test_everybody_brings_what_is_their_own_and_the_page_says_so(tmp_path: Path) -> None:
    result = compare(["box"], [BRINGER, "random"], tmp_path / "runs", conditions=NATIVE, engine="inline")
    assert not result.failed
    stages = {run.policy: run.config["configuration"]["views"]["stages"] for run in open_comparison(tmp_path / "runs")}
    assert stages == {BRINGER: [["turns?count=5"]], "random": [["pool"]]}
    (told,) = native_setup_text(gather([tmp_path / "runs"]))
    free, mapper = "0.3 m clearance", "mapper `default` with 0 iterations per keyframe, a keyframe"
    assert f"`{BRINGER}` up to 64 views of `turns?count=5`, {free}, {mapper} at the end of a path;" in told
    assert f"`random` up to 64 views of `pool`, {free}, {mapper} every 20 frames." in told
    with pytest.raises(InputError, match="setup was native, asked for is shared"):
        compare(["box"], ["random"], tmp_path / "runs", conditions=SHARED, engine="inline", resume=True)
    compare(["box"], ["random"], tmp_path / "shared", conditions=SHARED, engine="inline")
    with pytest.raises(InputError, match="setup"):
        gather([tmp_path / "runs", tmp_path / "shared"])
    assert result.runs[0].job.conditions == NATIVE
