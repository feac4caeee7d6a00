"""The one exception for unusable input."""


class InputError(ValueError):
    """Unusable input: one line that says what is wrong, where, and what to do. The command line exits with status 2."""
