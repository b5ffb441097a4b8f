import os
import subprocess
import sys

import pytest

from benchmark.machine import ROOT, peak_mib, resident_mib


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has statm")
def test_the_peak_is_at_least_what_is_held_now():
    held = resident_mib(os.getpid())
    assert peak_mib() >= held > 10


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has VmHWM")
def test_the_peak_of_a_child_is_its_own():
    """ru_maxrss would be that of the parent, which holds 400 MiB here."""
    child = "from benchmark.machine import peak_mib; print(peak_mib())"
    parent = f"import subprocess, sys; held = b'x' * (400 << 20); subprocess.run([sys.executable, '-c', {child!r}])"
    done = subprocess.run([sys.executable, "-c", parent], cwd=ROOT, capture_output=True, text=True, check=True)
    assert 0 < float(done.stdout) < 300


def test_a_process_that_does_not_exist_holds_nothing():
    assert resident_mib(2**31 - 1) == 0.0
