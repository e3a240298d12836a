"""Files that are no picture of a plot: one sentence each, in bounded time."""

import struct
import time
import zlib
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from tests.records.rendered import PLOTS

from stepax import StepRecord, trace_image


def png(width, height, data=b"\0" * 10**6):
    """A file that claims a size."""

    def chunk(kind, content):
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def photo(shape=(300, 400)):
    """Soft shapes and noise, as a camera sees them."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    soft = np.stack([np.sin(x / 70 + y / 90), np.cos(y / 50), np.sin(x * y / 9000)], axis=2)
    noisy = 128 + 90 * soft + np.random.default_rng(1).normal(0, 12, soft.shape)
    return Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (png(30_000, 30_000), "more than 40 million pixels"),
        (png(9_000, 9_000), "more than 40 million pixels"),
        (b"time,output\n0,1\n", "no PNG, JPEG, WebP or GIF picture"),
        (b"", "is empty"),
        (Image.new("RGB", (1, 1)), "1 x 1 pixels, too few"),
        (Image.new("RGB", (640, 480), "white"), "no axes were found"),
        (photo(), "no axes were found"),
    ],
)
def test_what_is_no_plot(content, sentence, tmp_path):
    path = tmp_path / "a.png"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content.save(path)
    with pytest.raises(ValueError, match=sentence):
        trace_image(path, x_range=(0, 1), y_range=(0, 1))


def test_empty_axes_and_cut_files(tmp_path):
    content = PLOTS[0].written(tmp_path)[0].read_bytes()
    (tmp_path / "cut.png").write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="is damaged"):
        trace_image(tmp_path / "cut.png")
    with pytest.raises(FileNotFoundError, match="There is no file"):
        trace_image(tmp_path / "none.png")
    frame = np.full((200, 300, 3), 255, np.uint8)
    frame[[20, 180], 30:271] = frame[20:181, [30, 270]] = 0
    Image.fromarray(frame).save(tmp_path / "frame.png")
    with pytest.raises(ValueError, match="no curve in the axes"):
        trace_image(tmp_path / "frame.png")


def mutated(content, random):
    """A file with bytes changed, cut off, put in or a wrong beginning."""
    data = bytearray(content)
    kind = random.integers(5)
    if kind == 0:
        return bytes(data[: random.integers(len(data))])
    if kind == 1:
        at = random.integers(len(data))
        data[at:at] = random.bytes(int(random.integers(1, 50)))
    elif kind == 2:
        data[: random.integers(1, 40)] = random.bytes(int(random.integers(1, 40)))
    else:
        for at in random.integers(8, len(data), random.integers(1, 20)):
            data[at] = random.integers(256)
    return bytes(data)


def check_mutations(folder, count):
    """Only the documented errors, in bounded time; what can still be read is a record."""
    plot = replace(PLOTS[0], name="small one", size=(3.2, 2.4))
    files = []
    for kind in ("png", "jpg", "webp", "gif"):
        path, options, _ = replace(plot, kind=kind).written(folder)
        files.append((path, path.read_bytes()))
    random, outcomes = np.random.default_rng(16), []
    for number in range(count):
        path, content = files[number % len(files)]
        broken = folder / f"broken{path.suffix}"
        broken.write_bytes(mutated(content, random))
        start = time.perf_counter()
        try:
            outcomes.append(isinstance(trace_image(broken, **options), StepRecord))
        except (ValueError, TypeError, OSError) as error:
            assert str(error) and "\n" not in str(error)
            place = error.__traceback__
            while place.tb_next is not None:
                place = place.tb_next
            assert "stepax" in place.tb_frame.f_code.co_filename  # a sentence of its own
            outcomes.append(False)
        assert time.perf_counter() - start < 5
    return outcomes


def test_mutated_files(tmp_path):
    outcomes = check_mutations(tmp_path, 200)
    assert 0 < sum(outcomes) < len(outcomes)


@pytest.mark.long
def test_many_mutated_files(tmp_path):
    check_mutations(tmp_path, 2000)
