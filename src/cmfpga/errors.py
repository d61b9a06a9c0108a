"""Errors that are the user's to mend.

Everything that a person can get wrong (a file, an option, a value) raises one of these. The message is one
line: what is wrong, where, and what is allowed. The command lines print it and exit with status 2.
"""


class UserError(ValueError):
    """Base of all errors that a command line reports in one line, without a traceback."""


class ConfigError(UserError):
    """A configuration field, or a combination of fields, has a value that is not allowed."""


class RecordingError(UserError):
    """A recording is missing, unreadable, or holds events that cannot be used."""
