"""Makes Markdown of what our docstrings borrow from reStructuredText, for the pages of public names (`mkdocs.yml`)."""

import re

import griffe


def markdown(text):
    """Roles become code, ``::`` a colon, and the members of a component attributes, which the reader knows."""
    text = re.sub(r":(?:py:)?[a-z]+:`~?([^`]+)`", r"`\1`", text)
    # What follows `name : `, and what is returned, is shown as code anyway.
    text = re.sub(
        r"^(?:[\w*, ]+ : |(?:Returns|Yields)\n-+\n).+$",
        lambda type_: type_[0].replace("`", ""),
        text,
        flags=re.MULTILINE,
    )
    text = re.sub(r"::$", ":", text, flags=re.MULTILINE)
    return re.sub(r"^Members\n-{3,}$", "Attributes\n----------", text, flags=re.MULTILINE)


class Markdown(griffe.Extension):
    """Runs :func:`markdown` over every docstring."""

    def on_object(self, *, obj, **_):
        if obj.docstring:
            obj.docstring.value = markdown(obj.docstring.value)
