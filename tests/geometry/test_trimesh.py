"""Meshes and scenes of trimesh, and other objects with vertices and faces, in place of meshes."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import PIL.Image
import pytest
import trimesh

from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    PinholeCamera,
    PointLight,
    Scene,
    SpotLight,
    drop_to_ground,
    fit_to_size,
    library_mesh,
    merge,
)
from diffshadow.raster import draw_surface
from diffshadow.shadow import draw_shadow_map

CAMERA = PinholeCamera((2.0, 2.0, 3.0), (0.0, 0.5, 0.0), resolution=(32, 32))
LIGHT = DirectionalLight((0.5, -1.0, -0.3), (0.0, 0.5, 0.0), (3.0, 3.0), -2.0, 2.0)
MIRROR = np.diag([-2.0, 1.0, 1.0, 1.0])


def two_boxes():
    """A box, and its mirror image twice as wide, turned from +y to +z, ten units up."""
    scene = trimesh.Scene()
    scene.add_geometry(library_mesh("box").to_trimesh(), geom_name="box", node_name="first")
    twin = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]) @ MIRROR
    twin[1, 3] = 10
    scene.graph.update(frame_to="twin", matrix=twin, geometry="box")
    return scene


def volume(mesh):
    return np.linalg.det(np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]).sum() / 6


def test_a_mesh_comes_back_from_trimesh_with_its_colours_and_creases():
    box = library_mesh("box")
    box = Mesh(box.vertices, box.faces, box.corner_normals, np.linspace(0, 1, 36).reshape(12, 3))
    back = Mesh.from_trimesh(box.to_trimesh())
    np.testing.assert_array_equal(back.vertices, box.vertices)
    np.testing.assert_array_equal(back.faces, box.faces)
    np.testing.assert_allclose(back.corner_normals, box.corner_normals, atol=1e-6)
    np.testing.assert_allclose(back.albedo, box.albedo, atol=0.5 / 255 + 1e-6)
    assert Mesh.from_trimesh(trimesh.creation.box()).albedo[0, 0] == Mesh(box.vertices, box.faces).albedo[0, 0]


def test_materials_and_vertices_colour_faces():
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.SimpleMaterial(diffuse=[255, 51, 0]))
    np.testing.assert_allclose(Mesh.from_trimesh(box).albedo, np.tile([1.0, 0.2, 0.0], (12, 1)), atol=1e-6)
    box = trimesh.creation.box()
    box.visual.vertex_colors = np.tile([0, 255, 51, 255], (8, 1))
    mesh = Mesh.from_trimesh(box)
    np.testing.assert_allclose(mesh.corner_colours, np.tile([0.0, 1.0, 0.2], (12, 3, 1)), atol=1e-6)
    np.testing.assert_array_equal(mesh.albedo, 1)


def test_a_texture_comes_with_its_factor_and_its_alpha_test():
    levels = np.array([[[188, 0, 0, 255], [0, 188, 0, 51]], [[0, 0, 188, 255], [255, 255, 255, 0]]], np.uint8)
    image, uv = PIL.Image.fromarray(levels), np.random.default_rng(0).uniform(size=(8, 2))
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(uv=uv, image=image)
    mesh = Mesh.from_trimesh(box)
    np.testing.assert_array_equal(mesh.albedo, 1)
    np.testing.assert_allclose(mesh.textures.uv, uv[np.asarray(box.faces)], atol=1e-6)
    # The image's last row is its bottom row; half of the light is 188 of 255.
    expected = [[0, 0, 0.5, 1], [1, 1, 1, 0], [0.5, 0, 0, 1], [0, 0.5, 0, 0.2]]
    np.testing.assert_allclose(mesh.textures.texels, expected, atol=0.005)
    assert mesh.alpha_test is None
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=image, baseColorFactor=[255, 51, 0, 128], alphaMode="MASK", alphaCutoff=0.3
    )
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    mesh = Mesh.from_trimesh(box)
    np.testing.assert_allclose(mesh.albedo[0], [1, 0.2, 0], atol=1e-6)
    # The factor's alpha, which has 8 bits, times the texel's is compared with the cutoff.
    np.testing.assert_allclose(mesh.textures.cutoff, 0.6, rtol=0.01)


def test_split_vertices_are_welded_and_own_normals_are_taken_if_asked_for():
    box = library_mesh("box")
    split = SimpleNamespace(vertices=np.asarray(box.vertices)[np.asarray(box.faces)].reshape(-1, 3))
    split.faces = np.arange(36).reshape(12, 3)
    assert Mesh.from_trimesh(split).vertices.shape == (8, 3)
    with pytest.raises(ValueError, match="the mesh has no finite vertex_normals"):
        Mesh.from_trimesh(split, crease_angle=None)
    split.vertex_normals = np.tile([0.0, 2.0, 0.0], (36, 1))
    np.testing.assert_allclose(Mesh.from_trimesh(split, None).corner_normals, np.tile([0.0, 1, 0], (12, 3, 1)))


def test_a_scene_has_a_mesh_for_each_node_where_its_graph_puts_it():
    scene = Scene(two_boxes(), CAMERA, LIGHT, casts=(True, False))
    assert len(scene.meshes) == 2
    np.testing.assert_allclose(scene.meshes[1].bounds, [[-1, 9.5, 0], [1, 10.5, 1]], atol=1e-6)
    # A mirror reverses the winding, or the volume would count negative.
    assert [volume(mesh) for mesh in scene.meshes] == pytest.approx([1, 2])
    assert volume(Mesh.from_trimesh(two_boxes())) == pytest.approx(3)
    own = Mesh.from_trimesh(two_boxes(), crease_angle=None)
    outwards = np.cross(*np.moveaxis(np.diff(np.asarray(own.vertices)[np.asarray(own.faces)], axis=1), 1, 0))
    assert (np.einsum("fkc,fc->fk", own.corner_normals, outwards) > 0).all()


def test_a_scene_brings_its_camera_and_its_lights():
    given = two_boxes()
    with pytest.raises(ValueError, match="the scene has no camera; expected one"):
        Scene(given)
    camera = trimesh.scene.Camera(name="eye", resolution=(64, 32), fov=(60, 40), z_near=0.5, z_far=50)
    given.camera = camera
    # From -z to -x, and on its side.
    turn = [trimesh.transformations.rotation_matrix(np.pi / 2, axis) for axis in ([0, 1, 0], [0, 0, 1])]
    given.camera_transform = trimesh.transformations.translation_matrix([0, 1, 20]) @ turn[0] @ turn[1]
    with pytest.raises(ValueError, match="the scene has no light"):
        Scene(given)
    lighting = trimesh.scene.lighting
    given.lights = [
        lighting.DirectionalLight(name="sun"),
        lighting.PointLight(name="bulb"),
        lighting.SpotLight(name="spot", innerConeAngle=0.5, outerConeAngle=1.0),
    ]
    for name in ("sun", "bulb", "spot"):
        pose = trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])  # from -z to -y
        pose[:3, 3] = [0, 30, 0]
        given.graph.update(frame_to=name, matrix=pose)
    scene = Scene(given)
    np.testing.assert_allclose([*scene.camera.eye, *scene.camera.target], [0, 1, 20, -1, 1, 20], atol=1e-6)
    np.testing.assert_allclose(scene.camera.view().world_to_eye[1, :3], [0, 0, 1], atol=1e-6)
    assert scene.camera.resolution == (32, 64)
    assert (float(scene.camera.fov_y), float(scene.camera.near), float(scene.camera.far)) == (40, 0.5, 50)
    sun, bulb, spot = scene.lights
    assert (type(sun), type(bulb), type(spot)) == (DirectionalLight, PointLight, SpotLight)
    np.testing.assert_allclose([sun.direction, spot.direction], [[0, -1, 0], [0, -1, 0]], atol=1e-6)
    np.testing.assert_allclose([bulb.position, spot.position], [[0, 30, 0], [0, 30, 0]], atol=1e-6)
    assert float(spot.outer_angle) == pytest.approx(np.rad2deg(1))
    # What is given comes first.
    assert Scene(given, CAMERA, LIGHT).lights == (LIGHT,)
    assert Scene(given, CAMERA, LIGHT).camera is CAMERA


def test_whatever_takes_a_mesh_takes_one_of_trimesh():
    box, other = library_mesh("box"), library_mesh("box").to_trimesh()
    same = lambda a, b: np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
    same(draw_surface(other, CAMERA).face, draw_surface(box, CAMERA).face)
    same(draw_shadow_map(other, LIGHT, (32, 32)).depth, draw_shadow_map(box, LIGHT, (32, 32)).depth)
    same(merge([other, box]).vertices, merge([box, box]).vertices)
    same(fit_to_size(other, 2.0).vertices, fit_to_size(box, 2.0).vertices)
    same(drop_to_ground(other, 2.0).vertices, drop_to_ground(box, 2.0).vertices)
    same(Edges.of(other).vertices, Edges.of(box).vertices)
    same(Scene([other, box], CAMERA, LIGHT).mesh.faces, Scene([box, box], CAMERA, LIGHT).mesh.faces)


NAN = np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0.0]])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (trimesh.Trimesh(), "the mesh has no faces; expected at least one triangle"),
        (trimesh.Trimesh(NAN, [[0, 1, 2]], process=False), "the mesh: 1 of the 3 vertices to weld are NaN"),
        (trimesh.Scene(), "the scene has no geometry with faces; expected at least one triangle"),
        (trimesh.Scene(trimesh.Trimesh(NAN, [[0, 1, 2]], process=False)), "the scene's mesh 'geometry_0': 1 of the 3"),
        (SimpleNamespace(vertices=NAN[:2], faces=[[0, 1, 2]]), "use vertices 0 to 2; expected 0 to 1"),
        (SimpleNamespace(vertices=NAN, faces=[[0, 1, 2, 2]]), r"faces of the mesh have shape \(1, 4\).*expected integ"),
        (SimpleNamespace(vertices=NAN[:, :2], faces=[[0, 1, 2]]), r"vertices of the mesh have shape \(3, 2\)"),
        (SimpleNamespace(vertices=0 * NAN[:2], faces=[[0, 1, 1]]), "every triangle of the mesh has two corners"),
    ],
)
def test_objects_without_triangles_get_one_clear_error(given, message):
    with pytest.raises(ValueError, match=message):
        Mesh.from_trimesh(given)


def test_paths_of_a_scene_are_left_out_with_a_warning():
    given = two_boxes()
    given.add_geometry(trimesh.PointCloud(np.zeros((4, 3))), geom_name="cloud")
    with pytest.warns(UserWarning, match="the scene is used without cloud: expected faces"):
        Scene(given, CAMERA, LIGHT)


def test_what_is_no_mesh_is_refused():
    with pytest.raises(TypeError, match="a mesh of the scene is of type float; expected a Mesh, or an object with"):
        Scene([1.0], CAMERA, LIGHT)
    with pytest.raises(TypeError, match="a mesh of the scene is the class Trimesh"):
        Scene(trimesh.Trimesh, CAMERA, LIGHT)


@pytest.mark.exhaustive
def test_trimesh_is_loaded_only_for_what_needs_it():
    program = (
        "import sys; from diffshadow import config, geometry, io, study; geometry.library_mesh('box'); "
        "assert 'trimesh' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
