"""Meshes from files: formats, scenes, and the message for each thing that can be wrong."""

import json
import os
import struct
import warnings
import zipfile
from pathlib import Path

import jax
import numpy as np
import pytest
import trimesh

from diffshadow.geometry import face_normals, library_mesh
from diffshadow.io import FileError, MeshWarning, load_mesh, write_ply
from diffshadow.io._errors import MeshError
from diffshadow.io._gltf import _matrix
from diffshadow.io._gltf_schema import Node
from diffshadow.io._meshes import _READERS
from diffshadow.io._polygons import repeated
from diffshadow.settings.scene import MESH_SUFFIXES

SHARED = Path(__file__).parents[2] / ".." / "shared" / "meshes"


def as_trimesh(mesh):
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)


def volume(mesh):
    return np.linalg.det(np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]).sum() / 6


def is_closed(mesh):
    faces = np.asarray(mesh.faces)
    edges = {tuple(e) for e in np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()}
    return len(edges) == 3 * len(faces) and {(b, a) for a, b in edges} == edges


def write(path, text):
    path.write_text(text)
    return path


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb", "OBJ"])
def test_a_closed_mesh_comes_back_closed_from_every_format(suffix, tmp_path):
    torus = library_mesh("torus", segments=16, sides=8)
    path = tmp_path / f"torus.{suffix}"
    path.write_bytes(_bytes(as_trimesh(torus).export(file_type=suffix.lower())))
    mesh = load_mesh(path)
    # STL stores three vertices a triangle; welding makes them one again.
    assert mesh.vertices.shape == torus.vertices.shape
    assert mesh.faces.shape == torus.faces.shape
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(volume(torus), rel=1e-5)


def _bytes(exported):
    return exported if isinstance(exported, bytes) else exported.encode()


def triangles(vertices, faces):
    """The triangles in an order that depends on nothing but their corners, each from its least corner on."""
    corners = np.asarray(vertices, np.float32)[np.asarray(faces)] + np.float32(0)
    turned = [np.roll(each, -min(range(3), key=lambda i: tuple(each[i])), axis=0) for each in corners]
    return sorted(np.reshape(each, -1).tolist() for each in turned)


def written(path, mesh):
    """Writes the mesh as we do for PLY, and as trimesh does for other formats."""
    if path.name == "ours.ply":
        write_ply(path, np.asarray(mesh.vertices), np.asarray(mesh.faces))
    else:
        path.write_bytes(_bytes(as_trimesh(mesh).export(file_type=path.suffix[1:])))
    return path


@pytest.mark.parametrize("name", ["ours.ply", "a.ply", "a.obj", "a.off", "a.stl", "a.glb"])
def test_trimesh_reads_the_same_triangles_from_every_format(name, tmp_path):
    torus = library_mesh("torus", segments=6, sides=4)
    path = written(tmp_path / name, torus)
    ours, theirs = load_mesh(path), trimesh.load_mesh(path, process=False)
    expected = triangles(torus.vertices, torus.faces)
    np.testing.assert_allclose(triangles(ours.vertices, ours.faces), expected, atol=1e-6)
    np.testing.assert_allclose(triangles(theirs.vertices, theirs.faces), expected, atol=1e-6)


# Formats that trimesh reads


def test_an_archive_is_read_with_a_remark_on_its_polygons(tmp_path):
    torus = library_mesh("torus", segments=16, sides=8)
    with zipfile.ZipFile(tmp_path / "torus.zip", "w") as archive:
        archive.writestr("torus.obj", as_trimesh(torus).export(file_type="obj"))
    with pytest.warns(MeshWarning, match=r"torus\.zip is read by trimesh, which cuts polygons as fans"):
        mesh = load_mesh(tmp_path / "torus.zip")
    assert mesh.faces.shape == torus.faces.shape
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(volume(torus), rel=1e-5)


@pytest.mark.parametrize(("suffix", "package"), [("3mf", "lxml"), ("dae", "collada")])
def test_objects_of_a_format_that_trimesh_reads_stand_where_its_scene_puts_them(suffix, package, tmp_path):
    pytest.importorskip(package)
    pytest.importorskip("networkx")
    scene = trimesh.Scene()
    box = as_trimesh(library_mesh("box"))
    scene.add_geometry(box, geom_name="box")
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([10, 0, 0]))
    if suffix == "dae":  # whose writer takes meshes alone
        scene = scene.to_mesh()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the package that writes it
        (tmp_path / f"part.{suffix}").write_bytes(_bytes(scene.export(file_type=suffix)))
        mesh = load_mesh(tmp_path / f"part.{suffix}")
    assert mesh.faces.shape == (24, 3)
    np.testing.assert_allclose(mesh.bounds, [[-0.5, 0, -0.5], [10.5, 1, 0.5]], atol=1e-6)


@pytest.mark.parametrize("message", ["No module named 'lxml'", "missing `pip install lxml`"])
def test_a_missing_package_is_named(message, tmp_path, monkeypatch):
    def fail(**_):
        raise ImportError(message)

    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, "3mf", fail)
    expected = r"part\.3mf is in the format 3mf, which needs a package that is not installed: lxml; install it"
    with pytest.raises(FileError, match=expected):
        load_mesh(write(tmp_path / "part.3mf", ""))


def test_points_in_a_format_that_trimesh_reads_are_no_mesh(tmp_path):
    with pytest.raises(FileError, match=r"3 points but no triangles"):
        load_mesh(write(tmp_path / "points.xyz", "0 0 0\n1 0 0\n0 1 0\n"))
    with pytest.raises(FileError, match=r"is damaged: trimesh cannot read it"):
        load_mesh(write(tmp_path / "garbage.zip", "garbage"))


def test_crease_angle_decides_between_flat_and_smooth(tmp_path):
    path = tmp_path / "box.stl"
    path.write_bytes(_bytes(as_trimesh(library_mesh("box")).export(file_type="stl")))
    sharp, smooth = load_mesh(str(path)), load_mesh(path, crease_angle=180)
    flat = np.asarray(face_normals(sharp))[:, None]
    np.testing.assert_allclose(sharp.corner_normals, np.broadcast_to(flat, (12, 3, 3)), atol=1e-6)
    np.testing.assert_allclose((np.asarray(smooth.corner_normals) * flat).sum(-1), 3**-0.5, atol=1e-6)


def test_texture_seams_are_welded_and_quads_cut(tmp_path):
    path = write(
        tmp_path / "seam.obj",
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "f 1/1 2/2 3/3 4/4\nf 2/1 5/2 6/3 3/4\n",
    )
    mesh = load_mesh(path)
    assert mesh.vertices.shape == (6, 3)
    assert mesh.faces.shape == (4, 3)


def test_objects_of_a_scene_stand_where_their_nodes_put_them(tmp_path):
    box = as_trimesh(library_mesh("box"))
    scene = trimesh.Scene()
    away = np.diag([2.0, 2.0, 2.0, 1.0])
    away[:3, 3] = [10, 0, 0]
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = [0, 0, 5]
    scene.add_geometry(box, geom_name="box", transform=away)
    scene.graph.update(frame_to="twin", matrix=mirror, geometry="box")
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    mesh = load_mesh(path)
    assert mesh.faces.shape == (24, 3)
    np.testing.assert_allclose(mesh.bounds, [[-0.5, 0, -1], [11, 2, 5.5]], atol=1e-6)
    # The mirrored box is still wound outwards, or its volume would count negative.
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(8 + 1)


def test_nodes_are_scaled_then_turned_then_moved_or_have_a_matrix_column_by_column():
    # A quarter turn about z, after twice the length along x.
    turned = Node(rotation=(0, 0, 0.5**0.5, 0.5**0.5), scale=(2, 1, 1), translation=(5, 6, 7))
    placed = _matrix(turned, 0)
    np.testing.assert_allclose(placed @ [1, 0, 0, 1], [5, 8, 7, 1], atol=1e-12)
    np.testing.assert_allclose(placed @ [0, 1, 0, 1], [4, 6, 7, 1], atol=1e-12)
    np.testing.assert_allclose(_matrix(Node(matrix=tuple(placed.T.ravel().tolist())), 0), placed)


def test_points_beside_triangles_are_left_out_with_a_warning(tmp_path):
    scene = trimesh.Scene([as_trimesh(library_mesh("box")), trimesh.PointCloud(np.full((4, 3), 9.0))])
    path = tmp_path / "mixed.glb"
    path.write_bytes(scene.export(file_type="glb"))
    with pytest.warns(MeshWarning, match=r"mixed\.glb is loaded without its 4 points$"):
        mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.bounds, [[-0.5, 0, -0.5], [0.5, 1, 0.5]], atol=1e-6)


def test_a_small_mesh_far_from_the_origin_keeps_its_vertices_apart(tmp_path):
    sphere = as_trimesh(library_mesh("sphere", subdivisions=2))
    sphere.vertices = sphere.vertices * 1e-3 + 1.0
    path = write(tmp_path / "far.obj", sphere.export(file_type="obj", digits=12))
    assert load_mesh(path).vertices.shape == (162, 3)


# What can be wrong


def test_missing_file_names_the_path_looked_at_and_a_near_name(tmp_path, monkeypatch):
    write(tmp_path / "Bunny.ply", "")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileError, match=rf"no mesh file {tmp_path}/buny\.ply; did you mean 'Bunny\.ply'"):
        load_mesh("buny.ply")
    with pytest.raises(FileError, match=r"zzz\.obj; check the path"):
        load_mesh("zzz.obj")
    with pytest.raises(FileError, match=rf"the folder {tmp_path}/nowhere does not exist"):
        load_mesh("nowhere/bunny.ply")


def test_a_folder_is_no_mesh(tmp_path):
    with pytest.raises(FileError, match="is a folder; expected a mesh file"):
        load_mesh(tmp_path)


def test_a_pipe_is_refused_before_it_is_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.obj")
    with pytest.raises(FileError, match=r"pipe\.obj is a device or a pipe; expected a mesh file"):
        load_mesh(tmp_path / "pipe.obj")


@pytest.mark.parametrize("name", ["mesh.txt", "mesh.png", "mesh", "mesh.binvox"])
def test_unknown_suffixes_are_refused_with_the_known_ones(name, tmp_path):
    with pytest.raises(FileError, match=r"its suffix is .*expected one of .*\.glb.*\.obj.*\.ply.*\.stl"):
        load_mesh(write(tmp_path / name, TRIANGLE))


DAMAGED = {
    "garbage.ply": "garbage",
    "garbage.glb": "garbage",
    "words.obj": "v 0 0 x\nf 1 2 3\n",
    "index.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "short.off": "OFF\n3 1 0\n0 0 0\n1 0 0\n",
    "index.off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
    "index.ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_refused(name, tmp_path):
    with pytest.raises(FileError, match=rf"mesh file .*{name} is damaged"):
        load_mesh(write(tmp_path / name, DAMAGED[name]))


def test_a_truncated_binary_file_is_refused(tmp_path):
    whole = _bytes(as_trimesh(library_mesh("torus")).export(file_type="stl"))
    path = tmp_path / "cut.stl"
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=r"is damaged|no triangles"):
        load_mesh(path)


POINTS_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    "0 0 0\n1 1 1\n"
)


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("empty.obj", "", "no triangles"),
        ("empty.stl", "", "no triangles|is damaged"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "2 points but no triangles"),
        ("points.ply", POINTS_PLY, "2 points but no triangles"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nf 1 2 2\n", "every triangle of .*two corners at the same position"),
        ("none.gltf", json.dumps({"asset": {"version": "2.0"}}), "no triangles"),
    ],
)
def test_files_without_triangles_are_refused(name, text, found, tmp_path):
    with pytest.raises(FileError, match=found):
        load_mesh(write(tmp_path / name, text))


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_vertices_that_are_not_finite_are_counted(value, tmp_path):
    with pytest.raises(FileError, match=r"bad\.obj is damaged: 1 of the 3 vertices.*first is vertex 2"):
        load_mesh(write(tmp_path / "bad.obj", TRIANGLE.replace("v 0 1 0", f"v 0 {value} 0")))


def test_binary_stl_with_nan_is_refused(tmp_path):
    path = tmp_path / "nan.stl"
    values = [0, 0, 1, 0, 0, 0, 1, 0, 0, 0, float("nan"), 0]
    path.write_bytes(bytes(80) + struct.pack("<I12fH", 1, *values, 0))
    with pytest.raises(FileError, match="NaN or infinite"):
        load_mesh(path)


def curved(far):
    """A dozen points on an arc, two units wide, `far` along x."""
    angle = np.linspace(0, 3, 12)
    return np.stack([np.cos(angle) + far, np.sin(angle), 0 * angle], axis=-1)


def fan(path, points, digits=".17g"):
    """An OBJ file with the fan of triangles over `points`."""
    rows = ["v " + " ".join(format(value, digits) for value in point) for point in points.tolist()]
    return write(path, "\n".join([*rows, *(f"f 1 {i} {i + 1}" for i in range(2, len(points)))]))


def test_a_mesh_far_from_its_origin_keeps_its_digits_in_double_precision(tmp_path):
    path = fan(tmp_path / "far.obj", curved(1e6))
    with jax.enable_x64(True):
        np.testing.assert_array_equal(load_mesh(path).vertices, curved(1e6))
    assert load_mesh(path).vertices.dtype == np.float32


@pytest.mark.parametrize(
    ("far", "beside", "digits", "steps"),
    [
        (1e5, 0, ".17g", "0.0078, 0.39%"),
        (1e5, 0, ".8g", "0.0078, 0.39%"),
        # Smaller coordinates have smaller steps.
        (6e6, 3e6, ".17g", "0.5, 25.00%"),
    ],
)
def test_a_mesh_rounded_to_single_precision_far_from_its_origin_is_remarked_on(far, beside, digits, steps, tmp_path):
    points = (curved(far) + np.array([0, beside, 0])).astype(np.float32)
    with pytest.warns(MeshWarning, match=f"rounded.obj is far from its origin.*steps of {steps} of its size, as in"):
        load_mesh(fan(tmp_path / "rounded.obj", points, digits))


def test_near_coordinates_and_round_numbers_get_no_remark(tmp_path):
    load_mesh(fan(tmp_path / "near.obj", curved(1e3).astype(np.float32)))
    load_mesh(fan(tmp_path / "round.obj", np.round(16 * curved(0)) / 16 + 1e5))
    load_mesh(write(tmp_path / "few.obj", "v 1000000 0 0\nv 1000001 0 0\nv 1000000 1 0\nf 1 2 3\n"))


# Meshes that other people made


@pytest.mark.parametrize(
    ("name", "vertices", "faces", "closed", "extent"),
    [
        ("bunny.ply", 8146, 16301, False, (0.16, 0.15, 0.12)),
        ("spot.obj", 2930, 5856, True, (0.9, 1.7, 1.7)),
        ("teapot.obj", 3241, 6320, False, (6.4, 3.2, 4.0)),
        ("fandisk.obj", 6475, 12946, True, (4.8, 5.2, 2.7)),
    ],
)
def test_real_meshes_load(name, vertices, faces, closed, extent):
    if not (SHARED / name).exists():
        pytest.skip(f"no file ../shared/meshes/{name} beside the repository")
    mesh = load_mesh(SHARED / name)
    assert mesh.vertices.shape == (vertices, 3)
    assert mesh.faces.shape[0] == faces
    assert is_closed(mesh) == closed
    low, high = np.asarray(mesh.bounds)
    np.testing.assert_allclose(high - low, extent, atol=0.06, rtol=0.05)
    lengths = np.linalg.norm(np.asarray(mesh.corner_normals), axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-5)


def test_more_triangles_than_fit_into_memory_are_refused_before_they_are_made():
    points, triangles = np.zeros((4, 3)), np.array([[0, 1, 2], [0, 2, 3]])
    places = np.broadcast_to(np.eye(4), (1 << 24, 4, 4))
    with pytest.raises(MeshError, match="16,777,216 instances of 2 triangles; expected at most 33,554,432"):
        repeated(points, triangles, None, places)


def test_suffixes_of_meshes_are_those_of_the_readers():
    assert tuple(_READERS) == MESH_SUFFIXES
