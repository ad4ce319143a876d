"""Studies, requirements, campaigns, verdicts, evidence, and the command line `slewcert`."""

import os

THREADS = "OPENBLAS_NUM_THREADS"

# Read when NumPy is loaded. Matrices here are small and many: on a busy machine threads that share them wait for each other, some
# hundred times as long as they work. Who sets the variable has another wish.
os.environ.setdefault(THREADS, "1")
