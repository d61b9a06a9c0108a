"""Modules broken on purpose: one replacement in the source, which tests must notice."""

import inspect
import types


def mutated(original, old, new):
    """The module ``original`` with ``old``, which stands in it once, replaced.

    Fails where the source has changed so that the mutant means nothing any more.
    """
    source = inspect.getsource(original)
    assert source.count(old) == 1, f"the pattern occurs {source.count(old)} times in {original.__name__}: {old}"
    mutant = types.ModuleType(original.__name__)
    mutant.__package__ = original.__package__
    exec(compile(source.replace(old, new), f"<{original.__name__}: {new}>", "exec"), mutant.__dict__)
    return mutant


def methods_of(mutant, kind):
    """``{name: function}`` of the mutant's class of that name; what is made before elaboration stays as it was."""
    own = vars(getattr(mutant, kind)).items()
    return {name: value for name, value in own if inspect.isfunction(value) and name != "__init__"}


def break_blocks(monkeypatch, original, old, new):
    """Give the classes of the module ``original`` the methods of its mutant."""
    mutant = mutated(original, old, new)
    for name, kind in vars(mutant).items():
        if inspect.isclass(kind) and kind.__module__ == mutant.__name__:
            for key, value in methods_of(mutant, name).items():
                monkeypatch.setattr(getattr(original, name), key, value)
