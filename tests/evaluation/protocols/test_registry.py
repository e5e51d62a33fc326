"""Protocols by name: registered, or a class of any module."""

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import ClassVar

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.run_files import EVALUATION
from activestructure_gym.evaluation.protocols import PROTOCOLS, StandardProtocol, get_protocol, protocol_from
from activestructure_gym.evaluation.protocols.base import measure_by


@dataclass(frozen=True)
class Mine(StandardProtocol):
    name: ClassVar[str] = "mine"
    version: ClassVar[int] = 2


@pytest.fixture
def plug_in(monkeypatch):
    module = ModuleType("my_protocols")
    module.Mine, module.number = Mine, 3
    monkeypatch.setitem(sys.modules, "my_protocols", module)
    return "my_protocols:Mine"


def test_a_plug_in_has_the_name_that_it_is_asked_for_by(plug_in, monkeypatch):
    parameters = get_protocol(plug_in).parameters()
    assert (parameters["name"], parameters["version"]) == (plug_in, 2)
    with pytest.raises(InputError, match=r"'run' names the protocol 'my_protocols:Mine'.* add --trust-code"):
        protocol_from(parameters, "run")
    monkeypatch.setenv("ASG_TRUST_CODE", "1")
    assert protocol_from(parameters, "run") == get_protocol(plug_in)
    ones = ", ".join(f"'{name}' version 1" for name in ("naruto", "offline"))
    known = f"this version knows 'activegamer' version 2, 'activesplat' version 2, {ones}, 'standard' version 5"
    with pytest.raises(InputError, match=f"version 1, {known}"):
        protocol_from(parameters | {"version": 1}, "run")


@pytest.mark.parametrize("more", [{}, {"views": [{"psnr": 1.0}], "lpips": 0.2, "notes": {"a": "b"}}])
def test_a_result_without_images_and_notes_can_be_stored_and_read(more):
    class Bare:
        def evaluate(self, gaussians, truth, path):
            return {"completion_ratio": 50.0, **more}

    found = measure_by(Bare(), None, None, None)
    assert found == {"views": [], "lpips": None, "notes": {}, "completion_ratio": 50.0, **more}
    EVALUATION({"protocol": StandardProtocol().parameters(), "metrics": found}, "")


def test_conditions_import_no_plug_in():
    conditions = Conditions(also=("not_there:Mine", "activegamer"))
    assert Conditions.from_dict(conditions.as_dict()) == conditions
    assert "not_there" not in sys.modules


def test_what_is_no_protocol_is_refused(plug_in):
    with pytest.raises(InputError, match="protocol 'my_protocols:number' must be a frozen dataclass with"):
        get_protocol("my_protocols:number")
    with pytest.raises(InputError, match="unknown protocol 'activgamer'; did you mean 'activegamer'"):
        Conditions(also=("activgamer",))
    assert list(PROTOCOLS) == ["activegamer", "activesplat", "naruto", "offline", "standard"]
