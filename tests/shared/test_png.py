import io

import numpy as np
import pytest
from matplotlib.image import imread

from workbook import png


def opaque(rgb):
    return np.dstack([rgb, np.full(rgb.shape[:2], 255)]).astype(np.uint8)


def decoded(data):
    return np.rint(255 * imread(io.BytesIO(data))).astype(np.uint8)


def kind_of(data):
    """How the file stores colours: 3 is a palette, 2 and 6 are all colours without and with alpha."""
    return data[25]


def ramp(height, width, levels):
    """A white page with a black line and a stripe of many colours."""
    rgb = np.full((height, width, 3), 255)
    rgb[height // 2] = 0
    rng = np.random.default_rng(3)
    rgb[:levels, :, 0] = rng.integers(0, 256, (levels, width))
    rgb[:levels, :, 1] = rng.integers(0, 256, (levels, width))
    return opaque(rgb)


def test_the_fast_way_keeps_every_colour_and_alpha():
    pixels = np.random.default_rng(4).integers(0, 256, (37, 53, 4), np.uint8)
    data = png.encode_fast(pixels)
    assert kind_of(data) == 6
    np.testing.assert_array_equal(decoded(data), pixels)
    np.testing.assert_array_equal(decoded(png.encode_fast(pixels[::2, ::3])), pixels[::2, ::3])


def test_up_to_256_colours_come_back_exactly():
    rgb = np.random.default_rng(1).integers(0, 256, (256, 3))[np.arange(4000).reshape(50, 80) % 256]
    data = png.encode(opaque(rgb), 150)
    assert kind_of(data) == 3
    np.testing.assert_array_equal(decoded(data)[..., :3], rgb)


@pytest.mark.slow
def test_frequent_colours_stay_exact_and_the_rest_is_close():
    picture = ramp(400, 500, 1)
    assert len(np.unique(picture.reshape(-1, 4), axis=0)) > 256
    back = decoded(data := png.encode(picture, 150))
    assert kind_of(data) == 3
    np.testing.assert_array_equal(back[1:, :, :3], picture[1:, :, :3])
    off = np.abs(back[..., :3].astype(int) - picture[..., :3]).max(axis=2)
    assert (off > png.NOTICED).mean() <= png.SHARE


def test_pale_areas_keep_their_shade():
    picture = ramp(400, 500, 1)
    shades = np.repeat(np.arange(200, 250), 10)  # stripes of one level's difference
    picture[10:150, :, 0] = picture[10:150, :, 1] = shades
    data = png.encode(picture, 150)
    assert kind_of(data) == 3
    np.testing.assert_array_equal(decoded(data)[10:, :, :3], picture[10:, :, :3])


def test_a_picture_that_would_lose_keeps_all_its_colours():
    picture = ramp(400, 500, 40)
    data = png.encode(picture, 150)
    assert kind_of(data) != 3
    np.testing.assert_array_equal(decoded(data)[..., :3], picture[..., :3])


def test_a_transparent_picture_keeps_its_alpha():
    picture = ramp(20, 30, 0)
    picture[3, 4, 3] = 100
    np.testing.assert_array_equal(decoded(png.encode(picture, 150)), picture)


@pytest.mark.parametrize("levels", [0, 1, 40])
def test_the_same_pixels_give_the_same_bytes(levels):
    assert png.encode(ramp(90, 80, levels), 150) == png.encode(ramp(90, 80, levels).copy(), 150)
