"""Run folders as a sweep makes them, without a sweep."""

from gpcjax.sweep.layout import FORMAT
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.plan import count, specification_hash, varying
from gpcjax.sweep.spec import as_dict

VERSIONS = {"gpcjax": "0.1.0", "jax": "0.10.2"}


def manifest_of(spec, **changes):
    """What the manifest of a sweep says before its first row."""
    return {
        "format": FORMAT,
        "hash": specification_hash(spec),
        "specification": as_dict(spec),
        "varying": varying(spec),
        "cells": count(spec),
        "baselines": {"idle": None, "oracles": {}},
        "versions": VERSIONS,
        "machine": {},
        **dict.fromkeys(("jobs", "wall_time_s", "compile_time_s", "env_steps", "env_steps_per_s"), 0),
        "complete": False,
        **changes,
    }


def begun(out, spec, **changes):
    """The run folder of a sweep before its first row."""
    out.mkdir(parents=True, exist_ok=True)
    write_manifest(out, manifest_of(spec, **changes))
    return out
