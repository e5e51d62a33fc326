import base64
import json
import zlib

from activestructure_gym.evaluation.report.packing import packed


def test_texts_come_out_as_they_went_in_and_alike_ones_cost_little():
    texts = ["<td>1.2</td>" * 400, 'a "b" <é> &', ""]
    word = packed(texts)
    assert word.isascii() and not set(word) & set("\"'<>& ")
    assert json.loads(zlib.decompress(base64.b64decode(word))) == texts
    assert len(packed(texts[:1] * 50)) < 0.02 * 50 * len(texts[0])
