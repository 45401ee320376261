"""Teach continuous controllers by corrective advice: GPC, GPC-NS and COACH, batched on JAX.

    learner = gpcjax.make_learner("gpc", "cartpole")
    state = learner.init()
    action = learner.act(state, obs)  # obs (4,) -> (1,), in [-1, 1]
    state, info = learner.correct(state, obs, action, [1.0])  # "more"; -1 is "less", 0 no advice

| To                         | there are                                                                       |
|----------------------------|---------------------------------------------------------------------------------|
| make something by its name | `make_learner`, `make_env`, `make_expert`, `make_oracle`, `gym_env`, `brax_env` |
| know the names             | `learner_names`, `env_names`, `expert_names`, `teacher_names`                   |
| teach in one's own program | `Session`, or the methods of a `Learner` with `Info`, `Status`; `evaluate`      |
| keep what was learned      | `save_policy`, `load_policy`, `export_policy`, `save_learner`, `load_learner`   |
| run many, and read them    | `run_sweep`, `load`, `load_corrections`, `load_policies`, `load_states`         |
| see what came of it        | `draw_report`, `compare`                                                        |
| search hyperparameters     | `run_tuning`                                                                    |
| write a task               | `Env` with its `State`, `HostEnv`, `parameter`                                  |
| write a learner, a teacher | `Learner`, `Controller`; `Teacher`, `Moment`, `Oracle`                          |
| describe one               | `TaskSpec`, `View`, `Control`; `LearnerSpec`, `TeacherSpec`, `Column`,           |
|                            | `Setting` with its `Numbers` or `OneOf`                                         |

`import gpcjax` itself loads no jax: a public name loads what it needs when it is first used, and the first one
switches jax to float64. `load_policy` loads no jax either; float64 is on there as soon as anything imports it.
"""

__version__ = "0.2.0"

_PUBLIC = {
    "Column": "gpcjax.describe:Column",
    "Controller": "gpcjax.policies.base:Controller",
    "Env": "gpcjax.envs.base:Env",
    "HostEnv": "gpcjax.envs.host:HostEnv",
    "Info": "gpcjax.learners.base:Info",
    "Learner": "gpcjax.learners.base:Learner",
    "LearnerSpec": "gpcjax.describe:LearnerSpec",
    "Moment": "gpcjax.moment:Moment",
    "Numbers": "gpcjax.allowed:Numbers",
    "OneOf": "gpcjax.allowed:OneOf",
    "Oracle": "gpcjax.teachers.oracle:Oracle",
    "Session": "gpcjax.engine.session:Session",
    "Setting": "gpcjax.describe:Setting",
    "State": "gpcjax.envs.base:State",
    "Status": "gpcjax.learners.base:Status",
    "TaskSpec": "gpcjax.describe:TaskSpec",
    "Teacher": "gpcjax.teachers.base:Teacher",
    "TeacherSpec": "gpcjax.describe:TeacherSpec",
    "Control": "gpcjax.describe:Control",
    "View": "gpcjax.describe:View",
    "brax_env": "gpcjax.envs.brax_adapter:brax_env",
    "compare": "gpcjax.report.compare:compare",
    "draw_report": "gpcjax.report.run:draw",
    "env_names": "gpcjax.envs.registry:env_names",
    "evaluate": "gpcjax.engine.evaluate:evaluate",
    "expert_names": "gpcjax.envs.registry:expert_names",
    "load": "gpcjax.sweep.reading:load",
    "load_corrections": "gpcjax.sweep.reading:load_corrections",
    "load_policies": "gpcjax.sweep.learned:load_policies",
    "load_states": "gpcjax.sweep.learned:load_states",
    "load_learner": "gpcjax.learners.saved:load_learner",
    "export_policy": "gpcjax.deploy.export:export_policy",
    "gym_env": "gpcjax.envs.host:gym_env",
    "learner_names": "gpcjax.registry:learner_names",
    "load_policy": "gpcjax.policies.saved:load_policy",
    "make_env": "gpcjax.envs.registry:make_env",
    "make_expert": "gpcjax.envs.registry:make_expert",
    "make_learner": "gpcjax.learners.factory:make_learner",
    "make_oracle": "gpcjax.sweep.build:make_oracle",
    "parameter": "gpcjax.envs.base:parameter",
    "run_sweep": "gpcjax.sweep.run:sweep",
    "run_tuning": "gpcjax.tune.run:tune",
    "save_learner": "gpcjax.learners.saved:save_learner",
    "save_policy": "gpcjax.learners.saved:save_policy",
    "teacher_names": "gpcjax.registry:teacher_names",
}
"""Public name -> where it lives. None is the name of a subpackage: importing one would hide it."""

_WITHOUT_JAX = {"load_policy", "export_policy"}
"""Names that need no jax: a program that only acts starts in a fraction of the time."""

__all__ = [  # noqa: RUF022  (the order of the interface)
    "make_learner",
    "make_env",
    "make_expert",
    "make_oracle",
    "env_names",
    "expert_names",
    "evaluate",
    "save_policy",
    "load_policy",
    "export_policy",
    "save_learner",
    "load_learner",
    "run_sweep",
    "run_tuning",
    "draw_report",
    "compare",
    "load",
    "load_corrections",
    "load_policies",
    "load_states",
    "learner_names",
    "teacher_names",
    "Env",
    "State",
    "HostEnv",
    "brax_env",
    "gym_env",
    "parameter",
    "Learner",
    "Session",
    "Moment",
    "Info",
    "Status",
    "Controller",
    "Teacher",
    "Oracle",
    "TaskSpec",
    "LearnerSpec",
    "TeacherSpec",
    "Setting",
    "Numbers",
    "OneOf",
    "Column",
    "View",
    "Control",
]

TYPE_CHECKING = False  # type checkers know it by this name; importing typing takes a command's first moments
if TYPE_CHECKING:
    from gpcjax.allowed import Numbers, OneOf
    from gpcjax.deploy.export import export_policy
    from gpcjax.describe import Column, Control, LearnerSpec, Setting, TaskSpec, TeacherSpec, View
    from gpcjax.engine.evaluate import evaluate
    from gpcjax.engine.session import Session
    from gpcjax.envs.base import Env, State, parameter
    from gpcjax.envs.brax_adapter import brax_env
    from gpcjax.envs.host import HostEnv, gym_env
    from gpcjax.envs.registry import env_names, expert_names, make_env, make_expert
    from gpcjax.learners.base import Info, Learner, Status
    from gpcjax.learners.factory import make_learner
    from gpcjax.learners.saved import load_learner, save_learner, save_policy
    from gpcjax.moment import Moment
    from gpcjax.policies.base import Controller
    from gpcjax.policies.saved import load_policy
    from gpcjax.registry import learner_names, teacher_names
    from gpcjax.report.compare import compare
    from gpcjax.report.run import draw as draw_report
    from gpcjax.sweep.build import make_oracle
    from gpcjax.sweep.learned import load_policies, load_states
    from gpcjax.sweep.reading import load, load_corrections
    from gpcjax.sweep.run import sweep as run_sweep
    from gpcjax.teachers.base import Teacher
    from gpcjax.teachers.oracle import Oracle
    from gpcjax.tune.run import tune as run_tuning


def __getattr__(name: str) -> object:
    """Resolve a public name at its first use (PEP 562)."""
    from importlib import import_module

    if name not in _PUBLIC:
        raise AttributeError(f"module 'gpcjax' has no attribute {name!r}")
    if name not in _WITHOUT_JAX:
        import_module("gpcjax._x64")
    module, _, attribute = _PUBLIC[name].partition(":")
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", "__doc__", "__name__", "__path__"})
