"""Pictures in colour from files: what each format holds, its encoding, and mistakes."""

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from diffshadow import io
from diffshadow._srgb import from_srgb, to_srgb

RNG = np.random.default_rng(0)
BYTES = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)
LINEAR = RNG.uniform(0, 3, (5, 7, 3)).astype(np.float32)


def test_png_and_jpeg_are_srgb_and_begin_with_the_top_row(tmp_path):
    Image.fromarray(BYTES).save(tmp_path / "picture.png")
    picture, encoding = io.read_picture(tmp_path / "picture.png")
    assert encoding == "srgb"
    np.testing.assert_array_equal(np.rint(255 * picture), BYTES[::-1])
    smooth = np.linspace(0, 255, 32 * 32).reshape(32, 32, 1).repeat(3, axis=2).astype(np.uint8)
    for suffix in ("jpg", "jpeg"):
        Image.fromarray(smooth).save(tmp_path / f"picture.{suffix}", format="JPEG", quality=95)
        picture, encoding = io.read_picture(tmp_path / f"picture.{suffix}")
        assert encoding == "srgb"
        np.testing.assert_allclose(255 * picture, smooth[::-1], atol=4)
        # Where visibility is expected, it is grey and linear, as of a PNG file.
        grey = io.read_visibility(tmp_path / f"picture.{suffix}")
        np.testing.assert_allclose(255 * grey, smooth[::-1, :, 0], atol=4)


def test_grey_has_three_equal_channels(tmp_path):
    Image.fromarray(BYTES[..., 0]).save(tmp_path / "grey.png")
    picture, _ = io.read_picture(tmp_path / "grey.png")
    np.testing.assert_array_equal(np.rint(255 * picture), np.repeat(BYTES[::-1, :, :1], 3, axis=2))


def test_exr_and_npy_are_linear_beyond_one_too(tmp_path):
    channels = {name: np.ascontiguousarray(LINEAR[::-1, :, k]) for k, name in enumerate("RGB")}
    with OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}, channels) as exr:
        exr.write(str(tmp_path / "picture.exr"))
    np.save(tmp_path / "picture.npy", LINEAR)
    for suffix in ("exr", "npy"):
        picture, encoding = io.read_picture(tmp_path / f"picture.{suffix}")
        assert encoding == "linear"
        np.testing.assert_array_equal(picture, LINEAR)


def test_pictures_that_cannot_be_read_are_reported(tmp_path):
    np.save(tmp_path / "grey.npy", LINEAR[..., 0])
    np.save(tmp_path / "nan.npy", np.where(LINEAR > 2, np.nan, LINEAR))
    (tmp_path / "text.png").write_text("no picture")
    for name, said in (
        ("grey.npy", r"shape \(5, 7\); expected \(h, w, 3\)"),
        ("nan.npy", "NaN or infinite"),
        ("text.png", "does not begin as a .png file"),
        ("missing.png", "there is no picture file"),
        ("picture.gif", "there is no picture file"),
    ):
        with pytest.raises(io.FileError, match=said):
            io.read_picture(tmp_path / name)


def test_srgb_is_its_standard_and_its_inverse():
    linear = np.linspace(0, 1, 101)
    np.testing.assert_allclose(from_srgb(to_srgb(linear)), linear, atol=1e-7)
    # Of IEC 61966-2-1: 18 % grey is 117.6 of 255, and the two parts meet.
    assert 255 * to_srgb(np.array(0.18)) == pytest.approx(117.65, abs=0.05)
    np.testing.assert_allclose(to_srgb(np.array([0.0031308, 0.00313081])), 0.04045, atol=2e-6)
