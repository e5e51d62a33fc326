"""Names in messages: the nearest one, at most five of many, and where all of them are listed."""

import re

import pytest

from activestructure_gym.config import configure, known_preset
from activestructure_gym.errors import MAX_NAMES, InputError, listed, unknown_keyword, unknown_name
from activestructure_gym.evaluation.cli.commands import find_command
from activestructure_gym.evaluation.cli.options import split_policies
from activestructure_gym.evaluation.protocols import get_protocol
from activestructure_gym.features import column_names
from activestructure_gym.policies import make_policy
from activestructure_gym.scenes import load_scene


def test_few_names_are_all_listed_and_many_by_a_command_or_the_nearest():
    assert str(unknown_name("thing", "b", "xyz")) == "unknown thing 'b'. Known: x, y, z"
    assert str(unknown_name("option of scene 'hut'", "b", "x")) == "unknown option 'b' of scene 'hut'. Known: x"
    assert str(unknown_name("thing", "b", ())) == "unknown thing 'b'. Known: none"
    many = [f"policy_{number}" for number in range(46)]
    said = str(unknown_name("policy", "polcy_7", many))
    assert said == "unknown policy 'polcy_7'; did you mean 'policy_7'? `asg list policies` lists the names"
    said = str(unknown_name("thing", "q", many))
    assert said.startswith("unknown thing 'q'. Nearest of 46: ") and said.count("policy_") == MAX_NAMES
    assert str(unknown_name("thing", 3, many)).count("policy_") == MAX_NAMES  # no text


@pytest.mark.parametrize(
    ("give", "command"),
    [
        (lambda: make_policy("zzz"), "asg list policies"),
        (lambda: split_policies(["zzz"]), "asg list policies"),
        (lambda: column_names(("zzz",)), "asg list features"),
        (lambda: configure("default", {"mapper.zzz": 1}), "asg list config"),
        (lambda: configure("default", {"zzz": 1}), "asg list config"),
        (lambda: find_command("zzz"), "asg --help"),
        (lambda: load_scene("zzz"), ""),
        (lambda: known_preset("zzz"), ""),
        (lambda: get_protocol("zzz"), ""),
    ],
)
def test_no_message_lists_more_than_five_names(give, command):
    with pytest.raises(InputError) as error:
        give()
    said = str(error.value)
    assert f"`{command}` lists the names" in said if command else "Known: " in said
    assert len(re.split(r"Known: |Nearest of \d+: ", said)[-1].split(", ")) <= MAX_NAMES + 1
    assert len(said) < 150


def test_a_long_list_of_given_names_ends_with_how_many_more_there_are():
    assert listed("ab") == "a, b" and listed("abcde") == "a, b, c, d, e"
    assert listed(range(46)) == "0, 1, 2, 3, 4 and 41 more"


def test_an_unknown_keyword_is_refused_in_python_s_own_words() -> None:
    def of_python(a: int) -> None: ...

    with pytest.raises(TypeError) as refused:
        of_python(b=1)  # type: ignore[call-arg]
    error = unknown_keyword(of_python.__qualname__, "b", ["a"])
    assert isinstance(error, TypeError) and isinstance(error, InputError)
    assert str(error).startswith(str(refused.value)) and str(error).endswith(". Known: a")
