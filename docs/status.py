"""Table of what is known of each block, as far as tests say it by what they import and break."""

import ast
import importlib
import inspect
from pathlib import Path

from amaranth.hdl import Elaboratable, Fragment
from declared import table

from cmfpga.config import preset
from cmfpga.rtl.top import VerilogCore

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "cmfpga.rtl."


def _blocks():
    """Modules of ``cmfpga.rtl``, by their names in it, that declare hardware of their own."""
    found = []
    for path in sorted((ROOT / "src" / "cmfpga" / "rtl").rglob("*.py")):
        name = ".".join(path.relative_to(ROOT / "src").with_suffix("").parts)
        kinds = vars(importlib.import_module(name)).values()
        own = [kind for kind in kinds if inspect.isclass(kind) and kind.__module__ == name]
        if any(issubclass(kind, Elaboratable) and "elaborate" in vars(kind) for kind in own):
            found.append(name.removeprefix(PACKAGE))
    return found


def _modules(tree, blocks):
    """``{name in a file: block}`` of what the file imports of a block, or the block itself."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(PACKAGE):
            for alias in node.names:
                names = (name.removeprefix(PACKAGE) for name in (f"{node.module}.{alias.name}", node.module))
                if block := next((name for name in names if name in blocks), None):
                    found[alias.name] = block
    return found


def _trees(*patterns):
    """``[(path, parsed file)]`` of tests."""
    paths = sorted({path for pattern in patterns for path in (ROOT / "tests").glob(pattern)})
    return [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in paths]


def _mutants(blocks):
    """``{block: number}`` of entries in tests' tables ``MUTANTS``.

    An entry names the module that it breaks, or a module of the emitted text, whose last word is the block; or else the
    block is what the test's file is called after.
    """
    counts, stems = dict.fromkeys(blocks, 0), {name.rpartition(".")[2]: name for name in blocks}
    for path, tree in _trees("**/*.py"):
        known = _modules(tree, blocks)
        made = {node.name: node for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
        for node in ast.walk(tree):
            name = getattr(node.targets[0], "id", "") if isinstance(node, ast.Assign) else ""
            if name == "MUTANTS" or (name and path.stem == "mutants"):
                entries = node.value.values if isinstance(node.value, ast.Dict) else getattr(node.value, "elts", ())
                for entry in entries:
                    if block := _broken(entry, made, known, stems) or stems.get(path.stem.removeprefix("test_")):
                        counts[block] += 1
    return counts


def _broken(entry, made, known, stems):
    """The block that an entry breaks; ``made``: what its file defines, where a default may stand."""
    maker = made.get(getattr(getattr(entry, "func", None), "id", ""), ast.Pass())
    named = [known[part.id] for part in ast.walk(entry) if getattr(part, "id", "") in known]
    texts = [part.value for part in ast.walk(entry) if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    emitted = [stems[stem] for text in texts if " " not in text for stem in stems if text.endswith(stem)]
    default = [known[part.id] for part in ast.walk(maker) if getattr(part, "id", "") in known]
    return next(iter([*named, *sorted(emitted, key=len)[-1:], *default]), None)


def _placed():
    """Blocks of the cores whose clock and area are measured."""
    found = set()

    def walk(fragment):
        found.update(type(origin).__module__.removeprefix(PACKAGE) for origin in fragment.origins or ())
        for inner, *_ in fragment.subfragments:
            walk(inner)

    for name in ("fast", "paper"):
        walk(Fragment.get(VerilogCore(preset(name)), None))
    return found


def status_table():
    """A row a block: part of a proof, simulated by itself, number of mutants, placed."""
    blocks = _blocks()
    proved = {name for _, tree in _trees("**/*_proof.py") for name in _modules(tree, blocks).values()}
    alone = {
        name for path, tree in _trees("rtl/**/test_*.py") if "mutants" not in path.name
        for name in _modules(tree, blocks).values()
    }  # fmt: skip
    mutants, placed = _mutants(blocks), _placed()
    rows = [
        (f"`{name}`", *("✓" * (name in kind) for kind in (proved, alone)), mutants[name] or "", "✓" * (name in placed))
        for name in blocks
    ]
    made = table(("block", "proof", "alone", "mutants", "placed"), rows, right=(3,))
    return made.replace("| ", "|").replace(" |", "|")
