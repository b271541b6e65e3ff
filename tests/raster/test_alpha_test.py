"""The alpha test against drawings by OpenGL's `discard`, and against rays."""

from pathlib import Path

import golden_cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.geometry import Pages, Textures
from diffshadow.raster import _band_pass, rasterize

FOLDER = Path(golden_cases.FOLDER) / "cutouts"
# As small meshes are padded, so that all share a program.
FACES = 256


def drawn(name):
    """What OpenGL drew, and the arguments of `rasterize`; faces without area are added, so that all share a program."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        golden = dict(stored)
    images = [np.stack([alpha] * 4, axis=-1) for alpha in (golden["fence"], golden["foliage"])]
    sizes = [image.shape[:2] for image in images]
    starts = np.cumsum([0, *(h * w for h, w in sizes)])
    table = [(start, *size) for start, size in zip(starts, sizes, strict=False)]
    texels = np.concatenate([image.reshape(-1, 4) for image in images])
    textures = Textures(golden["uv"], golden["index"], texels, table, golden["cutoffs"]).padded(FACES)
    clip = np.zeros((FACES, 4), np.float32)
    clip[: len(golden["clip"])] = golden["clip"]
    faces = np.zeros((FACES, 3), np.int32)
    faces[: len(golden["faces"])] = golden["faces"]
    return golden, (jnp.asarray(clip), jnp.asarray(faces), golden["winner"].shape), textures


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["fences", "behind_the_eye", "leaves"])
def test_pixels_are_cut_out_as_by_opengl(name):
    golden, given, textures = drawn(name)
    seen = rasterize(*given, alpha_test=textures)
    same = np.asarray(seen.face) == golden["winner"]
    assert same.mean() >= 0.999
    np.testing.assert_allclose(np.asarray(seen.depth)[same], golden["depth"][same], atol=4e-6)
    # Many pixels are cut out, so that this tests something.
    whole = np.asarray(rasterize(*given).face)
    assert (whole != golden["winner"]).mean() > 0.1


@pytest.mark.exhaustive
def test_pages_are_cut_out_as_the_whole_map(monkeypatch):
    _, (clip, faces, _), textures = drawn("behind_the_eye")
    whole = np.asarray(rasterize(clip, faces, (64, 64), alpha_test=textures).face)
    pages = Pages.of(jnp.ones(Pages.total(3), bool), 16, 6, 3, 22)
    found = np.asarray(rasterize(clip, faces, (28, 28), pages=pages, alpha_test=textures).face)
    assert (whole >= 0).mean() > 0.3
    for layer, (x, y) in enumerate(np.asarray(pages.tile.origin)[:16]):
        np.testing.assert_array_equal(found[layer], whole[y : y + 28, x : x + 28])


@pytest.mark.exhaustive
@pytest.mark.parametrize("way", ["bands", "gpu"])
def test_large_images_and_gpus_cut_out_the_same(way, monkeypatch):
    _, (clip, faces, _), textures = drawn("behind_the_eye")
    # A shape of its own, since programs are found again by their shapes.
    resolution = (103, 91)
    expected = rasterize(clip, faces, resolution, alpha_test=textures)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu" if way == "gpu" else "cpu")
    if way == "bands":
        for name, value in (("_MAX_IN_ONE", 0), ("_MIN_BYTES", 1), ("_MIN_ROWS", 20)):
            monkeypatch.setattr(_band_pass, name, value)
        assert _band_pass.bands_of(resolution, 8) > 1
    found = jax.jit(lambda clip: rasterize(clip, faces, resolution, alpha_test=textures))(clip)
    assert np.mean(np.asarray(found.face) == np.asarray(expected.face)) >= 0.999
