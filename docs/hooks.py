"""What the site (`mkdocs.yml`) needs beside the pages of docs/.

- Links from a page to a file that the site does not hold become the file's path in the repository.
- The boards' pages, which lie in the folders of their boards.
- Long names in tables, which may be broken behind a dot and the like: no table is wider than the page.
- One page per package with all its public names, made from the docstrings without importing the package.
"""

import os
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "cmfpga"
DOCS = "docs/"
# Pages that lie outside docs/, and their names in the site.
ELSEWHERE = {f"{name}.md": f"boards/{name}/README.md" for name in ("kv260", "ulx3s", "tang_primer_20k")}
SIGNS = re.compile(r"(?<=[._/,=|:\])-])(?=[^\s])")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")


def inside(markdown, source):
    """``markdown`` of the page ``source`` (a path in the repository), with links that the site can follow.

    Of a link to a file that the site does not hold, the text stays, with the file's path in the repository behind it
    unless the text names it already.
    """
    pages = {there: name for name, there in ELSEWHERE.items()}
    # Where the page lies in the site.
    here = os.path.dirname(pages.get(source, source.removeprefix(DOCS)))

    def replace(match):
        text, target, anchor = match[1], match[2], match[3] or ""
        path = os.path.normpath(os.path.join(os.path.dirname(source), target))
        page = pages.get(path, path.removeprefix(DOCS) if path.startswith(DOCS) else None)
        if page is not None:
            return f"[{text}]({os.path.relpath(page, here or '.')}{anchor})"
        return text if path in text else f"{text} (`{path}`)"

    return LINK.sub(replace, markdown)


def packages():
    """``{dotted name: [what mkdocstrings is asked for]}`` of every package; the first has the modules beside them."""
    inits = sorted(PACKAGE.rglob("__init__.py"))
    found = {}
    for init in inits:
        name = ".".join(init.parent.relative_to(PACKAGE.parent).parts)
        modules = sorted(file.stem for file in init.parent.glob("*.py") if not file.stem.startswith("_"))
        found[name] = [name, *(f"{name}.{module}" for module in modules)]
    return found


def names_page(name, modules):
    """Markdown of the page of one package; sub-packages have pages of their own."""
    parts = [f"::: {module}\n    options:\n      show_submodules: false\n" for module in modules]
    return f"# `{name}`\n\nMade from the docstrings.\n\n" + "\n".join(parts)


def on_config(config):
    config.nav.append({"Every public name": [{name: f"names/{name}.md"} for name in packages()]})
    return config


def on_files(files, config):
    for name, modules in packages().items():
        files.append(File.generated(config, f"names/{name}.md", content=names_page(name, modules)))
    for name, there in ELSEWHERE.items():
        files.append(File.generated(config, name, content=(ROOT / there).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown, page, **_):
    name = page.file.src_uri
    return markdown if name.startswith("names/") else inside(markdown, ELSEWHERE.get(name, DOCS + name))


def on_page_content(html, **_):
    return re.sub(r"<t([dh])[^>]*>.*?</t\1>", lambda cell: breakable(cell[0]), html, flags=re.DOTALL)


def breakable(cell):
    """A table's cell, in whose code a line may end behind these signs."""
    return re.sub(r"<code>([^<]*)</code>", lambda code: f"<code>{SIGNS.sub('<wbr>', code[1])}</code>", cell)
