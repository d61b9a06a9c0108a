"""A page as one HTML file: a template, filled in; data in base64."""

import base64
import html
import importlib.resources
import json
import math
import re
import zlib


def fill(body, head, blob, *, one, title, lead, notes, scripts, **parts):
    """A page's text, with controls to choose ``one`` of what it shows: ``{{name}}`` in it replaced by ``parts[name]``.

    The file ``body`` has what is below the controls; ``scripts`` come after that of all pages. ``{{head}}`` becomes
    what :mod:`json` makes of ``head``, and ``{{blob}}`` the bytes of ``blob``, deflated, in base64.
    """
    page = asset("frame.html").replace("{{body}}", asset(f"{body}.html"))
    parts |= {"one": one, "One": one.capitalize(), "title": html.escape(title), "lead": html.escape(lead)}
    parts["notes"] = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    parts["style"], parts["script"] = asset("frame.css"), "\n".join(map(asset, ("frame.js", *scripts)))
    # In a script element only "</" and "<!--" have a meaning.
    parts["head"] = json.dumps(head, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    parts["blob"] = base64.b64encode(zlib.compress(blob, 6)).decode()
    return re.sub(r"\{\{(\w+)\}\}", lambda name: parts[name[1]], page)


def asset(name):
    """The text of a file beside this one."""
    return importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def plain(value):
    """A number as JSON can hold it, with six digits behind the point; None of what is no number."""
    return None if value is None or not math.isfinite(value) else round(float(value), 6)


def shown_name(recording):
    """A file's name; signs that cannot be shown as ``?``."""
    name = recording.encode("utf-8", "replace").decode()
    return "".join(sign if sign.isprintable() else "?" for sign in name)
