"""A picture from a file, as numbers; what cannot be read is said in one sentence."""

import warnings
from io import BufferedIOBase, BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._table import file_content, file_name


SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".webp", ".gif"})
"""Endings of files that are taken for pictures."""

FORMATS = ("PNG", "JPEG", "WEBP", "GIF")

MOST_PIXELS = 40_000_000
"""A poster at 300 dots an inch has half as many; reading more would take gigabytes."""

SHORTEST_SIDE = 64
"""Pixels below which no plot has axes, ticks and a curve."""


class Picture(NamedTuple):
    """A picture: its name, and red, green and blue from 0 to 255, (height, width, 3).

    `lossy`: its colours are blurred, as JPEG and WebP store them.
    """

    name: str
    pixels: np.ndarray
    lossy: bool = False

    @property
    def height(self) -> int:
        """Rows of pixels."""
        return self.pixels.shape[0]

    @property
    def width(self) -> int:
        """Columns of pixels."""
        return self.pixels.shape[1]


def load(path: Path | BufferedIOBase) -> Picture:
    """The picture in a file; transparent parts are as on paper. **Raises** `ValueError`, `OSError`.

    A light drawing on a transparent ground was meant for a dark one, and gets it.
    """
    from PIL import Image, UnidentifiedImageError

    content, name = file_content(path), file_name(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(BytesIO(content), formats=FORMATS) as image:
                _check_size(name, *image.size)
                lossy = image.format == "JPEG" or (image.format == "WEBP" and b"VP8 " in content)
                return Picture(name, _pixels(image), lossy)
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise ValueError(_too_large(name)) from None
    except UnidentifiedImageError:
        raise ValueError(f"{name} is no PNG, JPEG, WebP or GIF picture.") from None
    except _Size:
        raise
    except Exception:  # Pillow has many for a damaged file
        raise ValueError(f"{name} is damaged: the picture in it cannot be read.") from None


class _Size(ValueError):
    """A picture of a size that is not read."""


def _check_size(name: str, width: int, height: int) -> None:
    if width * height > MOST_PIXELS:
        raise _Size(_too_large(name))
    if min(width, height) < SHORTEST_SIDE:
        raise _Size(f"{name} has {width} x {height} pixels, too few for a plot.")


def _too_large(name: str) -> str:
    return f"{name} has more than {MOST_PIXELS // 10**6} million pixels: make it smaller."


def _pixels(image: Any) -> np.ndarray:
    """Red, green and blue of a picture in any mode."""
    if image.mode.startswith("I"):  # 16 bits of grey, which Pillow would cut off and not scale
        grey = np.clip(np.asarray(image, np.int64) // 257, 0, 255).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    if image.mode not in ("RGBA", "LA", "PA", "La", "RGBa") and "transparency" not in image.info:
        return np.array(image.convert("RGB"))
    layers = np.asarray(image.convert("RGBA"))
    opaque = layers[:, :, 3:]
    drawn = layers[:, :, :3][opaque[:, :, 0] > 127]
    paper = 0 if drawn.size and np.mean(drawn) > 170 and np.any(opaque < 128) else 255
    share = opaque.astype(np.float32) / 255
    return np.rint(share * layers[:, :, :3] + (1 - share) * paper).astype(np.uint8)
