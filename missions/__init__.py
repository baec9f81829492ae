"""The programs that a person starts: the command line, the role programs, reports and checks.

Linear algebra runs in one thread: matrices are small, and OpenBLAS's threads wait for each other by
spinning. Where other programs need the cores too, a system of 160 unknowns took 200 times as long
with two of them as with one.
"""

import os

# read when numpy is loaded; inherited by programs that are started
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
