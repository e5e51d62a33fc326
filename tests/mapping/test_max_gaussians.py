"""A bound on the number of Gaussians: an even choice of seeds, and nothing mapped goes."""

from __future__ import annotations

import numpy as np

from activestructure_gym.mapping import Mapper, MapperConfig
from tests.mapping.surfaces import (
    FORWARD,
    mapped,
    picture,
    plane,
)


def test_a_bound_gets_an_even_choice_and_nothing_mapped_goes() -> None:
    near = picture([plane([4, 0, 0], [1, 0, 0])])
    free = mapped(near).map.count
    mapper = Mapper(MapperConfig(max_gaussians=free // 4), np.random.default_rng(0))
    report = mapper.observe(near, iterations=0)
    assert (report.added, report.left_out, report.count) == (free // 4, free - free // 4, free // 4)
    quarters = np.histogram2d(mapper.map.means[:, 1], mapper.map.means[:, 2], bins=2)[0]
    assert quarters.min() > 0.8 * quarters.max()
    ids = mapper.map.ids[: mapper.map.count].copy()
    report = mapper.observe(picture([plane([-3, 0, 0], [1, 0, 0])], direction=-FORWARD), iterations=0)
    assert (report.added, report.replaced, report.pruned) == (0, 0, 0) and report.left_out > 1000
    assert np.array_equal(mapper.map.ids[: mapper.map.count], ids)


def test_at_the_bound_what_is_coarse_stays_if_the_finer_ones_have_no_room() -> None:
    wall = [plane([0, 0, 0], [1, 0, 0])]
    fine = lambda p: (np.floor(p[:, 1] / 0.05) + np.floor(p[:, 2] / 0.05)) % 2 == 0  # noqa: E731
    far, near = (picture(wall, [-x, 0, 0], paint=fine) for x in (2.6, 0.4))
    free = mapped(far).map.count
    mapper = Mapper(MapperConfig(max_gaussians=free + 20), np.random.default_rng(0))
    mapper.observe(far, iterations=0)
    ids = mapper.map.ids[:free].copy()
    report = mapper.observe(near, iterations=0)
    assert (report.replaced, report.added, report.count) == (0, 20, free + 20) and report.left_out > 300
    assert np.array_equal(mapper.map.ids[:free], ids)
    roomy = Mapper(MapperConfig(max_gaussians=100_000), np.random.default_rng(0))
    unbounded = mapped(far, near)
    for frame in (far, near):
        roomy.observe(frame, iterations=0)
    assert np.array_equal(roomy.map.means, unbounded.map.means)
