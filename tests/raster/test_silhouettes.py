"""Edges of meshes, and the two finders of silhouettes."""

import functools
from collections import Counter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from scenes import filled

from diffshadow.geometry import (
    LIBRARY,
    NO_NEIGHBOUR,
    DirectionalLight,
    Edges,
    Mesh,
    SpotLight,
    library_mesh,
    merge,
    share_vertices,
)
from diffshadow.raster import Silhouettes, light_sides, silhouettes_by_adjacency

SMALL = {
    "sphere": {"subdivisions": 2},
    "blob": {"subdivisions": 2},
    "torus": {"segments": 12, "sides": 7},
    "torus_knot": {"segments": 24, "sides": 5},
    "plane": {"segments": 3},
    "chair": {"spindles": 1, "sides": 3},
}
CLOSED = sorted(set(LIBRARY) - {"plane"})
SUN = DirectionalLight((0.5, -1.0, -0.3), (0, 0, 0), (4, 4), -4, 4)
LAMP = SpotLight((-1.2, 3.0, 0.9), (0.4, -1.0, -0.3), 40.0, 0.1, 10.0)
FACES, VERTICES = 12, 7
seeds = st.integers(0, 2**32 - 1)


@functools.cache
def piece(name):
    return library_mesh(name, **SMALL.get(name, {}))


def _list(values):
    return np.asarray(values).tolist()


def total(found: Silhouettes) -> dict[tuple[int, int], int]:
    """The multiplicity of each silhouette from its lower vertex to its higher, rows of one edge summed up."""
    sums = Counter()
    for (a, b), multiplicity in zip(*map(_list, (found.vertices, found.multiplicity)), strict=True):
        sums[min(a, b), max(a, b)] += multiplicity if a < b else -multiplicity
    return {edge: number for edge, number in sums.items() if number}


# What every mesh is filled up to, so that they share what is compiled.
SIZES = (1000, 1800, 2700)


def filled_up(mesh):
    return filled(mesh, Edges.of(mesh), *SIZES)


_sides = eqx.filter_jit(light_sides)


def sides_of(mesh, light):
    """Which side of each face (f,) the light sees."""
    return np.asarray(_sides(filled_up(mesh)[0], light))[: len(mesh.faces)]


def silhouettes_by_cancelling(faces, orientation):
    """The same silhouettes, by listing the directed sides of all faces and cancelling opposite ones.

    `faces` (f, 3) name the same vertices where they meet, as from `share_vertices`. There are (3 f,) rows. Each
    silhouette is in one of them, from its lower vertex to its higher; all others have multiplicity 0.
    """
    start, end = faces.reshape(-1), jnp.roll(faces, -1, axis=1).reshape(-1)
    pushed = jnp.repeat(orientation, 3) * jnp.sign(end - start)
    low, high, pushed = lax.sort((jnp.minimum(start, end), jnp.maximum(start, end), pushed), num_keys=2)
    is_new = jnp.ones(low.shape, bool).at[1:].set((low[1:] != low[:-1]) | (high[1:] != high[:-1]))
    edge = jnp.cumsum(is_new, dtype=jnp.int32) - 1
    total = jax.ops.segment_sum(pushed, edge, low.shape[0], indices_are_sorted=True)
    return Silhouettes(jnp.stack([low, high], axis=1), jnp.where(is_new, total[edge], 0))


@eqx.filter_jit
def _found(edges, faces, orientation):
    return silhouettes_by_adjacency(edges, orientation), silhouettes_by_cancelling(faces, orientation)


def find(mesh, orientation):
    """What each finder finds."""
    _, edges = filled_up(mesh)
    turned = np.zeros(SIZES[1], np.int32)
    turned[: len(mesh.faces)] = orientation
    faces = np.zeros((SIZES[1], 3), np.int32)
    faces[: len(mesh.faces)] = share_vertices(mesh)
    return _found(edges, jnp.asarray(faces), jnp.asarray(turned))


def both(mesh, orientation):
    """What each finder finds, summed up."""
    one, other = find(mesh, orientation)
    return total(one), total(other)


def random_mesh(rng):
    """A soup on few vertices, some of them at the same place: edges of any number of faces, and faces without area."""
    vertices = rng.integers(-2, 3, (VERTICES, 3)).astype(float)
    return Mesh(vertices, rng.integers(0, VERTICES, (FACES, 3)))


# The table


@pytest.mark.parametrize("name", CLOSED)
def test_closed_pieces_have_two_opposed_faces_at_every_edge(name):
    mesh = piece(name)
    edges = Edges.of(mesh)
    assert edges.is_closed
    assert np.asarray(edges.solid).all()
    # Three sides a face, two faces an edge.
    assert len(edges.vertices) == len(mesh.faces) * 3 // 2
    np.testing.assert_array_equal(edges.directions, np.tile([1, -1], (len(edges.vertices), 1)))
    # The first face runs along the edge, the second back.
    for side, way in ((0, (0, 1)), (1, (1, 0))):
        start, end = (np.asarray(edges.vertices)[:, k] for k in way)
        corners = np.asarray(mesh.faces)[np.asarray(edges.faces)[:, side]]
        runs = (corners == start[:, None]) & (np.roll(corners, -1, axis=1) == end[:, None])
        assert runs.any(axis=1).all()


def test_open_sheet_has_edges_of_one_face_round_its_rim():
    edges = Edges.of(piece("plane"))
    assert not edges.is_closed
    assert not np.asarray(edges.solid).any()
    assert np.sum(np.asarray(edges.faces)[:, 1] == NO_NEIGHBOUR) == 4 * 3


def test_vertices_at_one_place_count_as_one():
    mesh = piece("box")
    apart = Mesh(np.asarray(mesh.vertices)[np.asarray(mesh.faces)].reshape(-1, 3), np.arange(36).reshape(12, 3))
    edges = Edges.of(apart)
    assert edges.is_closed
    assert len(edges.vertices) == 18
    order = np.argsort(_order(mesh, apart))
    np.testing.assert_array_equal(edges.faces, np.asarray(Edges.of(mesh).faces)[order])


def _order(mesh, apart):
    """Where each row of the edges of `apart` is in those of `mesh`, both named by their faces."""
    rows = [sorted(pair) for pair in np.asarray(Edges.of(apart).faces).tolist()]
    named = [sorted(pair) for pair in np.asarray(Edges.of(mesh).faces).tolist()]
    return [rows.index(pair) for pair in named]


def test_zeros_of_either_sign_are_one_place():
    vertices = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [-0.0, -0.0, 0.0],
        [0.0, -1.0, 0.0],
        [1.0, -0.0, -0.0],
    ]
    edges = Edges.of(Mesh(vertices, [[0, 1, 2], [3, 4, 5]]))
    assert edges.faces.shape == (5, 2)
    assert int((edges.faces[:, 1] != NO_NEIGHBOUR).sum()) == 1


def test_edge_of_three_faces_has_a_row_for_each():
    mesh = Mesh([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 1], [-1, 0, -1]], [[0, 1, 2], [0, 1, 3], [1, 0, 4]])
    edges = Edges.of(mesh)
    spine = (np.sort(np.asarray(edges.vertices), axis=1) == [0, 1]).all(axis=1)
    assert sorted(np.asarray(edges.faces)[spine].tolist()) == [[0, -1], [1, -1], [2, -1]]


def test_a_component_inside_out_is_closed_but_not_solid():
    box = piece("box")
    inverted = Mesh(box.vertices + jnp.array([3.0, 0, 0]), box.faces[:, ::-1])
    edges = Edges.of(merge([box, inverted, piece("plane")]))
    assert np.asarray(edges.solid)[np.asarray(edges.component)[[0, 12, 24]]].tolist() == [True, False, False]
    assert not edges.is_closed


def test_edges_of_a_traced_mesh_are_refused():
    with pytest.raises(ValueError, match=r"call Edges\.of\(mesh\) outside"):
        jax.jit(lambda v: Edges.of(Mesh(v, piece("box").faces)).vertices)(piece("box").vertices)


# Facing


@pytest.mark.parametrize("light", [SUN, LAMP], ids=["sun", "lamp"])
def test_light_sides_follow_the_centroid_formula_in_float64(light):
    mesh = piece("torus")
    a, b, c = np.moveaxis(np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)], 1, 0)
    middle = (a + b + c) / 3
    from_light = np.array([0.5, -1.0, -0.3]) if light is SUN else middle - [-1.2, 3.0, 0.9]
    signed = np.sum(from_light * np.cross(b - a, c - b), axis=1)
    sure = np.abs(signed) > 1e-6 * np.abs(signed).max()
    np.testing.assert_array_equal(sides_of(mesh, light)[sure], -np.sign(signed)[sure])


def test_light_sides_is_zero_edge_on_and_without_area():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 1], [0, 1, 3], [0, 3, 1]])
    down = DirectionalLight((0, -1, 0), (0, 0, 0), (1, 1), -1, 1)
    assert sides_of(mesh, down).tolist() == [0, 0, -1, 1]


# Finders


@pytest.mark.parametrize("light", [SUN, LAMP], ids=["sun", "lamp"])
@pytest.mark.parametrize("name", sorted(LIBRARY))
def test_finders_agree_on_library_meshes(name, light):
    mesh = piece(name)
    sides = sides_of(mesh, light)
    for orientation in (sides, np.maximum(sides, 0)):
        one, other = both(mesh, orientation)
        assert one == other
        assert one


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_finders_agree_on_soups_of_any_topology(seed):
    rng = np.random.default_rng(seed)
    mesh, orientation = random_mesh(rng), rng.integers(-1, 2, FACES)
    one, other = both(mesh, orientation)
    assert one == other
    # Every outline closes: as much of it leaves a vertex as reaches it.
    leaving = Counter()
    for (a, b), number in one.items():
        leaving[a] += number
        leaving[b] -= number
    assert not any(leaving.values())


def test_closed_mesh_has_silhouettes_where_facing_meets_averted():
    mesh = piece("torus")
    faces, sides = np.asarray(Edges.of(mesh).faces), sides_of(mesh, LAMP)
    multiplicity = np.asarray(find(mesh, np.maximum(sides, 0))[0].multiplicity)[: len(faces)]
    np.testing.assert_array_equal(multiplicity != 0, sides[faces[:, 0]] != sides[faces[:, 1]])
    assert set(multiplicity.tolist()) == {-1, 0, 1}


def test_open_mesh_turned_to_the_light_has_silhouettes_of_multiplicity_one_and_two():
    # A roof: the light sees the front of one slope, the back of the other, and the rim of both.
    roof = Mesh([[0, 1, 0], [0, 1, 1], [1, 0, 0], [-3, 0.9, 0]], [[0, 1, 2], [1, 0, 3]])
    light = DirectionalLight((1, -0.2, 0), (0, 0, 0), (1, 1), -1, 1)
    sides = sides_of(roof, light)
    assert sorted(sides.tolist()) == [-1, 1]
    multiplicity = np.abs(find(roof, sides)[0].multiplicity)
    assert sorted(multiplicity[:5].tolist()) == [1, 1, 1, 1, 2]
    assert not multiplicity[5:].any()
