"""What files must hold."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.evaluation.archive.schema import (
    MAX_JSON_BYTES,
    Array,
    Mismatch,
    check_arrays,
    checked_json,
    each,
    flag,
    maybe,
    number,
    read_checked_json,
    scalar,
    table,
    text,
)

CHECK = table(
    {"name": text, "count": number(0, 9, whole=True)},
    {"on": flag, "points": each(number(), least=1), "pair": each(maybe(text), length=2)},
    others=scalar,
)


def test_what_fits_passes():
    CHECK({"name": "a", "count": 3}, "")
    CHECK({"name": "a", "count": 0, "on": True, "points": [1, 2.5], "pair": [None, "b"], "more": None}, "")


@pytest.mark.parametrize(
    "change, words",
    [
        ({"name": 3}, "name: expected a text, got 3"),
        ({"count": 10}, "count: expected a whole number from 0 to 9, got 10"),
        ({"count": True}, "count: expected a whole number from 0 to 9, got True"),
        ({"count": 2.0}, "count: expected a whole number from 0 to 9, got 2.0"),
        ({"on": 1}, "on: expected true or false, got 1"),
        ({"points": []}, "points: expected at least 1, got 0"),
        ({"points": [1, "2"]}, r"points\[1\]: expected a number, got '2'"),
        ({"points": [1e300]}, r"points\[0\]: expected a number, got 1e\+300"),
        ({"pair": ["a"]}, "pair: expected 2 entries, got 1"),
        ({"more": {}}, "more: expected a number, got {}"),
    ],
)
def test_what_does_not_is_named_by_its_place(change, words):
    with pytest.raises(Mismatch, match=f"^{words}$"):
        CHECK({"name": "a", "count": 3} | change, "")


@pytest.mark.parametrize("value", [[], None, "a"])
def test_a_table_is_a_table_and_has_what_it_needs(value):
    with pytest.raises(Mismatch, match="it: expected a table of names and values"):
        CHECK(value, "")
    with pytest.raises(Mismatch, match=r"outer\[0\] lacks name, count"):
        each(CHECK)([{}], "outer")


@pytest.mark.parametrize(
    "content, words",
    [
        (b"\xff\xfe", "not UTF-8 text"),
        (b"{", "not JSON"),
        (b"", "not JSON"),
        (b'{"a": NaN}', "holds NaN"),
        (b'{"a": -Infinity}', "holds -Infinity"),
        (b"[" * 100_000, "nested deeper"),
        (b"[" * 40 + b"]" * 40, "nested deeper"),
        (b'{"a": ' + b"9" * 5000 + b"}", "not JSON"),
    ],
)
def test_what_is_no_json_of_ours(content, words):
    with pytest.raises(Mismatch, match=words) as error:
        checked_json(content)
    assert len(str(error.value).splitlines()) == 1 and len(str(error.value)) < 300


def test_a_file_is_read_up_to_a_size(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": 1}')
    assert read_checked_json(path) == {"a": 1}
    with open(path, "wb") as file:
        file.truncate(MAX_JSON_BYTES + 1)
    with pytest.raises(Mismatch, match="it has 67,108,865 bytes, at most 67,108,864 are read"):
        read_checked_json(path)
    with pytest.raises(Mismatch, match="not a regular file"):
        read_checked_json(tmp_path)


LAYOUT = {"points": Array("f8", ("n", 3)), "ids": Array("i8", ("n",), low=0, high=9), "flags": Array("b1", (2,))}


def arrays(**changes):
    return {"points": np.zeros((4, 3)), "ids": np.arange(4), "flags": np.ones(2, bool)} | changes


@pytest.mark.parametrize(
    "change, words",
    [
        ({"points": np.zeros((4, 2))}, r"points: expected n x 3, got the shape \(4, 2\)"),
        ({"points": np.zeros(4)}, "points: expected float64, n x 3, got <f8 of the shape"),
        ({"points": np.full((4, 3), np.nan)}, "points holds numbers that are not finite"),
        ({"ids": np.arange(5)}, r"ids: expected 4, got the shape \(5,\)"),
        ({"ids": np.arange(4.0)}, "ids: expected int64, 4, got <f8"),
        ({"ids": np.arange(7, 11)}, "ids holds numbers outside 0 .. 9"),
        ({"flags": np.ones(3, bool)}, "flags: expected 2, got the shape"),
        ({"points": np.zeros((4, 3), np.float32)}, "points: expected float64, n x 3, got <f4"),
        ({"points": np.zeros((4, 3), ">f8")}, "points: expected float64, n x 3, got >f8"),
        ({"ids": np.arange(4, dtype=np.uint64)}, "ids: expected int64, 4, got <u8"),
        ({"flags": np.array(["a", "b"])}, "flags: expected bool, 2, got <U1"),
    ],
)
def test_arrays_agree_with_each_other(change, words):
    assert check_arrays(arrays(), LAYOUT) == {"n": 4}
    with pytest.raises(Mismatch, match=words):
        check_arrays(arrays(**change), LAYOUT)


def test_an_array_that_is_not_there():
    with pytest.raises(Mismatch, match="lacks the array ids, flags"):
        check_arrays({"points": np.zeros((1, 3))}, LAYOUT)
