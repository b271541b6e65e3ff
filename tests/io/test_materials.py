"""Colours, textures and alpha tests of mesh files."""

import json
import shutil

import numpy as np
import PIL.Image
import pytest
from rich.console import Console
from scenes import fence, fence_over_floor, side_camera, sun

from diffshadow import io
from diffshadow.config import build_scene, load_config
from diffshadow.geometry import Mesh, Scene, face_colours, merge
from diffshadow.study.imports._import import import_scene

CUT = fence_over_floor()
SHADES = np.random.default_rng(4).uniform(0, 1, (2, 3, 3))


def written(path, *meshes):
    whole = merge(meshes)
    io.write_gltf(path, Scene(meshes, side_camera(), sun(whole)))
    return path


def changed(path, change):
    """The JSON of a glTF file after `change`."""
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def image_file(path):
    """The image of the fence, with alpha."""
    image = fence().textures.images()[0]
    levels = np.rint(255 * np.concatenate([image[..., :3] ** (1 / 2.2), image[..., 3:]], axis=-1)).astype(np.uint8)
    PIL.Image.fromarray(levels[::-1]).save(path)
    return path


def assert_same_looks(found, expected):
    """To the 8 bits of an image's colours, which are closer together where they are dark."""
    np.testing.assert_allclose(face_colours(found), face_colours(expected), atol=0.01)
    for mine, theirs in zip(found.textures.images(), expected.textures.images(), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=0.006)
    np.testing.assert_array_equal(found.textures.index, expected.textures.index)
    has_texture = np.asarray(expected.textures.index) >= 0
    np.testing.assert_allclose(
        np.asarray(found.textures.uv)[has_texture], np.asarray(expected.textures.uv)[has_texture], atol=1e-6
    )


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_what_gltf_is_written_with_is_read_back(suffix, tmp_path):
    floor, cut = CUT
    shaded = Mesh(floor.vertices, floor.faces, floor.corner_normals, 0.5, SHADES)
    second = Mesh(floor.vertices + np.float32([0, 2, 0]), floor.faces, textures=fence(None).textures)
    found = io.load_mesh(written(tmp_path / f"a{suffix}", shaded, merge([cut, second])), None)
    expected = merge([shaded, cut, second])
    assert_same_looks(found, expected)
    np.testing.assert_allclose(
        np.asarray(found.albedo)[:2, None] * np.asarray(found.corner_colours)[:2], 0.5 * SHADES, atol=1e-6
    )
    np.testing.assert_allclose(found.textures.cutoff, [0.5, 0.0])


def test_a_factor_scales_colours_and_the_cutoff_and_a_transform_moves_coordinates(tmp_path):
    def change(document):
        look = document["materials"][0]["pbrMetallicRoughness"]
        look["baseColorFactor"] = [1.0, 0.5, 0.25, 0.8]
        transform = {"offset": [0.25, 0.5], "rotation": np.pi / 2, "scale": [2.0, 1.0]}
        look["baseColorTexture"]["extensions"] = {"KHR_texture_transform": transform}

    path = changed(written(tmp_path / "a.gltf", CUT[1]), change)
    found = io.load_mesh(path, None)
    np.testing.assert_allclose(found.albedo, np.tile([1, 0.5, 0.25], (2, 1)), atol=1e-6)
    np.testing.assert_allclose(found.textures.cutoff, 0.5 / 0.8)
    # In glTF v points down. A quarter turn anticlockwise on the screen maps (u, v) to (v, -u).
    u, v = np.moveaxis(np.asarray(CUT[1].textures.uv, np.float64), -1, 0)
    down = 1 - v
    expected = np.stack([down + 0.25, 1 - (-2 * u + 0.5)], axis=-1)
    np.testing.assert_allclose(found.textures.uv, expected, atol=1e-6)


def test_what_cannot_be_read_of_a_material_is_left_out_with_a_warning(tmp_path):
    path = written(tmp_path / "a.gltf", CUT[1])

    def lose_image(document):
        document["images"][0] = {"uri": "missing.png"}

    with pytest.warns(io.MeshWarning, match="without its 1 texture that cannot be read"):
        found = io.load_mesh(changed(path, lose_image))
    assert found.textures is None
    np.testing.assert_array_equal(found.albedo, 1)

    def hide(document):
        document["materials"][0] = {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.4]}}

    with pytest.raises(io.FileError, match="no triangles"):
        io.load_mesh(changed(path, hide))


def test_ply_has_colours_and_coordinates_of_vertices(tmp_path):
    cut = CUT[1]
    colours, uv = np.random.default_rng(1).uniform(0, 1, (4, 3)), np.asarray([(0, 0), (2.5, 0), (2.5, 2), (0, 2)])
    io.write_ply(tmp_path / "a.ply", np.asarray(cut.vertices), np.asarray(cut.faces), colours=colours, uv=uv)
    found = io.load_mesh(tmp_path / "a.ply", texture=image_file(tmp_path / "a.png"), alpha_cutoff=0.5)
    np.testing.assert_allclose(found.corner_colours, colours[np.asarray(cut.faces)], atol=1e-6)
    np.testing.assert_allclose(found.textures.uv, uv[np.asarray(cut.faces)], atol=1e-6)
    assert found.alpha_test is not None
    assert io.load_mesh(tmp_path / "a.ply", texture=tmp_path / "a.png", alpha_cutoff=0.0).alpha_test is None
    text = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    text += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    text += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "b.ply").write_text(text + "0 0 0 255 0 0\n1 0 0 0 51 0\n0 1 0 0 0 255\n3 0 1 2\n")
    expected = [[[1, 0, 0], [0, 0.2, 0], [0, 0, 1]]]
    np.testing.assert_allclose(io.load_mesh(tmp_path / "b.ply").corner_colours, expected, atol=1e-6)


def test_obj_has_coordinates_of_corners_for_a_texture(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.5\n"
    (tmp_path / "a.obj").write_text(text + "f 1/1 2/2 3/3\nf 1/-1 3/3 4/4\n")
    found = io.load_mesh(tmp_path / "a.obj", texture=image_file(tmp_path / "a.png"))
    assert len(found.vertices) == 4
    expected = [[(0, 0), (1, 0), (1, 1)], [(0.5, 0.5), (1, 1), (0, 1)]]
    np.testing.assert_allclose(found.textures.uv, expected, atol=1e-6)
    # Without a texture, coordinates are not read.
    assert io.load_mesh(tmp_path / "a.obj").textures is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"texture": "a.png"}, "has no texture coordinates"),
        ({"texture": "none.png"}, "none.png"),
        ({"texture": "a.obj"}, "has a texture.*cannot be read"),
        ({"alpha_cutoff": 0.5}, "has no textures, and alpha_cutoff 0.5 was given"),
    ],
)
def test_textures_that_cannot_be_used_get_one_clear_error(given, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    image_file(tmp_path / "a.png")
    with pytest.raises(io.FileError, match=message):
        io.load_mesh("a.obj", **given)


def test_import_and_configuration_have_textures_and_alpha_tests(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "a.gltf", *CUT)
    path = import_scene("a.gltf", console=Console(quiet=True), output=tmp_path / "out")
    shutil.move("a.gltf", "b.gltf")
    text = path.read_text()
    assert "alpha_cutoff: 0.5" in text
    assert "texture: meshes/" in text
    found = merge(build_scene(load_config(path)).meshes)
    expected = merge(CUT)
    assert found.alpha_test is not None
    assert_same_looks(found, expected)
    np.testing.assert_allclose(np.asarray(found.albedo), np.asarray(expected.albedo), atol=1e-4)


def test_meshes_that_share_an_image_share_its_texels(tmp_path):
    cut = CUT[1]
    uv = np.asarray([(0, 0), (2.5, 0), (2.5, 2), (0, 2)])
    io.write_ply(tmp_path / "a.ply", np.asarray(cut.vertices), np.asarray(cut.faces), uv=uv)
    image = image_file(tmp_path / "a.png")
    first, second = (io.load_mesh(tmp_path / "a.ply", texture=image) for _ in range(2))
    assert merge([first, second]).textures.texels.shape == first.textures.texels.shape
