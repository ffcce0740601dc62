"""Make the wheel rainsim-kernels: `python -m benchmarks.pack --out FOLDER`.

It holds the machine code of the recorded kernels, compiled for `shipped.PROCESSOR`, and a manifest
of what it was made for; no code of Python. `rainsim/compiling/shipped.py` loads it. With
`--cuda 9.0` it also holds those of GPUs of that compute capability: numba-cuda must be installed, a
GPU is not needed.
"""

import argparse
import base64
import hashlib
import json
import os
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

from rainsim import __version__
from rainsim.compiling import gpu, shipped
from rainsim.compiling.folder import NAME
from rainsim.compiling.pool import Pool, processes
from rainsim.compiling.recorded import SORT, needed, on_gpu
from rainsim.compiling.uses import ALL, ALL_CUDA

METADATA = """Metadata-Version: 2.1
Name: {name}
Version: {version}
Summary: Compiled kernels of rainsim {version} for {processor}
License: Apache-2.0
Requires-Python: =={python}.*
Requires-Dist: rainsim=={version}
{requires}
"""
WHEEL = """Wheel-Version: 1.0
Generator: rainsim {version}
Root-Is-Purelib: false
Tag: {tag}
"""
EPOCH = (1980, 1, 1, 0, 0, 0)  # of all files: a wheel's bytes do not depend on the day


def make(out, entries, progress=None, capabilities=()):
    """Compile recorded kernels and write them as a wheel.

    Parameters
    ----------
    out : path-like
        The wheel's folder, which is created.
    entries : list of Recorded
        Those of the GPU count if there are capabilities.
    progress : callable, optional
        As for `Pool`.
    capabilities : sequence of str
        Compute capabilities that the kernels of the GPU are compiled for.

    Returns
    -------
    Path
        Of the wheel.

    Raises
    ------
    RuntimeError
        If the list is out of date, or a kernel could not be compiled.
    """
    with tempfile.TemporaryDirectory() as work:
        # Without Intel's library of vector functions, which a user may not have.
        own = {"NUMBA_CACHE_DIR": work, "NUMBA_DISABLE_INTEL_SVML": "1"}
        own |= shipped.PROCESSOR | {shipped.VARIABLE: shipped.OFF}
        _compile([entry for entry in entries if not on_gpu(entry)], progress, own)
        for one in capabilities:
            device = own | {gpu.CAPABILITY: one}
            _compile([entry for entry in entries if on_gpu(entry)], progress, device)
        place = Path(work) / NAME
        files = {
            file.relative_to(place).as_posix(): file.read_bytes()
            for file in sorted(place.glob("*/*.nb[ic]"))
        }
    return _write_wheel(Path(out), files, capabilities)


def _compile(entries, progress, environment):
    with Pool(entries, processes(), progress, environment) as pool:
        pool.join()
    if pool.stale or pool.compiled < len(entries):
        why = pool.stale[0] if pool.stale else "a process that compiles has ended"
        raise RuntimeError(f"{pool.compiled} of {len(entries)} kernels were compiled: {why}")


def _write_wheel(out, files, capabilities):
    """Write the wheel of some files, by name; return its path."""
    versions = shipped.versions()
    manifest = {
        "versions": versions, **shipped.PROCESSOR, "flags": shipped.FLAGS,
        "cuda": {one: gpu.versions(one) for one in capabilities},
        "files": {name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
    }  # fmt: skip
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    tag = f"{python}-{python}-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
    stem = f"{shipped.FOLDER}-{__version__}"
    words = {
        "name": shipped.DISTRIBUTION, "version": __version__, "tag": tag,
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "processor": shipped.PROCESSOR["NUMBA_CPU_NAME"],
        "requires": "\n".join(f"Requires-Dist: {n}=={versions[n]}" for n in shipped.COMPILERS),
    }  # fmt: skip
    content = {f"{shipped.FOLDER}/{name}": data for name, data in files.items()}
    content[f"{shipped.FOLDER}/{shipped.MANIFEST}"] = json.dumps(manifest, indent=1).encode()
    content[f"{stem}.dist-info/METADATA"] = METADATA.format(**words).encode()
    content[f"{stem}.dist-info/WHEEL"] = WHEEL.format(**words).encode()
    record = f"{stem}.dist-info/RECORD"
    rows = [f"{name},sha256={_digest(data)},{len(data)}" for name, data in content.items()]
    content[record] = "\n".join([*rows, f"{record},,", ""]).encode()
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{stem}-{tag}.whl"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as wheel:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.external_attr = 0o644 << 16
            wheel.writestr(entry, data, zipfile.ZIP_DEFLATED, 9)
    return path


def _digest(content):
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")


def _progress(share, done, total, count):
    if sys.stderr.isatty() or done == total:
        print(f"\rcompiled {done}/{total}", end="\n" * (done == total), file=sys.stderr, flush=True)


def _has_driver():
    """Return whether NVIDIA's driver is here, without which cuda-cccl compiles nothing."""
    try:
        gpu.driver()
    except OSError:
        return False
    return True


def main(words=None):
    """Compile all recorded kernels and print the wheel's path and size."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pack", description=__doc__)
    parser.add_argument("--out", required=True, metavar="FOLDER", help="Where the wheel goes.")
    parser.add_argument(
        "--cuda", action="append", default=[], metavar="CAPABILITY", dest="capabilities",
        help="A compute capability, such as 9.0, whose kernels are packed too; may be repeated.",
    )  # fmt: skip
    given = parser.parse_args(words)
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        sys.exit("kernels are packed on Linux on x86-64 alone; run this there")
    entries = needed((*ALL, *ALL_CUDA))
    if given.capabilities and not _has_driver():
        entries = [entry for entry in entries if entry.kernel != SORT]
        print(f"without {SORT}: it is compiled where NVIDIA's driver is", file=sys.stderr)
    path = make(given.out, entries, _progress, given.capabilities)
    print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)")


if __name__ == "__main__":
    main()
