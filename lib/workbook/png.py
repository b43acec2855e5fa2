"""A picture as PNG, with a palette of at most 256 colours where they show no less."""

import io
import struct
import zlib

import numpy as np

COLOURS = 256  # what a palette holds
CELL = 3  # bits of a channel by which colours of one cell differ: at most 7 levels of 255
NOTICED = 8  # levels of a channel; up to so much a pixel may be off unnoticed
SHARE = 0.005  # of the pixels, that may be off by more
AREA = 0.0005  # of the pixels; a colour that fills so many is seen as an area and kept exactly


def encode(pixels: np.ndarray, dpi: float) -> bytes:
    """PNG of a picture; the same pixels give the same bytes.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width, 4)
        Red, green, blue and alpha. A picture that is transparent anywhere keeps all its colours.
    dpi : float
        Resolution that the file states, dots per inch.
    """
    from PIL import Image

    found = indexed(pixels) if pixels[..., 3].min() == 255 else None
    if found is None:
        picture = Image.fromarray(pixels)
    else:
        index, palette = found
        picture = Image.fromarray(index)
        picture.putpalette(palette.tobytes())
    buffer = io.BytesIO()
    picture.save(buffer, format="png", dpi=(dpi, dpi))
    return buffer.getvalue()


def encode_fast(pixels: np.ndarray) -> bytes:
    """PNG of a picture that goes a short way and is soon replaced: all colours, in half the time that Pillow takes.

    Pillow tries five filters on each row of pixels; a drawing is mostly paper and needs none.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width, 4)
        Red, green, blue and alpha.
    """
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 4 * width), np.uint8)  # each begins with its filter: 0, none
    rows[:, 1:] = pixels.reshape(height, -1)
    parts = {
        b"IHDR": struct.pack(">2I5B", width, height, 8, 6, 0, 0, 0),
        b"IDAT": zlib.compress(rows, 1),
        b"IEND": b"",
    }
    chunks = (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in parts.items()
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def indexed(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Each pixel's place in a palette, and the palette; None where it would show.

    The colour of an area, however pale, is kept exactly. Other colours that agree but for the last bits of each
    channel are one cell, and the most frequent stands for all. If there are too many cells some, rare shades of
    edges mostly, take the nearest colour of the others.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width, 4)

    Returns
    -------
    tuple of ndarray of uint8, optional
        Shapes (height, width) and (colours, 3).
    """
    codes = (np.ascontiguousarray(pixels).view("<u4")[..., 0] & np.uint32(0xFFFFFF)).ravel()
    # A picture is mostly paper: a run of one colour counts as one.
    starts = np.flatnonzero(np.diff(codes, prepend=~codes[:1]))
    lengths = np.diff(starts, append=codes.size)
    colours, colour = np.unique(codes[starts], return_inverse=True)
    counts = np.bincount(colour, lengths).astype(int)
    channels = (colours[:, None] >> np.array([0, 8, 16], np.uint32) & 255).astype(np.int16)
    area = counts >= AREA * codes.size
    cells = colours
    if len(colours) > COLOURS:
        cells = (channels >> CELL).astype(np.int32) @ np.array([1, 256, 65536], np.int32)
        cells[area] = -1 - np.arange(area.sum())  # a cell of its own
    _, cell = np.unique(cells, return_inverse=True)
    frequent = np.empty(cell.max() + 1, int)
    rising = np.argsort(counts, kind="stable")
    frequent[cell[rising]] = rising  # the last one written is the most frequent
    weights = np.bincount(cell, counts) * np.where(area[frequent], codes.size, 1)  # areas come first
    palette, nearest = _palette(channels[frequent], weights)
    place = nearest[cell]
    off = np.abs(channels - palette[place]).max(axis=1)
    if off[area].any() or counts[off > NOTICED].sum() > SHARE * codes.size:
        return None
    index = np.repeat(place.astype(np.uint8)[colour], lengths)
    return index.reshape(pixels.shape[:2]), palette.astype(np.uint8)


def _palette(colours: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours for a palette, the one most missed next: by its weight and how far off, squared; each one's nearest."""
    off = np.full(len(colours), 255, np.int16)
    nearest = np.zeros(len(colours), int)
    chosen = []
    while len(chosen) < COLOURS and off.any():
        missed = int(np.argmax(weights * off.astype(float) ** 2))
        distance = np.abs(colours - colours[missed]).max(axis=1)
        closer = distance < off
        nearest[closer], off[closer] = len(chosen), distance[closer]
        chosen.append(missed)
    return colours[chosen], nearest
