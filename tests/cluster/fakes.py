"""A Ray without Ray: actors are objects of a script, whose calls come back at once or never."""

import pickle
from concurrent.futures import Future
from types import SimpleNamespace

from gpcjax.sweep.executors.remote import Place, place

HERE = place()
NEVER = object()
"""What a call comes to that does not come back: its actor waits for a machine."""


def there(name="elsewhere", **changes):
    """A place like this one, but for these fields."""
    return Place(**{**vars(HERE), "name": name, **changes})


class Reference:
    """Of a call: an error is raised where its result is asked for."""

    def __init__(self, result):
        self._future = Future()
        if isinstance(result, Exception):
            self._future.set_exception(result)
        elif result is not NEVER:
            self._future.set_result(result)

    def future(self):
        return self._future


class FakeRay:
    """`hire(number of the actor)` makes each actor: an object with `begin` and `hear(message or None, archives)`."""

    def __init__(self, hire):
        self._hire, self.actors, self.killed = hire, [], []

    def put(self, thing):
        return thing

    def remote(self, kind):
        return self

    def options(self, **options):
        assert options["num_cpus"] == 1 and options["max_restarts"] == 0
        return SimpleNamespace(remote=self._made)

    def wait(self, references, **options):
        return references, []

    def kill(self, actor):
        self.killed.append(actor.script)

    def _made(self):
        script = self._hire(len(self.actors))
        self.actors.append(script)

        def called(method):
            def call(*arguments):
                try:
                    return Reference(method(*arguments))
                except Exception as error:
                    return Reference(error)

            return SimpleNamespace(remote=call)

        def hear(given):
            answer, archives = (None, {}) if given is None else pickle.loads(given)
            said = script.hear(answer, archives)
            return said if said is NEVER else pickle.dumps(said)

        return SimpleNamespace(
            script=script,
            begin=called(lambda parcel, patience: script.begin()),
            hear=called(hear),
            close=called(lambda: None),
        )
