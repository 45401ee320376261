"""What ends a command in one line: a person's mistake, or a run that failed without one."""


class UserError(ValueError):
    """A request that cannot be met as it was made.

    Its message is one sentence that names the value (or the file and key) and what is allowed. The command line
    prints it as one line and ends with status 2.
    """


class Failure(RuntimeError):
    """A run that ended for a reason of the machine or of ours: what was finished is kept.

    Its message is one sentence that names the reason. The command line prints it as one line and ends with status 1.
    """

    def __init__(self, message: str, details: str = ""):
        super().__init__(message)
        self.details = details
        """The full text of an error that is no fault of the machine, a traceback; else empty."""
