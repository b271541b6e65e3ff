"""Mesh files as programs write them: each has the area and volume that it must have, or is refused in one line."""

import re
import warnings

import numpy as np
import odd_gltf
import odd_meshes
import pytest

from diffshadow.io import FileError, MeshWarning, load_mesh

FILES = {**odd_meshes.FILES, **odd_gltf.FILES}
REFUSED = {**odd_meshes.REFUSED, **odd_gltf.REFUSED}


def written(folder, name, data):
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def triangles(mesh):
    return np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]


def area(mesh):
    a, b, c = np.moveaxis(triangles(mesh), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2


def volume(mesh):
    return np.linalg.det(triangles(mesh)).sum() / 6


def is_closed(mesh):
    """Whether each edge of a triangle runs the other way in exactly one other."""
    faces = np.asarray(mesh.faces)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()
    return sorted(edges) == sorted([b, a] for a, b in edges)


@pytest.mark.parametrize("suffix", odd_meshes.WRITERS)
@pytest.mark.parametrize("name", odd_meshes.SHAPES)
def test_polygons_have_their_area_and_winding(name, suffix, tmp_path):
    shape = odd_meshes.SHAPES[name]
    mesh = load_mesh(written(tmp_path, f"{name}.{suffix}", odd_meshes.WRITERS[suffix](shape)))
    assert area(mesh) == pytest.approx(shape.area, rel=1e-5)
    assert volume(mesh) == pytest.approx(shape.volume, rel=1e-5)
    # Cut polygons keep every corner: their neighbours still share whole edges with them.
    assert is_closed(mesh) == shape.closed


@pytest.mark.parametrize("name", FILES)
def test_odd_files_load_whole(name, tmp_path):
    file = FILES[name]
    path = written(tmp_path, name, file.data)
    if file.left_out is None:
        mesh = load_mesh(path)
    else:
        with pytest.warns(MeshWarning, match=rf"^the mesh file {path} is loaded without its {file.left_out}$"):
            mesh = load_mesh(path)
    assert area(mesh) == pytest.approx(file.area, rel=1e-4)
    assert volume(mesh) == pytest.approx(file.volume, rel=1e-4)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_said_in_one_line(name, tmp_path, capfd):
    data, said = REFUSED[name]
    path = written(tmp_path, name, data)
    with pytest.raises(FileError, match=said) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"the mesh file {path} ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_bent_face_of_four_is_cut_along_its_shorter_diagonal(tmp_path):
    corners = [(0, 0, 0), (1, 0, 0), (0.1, 0, 0.1), (0.9, 0.1, 0.0)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    mesh = load_mesh(written(tmp_path, "bent.obj", "\n".join([*lines, "f 1 2 3 4"])))
    assert sorted(map(sorted, np.asarray(mesh.faces).tolist())) == [[0, 1, 3], [1, 2, 3]]


def test_many_random_polygons_keep_their_area(tmp_path):
    rng = np.random.default_rng(0)
    rows, faces, areas = [], [], []
    for number in range(300):
        n = int(rng.integers(5, 40))
        angles = 2 * np.pi * (np.arange(n) + rng.uniform(0, 0.9, n)) / n
        outline = rng.uniform(0.1, 1, (n, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        faces.append(range(len(rows), len(rows) + n))
        rows += list(outline @ frame[:2] + 3 * np.array([number % 10, number // 10, 0]))
        areas.append(abs(odd_meshes.shoelace(outline)))
    shape = odd_meshes.Shape(np.array(rows), [list(face) for face in faces], sum(areas), 0.0)
    mesh = load_mesh(written(tmp_path, "stars.off", odd_meshes.off(shape)))
    assert mesh.faces.shape[0] == sum(len(face) - 2 for face in faces)
    assert area(mesh) == pytest.approx(shape.area, rel=1e-5)


def test_a_file_beside_a_gltf_is_found_by_its_quoted_name(tmp_path):
    builder = odd_gltf.BUILT["list"]
    (tmp_path / "square 0.bin").write_bytes(builder.bytes)
    data = odd_gltf.with_buffers({"byteLength": len(builder.bytes), "uri": "square%200.bin"})
    assert area(load_mesh(written(tmp_path, "square.gltf", data))) == pytest.approx(1)


def test_damage_anywhere_is_refused_or_harmless(tmp_path):
    """Bytes changed, cut out, doubled or cut off at the end of each odd file; only `FileError` may come of it."""
    rng = np.random.default_rng(1)
    words = [b"nan", b"-1", b"1e308", b"9" * 30, b"", b"[]", b"null", b"\xff"]
    refused: list[str] = []
    for name, file in FILES.items():
        for _ in range(4):
            data = bytearray(file.data)
            i = int(rng.integers(len(data)))
            match rng.integers(4):
                case 0:
                    data[i] = int(rng.integers(256))
                case 1:
                    del data[i : i + int(rng.integers(1, 30))]
                case 2:
                    del data[i:]
                case _:
                    numbers = list(re.finditer(rb"[-+.0-9e]+", bytes(data))) or [re.compile(b"").match(b"")]
                    at = numbers[int(rng.integers(len(numbers)))].span()
                    data[slice(*at)] = words[int(rng.integers(len(words)))]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", MeshWarning)
                try:
                    load_mesh(written(tmp_path, name, bytes(data)))
                except FileError as error:
                    refused.append(str(error))
    assert len(refused) > len(FILES)
    assert not any("\n" in text for text in refused)
