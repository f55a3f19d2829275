"""The one exception that a user is meant to read."""


class InputError(Exception):
    """Bad input or wrong use: one sentence that says what is wrong, where, and what to do.

    The command line prints it without a traceback and exits with code 2. Anything else that escapes is a defect
    of this project and keeps its traceback.
    """
