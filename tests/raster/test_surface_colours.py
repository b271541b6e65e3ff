"""Colours of corners and textures on surfaces: values in closed form, gradients against differences, creases."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError
from scenes import quad

from diffshadow.geometry import (
    NO_TEXTURE,
    Edges,
    Mesh,
    PinholeCamera,
    Textures,
    face_colours,
    merge,
    scaling,
)
from diffshadow.raster import draw_antialiased, draw_surface
from diffshadow.raster._boundaries import find_creases
from diffshadow.raster._interpolate import Points, by_bands
from diffshadow.raster._surface import passes_at_points

RESOLUTION = (24, 32)
CAMERA = PinholeCamera((0.7, 0.5, 2.2), (0, 0, 0), near=0.5, far=5.0, resolution=RESOLUTION)
REPEATS = (3.0, 2.0)
WRAPS = ("repeat", "clamp", "mirror")
RANDOM = np.random.default_rng(1)
IMAGE = RANDOM.uniform(0, 1, (5, 8, 4))
COLOURS = RANDOM.uniform(0, 1, (2, 3, 3))


def textured(**given):
    """A square from -1 to 1 in x and y, whose texture repeats."""
    card = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * REPEATS
    textures = Textures.of(IMAGE, corners[np.asarray(card.faces)])
    return Mesh(card.vertices, card.faces, card.corner_normals, textures=textures, **given)


def sampled(image, u, v):
    """An image that repeats at (u, v), by the four texels around: a sum over hat functions of all texels."""
    height, width = image.shape[:2]

    def hats(coordinate, size):
        away = (coordinate[..., None] * size - 0.5 - np.arange(size) + size / 2) % size - size / 2
        return np.maximum(1 - np.abs(away), 0)

    return np.einsum("...j,...i,jic->...c", hats(v, height), hats(u, width), image)


def test_a_texture_is_read_between_its_texels_and_repeats():
    surface = draw_surface(textured(albedo=0.5), CAMERA)
    x, y, _ = np.moveaxis(np.asarray(surface.position, np.float64), -1, 0)
    expected = sampled(IMAGE, (x + 1) / 2 * REPEATS[0], (y + 1) / 2 * REPEATS[1])[..., :3]
    mask = np.asarray(surface.mask)
    assert mask.mean() > 0.5
    np.testing.assert_allclose(np.asarray(surface.albedo)[mask], 0.5 * expected[mask], atol=1e-5)


def read_by_hand(image, wrap, filter, u, v):
    """An image at (u, v), texel by texel."""

    def texel(number, size, how):
        if how == "clamp":
            return min(max(number, 0), size - 1)
        number %= 2 * size if how == "mirror" else size
        return 2 * size - 1 - number if number >= size else number

    height, width = image.shape[:2]
    at = lambda row, column: image[texel(row, height, wrap[1]), texel(column, width, wrap[0])]
    x, y = u * width, v * height
    if filter == "nearest":
        return at(int(np.floor(y)), int(np.floor(x)))
    x, y = x - 0.5, y - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    right, up = x - column, y - row
    lower = at(row, column) * (1 - right) + at(row, column + 1) * right
    return lower * (1 - up) + (at(row + 1, column) * (1 - right) + at(row + 1, column + 1) * right) * up


SAMPLERS = [((u, v), filter) for u in WRAPS for v in WRAPS for filter in ("linear", "nearest")]


def test_textures_repeat_end_and_mirror_along_each_axis_and_have_the_derivatives_of_differences():
    each = [Textures.of(IMAGE, np.zeros((0, 3, 2)), wrap=wrap, filter=filter) for wrap, filter in SAMPLERS]
    codes = [(0, 0, 0) if one.samplers is None else np.asarray(one.samplers)[0] for one in each]
    table = np.tile([[0, *IMAGE.shape[:2]]], (len(SAMPLERS), 1))
    with jax.enable_x64(True):
        textures = Textures(np.zeros((0, 3, 2)), np.zeros(0, int), IMAGE.reshape(-1, 4), table, samplers=codes)
        index = np.repeat(np.arange(len(SAMPLERS)), 40)
        uv = np.random.default_rng(3).uniform(-2.5, 3.5, (len(index), 2))
        read = jax.jit(lambda uv: textures.at(jnp.asarray(index), uv))
        expected = [read_by_hand(IMAGE, *SAMPLERS[i], *at) for i, at in zip(index, uv, strict=True)]
        np.testing.assert_allclose(read(uv), expected, atol=1e-12)
        towards, step = np.random.default_rng(4).normal(size=uv.shape), 1e-7
        slope = jax.jit(lambda uv: jax.jvp(read, (uv,), (towards,))[1])(uv)
        difference = (read(uv + step * towards) - read(uv - step * towards)) / (2 * step)
        np.testing.assert_allclose(slope, difference, atol=1e-6)


def test_a_mesh_with_colours_is_white_and_one_without_is_light_grey():
    card = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    np.testing.assert_array_equal(textured().albedo, 1)
    np.testing.assert_array_equal(Mesh(card.vertices, card.faces, corner_colours=COLOURS).albedo, 1)
    np.testing.assert_allclose(card.albedo, 0.8)


def test_merged_meshes_keep_their_textures_and_padding_adds_none():
    small = dataclasses.replace(textured(), textures=Textures.of(IMAGE[:2, :3], textured().textures.uv, cutoff=0.5))
    plain = quad((0, 0, 1), (1, 0, 0), (0, 1, 0))
    whole = merge([textured(), plain, small])
    uv = RANDOM.uniform(-2, 2, (6, 2)).astype(np.float32)
    for mesh in (whole, whole.padded()):
        textures = mesh.textures
        np.testing.assert_array_equal(np.asarray(textures.index)[:6], [0, 0, NO_TEXTURE, NO_TEXTURE, 1, 1])
        assert (np.asarray(textures.index)[6:] == NO_TEXTURE).all()
        np.testing.assert_array_equal(np.asarray(textures.cutoff)[:2], [0, 0.5])
        found = np.asarray(textures.at(jnp.asarray(textures.index[:6]), jnp.asarray(uv)))
        expected = [sampled(IMAGE, *uv[:2].T), np.ones((2, 4)), sampled(IMAGE[:2, :3], *uv[4:].T)]
        np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-5)
    np.testing.assert_array_equal(face_colours(whole)[2:4], plain.albedo)
    colours = merge([plain, Mesh(plain.vertices, plain.faces, corner_colours=COLOURS)]).corner_colours
    np.testing.assert_allclose(colours, np.concatenate([np.ones((2, 3, 3)), COLOURS]), rtol=1e-6)


def test_faces_of_one_texture_follow_those_of_another():
    first, second = (
        Textures.of(IMAGE, RANDOM.uniform(size=(n, 3, 2)), 0.5, corner_alpha=np.full((n, 3), n / 4)) for n in (1, 3)
    )
    second = dataclasses.replace(second, index=jnp.asarray([0, NO_TEXTURE, 0]))
    both = first.followed_by(second)
    for part in ("uv", "index", "corner_alpha"):
        expected = np.concatenate([getattr(first, part), getattr(second, part)])
        np.testing.assert_array_equal(getattr(both, part), expected)
    np.testing.assert_array_equal(both.texels, first.texels)


def test_a_mirror_keeps_colours_at_their_corners():
    mesh = textured(corner_colours=COLOURS)
    mirrored = mesh.transformed(scaling(jnp.array([1.0, 1.0, -1.0])))
    for part in (lambda one: one.textures.uv, lambda one: one.corner_colours):
        assert _by_corner(mirrored, part) == _by_corner(mesh, part)


def _by_corner(mesh, part):
    """What the corners of faces have, by face and place in x and y."""
    faces, values = np.asarray(mesh.faces), np.asarray(part(mesh))
    places = np.asarray(mesh.vertices)[faces][..., :2]
    return {(face, *places[face, k]): tuple(values[face, k]) for face in range(len(faces)) for k in range(3)}


def test_creases_are_where_textures_and_colours_end_and_not_where_they_continue():
    def creases(mesh):
        edges = Edges.of(mesh)
        return int(np.sum(find_creases(mesh, edges)))

    assert creases(textured()) == 0
    uv = np.asarray(textured().textures.uv)
    of = lambda mesh, **new: dataclasses.replace(mesh, textures=dataclasses.replace(mesh.textures, **new))
    # A second face that is whole repetitions away shows the same.
    assert creases(of(textured(), uv=uv + np.array([[[0, 0]], [[2, -1]]]))) == 0
    assert creases(of(textured(), uv=uv + np.array([[[0, 0]], [[0.25, 0]]]))) == 1
    # Where the border goes on, a whole repetition away is another place.
    assert creases(of(textured(), uv=uv + np.array([[[0, 0]], [[2, 0]]]), samplers=[(1, 0, 0)])) == 1
    assert creases(of(textured(), index=np.array([0, NO_TEXTURE]))) == 1
    shared = np.array([[(1, 0, 0), (0, 1, 0), (0, 0, 1)], [(1, 0, 0), (0, 0, 1), (1, 1, 1)]], float)
    assert creases(textured(corner_colours=shared)) == 0
    assert creases(textured(corner_colours=shared[:, ::-1])) == 1


def test_the_alpha_test_of_points_is_that_of_their_texels():
    mesh = textured()
    uv, rng = np.asarray(mesh.textures.uv) / np.array(REPEATS), np.random.default_rng(2)
    mesh = dataclasses.replace(mesh, textures=Textures.of(IMAGE, uv, cutoff=0.5))
    at = rng.uniform(0.1, 0.9, (2, 40))
    # The first face is the one below the diagonal.
    face = np.where(rng.uniform(size=40) < 0.1, -1, np.where(at[1] < at[0], 0, 1)).astype(np.int32)
    view = CAMERA.view()
    place = view.clip(jnp.asarray([*(2 * at - 1), np.zeros(40)]).T)
    x, y = (place[:, :2] / place[:, 3:]).T
    found = passes_at_points(
        mesh, jnp.asarray(face[None]), view.clip_vertices(mesh.vertices), Points(x[None], y[None])
    )[0]
    alpha = np.where(face < 0, 1, sampled(IMAGE, *at)[:, 3])
    sure = np.abs(alpha - 0.5) > 1e-3
    assert 5 < np.sum(alpha[sure] < 0.5) < 35
    np.testing.assert_array_equal(np.asarray(found)[sure], alpha[sure] >= 0.5)


@pytest.mark.parametrize("band", [24, 9, 4, 1])
def test_bands_of_an_image_together_are_the_image(band):
    face = jnp.arange(24, dtype=jnp.int32).reshape(6, 4)
    row = lambda part, rows: rows.first + jnp.arange(part.shape[0])[:, None]
    found = by_bands(
        lambda part, rows: (part + 100 * row(part, rows), jnp.full(len(part), rows.height)), face, band=band
    )
    np.testing.assert_array_equal(found[0], face + 100 * np.arange(6)[:, None])
    np.testing.assert_array_equal(found[1], [6] * 6)


@pytest.mark.exhaustive
def test_an_antialiased_picture_has_no_line_where_the_alpha_test_cuts_out_the_rim():
    """The rim of a card whose outer texels are cut out is no outline of the picture."""
    alpha = np.zeros((8, 8))
    alpha[2:-2, 2:-2] = 1
    image = np.concatenate([np.ones((8, 8, 3)), alpha[..., None]], axis=-1)
    mesh = textured()
    uv = np.asarray(mesh.textures.uv) / np.array(REPEATS)
    mesh = dataclasses.replace(mesh, textures=Textures.of(image, uv, cutoff=0.5))
    seen = draw_antialiased(mesh, CAMERA)
    picture = np.asarray(seen.resolve(seen.surface.albedo))
    np.testing.assert_array_equal(picture, np.asarray(draw_surface(mesh, CAMERA).albedo))
    # Whole, its rim is one.
    whole = dataclasses.replace(mesh, textures=Textures.of(image, uv))
    seen = draw_antialiased(whole, CAMERA)
    assert (np.asarray(seen.resolve(seen.surface.albedo)) != np.asarray(seen.centres.albedo)).any()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"texels": np.full((6, 4), 1.5)}, "a texel is"),
        ({"uv": np.full((2, 3, 2), np.nan)}, "texture coordinates are NaN"),
        ({"table": [(0, 3, 3)]}, "the textures' table"),
        ({"index": [0, 1]}, "up to 0"),
        ({"uv": np.zeros((1, 3, 2))}, "have shape"),
        ({"samplers": [(0, 3, 0)]}, "samplers are"),
        ({"samplers": [(0, 0)]}, "samplers have shape"),
        ({"corner_alpha": np.full((2, 3), 1.5)}, "the corners' alpha is from 1.5"),
        ({"corner_alpha": np.ones((1, 3))}, "corner_alpha have shape"),
    ],
)
def test_bad_textures_are_refused(given, message):
    good = {"uv": np.zeros((2, 3, 2)), "index": [0, 0], "texels": np.ones((6, 4)), "table": [(0, 2, 3)]}
    Textures(**good)
    with pytest.raises(ValueError, match=message):
        Textures(**good | given)
    with pytest.raises(ValueError, match="the texture's image has shape"):
        Textures.of(np.ones((2, 2)), good["uv"])
    for word in ({"wrap": "mirrored"}, {"filter": "bilinear"}):
        with pytest.raises((ValueError, TypeCheckError), match=next(iter(word.values()))):
            Textures.of(IMAGE, good["uv"], **word)


def test_colours_for_other_faces_are_refused():
    card = quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    with pytest.raises(ValueError, match="textures are for 1 faces; expected 2"):
        Mesh(card.vertices, card.faces, textures=Textures.of(IMAGE, np.zeros((1, 3, 2))))
    with pytest.raises(ValueError, match="corner_colours have shape"):
        Mesh(card.vertices, card.faces, corner_colours=np.ones((1, 3, 3)))
    with pytest.raises(ValueError, match="corner_colours is"):
        Mesh(card.vertices, card.faces, corner_colours=np.full((2, 3, 3), 1.5))
