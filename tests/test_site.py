"""The documentation site holds every public name, needs no other host, and is found by its search."""

import functools
import http.server
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("mkdocs", reason="the site's packages are installed by `make docs`")
pytest.importorskip("mkdocstrings", reason="the site's packages are installed by `make docs`")

ROOT = Path(__file__).parent.parent
HOOKS = ROOT / "docs" / "hooks"
ENGINES = ROOT / "experiments" / "engines"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")

pytestmark = pytest.mark.exhaustive


def hook(name):
    """A module of the site's hooks, which are no package."""
    spec = importlib.util.spec_from_file_location(name, HOOKS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def build(config, folder):
    command = [sys.executable, "-m", "mkdocs", "build", "--config-file", str(config), "--site-dir", str(folder)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_public_name_is_on_its_subpackages_page_with_its_source(site):
    pages = hook("pages")
    for package in pages.SUBPACKAGES:
        module = f"{pages.PACKAGE}.{package}"
        page = (site / "api" / package / "index.html").read_text(encoding="utf-8")
        names = pages.public_names(module)
        assert not [name for name in names if f'id="{module}.{name}"' not in page]
        assert "Source code in" in page or package == "settings"
    scene = (site / "api" / "geometry" / "index.html").read_text(encoding="utf-8")
    assert "<strong>Arguments:</strong>" in scene, "docstrings are Markdown"
    # Only the imported package knows the ranges.
    assert "<strong>Ranges</strong>" in scene


def test_pages_need_no_other_host(site):
    loads = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?(?:src|href)=\"?((?:https?:)?//[^\"\s>]+)")
    for page in site.rglob("*.html"):
        assert not loads.findall(page.read_text(encoding="utf-8")), page
    for style in site.rglob("*.css"):
        assert not re.search(r"@import|url\([\"']?(?:https?:)?//", style.read_text(encoding="utf-8")), style


def test_formulas_are_mathml(site):
    page = (site / "notebooks" / "write_your_own_filter" / "index.html").read_text(encoding="utf-8")
    assert "<math" in page
    assert r"\sigma" not in page


def test_notebooks_begin_with_what_one_gets(site):
    page = (site / "notebooks" / "first_look" / "index.html").read_text(encoding="utf-8")
    text, folded = page.index("A shadow map needs a bias"), page.index("<summary>Imports and sizes</summary>")
    picture = page.index('src="../first_look_1.png"')
    assert text < picture < folded < page.index("matplotlib.pyplot")
    assert page.count('src="../first_look_1.png"') == 2, "at the top, and where it is drawn"


def test_search_shows_prose_and_no_imports(site):
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))["docs"]
    text = {section["location"]: section["text"] for section in index}
    assert not [place for place in text if "DIFFSHADOW_SMALL" in text[place] and place != "notebooks/"]
    code = {place: re.findall(r"<pre>(.*?)</pre>", text[place], re.DOTALL) for place in text}
    assert not [
        place for place in code if re.search(r"(^|<code>)(import|from) \w", "\n".join(code[place]), re.MULTILINE)
    ]
    assert not [place for place in text if "Source code in" in text[place]]
    snippet = text["docs/gpu/#memory"]
    assert snippet.index("JAX reserves") < snippet.index("XLA_PYTHON_CLIENT_PREALLOCATE=false")
    titles = {section["location"]: section["title"] for section in index}
    assert titles["docs/gpu/"] == "On a GPU"


def test_imports_are_left_out_of_code_and_prose_comes_first():
    imports = "import a\nfrom b import (\n    c,\n)\nfrom d import e\n\nsetup()  # first\n"
    of = hook("pages").prose_first
    code = "<pre><code>\n\nx = important()\n</code></pre>"
    assert of(f"<pre><code>{imports}x = important()\n</code></pre> <p>Said.</p>") == f"<p>Said.</p>\n{code}"
    assert of("<pre><code>import a\n</code></pre> <p>Said.</p>") == "<p>Said.</p>"


def test_undocumented_names_are_found(tmp_path, monkeypatch):
    from griffe import GriffeLoader

    package = tmp_path / "undescribed" / "part"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").write_text("")
    (package / "__init__.py").write_text("from ._a import A as A\nfrom ._a import B as B\nfrom ._a import c as c\n")
    (package / "_a.py").write_text(
        'class A:\n    """Said."""\n\n    def said(self):\n        """Said."""\n\n    def unsaid(self): ...\n\n'
        'class B(A):\n    """Said."""\n\n    def said(self): ...\n\ndef c(): ...\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    loaded = GriffeLoader(search_paths=[str(tmp_path)]).load("undescribed", submodules=True)
    assert hook("signatures").undocumented(loaded) == ["undescribed.part.A.unsaid", "undescribed.part.c"]


@pytest.mark.parametrize("link", ["no_such_page.md", "usage.md#no-such-heading"])
def test_broken_links_fail(tmp_path, link):
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text(f"# Home\n\n[elsewhere]({link})\n")
    (docs / "usage.md").write_text("# Usage\n")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    # Without hooks and navigation, which name other files.
    text = re.sub(r"^(nav|hooks|watch|plugins|extra_css):.*\n(?:(?:[ #].*)?\n)*", "", text, flags=re.MULTILINE)
    (tmp_path / "mkdocs.yml").write_text(text)
    done = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert done.returncode != 0
    assert link.partition("#")[2] or link in done.stderr


@pytest.mark.browser
def test_search_finds_a_bias_by_words(site):
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None or shutil.which("node") is None or not (ENGINES / "node_modules" / "playwright-core").is_dir():
        pytest.skip("needs node, chromium and playwright-core, as the engines do")
    handler = functools.partial(QuietHandler, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/"
        command = ["node", str(ROOT / "tests" / "read_site.mjs"), str(ENGINES), browser, address, "receiver plane"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        server.shutdown()
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert urlsplit(found["address"]).path == "/api/shadow/"
    assert "diffshadow.shadow.ReceiverPlane" in found["names"]
    assert {urlsplit(request).netloc for request in found["requests"]} == {urlsplit(address).netloc}


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves files and writes no log."""

    def log_message(self, *_):
        pass
