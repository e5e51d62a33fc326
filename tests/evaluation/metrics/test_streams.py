import numpy as np
import pytest

from activestructure_gym.evaluation.metrics.streams import StreamedSum, batched


@pytest.mark.parametrize("count", [0, 1, 7, 129, 65_536, 65_537, 131_080, 300_001, 1_234_567])
def test_a_streamed_sum_is_numpys_to_the_last_bit(count, rng):
    numbers = rng.random(count) * 10.0 ** rng.integers(-3, 4, count)
    total, start = StreamedSum(count), 0
    while start < count:
        size = int(rng.integers(0, 90_000))
        total.add(numbers[start : start + size])
        start += size
    assert total.value == float(numbers.sum())
    assert not count or total.value / count == float(numbers.mean())


def test_a_streamed_sum_knows_when_it_is_complete():
    total = StreamedSum(3)
    total.add(np.ones(2))
    with pytest.raises(ValueError, match="more or fewer"):
        total.value  # noqa: B018
    total.add(np.ones(2))
    with pytest.raises(ValueError, match="more or fewer"):
        total.value  # noqa: B018


def test_batches_hold_all_rows_in_order():
    pieces = [np.arange(3 * size).reshape(-1, 3) + 1000 * number for number, size in enumerate((0, 5, 47, 10, 0, 8))]
    batches = list(batched(pieces, 10))
    assert [len(batch) for batch in batches] == [10] * 7
    np.testing.assert_array_equal(np.concatenate(batches), np.concatenate(pieces))
    assert list(batched([], 10)) == []
