import base64
import json
import zlib

import pytest

from activestructure_gym.evaluation.report.text_filters import compressed, without_folders


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/me/scenes/flat.glb", "flat.glb"),
        ("mesh:/home/me/flat.glb?up=z&layout=/tmp/x.json", "mesh:flat.glb?up=z&layout=x.json"),
        (
            "asg compare --scenes /home/me/a.glb,/home/me/b.glb --out=/tmp/c/",
            "asg compare --scenes a.glb,b.glb --out=c",
        ),
        ("'/home/me' is not a scene", "'me' is not a scene"),
        ("~/scenes/a.glb and C:\\Users\\me\\a.glb", "a.glb and a.glb"),
        (
            "../shared/a.glb, runs/mine, ./b and docs/reference/protocols.md",
            "../shared/a.glb, runs/mine, ./b and docs/reference/protocols.md",
        ),
        ("12 m/s, 1 / 2, 3/4 and https://example.org/a/b", "12 m/s, 1 / 2, 3/4 and https://example.org/a/b"),
    ],
)
def test_of_an_absolute_path_the_name_is_left(text, shown):
    assert without_folders(text) == shown


def test_compressed_texts_come_out_as_they_went_in_and_similar_ones_cost_little():
    texts = ["<td>1.2</td>" * 400, 'a "b" <é> &', ""]
    word = compressed(texts)
    assert word.isascii() and not set(word) & set("\"'<>& ")
    assert json.loads(zlib.decompress(base64.b64decode(word))) == texts
    assert len(compressed(texts[:1] * 50)) < 0.02 * 50 * len(texts[0])
