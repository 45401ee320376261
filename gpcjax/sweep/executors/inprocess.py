"""A sweep in this very process: for notebooks, debuggers and tests, where no worker is to be started. Loads no jax."""

from gpcjax.sweep.environment import refuse_another_environment
from gpcjax.sweep.executors.desk import Desk


class InProcess:
    """An executor with one worker, this thread. Rows are the same bits as those of worker processes.

    This holds where the process computes as workers do, with the variables of
    `gpcjax.sweep.environment.computing_environment()` set before numpy and jax were loaded; elsewhere it is refused.
    A signal is heard between two chunks of work, so not while XLA compiles.
    """

    jobs = 1

    def run(self, desk: Desk) -> None:
        """Returns when all is done.

        Raises:
            UserError: this process computes otherwise than workers do.
            Failure: the worker failed.
            Stopped: a signal came in, within `stopping.deferred`.
        """
        refuse_another_environment()
        from gpcjax.sweep.worker import work  # loads jax

        work(lambda message: desk.answer(0, message))
