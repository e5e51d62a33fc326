import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.comparison import open_comparison


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"jobs": 3}', "no json"])
def test_a_damaged_record_is_one_sentence(tmp_path, content):
    (tmp_path / "compare.json").write_text(content)
    with pytest.raises(InputError, match="compare.json' is damaged: .*; move it away and give"):
        open_comparison(tmp_path)
