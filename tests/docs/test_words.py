"""The documentation is read once: how many words and pages it has, how long its sentences are; links lead somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
README = DOCS.parent / "README.md"
PAGES = sorted(DOCS.glob("*.md"))
EVERY = [
    *(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING", "SECURITY")),
    *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "boards").rglob("*.md")),
]  # fmt: skip
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
PATH = re.compile(r"`((?:src|tests|docs|boards|sim)/[\w./-]+)`")


def sentences(text):
    """Sentences of the prose: neither code, tables nor headings; an item of a list is one at least."""
    text = re.sub(r"^```.*?^```$|!\[[^]]*\]\([^)]*\)", "\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^(?: {4}|[|#<]).*$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    blocks = re.split(r"\n\s*\n|^\s*(?:[-*]|\d+\.) ", text, flags=re.MULTILINE)
    found = (re.split(r"(?<=[.!?])(?:\*\*|[)\]])?\s+", block.strip()) for block in blocks)
    return [one for block in found for one in block if re.search(r"\w", one)]


def words(sentence):
    return len([word for word in sentence.split() if re.search(r"\w", word)])


def test_sentences_are_found():
    prose = "One two. Three [four five](x.md#y)?\n\n- **Six.** Seven\n  eight; nine.\n"
    text = f"# A b c\n\n{prose}\n| no | no |\n\n```sh\nno\n```\n"
    assert [words(one) for one in sentences(text)] == [2, 3, 1, 3]


def test_the_whole_is_short():
    assert len(PAGES) <= 20
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in PAGES) <= 35_000  # as `wc -w` counts


def test_the_readme_is_short():
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150 and len(text.split()) <= 1000


@pytest.mark.parametrize("page", [README, *PAGES], ids=lambda page: page.stem)
def test_sentences_are_short(page):
    found = sentences(page.read_text(encoding="utf-8"))
    assert not [one for one in found if words(one) > 35]
    assert sum(map(words, found)) / len(found) <= 20


def anchors(page):
    """Anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", EVERY, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_paths(page):
    text = page.read_text(encoding="utf-8")
    for path in PATH.findall(text):
        assert (ROOT / path).exists(), f"{path}: no such file"
    for target in LINK.findall(text):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), f"{target}: no such file"
        assert not anchor or anchor in anchors(file), f"{target}: no such heading"


def test_decisions_are_short_and_alike():
    pages = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    assert [int(page.name[:4]) for page in pages] == list(range(1, len(pages) + 1))
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert len(text.splitlines()) <= 25, page.name
        for part in ("**Context.**", "**Decision.**", "**Consequence.**"):
            assert text.count(part) == 1, f"{page.name}: {part}"


def test_pictures_are_small():
    for picture in (ROOT / "docs" / "images").iterdir():
        assert picture.stat().st_size < 300_000, picture.name
