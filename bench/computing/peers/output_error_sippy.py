"""sippy_unipi, in a Python that has it: the output error fit of data.txt (u, y); writes sippy.txt."""

import time
from pathlib import Path

import numpy as np
import sippy_unipi

u, y = np.loadtxt("data.txt").T
seconds = []
for _ in range(3):
    before = time.process_time()
    model = sippy_unipi.system_identification(y, u, "OE", OE_orders=[2, 2, 0], OE_mod="OPT")
    seconds.append(time.process_time() - before)
below, above = np.ravel(model.DENOMINATOR), np.ravel(model.NUMERATOR)
Path("sippy.txt").write_text(" ".join(map(repr, [*below[1:3].tolist(), *above[:2].tolist(), min(seconds)])))
