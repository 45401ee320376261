"""Whether what belongs to many lanes is computed one lane after the other, or for all of them at once.

A CPU goes through the few lanes that have something to do, each with as much of its factor as is in use, and touches
no other. An accelerator has more units than a lane can use, and each operation costs it some microseconds, however
small it is: so it computes all lanes together, with whole factors, and keeps what was wanted. Both come to the same
numbers but for rounding.
"""

import jax


def together() -> bool:
    """Whether this process computes on an accelerator; asked when a program is traced."""
    return jax.default_backend() != "cpu"
