"""Text is broken between words and parts of names, and never inside a number."""

import pytest

from activestructure_gym.evaluation.machine.terminal import aligned, folded, paragraphs, shortened


@pytest.mark.parametrize(
    ("text", "width", "lines"),
    [
        ("one two three", 20, ["one two three"]),
        ("one two three", 8, ["one two", "three"]),
        ("apartment?rooms=2&seed=13", 18, ["apartment?rooms=2&", "seed=13"]),
        ("box?size=4.25,3,2.5", 12, ["box?", "size=", "4.25,3,2.5"]),
        ("7:06 left of 1,234,567", 9, ["7:06 left", "of", "1,234,567"]),
        ("popgs_cov_trace_block_cov", 16, ["popgs_cov_trace_", "block_cov"]),
        ("activestructure", 8, ["activest", "ructure"]),
        ("room12345", 6, ["room", "12345"]),
        ("learned:runs/sb3/2024-05-13/best", 16, ["learned:runs/", "sb3/2024-05-13/", "best"]),
        ("0123456789", 4, ["0123", "4567", "89"]),
        ("", 4, [""]),
    ],
)
def test_lines(text, width, lines):
    assert folded(text, width) == lines


def test_a_shortened_text_ends_before_a_number_that_has_no_room():
    assert shortened("room?seed=12345", 20) == "room?seed=12345"
    assert shortened("room?seed=12345", 13) == "room?seed…"
    assert shortened("0.123 of it", 5) == "…" and shortened("words of it", 8) == "words o…"
    assert shortened("words", 0) == "" and shortened("words and", 7, "...") == "word..."


def test_one_line_per_row_and_the_last_entry_gives_way():
    rows = [["name", "value", "meaning"], ["a", "[1.0, 2.0, 3.0]", "how far it reaches"], ["bb", "1", "short"]]
    assert list(aligned(rows, None, (8, 5))) == [
        "name  value  meaning",
        "a     [1.0, 2.0, 3.0]  how far it reaches",
        "bb    1      short",
    ]
    assert list(aligned(rows, 32, (8, 5)))[1] == "a     [1.0, 2.0, 3.0]  how far…"
    assert list(aligned(rows, 24, (8, 5)))[1] == "a     [1.0, 2.0, 3.0]"  # no room for words
    assert list(aligned(rows, 16, (8, 5)))[1:3] == ["a     [1.0, 2.0,", "  3.0]"]


def test_paragraphs_and_items_are_lines():
    assert list(paragraphs("One\ntwo.\n\n- a\n  b\n- c")) == ["One two.", "", "- a b", "- c", ""]


def test_sections_of_a_docstring_keep_their_lines():
    lines = ["Parameters", "----------", "model", "    MJCF file.", "width, height", "    Pixels."]
    assert list(paragraphs("\n".join(lines))) == [*lines, ""]
