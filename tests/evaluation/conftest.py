"""What tests of the evaluation have in common."""

from collections.abc import Iterator

import pytest

from tests.bare_jobs import bare_jobs


@pytest.fixture(scope="package", autouse=True)
def bare() -> Iterator[None]:
    """Play jobs of this process without pictures and without compiling ahead."""
    with bare_jobs():
        yield
