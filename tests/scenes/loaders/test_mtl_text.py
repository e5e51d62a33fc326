from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.loaders.mtl_text import TextureMap, texture_map
from activestructure_gym.scenes.scene import CLAMP, REPEAT


@pytest.mark.parametrize(
    ("statement", "expected"),
    [
        ("wood.png", TextureMap("wood.png")),
        ("  my  oak wood.PNG \r", TextureMap("my  oak wood.PNG")),
        ('"my oak.png"', TextureMap("my oak.png")),
        ("-s 2 3 1 wood.png", TextureMap("wood.png", scale=(2, 3))),
        ("-s 2 3 wood.png", TextureMap("wood.png", scale=(2, 3))),
        ("-s 2 wood.png", TextureMap("wood.png", scale=(2, 1))),
        ("-o 0.25 wood.png", TextureMap("wood.png", offset=(0.25, 0))),
        ("-S\t-2\t.5  -O +1e-1 -2. 0   My Tex.PNG", TextureMap("My Tex.PNG", scale=(-2, 0.5), offset=(0.1, -2))),
        ("-o .5 0 0 -s 10 10 10 -clamp off ..\\a\\b c.png", TextureMap("..\\a\\b c.png", (10, 10), (0.5, 0))),
        ("-s 1 1 1 2 by 4.png", TextureMap("2 by 4.png")),  # three numbers at most
        ("-s 2 2 1.png", TextureMap("1.png", scale=(2, 2))),
        ("-clamp ON wood.png", TextureMap("wood.png", clamp=True)),
        ("-s 2 2 -clamp on -s 3 3 -clamp off wood.png", TextureMap("wood.png", scale=(3, 3))),
        ("-blendu on -blendv on -cc off -mm 0 1 -t 0 0 0 wood.png", TextureMap("wood.png")),
        ("-texres 512 -boost 2.5 -bm 0.3 wood.png", TextureMap("wood.png")),
        ("-imfchan M -type sphere wood.png", TextureMap("wood.png", channel="m", ignored=("-type sphere",))),
        ("-t 1 .5 wood.png", TextureMap("wood.png", ignored=("-t 1 0.5",))),
        ("-mm 0.2 0.5 -cc on -blendu off w.png", TextureMap("w.png", ignored=("-mm 0.2 0.5", "-cc on", "-blendu off"))),
        ("-s wood.png", TextureMap("wood.png", ignored=("-s",))),
        ("-clamp wood.png", TextureMap("wood.png", ignored=("-clamp",))),
        ("-halo 3 wood.png", TextureMap("-halo 3 wood.png", ignored=("-halo",))),
        ("-wood.png", TextureMap("-wood.png")),
        ("-s 2 2 2", TextureMap("", scale=(2, 2))),
        ("", TextureMap("")),
    ],
)
def test_every_spelling_of_a_statement(statement, expected):
    assert texture_map(statement) == expected


def test_coordinates_by_hand():
    found = texture_map("-o 0.5 -1 -s 2 4 wood.png")
    np.testing.assert_allclose(found.placed(np.array([[0, 0], [1, 0.25]])), [[0.5, -1], [2.5, 0]])
    assert found.wrap == (REPEAT, REPEAT) and texture_map("-clamp on w.png").wrap == (CLAMP, CLAMP)
