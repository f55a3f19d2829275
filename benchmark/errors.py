"""The one exception that a user is meant to read."""


class InputError(Exception):
    """Bad input or wrong use: one sentence that says what is wrong, where, and what to do.

    The command line prints it without a traceback and exits with code 2. Anything else that escapes is a defect
    of this project and keeps its traceback.
    """

    def __str__(self) -> str:
        # Names of files may be bytes that are no text, and a sentence must be printable everywhere.
        return super().__str__().encode(errors="backslashreplace").decode()
