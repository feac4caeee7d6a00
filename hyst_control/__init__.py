"""hyst_control: identification, control and sim-to-real diagnosis of piezo stages and fast steering mirrors."""

import os

# The matrices here are small: BLAS threads only spin against each other and against the nodes of a running loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hyst_control import numba_cache  # before anything imports numba

numba_cache.prepare()
