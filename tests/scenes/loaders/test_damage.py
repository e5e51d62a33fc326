from __future__ import annotations

import pytest

from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.damage import UnreadableMesh, in_words

NOT_THE_FORMAT = "its content is damaged or not what the format says; export it again"

NO_NUMBER = "it has other text where numbers are expected (with points, no commas); export it again"


def stumble(statement):
    with pytest.raises(Exception) as caught:
        exec(statement, {})
    return in_words(caught.value)


@pytest.mark.parametrize(
    "statement, words",
    [
        ("{}['count']", "an entry in it lacks 'count'; export it again"),
        ("{}[3]", NOT_THE_FORMAT),
        ("[][1]", "it refers to an entry that does not exist; export it again"),
        ("None.get('x')", NOT_THE_FORMAT),
        ("a, b = [1]", NOT_THE_FORMAT),
        ("import struct; struct.unpack('<I', b'')", "it is cut off or damaged; copy or export it again"),
        ("import base64; base64.b64decode('a')", "it is cut off or damaged; copy or export it again"),
        ("import json; json.loads('{\\n1')", "its JSON is damaged at line 2, column 1"),
        ("b'\\xff'.decode()", "its text is not in UTF-8; save it so"),
        ("import xml.etree.ElementTree as e; e.fromstring('<a>')", "its XML is damaged at line 1, column 3"),
        (
            "import numpy; numpy.frombuffer(b'1', int)",
            NOT_THE_FORMAT,
        ),
        ("int('0,5')", NO_NUMBER),
        ("import numpy; numpy.array(['0,5'], float)", NO_NUMBER),
        ("import numpy; numpy.fromstring('1 x', sep=' ')", NO_NUMBER),
        ("open('/')", "it cannot be opened (Is a directory)"),
        ("raise RecursionError('maximum recursion depth')", "its entries are nested too deeply"),
    ],
)
def test_what_readers_stumble_over(statement, words):
    assert stumble(statement) == words


def test_our_own_words_are_kept():
    assert in_words(UnreadableMesh("its nodes\n form a loop")) == "its nodes form a loop"
    assert in_words(LimitError("it comes to more than 3")) == "it comes to more than 3"
