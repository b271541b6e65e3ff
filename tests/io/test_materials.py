"""Colours, textures and alpha tests of mesh files."""

import dataclasses
import json
import shutil
import warnings

import numpy as np
import PIL.Image
import pytest
from odd_gltf import Builder
from rich.console import Console
from scenes import fence, fence_over_floor, side_camera, sun

from diffshadow import geometry, io
from diffshadow.config import build_scene, load_config
from diffshadow.geometry import Mesh, Scene, face_colours, merge
from diffshadow.io._meshes import files_of_mesh
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
        ({"texture_wrap": "mirror"}, "has no textures, and texture_wrap mirror was given"),
        ({"texture_filter": "nearest"}, "has no textures, and texture_filter nearest was given"),
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


@pytest.mark.parametrize("path", ["a.gltf", "a.glb", "configuration"])
def test_samplers_and_alpha_of_vertices_are_written_imported_and_read_back(path, tmp_path):
    floor, cut = CUT
    corners = np.random.default_rng(6).uniform(0, 1, 4)[np.asarray(cut.faces)]
    samplers = [("mirror", "clamp"), "nearest"], [("repeat", "mirror"), "linear"], [("repeat", "repeat"), "linear"]
    meshes = [floor]
    for height, (wrap, filter) in enumerate(samplers):
        image, uv = cut.textures.images()[0], cut.textures.uv
        textures = geometry.Textures.of(image, uv, 0.5, wrap=wrap, filter=filter, corner_alpha=corners)
        meshes.append(dataclasses.replace(cut, vertices=cut.vertices + np.float32([0, height, 0]), textures=textures))
    # The alpha of vertices alone cuts out the last one.
    meshes.append(dataclasses.replace(meshes[-1], vertices=cut.vertices - np.float32([0, 3, 0])))
    written(tmp_path / "a.glb" if path == "a.glb" else tmp_path / "a.gltf", *meshes)
    if path == "configuration":

        def lose_texture(document):
            del document["materials"][-1]["pbrMetallicRoughness"]["baseColorTexture"]

        changed(tmp_path / "a.gltf", lose_texture)
        made = import_scene(tmp_path / "a.gltf", console=Console(quiet=True), output=tmp_path / "out")
        text = made.read_text()
        assert text.count("texture_wrap: [mirror, clamp]\n    texture_filter: nearest\n") == 1
        assert text.count("texture_wrap: [repeat, mirror]\n    alpha_cutoff") == 1
        assert text.count("texture: meshes/") == 3
        found = merge(build_scene(load_config(made)).meshes).textures
        np.testing.assert_array_equal(found.images()[-1], np.ones((1, 1, 4)))
    else:
        found = io.load_mesh(tmp_path / path, None).textures
    each = [(list(one.wrap), one.filter) for one in found.each_sampler()]
    given = [(list(wrap), filter) for wrap, filter in samplers]
    assert each == [*given, given[2]][: len(each)]
    assert len(each) == (4 if path == "configuration" else 3) or path != "configuration"
    alpha = np.asarray(found.corner_alpha)
    np.testing.assert_array_equal(alpha[:2], 1)
    np.testing.assert_allclose(alpha[2:], np.tile(corners, (4, 1)), atol=1e-6)


COLOUR = np.array([[1.0, 0.4, 0.2, 0.0], [1, 1, 1, 0.4], [0, 0.2, 1, 1], [1, 1, 1, 0.8]])
STORED = {
    "floats": (COLOUR.astype(np.float32), {}),
    "bytes": (np.rint(255 * COLOUR).astype(np.uint8), {"normalized": True}),
    "shorts": (np.rint(65535 * COLOUR).astype(np.uint16), {"normalized": True}),
    "bytes that are not called parts": (np.rint(255 * COLOUR).astype(np.uint8), {}),
}


def coloured(stored, keys, material):
    builder = Builder(material=0)
    builder.primitive["attributes"]["COLOR_0"] = builder.add(stored, **keys)
    builder.tree["materials"] = [material]
    return builder


@pytest.mark.parametrize("name", STORED)
def test_alpha_of_vertices_is_tested_without_a_texture_too(name, tmp_path):
    material = {"alphaMode": "MASK", "alphaCutoff": 0.3, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.6]}}
    path = tmp_path / "a.gltf"
    path.write_bytes(coloured(*STORED[name], material).text())
    found = io.load_mesh(path)
    faces = [(0, 1, 2), (0, 2, 3)]
    np.testing.assert_allclose(found.corner_colours, COLOUR[faces, :3], atol=1e-6)
    np.testing.assert_allclose(found.textures.corner_alpha, COLOUR[faces, 3], atol=1e-6)
    np.testing.assert_allclose(found.textures.cutoff, 0.3 / 0.6)
    # Without alpha, or without a test of it, the mesh is whole.
    path.write_bytes(coloured(np.ascontiguousarray(STORED["floats"][0][:, :3]), {}, material).text())
    assert io.load_mesh(path).textures is None
    path.write_bytes(coloured(*STORED[name], {**material, "alphaMode": "BLEND"}).text())
    assert io.load_mesh(path).textures is None
    # The user's own test has it, too.
    np.testing.assert_allclose(io.load_mesh(path, alpha_cutoff=0.7).textures.cutoff, 0.7)
    np.testing.assert_allclose(io.load_mesh(path, alpha_cutoff=0.7).textures.corner_alpha, COLOUR[faces, 3], atol=1e-6)


def test_a_sampler_that_breaks_the_format_is_named_and_a_users_own_takes_its_place(tmp_path):
    def change(document):
        document["samplers"] = [{"wrapS": 1}]

    path = changed(written(tmp_path / "a.gltf", CUT[1]), change)
    with pytest.warns(io.MeshWarning, match="without its 1 sampler of a texture that cannot be read"):
        found = io.load_mesh(path)
    assert found.textures.samplers is None
    with warnings.catch_warnings(action="ignore"):
        found = io.load_mesh(path, texture_wrap=("clamp", "mirror"), texture_filter="nearest")
    np.testing.assert_array_equal(found.textures.samplers, [(1, 2, 1)])


OBJ = """mtllib my materials.mtl
usemtl leaf
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 2 0
v 0 1 -1
vt 0 0
vt 1 0
vt 1 1
f 1/1 2/2 3/3
usemtl bark
f 1/1 3/3 4/2
usemtl leaf
f 4 3 5
usemtl stone
f 4 5 6
"""
MTL = """newmtl leaf
Kd 0.5 0.8 0.4
d 0.8
map_Kd -s 2 3 -o 0.25 leaf.png
map_d -clamp on -s 2 3 1 -o 0.25 0 0 C:\\trees\\leaf alpha.png
newmtl bark
Kd 0.2
map_Kd -mm 0.1 0.9 -s 4 bark.png
newmtl unused
map_Kd nowhere.png
"""


def test_obj_has_the_materials_of_its_mtl_files(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "my materials.mtl").write_text(MTL)
    alpha = np.array([[255, 0], [40, 200]], np.uint8)
    colours = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    PIL.Image.fromarray(alpha[::-1]).save(tmp_path / "leaf alpha.png")
    PIL.Image.fromarray(colours[::-1]).save(tmp_path / "leaf.png")
    PIL.Image.fromarray(colours[::-1, :1]).save(tmp_path / "bark.png")
    with pytest.warns(io.MeshWarning) as caught:
        found = io.load_mesh(tmp_path / "a.obj")
    said = str(caught[0].message)
    for words in (
        "1 material stone that is in no material file",
        "1 option -mm of a map_Kd",
        "1 placement of a map_Kd, which differs from that of its map_d",
        "1 transparent look of a material",
        "1 texture of a face without texture coordinates",
    ):
        assert words in said
    assert "nowhere" not in said
    np.testing.assert_allclose(found.albedo, [(0.5, 0.8, 0.4), (0.2, 0.2, 0.2), (0.5, 0.8, 0.4), (1, 1, 1)], atol=1e-6)
    textures = found.textures
    np.testing.assert_array_equal(textures.index, [0, 1, -1, -1])
    leaf, bark = textures.images()
    np.testing.assert_allclose(leaf[..., 3], alpha / 255, atol=1e-6)
    np.testing.assert_allclose(leaf[..., :3], colours / 255, atol=1e-6)
    np.testing.assert_allclose(bark[..., :3], colours[:, :1] / 255, atol=1e-6)
    np.testing.assert_allclose(textures.cutoff, [0.5 / 0.8, 0])
    np.testing.assert_array_equal(textures.samplers, [(1, 1, 0), (0, 0, 0)])
    np.testing.assert_allclose(textures.uv[0], [(0.25, 0), (2.25, 0), (2.25, 3)])
    np.testing.assert_allclose(textures.uv[1], [(0, 0), (4, 1), (4, 0)])
    files = [file.name for file in files_of_mesh(tmp_path / "a.obj")]
    assert files == ["a.obj", "my materials.mtl", "leaf.png", "leaf alpha.png", "bark.png"]
    # An image of the user's takes the place of the materials' own, and their placement.
    with warnings.catch_warnings(action="ignore"), pytest.raises(io.FileError, match="no texture coordinates"):
        io.load_mesh(tmp_path / "a.obj", texture=tmp_path / "leaf.png")
    (tmp_path / "a.obj").write_text(OBJ[: OBJ.index("usemtl leaf\nf 4")])
    with warnings.catch_warnings(action="ignore"):
        given = io.load_mesh(tmp_path / "a.obj", texture=tmp_path / "leaf.png").textures
    np.testing.assert_allclose(given.uv[1], [(0, 0), (1, 1), (1, 0)])
    assert given.cutoff is None


@pytest.mark.parametrize(
    ("option", "image", "expected"),
    [
        ("", np.array([[[200, 100, 50, 255]]]), round(0.299 * 200 + 0.587 * 100 + 0.114 * 50)),
        ("", np.array([[[200, 100, 50, 70]]]), 70),
        ("-imfchan g ", np.array([[[200, 100, 50, 70]]]), 100),
        ("-imfchan l ", np.array([[[90, 90, 90, 70]]]), 90),
        ("-imfchan m ", np.array([[[90, 90, 90, 255]]]), 255),
    ],
)
def test_opacity_is_the_channel_that_a_map_names_or_alpha_or_luminance(option, image, expected, tmp_path):
    PIL.Image.fromarray(image.astype(np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text(f"newmtl a\nmap_d {option}a.png\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n")
    found = io.load_mesh(tmp_path / "a.obj").textures
    np.testing.assert_allclose(found.texels[0], [1, 1, 1, expected / 255], atol=1e-6)
    np.testing.assert_allclose(found.cutoff, 0.5)


def test_import_of_an_obj_file_keeps_its_materials(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "my materials.mtl").write_text(MTL.replace("-clamp on", "-clamp off"))
    PIL.Image.fromarray(np.array([[255, 0], [40, 200]], np.uint8)).save(tmp_path / "leaf alpha.png")
    PIL.Image.fromarray(np.full((2, 2, 3), 255, np.uint8)).save(tmp_path / "bark.png")
    made = import_scene(tmp_path / "a.obj", console=Console(quiet=True), output=tmp_path / "out")
    *parts, _ground = build_scene(load_config(made)).meshes
    assert made.read_text().count("alpha_cutoff: 0.625") == 1
    with warnings.catch_warnings(action="ignore"):
        whole = io.load_mesh(tmp_path / "a.obj")
    # Faces without a texture come first. The faces of each texture follow.
    order = [2, 3, 0, 1]
    found = merge(parts)
    colours = np.asarray(found.albedo)[:, None] * np.asarray(found.corner_colours)
    np.testing.assert_allclose(colours, np.tile(np.asarray(whole.albedo)[order, None], (1, 3, 1)), atol=1e-4)
    np.testing.assert_allclose(found.textures.uv[2:], np.asarray(whole.textures.uv)[:2], atol=1e-6)
    np.testing.assert_allclose(found.textures.cutoff[0], 0.625)
