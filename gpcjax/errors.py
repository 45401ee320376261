"""The one exception of a person's mistake."""


class UserError(ValueError):
    """A request that cannot be met as it was made.

    Its message is one sentence that names the value (or the file and key) and what is allowed. The command line
    prints it as one line and ends with status 2.
    """
