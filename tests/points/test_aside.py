"""Arrays that wait in files where memory is bounded: the same values, out of memory until they are used."""

import errno
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from simulated.scenes import city
from support.processes import environment

from msbdb.detect.adaptive.bathurst import extract_adaptive
from msbdb.detect.area3d.caowu import extract_area3d
from msbdb.errors import FileError
from msbdb.grid import lattice
from msbdb.params import Params
from msbdb.points import aside
from msbdb.points.aside import let_go, set_aside
from msbdb.run.preparation.drafts import build_surface
from msbdb.surface import heights_above
from msbdb.threads import memory_reused

STATUS = Path("/proc/self/status")


@pytest.fixture
def bounded():
    """Bound the memory."""
    with memory_reused(bounded=True):
        yield


def test_arrays_stay_where_memory_is_not_bounded():
    """A build in one piece writes no files."""
    values = np.arange(aside.LEAST)
    assert set_aside(values) is values
    with memory_reused():
        assert set_aside(values) is values


@pytest.mark.usefixtures("bounded")
@pytest.mark.parametrize(
    "values", [np.arange(3e6).reshape(3, -1), np.arange(3e6).reshape(3, -1).T, np.ones(2**21, bool)]
)
def test_arrays_keep_their_values(values):
    """Of any dtype, shape and layout; small ones stay where they are."""
    found = set_aside(values)
    assert found is not values
    np.testing.assert_array_equal(found, values)
    let_go()
    np.testing.assert_array_equal(found, values)
    assert (found.dtype, found.flags.writeable) == (values.dtype, True)
    few = values.ravel()[:9]
    assert set_aside(few) is few


LEAVING = """
import numpy as np, re
from pathlib import Path
from msbdb.points.aside import let_go, set_aside
from msbdb.threads import memory_reused

def held_mib():
    return int(re.search(r"VmRSS:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024

with memory_reused(bounded=True):
    before = held_mib()
    found = set_aside(np.ones(2**23))
    assert held_mib() < before + 8
    assert found.sum() == 2**23
    assert held_mib() > before + 56
    let_go()
    assert held_mib() < before + 8
    assert found.sum() == 2**23
"""


@pytest.mark.skipif(not STATUS.exists(), reason="the memory of a process is read from /proc, which Linux has")
def test_arrays_leave_the_memory_until_they_are_used():
    """Sixty-four MiB are there when they are read, and gone when they are let go, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", LEAVING], env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.usefixtures("bounded")
def test_a_full_folder_of_temporary_files_is_named(monkeypatch):
    """The message says how much was to be written, where, and what to do."""

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    with pytest.raises(FileError, match=r"8 MiB could not be written .*No space left on device.*TMPDIR"):
        set_aside(np.ones(2**20))


@pytest.mark.parametrize("extract", [extract_area3d, extract_adaptive])
def test_detectors_find_the_same_with_their_points_in_files(extract, monkeypatch):
    """Labels, regions and ledger do not depend on where the arrays are, be they as small as they like."""
    cloud, params = city().points, Params()
    heights, spec = heights_above(cloud, build_surface(cloud, params).dtm), lattice(cloud.bounds, 0.5, cloud.crs)
    plain = extract(cloud, heights.copy(), spec=spec, survey="test", params=params)
    monkeypatch.setattr(aside, "LEAST", 1)
    with memory_reused(bounded=True):
        found = extract(cloud.aside(), heights, spec=spec, survey="test", params=params)
    assert len(found.regions)
    np.testing.assert_array_equal(found.labels, plain.labels)
    assert found.regions.equals(plain.regions)
    assert found.rejections.equals(plain.rejections)
    assert found.counts == plain.counts
