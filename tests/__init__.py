"""One thread and the options of a sweep's workers, said before jax or numpy is loaded.

jaxlib's batched Cholesky can wait for ever on an XLA pool of several threads, and OpenBLAS's threads wait for each
other so long on a busy machine that one factor of 128 points takes a tenth of a second.
"""

import os

from gpcjax.sweep.environment import computing_environment

os.environ.update(computing_environment())
