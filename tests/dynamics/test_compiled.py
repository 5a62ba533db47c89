"""Compiled functions: what a later process does without."""

import os
import subprocess
import sys

SMOOTHED = """
import sys
import numpy as np
from rotorfit.dynamics.first_order_low_pass import first_order_low_pass
print(first_order_low_pass(np.array([1.0, 0.0, 4.0]), 0.5), "numba.np.arraymath" in sys.modules)
"""


def test_a_later_process_reads_the_code_without_the_compiler(tmp_path):
    def process():
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        return subprocess.check_output([sys.executable, "-c", SMOOTHED], env=environment, text=True).strip()

    assert [process(), process()] == ["[0.5   0.25  2.125] True", "[0.5   0.25  2.125] False"]
