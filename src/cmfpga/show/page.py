"""A page as one HTML file: a template, filled in; data in base64."""

import base64
import importlib.resources
import json
import re


def fill(body, parts, head, blob, *, one):
    """A page's text, with controls to choose ``one`` of what it shows: ``{{name}}`` in it replaced by ``parts[name]``.

    ``body`` is what is below the controls; style and script come after those of all pages. ``{{head}}`` becomes what
    :mod:`json` makes of ``head``, and ``{{blob}}`` the bytes of ``blob`` in base64.
    """
    page = asset("frame.html").replace("{{body}}", body)
    parts["style"] = asset("frame.css")
    parts["script"] = asset("frame.js") + "\n" + parts["script"]
    # In a script element only "</" and "<!--" have a meaning.
    text = json.dumps(head, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = {**parts, "one": one, "One": one.capitalize(), "head": text, "blob": base64.b64encode(blob).decode()}
    return re.sub(r"\{\{(\w+)\}\}", lambda name: parts[name[1]], page)


def asset(name):
    """The text of a file beside this one."""
    return importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def shown_name(recording):
    """A file's name; signs that cannot be shown as ``?``."""
    name = recording.encode("utf-8", "replace").decode()
    return "".join(sign if sign.isprintable() else "?" for sign in name)
