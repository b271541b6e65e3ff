"""What files are spoilt with, and words that suit keys where the schema says only that they are text."""

import math

from diffshadow.geometry import LIBRARY


class Verbatim(str):
    """Text that is written to a YAML file as it is."""


# fmt: off
TEXT = [
    "", " ", "~", "null", "yes", "1e-3", "0x10", "nan", "a: b", "# a", "'", '"', "é", "日本", "😀", "\ufeff", "x" * 300,
    "\x1b[31mred\x1b[0m", "two\nlines", "\0", "a\0b", "\x85", "\u2028", "\ud800", "\u202e", "\x7f", "\r", "\t",
    "\ufffe", "..", "/", "~nobody/x", "$HOME", "/dev/null", "/proc/self/mem", "%s %d {x} {0}", "[bold]x[/bold]",
    "scene.light",
]
NUMBERS = [
    0, -1, 1, 2, 3, -0.0, 0.5, 7, 1e-320, 1e-30, 1e-6, 65.5, 4096, 3000, 8193, 65537, 2**31, 2**32, 2**53 + 1, 2**63,
    2**64, 10**25, -(10**25), 10**39, -1e-300, 1e16, 1e30, 3.5e38, 1e39, 1e154, 1e308, -1e308, math.inf, -math.inf,
    math.nan,
]
YAML = [
    "&a [*a]", "&b {x: *b}", "*nowhere", "&c 1", "!!python/object/apply:os.getcwd []", "!mine 3", "!!int '3'",
    "!!str 3", "!!set {a, b}", "!!binary aGk=", "!!float nan", "|\n  folded\n", ">-\n  text", "? [a, b]", "@x", "`x`",
    "%x", "!", "&", "{<<: {type: pcf}}", "{[1, 2]: 3}", "{1: 2}", "{null: 1}", "{.nan: 1}", "{true: 1, True: 2}",
    "{? a}", "[,]", "[1, 2", "}", "*", "0o17", "0xFFFFFFFFFFFFFFFFFFFFFFF", "1_000", "1:30", "2026-01-01", "+.inf",
    ".NaN", "-.5e+400", "9" * 39, "9" * 5000, '"\\x1b]0;title\\a"', '"\\0"', '"\\ud83d"', '"\\N"', '"\\L"', "'it''s'",
    "[" * 600, "{a: " * 400 + "1" + "}" * 400,
]
OTHERS = [None, True, False, [], {}, [[]], {"type": "pcf"}, {"type": None}, {"": 1}, [1] * 500]
BYTES = [
    b"\t", b"\xff", b"\xc3", b"\x80", b"\x00", b"\x1b[2J", b"\x85", b"\xc2\x85", b"\xe2\x80\xa8", b"\xef\xbb\xbf",
    b"\xed\xa0\x80", b"\r", b"\r\n", b"---\n", b"\n...\n", b"%YAML 1.1\n---\n", b":", b"- ", b"{", b"]", b"'", b'"',
    b"&a ", b"*a ", b"!!x ", b"#", b"\n", b"? ", b"|", b">", b"<<: ", b",", b" ", b"[" * 2000, b"\xc2\xa0", b"~",
]
BOMB = b"".join(b"x%d: &x%d [%s]\n" % (n, n, b", ".join([b"*x%d" % (n - 1)] * 9 if n else [b"1"])) for n in range(9))
ENDS = [BOMB, b"\n---\na: 1\n", b"? ", b"\xfe\xff", b"seed: 1\n"]
WHOLE = [b"", b"\n", b"[]", b"3", b"text", b"~", b"- a", b"{}", b"\xff\xfe", b"\0", b"scene", b"[" * 5000]
FILES = ["a b.yaml", "a:1: b.yaml", "é.yaml", "two\nlines.yaml", "\x1b[1mx.yaml", "\udcff.yaml", "-x.yaml", "x.yaml"]
KEYS = ["", ".", "a..b", "scene.meshes.9.path", "scene.meshes.-1", "scene.meshes.x.y", "seed.x", "fit.parameters."]
ARGUMENTS = [
    "fit", "render", "validate", "sweep", "report", "compare", "case.yaml", "nowhere.yaml", ".", "runs", "seed=1",
    "=", "=3", "--help", "--version", "--debug", "--dry-run", "--workers", "--limit", "-1", "0", "x", "1e9", "--dpi",
    "--figures", "svg", "--figures=bmp", "--output", "/dev/null/x", "--", "-", "", " ", "\x1b[1m", "a\nb", "\udcff",
    "x" * 5000, "[bold]", "\x85",
]
SWEPT = ["filter.radius", "bias.constant", "filter.samples", "scene.light.elevation", "filter.type", "shadow_map.cull"]
BY_KEY = {
    "name": ["run", "a b", "a.b", "é", "-x", "x" * 240],
    "output": ["runs", "runs/deep", ".", "runs/../runs"],
    "path": ["builtin:box"] * len(LIBRARY) + [f"builtin:{name}" for name in LIBRARY],
    "x": ["filter.radius", "bias.constant", "seed", "label"],
    "y": ["rmse", "mae", "ssim", "rmse_to_limit"],
    "lines": ["filter.radius", "label"],
    "panels": ["filter.samples"],
    "parameters": [
        "bias.constant", "bias.slope", "bias.normal_offset", "bias.plane.fudge", "bias.slope_least", "filter.radius",
        "filter.light_size", "filter.exponent", "scene.light.azimuth", "scene.light.position.x", "scene.light.radius",
        "scene.light.angular_radius", "scene.meshes.0.translate.y", "scene.meshes.0.turn.z",
        "scene.lights.0.elevation", "scene.meshes.0.vertices.0.x",
    ],
    **dict.fromkeys(("grid", "zip", "axes", "list"), SWEPT),
}
# fmt: on
