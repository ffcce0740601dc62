"""Round trips through splat-transform, the converter that the README names, where it is there."""

import shutil
import subprocess

import numpy as np
import pytest

import made_formats as made
from made_formats import write_splats
from rainsim.scene.formats import read

PROGRAM = shutil.which("splat-transform")  # npm install -g @playcanvas/splat-transform
COUNT, OPAQUE = 600, 90
# Suffix, options: what the converter writes.
FORMATS = {
    "PLY": (".ply", ()),
    "compressed PLY": (".compressed.ply", ()),
    "SPZ 3": (".spz", ("--spz-version", "3")),
    "SPZ 4": (".spz", ("--spz-version", "4")),
    "glTF": (".glb", ()),
    "SOG": (".sog", ("--gpu", "cpu")),
    "SOG folder": ("/meta.json", ("--gpu", "cpu")),
}

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="splat-transform is not installed")


def convert(source, target, options=()):
    command = [PROGRAM, "--quiet", "--overwrite", *options, str(source), str(target)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and target.is_file(), done.stdout + done.stderr
    return target


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Splats of which every seventh is fully opaque, and their PLY."""
    splats = made.tame_splats(COUNT, 9)
    splats.opacity[: COUNT : COUNT // OPAQUE] = 1
    path = tmp_path_factory.mktemp("capture") / "capture.ply"
    write_splats(path, splats)
    return splats, path


def close(found, splats):
    """The same splats, perhaps in another order, to what bytes can hold."""
    assert len(found) == len(splats)
    apart = np.abs(found.position[:, None] - splats.position[None]).max(axis=2)
    match = apart.argmin(axis=1)
    assert len(set(match)) == len(splats)
    want = splats.take(match)
    np.testing.assert_allclose(found.position, want.position, atol=0.02)
    np.testing.assert_allclose(found.scale, want.scale, rtol=0.1)
    np.testing.assert_allclose(found.opacity, want.opacity, atol=0.02)
    assert np.abs(np.einsum("ni,ni->n", found.rotation, want.rotation)).min() > 0.99
    np.testing.assert_allclose(found.sh[:, 0], want.sh[:, 0], atol=0.05)
    assert np.corrcoef(found.sh[:, 1:].ravel(), want.sh[:, 1:].ravel())[0, 1] > 0.9
    made.check_arrays(found)


@pytest.mark.parametrize("kind", FORMATS)
def test_what_the_converter_writes_is_read_and_so_is_the_way_back(tmp_path, capture, kind):
    for module in ("gsply", "imagecodecs", "zstandard"):
        pytest.importorskip(module)
    splats, source = capture
    suffix, options = FORMATS[kind]
    there = tmp_path / f"there{suffix}"
    there.parent.mkdir(exist_ok=True)
    convert(source, there, options)
    reading = read(there)
    assert reading.broken == 0 and not reading.notes
    close(reading.splats, splats)
    if kind == "glTF":  # which the converter writes and does not read
        return
    back = read(convert(there, tmp_path / "back.ply"))
    assert back.broken == 0 and not back.notes
    close(back.splats, splats)
    assert np.count_nonzero(back.splats.opacity > 0.99) >= OPAQUE
