"""Shading normals of meshes whose vertices are moved one by one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.fit import MeshPose
from diffshadow.geometry import Mesh, crease_normals, face_normals, library_mesh

BY = np.array([0.004, -0.003, 0.005])


def moved(mesh, index, by=BY):
    """The mesh with one vertex moved, and those at the same place with it."""
    pose = MeshPose.of(mesh, [index])
    return eqx.tree_at(lambda one: one.vertices[str(index)], pose, shifted(pose.vertices[str(index)], by)).placed(mesh)


def shifted(vector, by):
    return jax.tree.map(lambda coordinate, step: coordinate + step, vector, type(vector)(*by))


def split(mesh):
    """The mesh with vertices of its own for each face, as files have it whose normals differ."""
    return Mesh(
        np.asarray(mesh.vertices)[np.asarray(mesh.faces)].reshape(-1, 3),
        np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        mesh.corner_normals,
    )


@pytest.mark.parametrize(("name", "angle"), [("box", 30.0), ("low_poly_sphere", 180.0)])
@pytest.mark.parametrize("is_split", [False, True])
def test_normals_of_moved_vertices_are_those_of_the_same_creases(name, angle, is_split):
    mesh = library_mesh(name)
    index = int(np.asarray(mesh.faces)[7, 1])
    ours = moved(split(mesh), 3 * 7 + 1) if is_split else moved(mesh, index)
    vertices = np.asarray(mesh.vertices, np.float64)
    vertices[index] += BY
    expected = crease_normals(vertices, np.asarray(mesh.faces), angle)
    np.testing.assert_allclose(ours.corner_normals, expected, atol=2e-6)
    change = np.abs(expected - np.asarray(mesh.corner_normals)).max(axis=(1, 2))
    assert np.count_nonzero(change > 1e-3) >= 6


def test_a_flat_mesh_stays_flat_and_a_smooth_one_smooth():
    # A pyramid over a square, with an edge of the base off the middle.
    vertices = np.array([[-1, 0, -1], [1, 0, -1.2], [1.1, 0, 1], [-1, 0, 1], [0.1, 1, 0.2]], float)
    faces = np.array([[0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]])
    for angle in (0.0, 180.0):
        mesh = Mesh(vertices, faces, crease_normals(vertices, faces, angle))
        ours = moved(mesh, 4, (0.2, 0.3, -0.1))
        expected = crease_normals(vertices + np.array([[0, 0, 0]] * 4 + [[0.2, 0.3, -0.1]]), faces, angle)
        np.testing.assert_allclose(ours.corner_normals, expected, atol=2e-6)


def test_normals_that_a_file_gave_are_kept_where_nothing_moves():
    """Of a sphere, the exact ones: those that are smooth with the vertex change by as much as the means over faces."""
    mesh = library_mesh("sphere")
    exact = np.asarray(mesh.vertices) - np.asarray(mesh.vertices).mean(axis=0)
    exact = (exact / np.linalg.norm(exact, axis=1, keepdims=True))[np.asarray(mesh.faces)]
    given = Mesh(mesh.vertices, mesh.faces, exact)
    assert np.abs(exact - np.asarray(mesh.corner_normals)).max() > 1e-4
    pose = MeshPose.of(given, [40])
    np.testing.assert_array_equal(pose.placed(given).corner_normals, given.corner_normals)
    ours, plain = moved(given, 40), moved(mesh, 40)
    change, expected = (
        np.asarray(each.corner_normals) - np.asarray(rest.corner_normals)
        for each, rest in ((ours, given), (plain, mesh))
    )
    np.testing.assert_allclose(change, expected, atol=2e-3)
    assert np.abs(expected).max() > 0.05


def test_normals_turn_with_the_mesh_after_its_vertices_moved():
    mesh = library_mesh("box")
    index = 3
    pose = MeshPose.of(mesh, [index])
    turned = eqx.tree_at(lambda one: one.turn, pose, shifted(pose.turn, (0.0, 90.0, 0.0)))
    both = eqx.tree_at(lambda one: one.vertices["3"], turned, shifted(pose.vertices["3"], (0.1, 0.2, -0.1))).placed(
        mesh
    )
    # The normals of the bent sides are the means over both of their triangles at shared corners: never far from either.
    cosines = jnp.sum(both.corner_normals * face_normals(both)[:, None], axis=-1)
    assert float(cosines.min()) > 0.95
    x, _, z = np.asarray(moved(mesh, index, (0.1, 0.2, -0.1)).corner_normals).reshape(-1, 3).T
    np.testing.assert_allclose(
        np.asarray(both.corner_normals).reshape(-1, 3)[:, [0, 2]], np.stack([z, -x], 1), atol=1e-6
    )
