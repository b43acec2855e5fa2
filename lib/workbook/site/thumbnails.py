"""Small pictures for lists of figures: a gallery of them in full size would weigh twenty megabytes."""

import io
from functools import cache

WIDTH = 480  # pixels: two for each of a column's


@cache
def thumbnail(png: bytes) -> tuple[bytes, int, int]:
    """A picture of `WIDTH` as WebP, with its width and height; a smaller one keeps its size.

    Parameters
    ----------
    png : bytes
        Of the whole picture.
    """
    from PIL import Image

    picture = Image.open(io.BytesIO(png)).convert("RGB")
    if picture.width > WIDTH:
        height = round(picture.height * WIDTH / picture.width)
        picture = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
    small = io.BytesIO()
    picture.save(small, "WEBP", quality=75, method=4)
    return small.getvalue(), *picture.size
