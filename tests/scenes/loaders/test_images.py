from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.images import FORMATS, opened_image
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore


def _encoded(kind: str, size=(6, 4), **options) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", size, (200, 100, 50)).save(stream, kind, **options)
    return stream.getvalue()


def png_header(width: int, height: int) -> bytes:
    """The beginning of a PNG that says it has this size."""
    chunks = (b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0), b"IDAT" + zlib.compress(bytes(100)))
    framed = (struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(framed)


@pytest.mark.parametrize("kind", FORMATS)
def test_formats_that_exporters_write(kind):
    pixel = np.asarray(opened_image(_encoded(kind)).convert("RGB"))[2, 2]
    np.testing.assert_allclose(pixel, [200, 100, 50], atol=10)


def test_postscript_starts_no_program(monkeypatch):
    from PIL import EpsImagePlugin

    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *args, **kwargs: pytest.fail("Ghostscript was started"))
    eps = _encoded("EPS")
    with pytest.raises(Exception, match="cannot identify"):
        opened_image(eps)
    store = TextureStore()
    assert store.add_bytes(eps, "drawing.png") == -1 and store.unreadable == ["drawing.png"]


@pytest.mark.parametrize("size", [(8193, 8192), (13_000, 13_000), (100_000, 100_000)])
def test_a_picture_says_its_size_before_it_is_decoded(size):
    store = TextureStore()
    assert store.add_bytes(png_header(*size), "sky.png") == -1
    (said,) = store.unreadable
    assert "67,108,864" in said and said.startswith("sky.png: has")


def test_many_progressive_scans_are_refused():
    data = _encoded("JPEG", progressive=True)
    assert opened_image(data).size == (6, 4)
    scan = data[data.index(b"\xff\xda") : data.rindex(b"\xff\xd9")]
    with pytest.raises(LimitError, match="scans"):
        opened_image(data[:-2] + 100 * scan + data[-2:])


def test_pictures_have_a_total():
    store = TextureStore(max_size=8192)
    picture = Image.new("RGB", (4096, 4096))
    added = [store.add(k, lambda: picture, f"{k}.png") for k in range(6)]
    assert added == [0] * 3 + [-1] * 3  # 16.8 million pixels each, of 64 million
    assert "pixels after shrinking" in store.unreadable[0]
