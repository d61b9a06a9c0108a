"""The site of mkdocs.yml builds without a warning, and holds every page and every public name."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from support.board_files import load

ROOT = Path(__file__).parents[2]
for package in ("mkdocs", "material", "mkdocstrings"):
    pytest.importorskip(package, reason=f"the site needs {package}: pip install 'cmfpga[docs]'")

PAGES = [file.relative_to(ROOT / "docs").as_posix() for file in sorted((ROOT / "docs").rglob("*.md"))]
CONFIG = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


def build(config, site):
    """``(exit status, what was printed)``; a process of its own, so that its libraries' warnings are not ours."""
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", config, "--site-dir", site],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", timeout=300,
        env={**os.environ, "PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    return done.returncode, done.stdout


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    status, said = build(ROOT / "mkdocs.yml", folder)
    assert status == 0, said
    return folder


@pytest.fixture(scope="module")
def hooks():
    return load("hooks", ROOT / "docs")


def html(site, page):
    return (site / page).with_suffix(".html").read_text(encoding="utf-8")


def test_every_page_is_in_the_nav(site):
    listed = re.findall(r"([\w/-]+\.md)$", CONFIG[CONFIG.index("\nnav:") :], re.MULTILINE)
    assert sorted(listed) == sorted([*PAGES, "kv260.md", "tang_primer_20k.md", "ulx3s.md"])
    assert (site / "index.html").exists()
    start = html(site, "index.md")
    for page in listed:
        assert f'href="{page.removesuffix(".md")}.html"' in start, page


@pytest.mark.parametrize("page", PAGES)
def test_tables_and_lists_are_rendered(site, page):
    """What code hosts show as a table or a list is one here too."""
    shown = re.sub(r"<(pre|code)\b.*?</\1>", "", html(site, page), flags=re.DOTALL)
    assert not re.search(r"^(<p>)?\| ", shown, re.MULTILINE)
    assert not re.search(r"^(<p>)?(- |\d+\. )", shown, re.MULTILINE)
    source = re.sub(r"^```.*?^```", "", (ROOT / "docs" / page).read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    assert shown.count("<table>") == len(re.findall(r"^\|[ :|-]+\|$", source, re.MULTILINE))


def test_every_package_has_a_page_with_its_names(site, hooks):
    packages = hooks.packages()
    assert {"cmfpga", "cmfpga.rtl", "cmfpga.rtl.axi", "cmfpga.events"} <= set(packages)
    for package, modules in packages.items():
        text = html(site, f"names/{package}.x")
        for module in modules:
            assert f'id="{module}"' in text, module
        # What docstrings borrow from reStructuredText became Markdown.
        assert not re.search(r":(attr|class|data|exc|func|meth|mod):|``|::</p>", text), package
    assert 'id="cmfpga.rtl.image.warp.Warp"' in html(site, "names/cmfpga.rtl.image.x")
    assert 'id="cmfpga.config.Config"' in html(site, "names/cmfpga.config.x")


def test_links_out_of_the_pages(hooks):
    for source, given, made in (
        ("docs/a.md", "[words](../src/x.py)", "words (`src/x.py`)"),
        ("docs/a.md", "[`src/x.py`](../src/x.py#y)", "`src/x.py`"),
        ("docs/d/a.md", "[b](../b.md#c)", "[b](../b.md#c)"),
        ("docs/a.md", "[KV260](../boards/kv260/README.md)", "[KV260](kv260.md)"),
        ("boards/kv260/README.md", "[driver](../../docs/driver.md#x)", "[driver](driver.md#x)"),
        ("docs/a.md", "[x](#y) [z](https://a.b/c)", "[x](#y) [z](https://a.b/c)"),
    ):
        assert hooks.inside(given, source) == made


def test_nothing_is_loaded_from_elsewhere(site):
    for page in PAGES:
        assert not re.search(r'<(?:script|link|img)[^>]* (?:src|href)="(?:https?:)?//', html(site, page)), page


def test_no_table_is_wider_than_the_page(site, browser):
    """In a window of 1280 px no table has to be scrolled."""
    size = {"width": 1280, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    wide = """return [...document.querySelectorAll('article table')].filter(table =>
        [table, table.parentElement, table.parentElement.parentElement].some(one => one.scrollWidth > one.clientWidth)
    ).map(table => table.innerText.slice(0, 60))"""
    counted, found = 0, {}
    for page in PAGES:
        browser.get((site / page).with_suffix(".html").as_uri())
        counted += browser.execute_script("return document.querySelectorAll('article table').length")
        found |= {page: tables} if (tables := browser.execute_script(wide)) else {}
    assert counted > 50 and not found


def test_search_without_a_server(site, browser):
    """As a reader does who opens the pages from a folder."""
    browser.get((site / "index.html").as_uri())
    field = browser.find_element("css selector", "[data-md-component=search-query]")
    browser.execute_script("document.querySelector('#__search').click(); arguments[0].focus()", field)
    field.send_keys("undistort")
    found = "return [...document.querySelectorAll('.md-search-result__item a')].map(link => link.getAttribute('href'))"
    end = time.monotonic() + 30
    while not (links := browser.execute_script(found)):
        assert time.monotonic() < end, browser.get_log("browser")
        time.sleep(0.1)
    assert any("/names/cmfpga.config.html" in link for link in links), links


def test_a_broken_link_ends_the_build(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("# A\n\n[b](b.md)\n")
    config = tmp_path / "mkdocs.yml"
    config.write_text("site_name: a\n" + re.search(r"^validation:\n(  .*\n)+", CONFIG, re.MULTILINE)[0])
    status, said = build(config, tmp_path / "site")
    assert status != 0 and "b.md" in said
