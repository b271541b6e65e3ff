"""Procedural pieces, welding, shading normals and placement."""

import inspect
import math
import tracemalloc

import jax.numpy as jnp
import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from diffshadow.geometry import (
    LIBRARY,
    Mesh,
    crease_normals,
    drop_to_ground,
    face_normals,
    fit_to_size,
    library_mesh,
    weld,
)

CLOSED = [name for name in LIBRARY if name != "plane"]


def arrays(mesh):
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)


def directed_edges(faces):
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def signed_volume(mesh):
    vertices, faces = arrays(mesh)
    return np.linalg.det(vertices[faces]).sum() / 6


def area(mesh):
    vertices, faces = arrays(mesh)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2


def assert_closed(faces):
    """Every edge is used exactly once each way."""
    edges = {tuple(edge) for edge in directed_edges(faces).tolist()}
    assert len(edges) == 3 * len(faces)
    assert {(b, a) for a, b in edges} == edges


@pytest.mark.parametrize("name", CLOSED)
def test_closed_pieces_are_two_manifolds_wound_outwards(name):
    mesh = library_mesh(name)
    assert_closed(np.asarray(mesh.faces))
    assert signed_volume(mesh) > 0


@pytest.mark.parametrize("name", LIBRARY)
def test_pieces_are_about_one_unit_and_stand_on_the_ground(name):
    low, high = np.asarray(library_mesh(name).bounds)
    assert low[1] == pytest.approx(0, abs=1e-6)
    assert 0.5 <= (high - low).max() <= 1.5
    np.testing.assert_allclose((low + high)[[0, 2]], 0, atol=1e-6)


@pytest.mark.parametrize("name", LIBRARY)
def test_pieces_use_every_vertex_and_have_no_degenerate_face(name):
    vertices, faces = arrays(library_mesh(name))
    welded, kept, _ = weld(vertices, faces)
    assert len(welded) == len(vertices)
    assert len(kept) == len(faces)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=-1).min() > 1e-6


def normals_of(mesh):
    """Unit normals of the faces, by the right-hand rule."""
    a, b, c = np.moveaxis(np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)], 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", LIBRARY)
def test_shading_normals_are_unit_and_on_the_side_of_the_face(name):
    mesh = library_mesh(name)
    normals = np.asarray(mesh.corner_normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)
    assert (normals * normals_of(mesh)[:, None]).sum(axis=-1).min() > 0.5


@pytest.mark.parametrize(
    ("name", "options", "volume"),
    [
        ("box", {"size": (1.0, 2.0, 3.0)}, 6.0),
        ("box", {"size": 2}, 8.0),
        ("thin_wall", {"width": 2.0, "height": 1.5, "thickness": 0.01}, 0.03),
        ("fence", {"slats": 7, "height": 2.0, "slat_width": 0.05, "thickness": 0.01}, 7 * 0.05 * 2.0 * 0.01),
        ("sphere", {"radius": 0.5}, math.pi / 6),
        ("torus", {"radius": 0.4, "tube": 0.1, "segments": 128, "sides": 64}, 2 * math.pi**2 * 0.4 * 0.01),
    ],
)
def test_volume_is_the_solids(name, options, volume):
    assert signed_volume(library_mesh(name, **options)) == pytest.approx(volume, rel=5e-3)


def test_torus_knot_has_the_volume_of_a_tube_along_its_curve_and_does_not_touch_itself():
    radius, tube = 0.28, 0.08
    mesh = library_mesh("torus_knot", radius=radius, tube=tube, segments=600, sides=32)
    t = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    ring = (2 + np.cos(3 * t)) * radius / 2
    curve = np.stack([ring * np.cos(2 * t), ring * np.sin(2 * t), -np.sin(3 * t) * radius / 2], axis=-1)
    length = np.linalg.norm(np.roll(curve, -1, axis=0) - curve, axis=-1).sum()
    # Pappus: a tube's volume is its cross-section times the length of its centre line.
    assert signed_volume(mesh) == pytest.approx(math.pi * tube**2 * length, rel=1e-2)

    pairs = KDTree(curve).query_pairs(2 * tube, output_type="ndarray")
    apart = np.abs(pairs[:, 0] - pairs[:, 1])
    along = np.minimum(apart, 2000 - apart) * length / 2000
    assert along.max() < math.pi * 2 * tube


def test_torus_knot_has_at_least_5000_triangles():
    assert library_mesh("torus_knot").faces.shape[0] == 6144


@pytest.mark.parametrize(("name", "count"), [("sphere", 5120), ("low_poly_sphere", 80)])
def test_vertices_of_spheres_lie_on_the_sphere(name, count):
    mesh = library_mesh(name, radius=0.7)
    vertices, faces = arrays(mesh)
    assert len(faces) == count
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    np.testing.assert_allclose(np.linalg.norm(vertices - middle, axis=-1), 0.7, rtol=1e-5)


def test_low_poly_sphere_is_shaded_round_or_flat():
    flat = library_mesh("low_poly_sphere", smooth=False)
    np.testing.assert_allclose(
        flat.corner_normals, np.broadcast_to(np.asarray(face_normals(flat))[:, None], (80, 3, 3)), atol=1e-5
    )
    smooth = library_mesh("low_poly_sphere")
    vertices, faces = arrays(smooth)
    outwards = (vertices - [0, vertices[:, 1].max() / 2, 0])[faces] / 0.5
    np.testing.assert_allclose(smooth.corner_normals, outwards, atol=0.05)


def test_plane_faces_up_with_the_area_and_segments_asked_for():
    mesh = library_mesh("plane", size=3, segments=4)
    assert mesh.faces.shape == (32, 3)
    np.testing.assert_allclose(face_normals(mesh), np.broadcast_to([0, 1, 0], (32, 3)), atol=1e-6)
    assert area(mesh) == pytest.approx(9, rel=1e-5)


def test_fences_slats_stand_apart():
    mesh = library_mesh("fence", slats=5, slat_width=0.1)
    x = np.asarray(mesh.vertices)[:, 0].reshape(5, 8)
    assert (x[1:].min(axis=1) > x[:-1].max(axis=1) + 0.1).all()
    assert np.ptp(np.asarray(mesh.vertices)[:, 0]) == pytest.approx(1), "as wide as the whole fence"
    assert library_mesh("fence", slats=1).faces.shape == (12, 3)


@pytest.mark.parametrize(("height", "spindles"), [(1.0, 5), (2.5, 0), (1.0, 12)])
def test_chair_stands_on_four_flat_feet_and_is_one_body(height, spindles):
    mesh = library_mesh("chair", height=height, spindles=spindles, sides=12)
    vertices, faces = arrays(mesh)
    assert np.ptp(vertices[:, 1]) == pytest.approx(height, rel=1e-6)
    # Each foot is a ring and its middle.
    feet = vertices[vertices[:, 1] < 1e-6 * height]
    assert len(feet) == 4 * 13
    assert {tuple(np.sign(foot).astype(int)) for foot in feet[:, [0, 2]]} == {(-1, -1), (-1, 1), (1, -1), (1, 1)}
    chair = manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))
    assert chair.status() == manifold3d.Error.NoError
    parts = chair.decompose()
    # Legs, stretchers, the seat and the bow.
    assert len(parts) == 4 + 3 + 1 + 1 + spindles
    assert len(manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add).decompose()) == 1


def test_blob_depends_on_its_seed_and_not_on_its_resolution():
    first, again, other = (np.asarray(library_mesh("blob", seed=s).vertices) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.05
    # An icosphere's vertices come first among those of a finer one; the finer one's box differs by a little.
    coarse = np.asarray(library_mesh("blob", seed=1, subdivisions=3).vertices)
    shift = first[: len(coarse)] - coarse
    assert np.ptp(shift, axis=0).max() < 1e-6
    assert np.abs(shift).max() < 0.01
    ball = library_mesh("blob", amplitude=0.0)
    assert signed_volume(ball) == pytest.approx(signed_volume(library_mesh("sphere")), rel=1e-5)


def test_library_names_the_nearest_piece_and_option():
    with pytest.raises(ValueError, match=r"no mesh called 'torusknot'.*did you mean 'torus_knot'.*plane"):
        library_mesh("torusknot")
    with pytest.raises(ValueError, match=r"raduis is not an option of sphere; .*; did you mean 'radius'\?"):
        library_mesh("sphere", raduis=1.0)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("plane", {"size": -1.0}, "size is -1.0; expected world units from 1e-06 to 1e\\+09"),
        ("plane", {"size": math.nan}, "size is nan"),
        ("plane", {"segments": 0}, "segments is 0; expected a whole number from 1 to 1024"),
        ("plane", {"segments": 1.5}, "segments is 1.5; expected a whole number"),
        ("box", {"size": (1.0, 2.0)}, "expected one number, or three"),
        ("box", {"size": (1.0, 0.0, 2.0)}, "size is 0.0"),
        ("box", {"size": "big"}, "size is 'big'; expected a number or three"),
        ("sphere", {"radius": "1"}, "radius is '1'; expected a number"),
        ("sphere", {"subdivisions": 12}, "subdivisions is 12"),
        ("low_poly_sphere", {"smooth": 1}, "smooth is 1; expected true or false"),
        ("torus", {"tube": 0.5}, "make the tube thinner"),
        ("torus", {"segments": 2**32}, "segments is 4294967296; expected a whole number from 3"),
        ("torus_knot", {"segments": 2048, "sides": 1024}, "makes 4,194,304 triangles; expected at most 2,097,152"),
        ("torus_knot", {"p": 2, "q": 4}, "divisor in common"),
        ("torus_knot", {"p": 10**30}, "p is 1"),
        ("fence", {"slats": 10**9}, "slats is 1000000000; expected a whole number from 1 to 10000"),
        ("blob", {"seed": -1}, "seed is -1"),
        ("fence", {"slats": 100}, "leaves no gaps"),
        ("blob", {"amplitude": 1.0}, "amplitude is 1.0"),
        ("chair", {"spindles": 101}, "spindles is 101; expected a whole number from 0 to 100"),
        ("chair", {"sides": 257}, "sides is 257; expected a whole number from 3 to 256"),
    ],
)
def test_unsuitable_options_are_refused_by_name(name, options, message):
    with pytest.raises(ValueError, match=f"{name}.*{message}"):
        library_mesh(name, **options)


def test_every_option_has_a_default():
    for piece in LIBRARY.values():
        assert all(p.default is not p.empty for p in inspect.signature(piece).parameters.values())


# Welding


def soup(mesh, noise=0.0, seed=0):
    """Every face with corners of its own, each moved a little."""
    vertices, faces = arrays(mesh)
    corners = vertices[faces].reshape(-1, 3)
    corners = corners + noise * np.random.default_rng(seed).uniform(-1, 1, corners.shape)
    return corners, np.arange(len(corners)).reshape(-1, 3)


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("noise", [0.0, 2e-7])
def test_weld_closes_a_triangle_soup(scale, noise):
    mesh = library_mesh("torus")
    corners, faces = soup(mesh, noise)
    vertices, faces, _ = weld(corners * scale, faces)
    assert len(vertices) == mesh.vertices.shape[0]
    assert_closed(faces)


def test_weld_keeps_apart_what_the_tolerance_keeps_apart():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1e-4, 0, 0], [1, 1e-4, 0], [1, 1, 0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert len(weld(vertices, faces, 1e-5)[0]) == 6
    assert len(weld(vertices, faces, 1e-3)[0]) == 4


def test_weld_of_a_part_far_below_the_tolerance_takes_no_memory_for_its_pairs():
    grain = np.random.default_rng(0).uniform(size=(6000, 3))
    vertices = np.concatenate([grain, [[1e8, 0, 0], [1e8, 1e8, 0], [1e8, 0, 1e8]]])
    tracemalloc.start()
    points, faces, _ = weld(vertices, np.arange(len(vertices)).reshape(-1, 3))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_array_equal(points, vertices[-3:])
    np.testing.assert_array_equal(faces, [[0, 1, 2]])
    # There are 18 million pairs.
    assert most < 20e6


def test_weld_drops_collapsed_faces_and_unused_vertices_and_keeps_the_order():
    vertices = np.array([[9.0, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [np.nan, 0, 0]])
    points, faces, _ = weld(vertices, np.array([[1, 2, 4], [1, 4, 3]]))
    np.testing.assert_array_equal(points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(faces, [[0, 1, 2]])


def test_weld_of_only_collapsed_faces_is_empty():
    points, faces, _ = weld(np.ones((3, 3)), np.array([[0, 1, 2]]))
    assert points.shape == faces.shape == (0, 3)


def test_weld_refuses_nan_and_a_negative_tolerance():
    with pytest.raises(ValueError, match=r"1 of the 3 vertices.*first is vertex 2"):
        weld(np.array([[0.0, 0, 0], [1, 0, 0], [np.nan, 0, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="weld tolerance is -1"):
        weld(np.zeros((3, 3)), np.array([[0, 1, 2]]), -1.0)


# Shading normals


def crease_normals_by_loop(vertices, faces, angle):
    """The definition, corner by corner."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = cross / np.linalg.norm(cross, axis=-1, keepdims=True)
    result = np.zeros((len(faces), 3, 3))
    for f in range(len(faces)):
        for k in range(3):
            for g, slot in zip(*np.nonzero(faces == faces[f, k]), strict=True):
                p, q, r = (corners[g, (slot + i) % 3] for i in range(3))
                u, v = (q - p) / np.linalg.norm(q - p), (r - p) / np.linalg.norm(r - p)
                if normals[g] @ normals[f] >= np.cos(np.deg2rad(angle)) - 1e-9:
                    result[f, k] += np.arccos(np.clip(u @ v, -1, 1)) * normals[g]
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


@pytest.mark.parametrize("angle", [0.0, 25.0, 60.0, 180.0])
def test_crease_normals_match_their_definition(angle):
    vertices, faces = arrays(library_mesh("blob", subdivisions=1, amplitude=0.6))
    np.testing.assert_allclose(
        crease_normals(vertices, faces, angle), crease_normals_by_loop(vertices, faces, angle), atol=1e-9
    )


def test_a_box_is_sharp_below_90_degrees_and_smooth_above():
    vertices, faces = arrays(library_mesh("box", size=2.0))
    sharp = crease_normals(vertices, faces, 89.0)
    np.testing.assert_allclose(sharp, crease_normals(vertices, faces, 0.0), atol=1e-9)
    smooth = crease_normals(vertices, faces, 91.0)
    # Weighted by angle, a corner of a cube points along its diagonal however its sides are cut.
    np.testing.assert_allclose(smooth, (vertices - [0, 1, 0])[faces] / np.sqrt(3), atol=1e-9)


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e15])
def test_crease_normals_do_not_depend_on_scale(scale):
    vertices, faces = arrays(library_mesh("torus", segments=12, sides=8))
    np.testing.assert_allclose(crease_normals(vertices * scale, faces), crease_normals(vertices, faces), atol=1e-9)


def test_degenerate_faces_have_no_nan():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0, 0], [5, 5, 5], [6, 6, 6], [7, 7, 7]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [4, 5, 6], [4, 4, 5]])
    normals = crease_normals(vertices, faces)
    # Beside a sound face the sliver takes that face's normal; alone it has none.
    np.testing.assert_allclose(normals[1, [0, 2]], [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(normals[[1, 2, 3, 3], [1, 0, 0, 2]], 0)


def test_opposite_faces_keep_their_own_normals():
    vertices = np.eye(3)
    normals = crease_normals(vertices, np.array([[0, 1, 2], [2, 1, 0]]), 180.0)
    np.testing.assert_allclose(normals[0], np.full((3, 3), 3**-0.5))
    np.testing.assert_allclose(normals[1], -normals[0])


def test_vertices_of_high_valence_are_done_in_parts():
    n = 3000
    angle = 2 * np.pi * np.arange(n) / n
    vertices = np.concatenate([[[0, 1, 0]], np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=-1)])
    ring = np.arange(n)
    faces = np.stack([0 * ring, 1 + ring, 1 + (ring + 1) % n], axis=-1)
    normals = crease_normals(vertices, faces, 180.0)
    np.testing.assert_allclose(normals[:, 0], np.broadcast_to([0, 1, 0], (n, 3)), atol=1e-9)


def test_crease_angle_out_of_range_is_refused():
    with pytest.raises(ValueError, match="crease angle is 200"):
        crease_normals(np.eye(3), np.array([[0, 1, 2]]), 200.0)


# Placement


@settings(max_examples=20, deadline=None)
@given(
    st.floats(1e-3, 1e3),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.sampled_from([0.01, 1, 5]),
)
def test_fitted_mesh_has_its_size_and_stands_over_the_origin(scale, x, y, z, size):
    box = library_mesh("box", size=(1.0, 2.0, 0.5))
    mesh = Mesh(box.vertices * scale + jnp.array([x, y, z]) * scale, box.faces, box.corner_normals)
    placed = drop_to_ground(fit_to_size(mesh, size), 0.5)
    low, high = np.asarray(placed.bounds)
    assert (high - low).max() == pytest.approx(size, rel=1e-4)
    np.testing.assert_allclose((high - low) / size, [0.5, 1, 0.25], rtol=1e-4)
    np.testing.assert_allclose((low + high)[[0, 2]], 0, atol=1e-5 * size)
    assert low[1] == pytest.approx(0.5, abs=1e-5 * size + 1e-6)
    np.testing.assert_array_equal(placed.corner_normals, mesh.corner_normals)


def test_placement_ignores_vertices_that_no_face_uses():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [50, -50, 50]], [[0, 1, 2]])
    np.testing.assert_allclose(drop_to_ground(fit_to_size(mesh, 2.0), 1.0).bounds, [[-1, 1, 0], [1, 3, 0]])


def test_placement_refuses_bad_sizes_and_meshes():
    mesh = library_mesh("box")
    for size in (0.0, -1, math.nan, math.inf):
        with pytest.raises(ValueError, match="expected positive world units"):
            fit_to_size(mesh, size)
    with pytest.raises(ValueError, match="cannot be scaled to a size of 1\\.0"):
        fit_to_size(Mesh([[1, 2, 3]] * 3, [[0, 1, 2]]), 1.0)
    with pytest.raises(ValueError, match="height to put a mesh at is nan"):
        drop_to_ground(mesh, math.nan)
