"""Files that are replaced at once."""

import pytest

from activestructure_gym.files import UNFINISHED, replaced


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_has_its_old_content_until_the_new_is_whole(tmp_path, durable):
    place = tmp_path / "a.json"
    place.write_text("old")
    with replaced(place, durable=durable) as file:
        file.write(b"ne")
        assert place.read_text() == "old" and len(list(tmp_path.glob(UNFINISHED))) == 1
        file.write(b"w")
    assert place.read_text() == "new" and list(tmp_path.iterdir()) == [place]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_error_leaves_nothing_behind(tmp_path, error):
    place = tmp_path / "a.json"
    place.write_text("old")
    with pytest.raises(error), replaced(place) as file:
        file.write(b"ne")
        raise error
    assert place.read_text() == "old" and list(tmp_path.iterdir()) == [place]


def test_two_writers_of_one_process_do_not_meet(tmp_path):
    with replaced(tmp_path / "a") as first, replaced(tmp_path / "a") as second:
        first.write(b"first")
        second.write(b"second")
    assert (tmp_path / "a").read_bytes() == b"first"  # whose block ended last
