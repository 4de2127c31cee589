"""What is put off is the same when it comes, in whichever order and from whichever thread."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mountnav.start_up import HELD_BY

ASKED = """
import sys, threading
from mountnav.start_up import put_off_unused
put_off_unused()
put_off_unused()
"""


def _said(code: str) -> str:
    run = subprocess.run([sys.executable, "-c", ASKED + code], capture_output=True, text=True, check=True)
    return run.stdout


def test_a_name_comes_from_the_module_that_holds_it_and_the_package_stays_out() -> None:
    code = """
from scipy.special import betainc
from scipy.spatial import KDTree, cKDTree
from scipy import ndimage
ndimage.label
print(sorted({"scipy.special._orthogonal", "scipy.spatial._qhull", "scipy.linalg._basic"} & set(sys.modules)))
import scipy.special._ufuncs, scipy.spatial._kdtree, scipy.ndimage._measurements
print(betainc is scipy.special._ufuncs.betainc, KDTree is scipy.spatial._kdtree.KDTree)
print(ndimage.label is scipy.ndimage._measurements.label)
"""
    assert _said(code).split("\n")[:3] == ["[]", "True True", "True"]


def test_the_first_name_that_is_held_nowhere_brings_the_whole_package() -> None:
    code = """
import json, types, scipy.special, scipy.spatial, scipy.linalg, scipy.ndimage, scipy.sparse, numpy.testing
early = scipy.special.betainc
scipy.special.roots_legendre, scipy.spatial.ConvexHull, scipy.linalg.solve, scipy.sparse.csr_array
scipy.ndimage.fourier_shift, numpy.testing.assert_equal
packages = ["special", "spatial", "linalg", "ndimage", "sparse"]
names = [*(f"scipy.{own}" for own in packages), "numpy.testing"]
assert early is scipy.special.betainc
print(json.dumps({name: [type(sys.modules[name]) is types.ModuleType, len(sys.modules[name].__all__)]
                  for name in names}))
"""
    whole = json.loads(_said(code))
    for name, (plain, names) in whole.items():
        __import__(name)
        assert plain, name
        assert names == len(sys.modules[name].__all__), name
    assert {*HELD_BY} <= {*whole}


@pytest.mark.parametrize(
    "first", ["scipy.spatial.distance", "scipy.interpolate", "scipy.linalg.interpolative"]
)
def test_a_module_of_such_a_package_may_come_first(first: str) -> None:
    code = f"""
import {first}
from scipy.spatial import distance, ConvexHull
print(distance.euclidean([0.0], [2.0]))
"""
    assert _said(code) == "2.0\n"


def test_what_is_nowhere_is_an_attribute_error() -> None:
    code = """
import scipy.linalg
for _ in range(2):
    try:
        scipy.linalg.nothing_of_that_name
    except AttributeError as error:
        print(error)
"""
    assert _said(code) == 2 * "module 'scipy.linalg' has no attribute 'nothing_of_that_name'\n"


@pytest.mark.long
def test_threads_that_ask_at_once_get_the_same() -> None:
    code = """
import scipy.special, scipy.spatial, scipy.linalg, scipy.ndimage
found, gate = [], threading.Barrier(8)
asked = [(scipy.special, "roots_legendre"), (scipy.spatial, "ConvexHull"), (scipy.linalg, "solve"),
         (scipy.ndimage, "fourier_shift")]
def ask(first):
    gate.wait()
    for package, name in asked[first:] + asked[:first]:
        found.append((name, getattr(package, name)))
threads = [threading.Thread(target=ask, args=(n % 4,)) for n in range(8)]
for thread in threads: thread.start()
for thread in threads: thread.join(60)
print(len(found), len({name: value for name, value in found}), len(set(found)))
"""
    assert _said(code).split() == ["32", "4", "4"]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="page faults are counted by Linux' /proc")
def test_arrays_are_made_in_memory_that_was_used_before() -> None:
    """What is freed is used again: hardly a page of the second to tenth array has to be cleared."""
    program = """
import resource
import numpy as np
from mountnav.start_up import keep_memory
keep_memory()
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(9):
        held = [np.ones(25_000_000, np.uint8) for _ in range(3)]
        del held
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
print(faults())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    pages = 25_000_000 // 4096
    assert int(done.stdout) < pages
