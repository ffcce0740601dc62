"""Shipped kernels: a wheel of a few is made, installed from a folder, loaded, and refused."""

import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

from benchmarks import pack
from rainsim import __version__
from rainsim.compiling import shipped
from rainsim.compiling.recorded import Recorded

HERE = sys.platform == "linux" and not set(shipped.FLAGS) - shipped._flags(shipped.CPU_INFO)
pytestmark = [
    pytest.mark.skipif(not HERE, reason="shipped kernels are for Linux on x86-64-v3 or above"),
    pytest.mark.skipif(
        os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="there are no kernels"
    ),
]
ROWS = {
    "rainsim.splatting.tiles:tile_starts": "int64[:, ::1]",
    "rainsim.water.tracks:wear": "float64[:, ::1], float32[:, ::1]",
    "made:triple": "int64",
}
MADE = """from rainsim.jit import serial_kernel

@serial_kernel
def triple(values):
    return 3 * values
"""
CALLS = """import importlib, json
import numpy as np
from rainsim.compiling import shipped
from rainsim.jit import KERNELS, processor

calls = {
    "rainsim.splatting.tiles:tile_starts": (np.array([[1, 2], [3, 4]]),),
    "rainsim.water.tracks:wear": (np.zeros((0, 8)), np.zeros((2, 3), np.float32)),
    "made:triple": (7,),
}
compiled, results = [], {}
for name, arguments in calls.items():
    importlib.import_module(name.partition(":")[0])
    found = KERNELS[name](*arguments)
    results[name] = [np.asarray(one).tolist() for one in (found, *arguments) if one is not None]
    compiled += [name] if sum(KERNELS[name].stats.cache_misses.values()) else []
print(json.dumps({
    "fault": shipped.FAULT, "compiled": compiled, "results": results, "processor": processor(),
}))
"""


class Environment:
    """A virtual environment that has the packages of this one, and the wheel from a folder."""

    def __init__(self, folder, wheels, root):
        venv.create(folder / "venv")
        self.python, self.site = folder / "venv" / "bin" / "python", None
        (self.site,) = (folder / "venv").glob("lib/python*/site-packages")
        (self.site / "those_here.pth").write_text("\n".join(filter(os.path.isdir, sys.path)))
        self._variables = {
            name: value
            for name, value in os.environ.items()
            if name not in (*shipped.PROCESSOR, shipped.VARIABLE)
        } | {
            "PYTHONPATH": os.pathsep.join([str(folder), str(root)]), "RAINSIM_CACHE": "off",
            "NUMBA_CACHE_DIR": str(folder / "cache"),
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-m", "pip", "--isolated", "--python", self.python, "install",
             "--no-index", "--no-deps", "--find-links", wheels, shipped.DISTRIBUTION],
            capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr

    def run(self, *words, code=0, **variables):
        """Return what a command of this environment's Python writes to standard output."""
        done = subprocess.run(
            [self.python, *words], env=self._variables | variables, capture_output=True, text=True
        )
        assert done.returncode == code, done.stderr[-3000:]
        return done.stdout

    def calls(self, **variables):
        """Return what is found when the kernels of `ROWS` are called."""
        return json.loads(self.run("-c", CALLS, **variables))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pack")
    (folder / "made.py").write_text(MADE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        entries = [Recorded(name, text, 1.0, "frames", ()) for name, text in ROWS.items()]
        pack.make(folder / "wheels", entries)
    return folder


@pytest.fixture(scope="module")
def installed(folder, root):
    return Environment(folder, folder / "wheels", root)


@pytest.fixture(autouse=True)
def of_the_level(monkeypatch):
    """Let this process, which has imported numba, count as one that compiles for the level."""
    for name, value in shipped.PROCESSOR.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv(shipped.VARIABLE, raising=False)


def test_the_wheel_names_what_it_is_tied_to(folder):
    (path,) = (folder / "wheels").iterdir()
    tag = f"cp3{sys.version_info.minor}"
    assert path.name == f"rainsim_kernels-{__version__}-{tag}-{tag}-linux_x86_64.whl"
    with zipfile.ZipFile(path) as wheel:
        names = wheel.namelist()
        metadata = wheel.read(f"rainsim_kernels-{__version__}.dist-info/METADATA").decode()
        manifest = json.loads(wheel.read("rainsim_kernels/manifest.json"))
        content = b"".join(wheel.read(name) for name in names)
    assert manifest["versions"] == shipped.versions()
    for name in (*shipped.COMPILERS, "rainsim"):
        assert f"Requires-Dist: {name}=={manifest['versions'][name]}\n" in metadata
    assert len(manifest["files"]) == 2 * len(ROWS) and not [n for n in names if n.endswith(".py")]
    assert manifest["NUMBA_CPU_NAME"] == "x86-64-v3" and "avx2" in manifest["flags"]
    assert b"# --- LINE" not in content  # numba's annotated sources stay behind


def test_installed_kernels_load_and_nothing_compiles(installed):
    found = installed.calls()
    assert found["fault"] is None and found["compiled"] == []
    assert found["processor"].split()[1:] == ["x86-64-v3"]
    assert found["results"]["made:triple"] == [21, 7]
    alone = installed.calls(RAINSIM_KERNELS="off")
    assert alone["compiled"] == list(ROWS) and alone["results"] == found["results"]
    assert alone["processor"].split()[1] != "x86-64-v3"
    other = installed.calls(NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert other["fault"] == "made for NUMBA_CPU_NAME=x86-64-v3, and it is set to 'generic'"
    assert other["compiled"] == list(ROWS) and other["processor"].split()[1] == "generic"


def test_numba_that_was_imported_before_compiles_for_this_machine(installed):
    code = (
        "import numba, os\nfrom rainsim.compiling import shipped\n"
        "print(shipped.FAULT, os.environ['RAINSIM_KERNELS'], 'NUMBA_CPU_NAME' in os.environ)"
    )
    assert installed.run("-c", code).startswith("numba was imported before rainsim: it compiles")
    assert installed.run("-c", code).endswith("off False\n")


def test_a_users_own_folders_are_not_looked_into(installed, folder):
    there = installed.site / shipped.FOLDER
    aside = there.rename(folder / "aside")
    try:
        (folder / shipped.FOLDER).symlink_to(aside)  # in a folder that PYTHONPATH names
        found = installed.calls()
        assert found["fault"] is None and found["processor"].split()[1] != "x86-64-v3"
    finally:
        (folder / shipped.FOLDER).unlink()
        aside.rename(there)


def test_a_changed_source_is_compiled_for_the_same_processor(installed, folder):
    (folder / "made.py").write_text(MADE.replace("3 * values", "4 * values"))
    try:
        found = installed.calls()
    finally:
        (folder / "made.py").write_text(MADE)
    assert found["compiled"] == ["made:triple"] and found["results"]["made:triple"] == [28, 7]
    assert found["fault"] is None and found["processor"].split()[1] == "x86-64-v3"


def test_a_file_with_another_hash_is_not_loaded_and_the_doctor_says_which(installed):
    place = installed.site / shipped.FOLDER
    line = json.loads(installed.run("-m", "rainsim", "doctor", "--json"))["kernels"]
    assert line["used"] and line["damaged"] == [] and "x86-64-v3" in line["processor"]
    assert not {name for name in ROWS} & set(line["changed"])
    (file,) = (place / "rainsim.water.tracks").glob("*.nbc")
    whole = file.read_bytes()
    # Changed on purpose: the digest within the file is right, the one of the manifest is not.
    from rainsim.compiling.checked_files import _digest

    changed = whole[32:] + b"\0"
    file.write_bytes(_digest(changed) + changed)
    try:
        found = json.loads(installed.run("-m", "rainsim", "doctor", "--json", code=1))
        assert found["kernels"]["damaged"] == [file.relative_to(place).as_posix()]
        assert "rainsim.water.tracks:wear" in found["kernels"]["changed"]
        assert any("1 file is damaged in rainsim-kernels" in line for line in found["wrong"])
        assert installed.calls()["compiled"] == ["rainsim.water.tracks:wear"]
    finally:
        file.write_bytes(whole)


def _changed(place, tmp_path, change):
    """Return what `find` makes of the installed package after a change of its manifest."""
    (tmp_path / shipped.FOLDER).mkdir()
    manifest = json.loads((place / shipped.FOLDER / shipped.MANIFEST).read_text())
    text = change(manifest)
    (tmp_path / shipped.FOLDER / shipped.MANIFEST).write_text(text or json.dumps(manifest))
    return shipped.find([tmp_path / "none", tmp_path])


@pytest.mark.parametrize("name", ["numba", "llvmlite", "numpy", "rainsim", "CPython"])
def test_other_versions_are_refused_by_name(installed, tmp_path, name):
    found, fault = _changed(installed.site, tmp_path, lambda m: m["versions"].update({name: "0.1"}))
    assert found is None
    assert fault == f"made for {name} 0.1, and {name} here is {shipped.versions()[name]}"


def test_a_damaged_manifest_is_refused(installed, tmp_path):
    found, fault = _changed(installed.site, tmp_path, lambda m: '{"versions": {')
    assert found is None and fault.startswith("damaged (manifest.json: JSONDecodeError")


def test_a_lower_processor_is_refused_by_what_it_lacks(installed, tmp_path):
    place = shipped.Pack(installed.site / shipped.FOLDER)
    info = tmp_path / "cpuinfo"
    flags = [flag for flag in shipped.FLAGS if flag not in ("avx2", "fma")]
    info.write_text("processor : 0\nflags : " + " ".join(flags) + "\n")
    assert place.fault(info) == "made for x86-64-v3, and this processor lacks avx2, fma"
    info.write_text("flags : " + " ".join(shipped.FLAGS) + " avx512f\n")
    assert place.fault(info) is None
    assert "lacks abm, avx" in place.fault(tmp_path / "none")


def test_a_pack_that_is_not_used_is_said_once_something_compiles(monkeypatch, capsys):
    from rainsim.commands.compile import compiled_beside
    from rainsim.commands.environment import _kernels_line
    from rainsim.commands.status import Status
    from rainsim.compiling import start

    monkeypatch.setattr(shipped, "FAULT", "made for numba 0.1, and numba here is 0.2")
    line = "rainsim-kernels is not used: made for numba 0.1, and numba here is 0.2"
    assert line in _kernels_line({"used": False, "why": shipped.FAULT})
    some = [Recorded("none:kernel", "int64", 1.0, "frames", ("drizzle",))]
    for lacking, said in (([], False), (some, True)):
        monkeypatch.setattr(start, "needed", lambda uses, lacking=lacking: lacking)
        monkeypatch.setattr(start, "processes", lambda most: 2)
        with compiled_beside(Status(), ["drizzle"]):
            pass
        assert (line in capsys.readouterr().err) == said


@pytest.mark.slow
def test_the_whole_pack_leaves_nothing_to_compile(root, tmp_path):
    subprocess.run(
        [sys.executable, "-m", "benchmarks.pack", "--out", tmp_path / "wheels"], check=True
    )
    (wheel,) = (tmp_path / "wheels").iterdir()
    print(f"{wheel.stat().st_size / 1e6:.1f} MB")
    assert wheel.stat().st_size < 6e6
    environment = Environment(tmp_path, tmp_path / "wheels", root)
    found = environment.run("-m", "rainsim", "doctor")
    assert "kernels    loaded from rainsim-kernels, for x86-64-v3\n" in found
    before = set(Path(tmp_path / "cache").rglob("*.nbi"))
    for preset in ("drizzle", "downpour", "flood"):
        environment.run(
            "-m", "rainsim", "run", "--preset", preset, "--width", "96", "--frames", "2",
            "--out", str(tmp_path / preset), "-q",
        )  # fmt: skip
    assert set(Path(tmp_path / "cache").rglob("*.nbi")) == before  # those of the doctor itself
