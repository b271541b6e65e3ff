"""Pages of the site: files of the repository at their own paths, executed notebooks, and a page for each subpackage."""

import ast
import base64
import json
import re
from pathlib import Path
from typing import TypeGuard

import nbformat
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
# What pages link to stands here too.
KEPT = (
    *("*.md", "LICENSE", "docs/*.md", "docs/images/**/*.png", "docs/images/**/*.webp", "docs/hooks/*.css"),
    "notebooks/README.md",
    *("diffshadow/*/README.md", "configs/*.yaml", "experiments/engines/*.mjs"),
)
PACKAGE = "diffshadow"
# In the order of the site's navigation.
SUBPACKAGES = (
    *("geometry", "raster", "shadow", "shading", "reference", "metrics", "fit", "io", "config", "study", "settings"),
)
# Headings of the names that a page has from folders of its package, and from its modules (``).
GROUPS = {
    "diffshadow.shadow": {
        "": "Techniques and maps",
        "filters": "Filters",
        "biases": "Biases",
        "layouts": "Layouts",
        "patterns": "Sampling patterns",
        "engines": "Engines",
    },
}
# Packages with further public names, on the page of their parent.
FURTHER = {"diffshadow.shadow": ("diffshadow.shadow.kernels",)}
# Of a package: its docstring without the names in it.
_TEXT_ALONE = "members: false, show_root_heading: false, show_root_toc_entry: false"
_FENCES = re.compile(r"(^ *```.*?^ *```)", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"<pre>.*?</pre>", re.DOTALL)
_IMPORTS = re.compile(r"^(?:import .+|from \S+ import (?:\([^)]*\)|.+))\n?|^setup\(.*\n?", re.MULTILINE)
# Which a hit in the documentation's text explains better.
_SOURCE = re.compile(r"Source code in <code>.*", re.DOTALL)
# How much hits count on a page. Numbers to type come first; how things came about comes last.
BOOSTS = {
    "docs/rules_of_thumb.md": 2,
    "notebooks/": 0.5,
    "api/": 0.5,
    "ARCHITECTURE.md": 0.5,
    "CHANGELOG.md": 0.2,
    "docs/changes_in_detail.md": 0.1,
}
_FORMULAS = re.compile(r"\$\$(?P<block>.+?)\$\$|\$(?P<inline>[^$\n]+?)\$", re.DOTALL)


class NotebookFile(File):
    """A page that links reach by the notebook's own name."""

    def is_documentation_page(self) -> bool:
        return True


def public_names(module: str) -> dict[str, str]:
    """The names in a package's `__all__`, and the module that each comes from.

    A package without `__all__` has those that it imports as themselves. Names from elsewhere, which are types of
    settings, come last.
    """
    tree = ast.parse(ROOT.joinpath(*module.split("."), "__init__.py").read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    imports.sort(key=lambda node: node.level)
    public = next((ast.literal_eval(node.value) for node in tree.body if is_all(node)), None)
    return {
        alias.name: str(node.module)
        for node in imports
        for alias in node.names
        if (alias.asname is not None if public is None else alias.name in public)
    }


def is_all(node: ast.stmt) -> TypeGuard[ast.Assign]:
    return isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Replaces the files of `docs_dir` by all that the site has."""
    for file in [file for file in files if file.src_dir == config.docs_dir]:
        files.remove(file)
    for pattern in KEPT:
        for path in sorted(ROOT.glob(pattern)):
            files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        for file in notebook_files(path, config):
            files.append(file)
    files.append(File.generated(config, "api/README.md", content=reference_page(PACKAGE)))
    for package in SUBPACKAGES:
        content = reference_page(f"{PACKAGE}.{package}")
        files.append(File.generated(config, f"api/{package}.md", content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Doubles the indentation of nested lists, which Python-Markdown expects to be four spaces."""
    for start, boost in BOOSTS.items():
        if page.file.src_uri.startswith(start):
            page.meta["search"] = {"boost": boost}
    if page.file.src_uri.startswith("api/"):
        return markdown
    parts = _FENCES.split(markdown)
    parts[::2] = [re.sub(r"^( +)", r"\1\1", part, flags=re.MULTILINE) for part in parts[::2]]
    return "".join(parts)


@event_priority(-100)
def on_post_build(config: MkDocsConfig) -> None:
    """Puts the prose of each section before its code in the index of the search, after the plugin has written it.

    A hit is shown with the first words of its section. Imports say nothing about it and are left out.
    """
    path = Path(config.site_dir, "search", "search_index.json")
    index = json.loads(path.read_text(encoding="utf-8"))
    for section in index["docs"]:
        section["text"] = prose_first(section["text"])
    path.write_text(json.dumps(index, ensure_ascii=False, separators=(",", ":")), encoding="utf-8")


def prose_first(text: str) -> str:
    """The HTML of a section with its code at the end, without imports and without the source of what it documents."""
    text = _SOURCE.sub("", text)
    code = [_IMPORTS.sub("", block) for block in _CODE.findall(text.replace("<pre><code>", "<pre><code>\n"))]
    blocks = [block for block in code if re.sub("<[^>]*>", "", block).strip()]
    return "\n".join([_CODE.sub("", text).strip(), *blocks]).strip()


def notebook_files(path: Path, config: MkDocsConfig) -> list[File]:
    """The page of an executed notebook, and its pictures.

    A cell with the tag `hide-input` is folded. The picture of the cell with the tag `picture` also follows the first
    text, so that the page begins with what one gets.
    """
    name = path.relative_to(ROOT).as_posix()
    parts: list[str] = []
    pictures: list[File] = []
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "markdown":
            parts.append(_FORMULAS.sub(mathml, cell.source))
            continue
        tags = cell.metadata.get("tags", ())
        code = f"```python\n{cell.source}\n```"
        parts.append(folded("Imports and sizes", code) if "hide-input" in tags else code)
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{path.stem}_{len(pictures)}.png"
                content = base64.b64decode(data["image/png"])
                pictures.append(File.generated(config, f"notebooks/{picture}", content=content))
                parts.append(f"![Output of the cell]({picture})")
                if "picture" in tags:
                    parts.insert(1, f"![What this notebook draws]({picture})")
            elif "text/html" in data:
                parts.append(re.sub(r"<style.*?</style>|^\s+", "", data["text/html"], flags=re.DOTALL | re.MULTILINE))
            else:
                parts.append(f"```text\n{(output.get('text') or data['text/plain']).rstrip()}\n```")
    return [NotebookFile.generated(config, name, content="\n\n".join(parts) + "\n"), *pictures]


def folded(title: str, block: str) -> str:
    """A block that opens with a click, and that the search leaves out."""
    head = f'<details class="note" markdown data-search-exclude><summary>{title}</summary>'
    return f"{head}\n\n{block}\n\n</details>"


def mathml(formula: re.Match[str]) -> str:
    """MathML, which browsers draw without a script."""
    if formula["block"]:
        return f"\n\n<div>{convert(formula['block'], display='block')}</div>\n\n"
    return f"<span>{convert(formula['inline'])}</span>"


def reference_page(module: str) -> str:
    """The Markdown of a subpackage's page: each public name with signature, docstring and source."""
    parts = [f"# `{module}`", entry(module, _TEXT_ALONE)]
    names, groups = public_names(module), GROUPS.get(module, {"": ""})
    for folder, title in groups.items():
        within = [name for name in names if folder == (part if (part := names[name].split(".")[0]) in groups else "")]
        parts += [f"## {title}"] * bool(title)
        parts += [entry(f"{module}.{name}", f"heading_level: {3 if title else 2}") for name in within]
    for further in FURTHER.get(module, ()):
        parts += [
            f"## `{further}`",
            entry(further, _TEXT_ALONE),
        ]
        parts += [entry(f"{further}.{name}", "heading_level: 3") for name in public_names(further) if name not in names]
    if module == PACKAGE:
        parts += ["## Subpackages", "\n".join(f"- [`{PACKAGE}.{each}`]({each}.md)" for each in SUBPACKAGES)]
    return "\n\n".join(parts) + "\n"


def entry(path: str, options: str) -> str:
    """The lines that become the documentation of `path`."""
    return f"::: {path}\n    options: {{{options}}}"
