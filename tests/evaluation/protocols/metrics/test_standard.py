"""The numbers of the protocol `standard` are described once, and for every reader."""

import re
from pathlib import Path

from activestructure_gym.evaluation.protocols.metrics import METRICS
from activestructure_gym.evaluation.protocols.metrics.standard import STANDARD

GUIDE = Path(__file__).resolve().parents[4] / "docs" / "reference" / "protocols.md"


def test_every_number_has_a_meaning_and_a_definition_in_the_guide():
    defined = set(re.findall(r"`(\w+)`", GUIDE.read_text(encoding="utf-8")))
    for metric in STANDARD:
        assert metric.meaning and METRICS.get(metric.name) is metric
        assert metric.name in defined or metric.name.startswith("tsdf_"), metric.name
    assert len({metric.label for metric in STANDARD}) == len(STANDARD)
