"""Small meshes as real files have them, odd but valid, with the area and volume that each must have.

`SHAPES` are polygons, which `WRITERS` put into any format; `FILES` are files that one format alone has, and `REFUSED`
those that cannot be read, with what is said of them. `odd_gltf` has those of glTF.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Points = Sequence[Sequence[float]]
Faces = Sequence[Sequence[int]]


class Shape(NamedTuple):
    """Polygons: vertices (v, 3), and the indices of each face's corners, with the area and the volume beneath."""

    vertices: np.ndarray
    faces: Faces
    area: float
    volume: float
    closed: bool = False


class OddFile(NamedTuple):
    """What a file holds, and what it must load as; `left_out` is what the warning says, if there must be one."""

    data: bytes
    area: float
    volume: float
    left_out: str | None = None


# Shapes


def flat(outline: Points, area: float, start: int = 0) -> Shape:
    """One face at a height of 1, which begins with the corner `start`; the volume beneath it is a third of its area."""
    vertices = np.array([(x, y, 1.0) for x, y in outline])
    return Shape(vertices, [np.roll(np.arange(len(outline)), -start).tolist()], area, area / 3)


def prism(outline: Points, area: float, height: float = 2.0) -> Shape:
    """A closed prism in a tilted frame, whose sides are quadrilaterals, and whose top and bottom are the outline.

    Corners in one place, as those at both ends of a bridge to a hole, are one vertex.
    """
    distinct = sorted(set(map(tuple, outline)))
    own = [distinct.index(tuple(corner)) for corner in outline]
    n = len(distinct)
    sides = list(zip(own, [*own[1:], own[0]], strict=True))
    # A bridge runs there and back, and has no wall.
    walls = [(a, b, b + n, a + n) for a, b in sides if (b, a) not in sides]
    perimeter = sum(float(np.hypot(*np.subtract(distinct[a], distinct[b]))) for a, b, *_ in walls)
    vertices = np.array([(*corner, z) for z in (0.0, height) for corner in distinct])
    faces = [own[::-1], [i + n for i in own], *walls]
    turn, _ = np.linalg.qr(np.array([[1.0, 2, 3], [-2, 1, 0.5], [0.3, -1, 2]]))
    turn *= np.sign(np.linalg.det(turn))
    return Shape(vertices @ turn.T + 5.0, faces, 2 * area + perimeter * height, area * height, closed=True)


L = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
# The second corner is the hollow one, so that the diagonal from the first lies outside.
ARROWHEAD = [(0, 2), (1, 1), (0, 0), (3, 1)]
# Neighbours may have corners in the middle of its sides.
L_WITH_MIDPOINTS = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1)]
WITH_A_HOLE = [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)]
WITH_TWO_HOLES = [(0, 0), (6, 0), (6, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1)]
WITH_TWO_HOLES += [(4, 1), (4, 2), (5, 2), (5, 1), (4, 1), (2, 1), (1, 1)]
COMB = [(0, 0), (9, 0), *((9 - x, 3 if x % 2 else 1) for x in range(10))]
# A triangle goes round, and the hollow of its side touches another.
TOUCHING_ITSELF = [(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)]
RING = [(np.cos(a), np.sin(a)) for a in np.linspace(0.1, 2 * np.pi, 20)]
RING += [(0.9 * x, 0.9 * y) for x, y in reversed(RING)]
TWICE = [(0, 0), (2, 0), (2, 0), (2, 1), (1, 1), (1, 1), (1, 2), (0, 2), (0, 2)]


def shoelace(outline: Points) -> float:
    x, y = np.transpose(outline)
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


SHAPES = {
    **{f"l_from_{i}": flat(L, 3, i) for i in range(6)},
    **{f"arrowhead_from_{i}": flat(ARROWHEAD, 2, i) for i in range(4)},
    "arrowhead_from_below": flat(ARROWHEAD[::-1], 2)._replace(volume=-2 / 3),
    "hole": flat(WITH_A_HOLE, 8),
    "two_holes": flat(WITH_TWO_HOLES, 16),
    "comb": flat(COMB, shoelace(COMB)),
    "touching_itself": flat(TOUCHING_ITSELF, 2),
    "corners_twice": flat(TWICE, 3),
    "thin_ring": flat(RING, shoelace(RING)),
    "l_prism": prism(L, 3),
    "l_prism_with_midpoints": prism(L_WITH_MIDPOINTS, 3),
    "prism_with_a_hole": prism(WITH_A_HOLE, 8),
}


# Formats


def obj(shape: Shape) -> bytes:
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in shape.vertices]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in shape.faces]
    return "\n".join(lines).encode()


def off(shape: Shape) -> bytes:
    lines = ["OFF", f"{len(shape.vertices)} {len(shape.faces)} 0"]
    lines += [f"{x:.17g} {y:.17g} {z:.17g}" for x, y, z in shape.vertices]
    lines += [" ".join(map(str, [len(face), *face])) for face in shape.faces]
    return "\n".join(lines).encode()


def ply_header(form: str, vertices: int, faces: int) -> bytes:
    lines = ["ply", f"format {form} 1.0", f"element vertex {vertices}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "property uchar red", "end_header\n"]
    return "\n".join(lines).encode()


def ply_text(shape: Shape) -> bytes:
    lines = [f"{x:.17g} {y:.17g} {z:.17g}" for x, y, z in shape.vertices]
    lines += [" ".join(map(str, [len(face), *face, 255])) for face in shape.faces]
    return ply_header("ascii", len(shape.vertices), len(shape.faces)) + "\n".join(lines).encode()


def ply_binary(shape: Shape, order: str) -> bytes:
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    rows = [struct.pack(f"{order}B{len(face)}iB", len(face), *face, 255) for face in shape.faces]
    points = np.asarray(shape.vertices).astype(f"{order}f8").tobytes()
    return ply_header(form, len(shape.vertices), len(shape.faces)) + points + b"".join(rows)


def stl_text(shape: Shape) -> bytes:
    """Text whose facets have any number of corners, which some writers give them."""
    lines = ["solid polygons"]
    for face in shape.faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(f"{x:.17g}" for x in shape.vertices[i]) for i in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid"]).encode()


WRITERS = {
    "obj": obj,
    "off": off,
    "text.ply": ply_text,
    "little.ply": lambda shape: ply_binary(shape, "<"),
    "big.ply": lambda shape: ply_binary(shape, ">"),
    "stl": stl_text,
}


# Files

# A unit square at a height of 1, of area 1 and volume 1/3.
SQUARE = "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 1 2 3 4\n"
OFF_SQUARE = "OFF\n4 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n4 0 1 2 3\n"
PLY_POINTS = "property float x\nproperty float y\nproperty float z\n"
PLY_SQUARE = (
    f"ply\nformat ascii 1.0\ncomment by Jürgen…\nelement vertex 4\n{PLY_POINTS}element face 1\n"
    "property list uchar int vertex_index\nend_header\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n4 0 1 2 3\n"
)
TRIANGLE_STL = "facet normal 0 0 0\nouter loop\nvertex 0 0 1\nvertex 2 0 1\nvertex 0 1 1\nendloop\nendfacet\n"


def one(data: str | bytes, left_out: str | None = None) -> OddFile:
    """A file of area 1 and volume 1/3."""
    return OddFile(data.encode() if isinstance(data, str) else data, 1.0, 1 / 3, left_out)


def binary_ply(ends: str, last: str | None = None) -> bytes:
    """`PLY_SQUARE` in binary, whose header's lines end with `ends`, and its last one with `last`."""
    header, _, _ = PLY_SQUARE.replace("ascii", "binary_little_endian").replace("…", "").partition("end_header\n")
    points = struct.pack("<12f", 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1)
    lines = header.encode("latin-1").replace(b"\n", ends.encode())
    return (
        lines + b"end_header" + (ends if last is None else last).encode() + points + struct.pack("<B4i", 4, 0, 1, 2, 3)
    )


# Of lines that end otherwise than the first. The first byte of the data may be that of a line's end.
PLY_ENDS = {
    "windows_binary": binary_ply("\r\n"),
    "old_mac_binary": binary_ply("\r"),
    "windows_last_line": binary_ply("\n", "\r\n"),
    "unix_last_line": binary_ply("\r\n", "\n"),
    "old_mac_windows_last_line": binary_ply("\r", "\r\n"),
    "the_other_way_round": binary_ply("\n\r"),
    "spaces_behind_the_last_word": binary_ply("\n", " \n"),
    "old_mac_data_of_line_ends": binary_ply("\r").replace(struct.pack("<f", 0), b"\n\0\0\0", 1),
    "mixed": PLY_SQUARE.replace("\n", "\r\n", 3),
}


def binary_stl(name: bytes) -> bytes:
    return name.ljust(80, b" ") + struct.pack("<I12fH", 1, 0, 0, 0, 0, 0, 1, 2, 0, 1, 0, 1, 1, 0)


FILES = {
    "latin_1.obj": one("# Müller\no Körper\nusemtl grün\n".encode("latin-1") + SQUARE.encode()),
    # What some encodings have as an ellipsis ends a line in others.
    "ellipsis.obj": one(b"# see\x85v 7 7 7\n" + SQUARE.encode()),
    "utf_16_little.obj": one(("\ufeff# Müller\n" + SQUARE).encode("utf-16-le")),
    "utf_16_big.obj": one(("\ufeff# Müller\n" + SQUARE).encode("utf-16-be")),
    "utf_16_without_mark.obj": one(SQUARE.encode("utf-16-le")),
    "utf_8_with_mark.obj": one(("\ufeff" + SQUARE).encode()),
    "windows_ends.obj": one(SQUARE.replace("\n", "\r\n")),
    "old_mac_ends.obj": one(SQUARE.replace("\n", "\r")),
    "tabs_and_comments.obj": one(SQUARE.replace(" ", "\t").replace("1\n", "1 # here\n")),
    "continued.obj": one(SQUARE.replace("f 1 2 3", "f 1 \\\n2 \\\n3")),
    "no_materials.obj": one(
        f"mtllib nowhere/jürgen.mtl\nusemtl red\n{SQUARE}", "1 material file nowhere/jürgen.mtl that cannot be read"
    ),
    "numbers.obj": one(SQUARE.replace("v 1 1 1", "v +1. 10e-1 0.1E+1")),
    "weights_and_colors.obj": one(SQUARE.replace("v 1 0 1", "v 1 0 1 0.5 0.5 0.5").replace("v 1 1 1", "v 1 1 1 1")),
    "zero_normals.obj": one(f"vn 0 0 0\nvt 0 0\n{SQUARE.replace('f 1 2 3 4', 'f 1/1/1 2/1/1 3/1/1 4/1/1')}"),
    "normals_only.obj": one(f"vn 0 0 0\n{SQUARE.replace('f 1 2 3 4', 'f 1//1 2//1 3//1 4//1')}"),
    "negative.obj": one(SQUARE.replace("f 1 2 3 4", "f -4 -3 -2 -1")),
    # Indices count back from the face, not from the end.
    "negative_in_two_objects.obj": OddFile(
        f"o a\n{SQUARE.replace('f 1 2 3 4', 'f -4 -3 -2 -1')}o b\nv 0 0 4\nv 2 0 4\nv 0 2 4\nf -3 -2 -1\n".encode(),
        3.0,
        1 / 3 + 8 / 3,
    ),
    # Nine words a line, but triangles with texture coordinates and a face of nine corners.
    "same_number_of_words.obj": OddFile(
        b"vt 0 0\nvn 0 0 1\n"
        + "".join(f"v {x} {y} 1\n" for x, y in [*L, (0, 1.5), (0, 1), (0, 0.5)]).encode()
        + b"f 1 2 3 4 5 6 7 8 9\nf 1/1/1 3/1/1 2/1/1\n",
        3 + 1.0,
        (3 - 1.0) / 3,
    ),
    "duplicate_and_unused.obj": one(
        "v 9 9 9\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 0 1\nv 1 1 1\nv 0 1 1\nv nan 0 0\nf 2 3 4\nf 5 6 7\n"
    ),
    "face_with_a_corner_twice.obj": one(SQUARE.replace("f 1 2 3 4", "f 1 2 2 3 4")),
    "lines_and_points.obj": one(f"{SQUARE}l 1 2\nl 2 3\np 1\n", "1 point and 2 lines"),
    "two_corners.obj": one(f"{SQUARE}f 1 2\n", "1 face of fewer than three corners"),
    "dust.obj": one(f"{SQUARE}v 1e-7 0 1\nv 0 1e-7 1\nf 1 5 6\n", "1 triangle of a millionth of its extent"),
    "latin_1.off": one(f"# Jürgen\n{OFF_SQUARE}".encode("latin-1")),
    "counts_beside.off": one(OFF_SQUARE.replace("OFF\n", "OFF ")),
    "counts_joined.off": one(OFF_SQUARE.replace("OFF\n", "OFF")),
    "no_keyword.off": one(OFF_SQUARE.replace("OFF\n", "")),
    "two_counts.off": one(OFF_SQUARE.replace("4 1 0", "4 1")),
    "colored_faces.off": one(OFF_SQUARE.replace("4 0 1 2 3", "4 0 1 2 3 0.5 0.5 0.5")),
    "colored_vertices.off": one(OFF_SQUARE.replace("OFF", "COFF").replace(" 1\n", " 1 255 0 0 255\n")),
    "latin_1.ply": one(PLY_SQUARE.encode("cp1252")),
    "utf_16.ply": one(PLY_SQUARE.encode("utf-16")),
    "windows_ends.ply": one(PLY_SQUARE.replace("\n", "\r\n")),
    "stray_line_in_the_header.ply": one(PLY_SQUARE.replace("comment by", "made by")),
    **{f"{name}.ply": one(data) for name, data in PLY_ENDS.items()},
    "mark_before_binary.ply": one(b"\xef\xbb\xbf" + binary_ply("\n")),
    "filled_up.ply": one(binary_ply("\n") + bytes(3)),
    "columns_without_a_property.ply": one(
        PLY_SQUARE.replace("1 1 1\n", "1 1 1 7 7\n").replace("4 0 1 2 3", "4 0 1 2 3 0 0"),
        "4 numbers of no property in its header",
    ),
    "strips.ply": OddFile(
        (
            f"ply\nformat ascii 1.0\nelement vertex 6\n{PLY_POINTS}element tristrips 1\n"
            "property list int int vertex_indices\nelement edge 1\nproperty int vertex1\nproperty int vertex2\n"
            "end_header\n0 0 1\n1 0 1\n0 1 1\n1 1 1\n0 2 1\n1 2 1\n7 0 1 2 3 -1 4 2\n0 1\n"
        ).encode(),
        1.0,
        1 / 3,
        "1 edge",
    ),
    "other_lists_first.ply": one(
        f"ply\nformat ascii 1.0\nelement other 2\nproperty list uchar float a\nelement vertex 4\nproperty uchar red\n"
        f"{PLY_POINTS}element face 2\nproperty list uchar float texcoord\nproperty list uchar int vertex_indices\n"
        "end_header\n1 7\n2 7 7\n0 0 0 1\n0 1 0 1\n0 1 1 1\n0 0 1 1\n2 8 8 3 0 1 2\n0 3 2 3 0\n"
    ),
    "latin_1.stl": one(f"solid Körper\n{TRIANGLE_STL}endsolid Körper\n".encode("latin-1")),
    "named_after_a_vertex.stl": one(f"solid my vertex of the endsolid\n{TRIANGLE_STL}endsolid\n"),
    "upper_case.stl": one(f"SOLID A\n{TRIANGLE_STL.upper()}ENDSOLID\n"),
    "two_solids.stl": OddFile(2 * f"solid\n{TRIANGLE_STL}endsolid\n".encode(), 2.0, 2 / 3),
    "one_line.stl": one(" ".join(f"solid my vertex of it\n{TRIANGLE_STL}endsolid\n".split())),
    "two_solids_on_one_line.stl": OddFile(
        " ".join(2 * f"solid a b facet of c {TRIANGLE_STL} endsolid a endfacet ".split()).encode(), 2.0, 2 / 3
    ),
    "a_facet_on_a_line.stl": one("solid\n" + TRIANGLE_STL.replace("\n", " ") + "\nendsolid\n"),
    "divided_keywords.stl": one(
        f"solid\n{TRIANGLE_STL}endsolid\n".replace("end", "end ").replace("outer loop", "outerloop")
    ),
    "long_name.stl": one(f"solid\nmade by hand,\nvertical\n{TRIANGLE_STL}"),
    "binary.stl": one(binary_stl(b"made by \xfc")),
    "binary_named_solid.stl": one(binary_stl(b"solid by CAD")),
}


REFUSED = {
    "bow_tie.obj": ("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n", r"face, number 1 with 4 corners, whose outline"),
    "second_face.obj": (
        f"{SQUARE}v 0 0 0\nv 2 2 0\nv 2 0 0\nv 0 1 0\nv -1 0 0\nf 5 6 7 8 9\n",
        r"face, number 2 with 5 corners, whose outline crosses itself; triangulate it",
    ),
    "pentagram.obj": (
        "".join(f"v {np.cos(a):.9g} {np.sin(a):.9g} 0\n" for a in 4 * np.pi / 5 * np.arange(5)) + "f 1 2 3 4 5\n",
        "crosses itself",
    ),
    "bent_too_far.obj": (
        "".join(f"v {x} {y} {z}\n" for x, y, z in [(0, 0, 0), (4, 0, 3), (1, 2, -3), (3, -2, 5), (4, 3, 0), (0, 3, 1)])
        + "f 1 2 3 4 5 6\n",
        r"crosses itself in its mean plane \(its corners do not lie in one plane\)",
    ),
    "word.obj": (f"{SQUARE}v 0 0 x\n", "is damaged: line 6 is 'v 0 0 x'; expected three numbers"),
    "two_numbers.obj": (f"{SQUARE}v 0 0\n", "line 6 is 'v 0 0'; expected three numbers"),
    "word_in_a_face.obj": (f"{SQUARE}f 1 2 x\n", "line 6 is 'f 1 2 x'; expected whole numbers of vertices"),
    "vertex_0.obj": (f"{SQUARE}f 0 1 2\n", "line 6, 'f 0 1 2', refers to vertex 0; expected 1 to 4"),
    "vertex_9.obj": (f"{SQUARE}f 1 2 9\n", "refers to vertex 9; expected 1 to 4"),
    "vertex_before_the_first.obj": (f"f -1 -2 -3\n{SQUARE}", "refers to vertex -1"),
    "huge.obj": (
        SQUARE.replace("v 1 1 1", "v 1 1e39 1"),
        "1 of the 4 vertices are NaN or infinite",
    ),
    "nan.obj": (SQUARE.replace("v 1 1 1", "v 1 nan 1"), r"the first is vertex 2\)"),
    "binary.off": ("OFF BINARY\n", "is a binary OFF file, which cannot be read"),
    "four_dimensions.off": ("4OFF\n1 0 0\n0 0 0 1\n", "not three-dimensional"),
    "few_lines.off": ("OFF\n99999999999 6 0\n0 0 0\n", "99999999999 vertices and 6 faces, but 1 lines follow"),
    "more_faces.off": (OFF_SQUARE + "3 0 1 2\n", "4 vertices and 1 faces, but 6 lines follow; expected one for each"),
    "no_counts.off": ("OFF\nthree\n", "followed by 'three'; expected the numbers of vertices and faces"),
    "short_face.off": (OFF_SQUARE.replace("4 0 1 2 3", "4 0 1 2"), "line 7 is '4 0 1 2'; expected a count"),
    "short.ply": (PLY_SQUARE.replace("vertex 4", "vertex 9999999999"), "ends before the last of the 9999999999 vertex"),
    "word.ply": (PLY_SQUARE + "x", "has 'x' below its header; expected numbers"),
    "header.ply": (PLY_SQUARE.replace("float y", "flaot y"), "line 6 of its header is 'property flaot y'"),
    "no_z.ply": (PLY_SQUARE.replace("float z", "float w"), "vertices have x, y, w; expected x, y and z"),
    "no_indices.ply": (PLY_SQUARE.replace("vertex_index", "corners"), "have corners; expected vertex_indices"),
    "half_a_vertex.ply": (PLY_SQUARE.replace("4 0 1 2 3", "4 0 1 2 2.5"), "vertex indices that are not whole"),
    "negative_list.ply": (PLY_SQUARE.replace("4 0 1 2 3", "-4 0 1 2 3"), "a list of length -4"),
    "vertex_4.ply": (PLY_SQUARE.replace("4 0 1 2 3", "4 0 1 2 4"), "face 1 refers to vertex 4; expected 0 to 3"),
    "one_face_too_few.ply": (
        PLY_SQUARE + "3 0 1 2\n",
        "4 numbers are left below the last row that its header announces; expected none",
    ),
    "one_face_too_few_binary.ply": (
        binary_ply("\n") + struct.pack("<B3i", 3, 0, 1, 2),
        r"\d+ bytes are left below the last row",
    ),
    "one_vertex_too_many.ply": (PLY_SQUARE.replace("vertex 4", "vertex 5"), "it ends before the last of the 1 face"),
    "faces_twice.ply": (
        PLY_SQUARE.replace("end_header", "element face 0\nend_header"),
        "line 10 of its header is 'element face 0', which cannot be read",
    ),
    "endless_list.ply": (PLY_SQUARE.replace("4 0 1 2 3", "9" * 5000), "has a list of length inf"),
    "short.stl": (binary_stl(b"")[:100], "has 100 bytes; expected 134 for its 1 triangles, or text"),
    "cut.stl": (f"solid a\n{TRIANGLE_STL[:60]}", "line 6 is 'vert'; expected another vertex, or endloop"),
    "cut_behind_a_line.stl": (f"solid a\n{TRIANGLE_STL[:56]}", "line 5 gives a vertex that no endloop follows"),
    "no_endloop.stl": (
        2 * f"solid a\n{TRIANGLE_STL}".replace("endloop\n", ""),
        "line 7 is 'endfacet'; expected another vertex, or endloop",
    ),
    "misspelt.stl": (
        f"solid a\n{TRIANGLE_STL.replace('outer', 'utter')}",
        "line 3 is 'utter loop'; expected a keyword",
    ),
    "word_on_one_line.stl": (
        " ".join(f"solid a\n{TRIANGLE_STL}".replace("vertex 2 0 1", "vertex 2 0 x").split()),
        "line 1 is 'vertex 2 0 x'; expected three numbers",
    ),
    "garbage.stl": ("garbage", "has 7 bytes; expected a header, or text that begins with solid"),
}
