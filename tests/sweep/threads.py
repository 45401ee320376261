"""The example of docs/extending.md: an executor of one's own, whose workers are threads of this process."""

from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

from gpcjax.sweep.environment import refuse_another_environment
from gpcjax.sweep.executors import Desk

LOOK_SECONDS = 0.5


class Threads:
    """So many threads at once. XLA computes outside Python's lock, so they do not wait for each other."""

    def __init__(self, jobs: int):
        self.jobs = jobs

    def run(self, desk: Desk) -> None:
        """Returns when all is done; a worker's error, or a signal, ends the others at their next word."""
        refuse_another_environment()
        from gpcjax.sweep.worker import work

        failed = False

        def serve(worker: int) -> None:
            def say(message):
                if failed:
                    raise RuntimeError("another worker has failed")
                return desk.answer(worker, message)

            work(say)

        with ThreadPoolExecutor(desk.workers) as pool:
            running = [pool.submit(serve, worker) for worker in range(desk.workers)]
            try:
                while (rest := wait(running, LOOK_SECONDS, FIRST_EXCEPTION)).not_done:
                    for done in rest.done:
                        done.result()
                    desk.look()
            except BaseException:
                failed = True
                raise
        for done in running:
            done.result()
